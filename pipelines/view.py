"""Plan in the browser: `python -m pipelines.view [run=DIR] [overrides]`."""

import os
import secrets
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from .app import run_directory
from .building import budget_of, build_optimiser, build_problem, mounts_of, refuse_crowd
from .command import Command
from .composing import RIG
from .export import build_export
from .nodes import keyed
from .operations.signals import CODES, stop
from .outputs import write_all

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lmd.cameras.mounts import MountSpace
    from lmd.export.exports import Export
    from lmd.geometry.camera import Camera
    from lmd.planner.plan import Plan
    from lmd.problem import Problem

UNSAVED = "unsaved"  # prefix of files with unsaved changes


def view(cfg: DictConfig) -> None:
    """Serve the planner for the configured deployment until a signal ends it."""
    import numpy as np

    from lmd.core.checks import integer
    from lmd.core.optional import optional
    from lmd.formats.tag_maps import read_deployment
    from lmd.planner.server import Planner
    from lmd.planner.session import PlanningSession

    optional("viser", "view")
    problem = build_problem(cfg)
    refuse_crowd(problem, "view")
    budget = budget_of(cfg)
    build_optimiser(cfg, cfg.seed).check(problem)  # checked before the first search
    tag, directory = problem.scene.tag, run_directory()
    unmapped = tag.is_point and cfg.export is None  # points have no map
    export = None if unmapped else build_export(cfg, "export", tag)
    sources = _calibrations(cfg)
    with keyed(rig="camera.rig"):
        session = PlanningSession(problem, problem.draw(np.random.default_rng(cfg.seed)), _space(cfg, problem))
    session.warm_up()
    planner = Planner(
        session,
        integer("port", cfg.port, low=0, high=65535),
        save=lambda plan: _save(directory, problem, export, plan, sources),
        optimiser=lambda: build_optimiser(cfg, cfg.seed),
        budget=budget,
        seed=cfg.seed if cfg.validate else None,
        survey=None if cfg.survey is None else read_deployment(Path(str(cfg.survey)) / "map.csv", "survey"),
    )
    try:
        print(f"planner {planner.address} (Ctrl-C ends it)", flush=True)
        planner.run()
    finally:
        if not session.is_saved:  # saved first, as closing may fail
            _keep_unsaved(directory, session.plan, sources, ups=not tag.is_point)
        planner.close()


def _space(cfg: DictConfig, problem: "Problem") -> "MountSpace | None":
    """Space of the mounts of a rig; None if mounts are not limited.

    Raises:
        InputError: the body is refused.
    """
    from math import pi

    from lmd.cameras.body import Body
    from lmd.cameras.mounts import MountSpace
    from lmd.scene.rig import Rig
    from lmd.space.parts import made

    rig = problem.scene.camera
    if cfg.body is None or cfg.body.boxes is None or not isinstance(rig, Rig):
        return None
    body, lenses = made("body", OmegaConf.to_container(cfg.body), Body), tuple(dict.fromkeys(rig.cameras))
    return MountSpace(body, lenses, len(rig.mounts), yaw=(-pi, pi), pitch=(-pi / 2, pi / 2), roll=(-pi, pi))


def _calibrations(cfg: DictConfig) -> "Mapping[Camera, Any]":
    """Calibration of each kind of camera for which the rig names a calibration."""
    from lmd.formats.rigs import calibrations_of

    mounts = mounts_of(cfg.camera)
    return {} if mounts is None else calibrations_of(mounts)


def _save(
    directory: Path, problem: "Problem", export: "Export | None", plan: "Plan", sources: "Mapping[Camera, Any]"
) -> str:
    """Write landmarks.csv, the rig if there is one, and the exports, all or none, and return the names of the files."""
    from lmd.formats.rigs import write_rig

    scene = problem.scene
    files: dict[str, Any] = {"landmarks.csv": partial(plan.deployment.to_csv, ups=not scene.tag.is_point)}
    if plan.rig is not None:
        files[RIG] = partial(write_rig, rig=plan.rig, sources=sources)
    files |= export.writers(scene.room, scene.tag, plan.deployment) if export else {}
    with stop.postponed():
        written = write_all(directory, files)
    return f"{directory}: {', '.join(file.name for file in written)}"


def _keep_unsaved(directory: Path, plan: "Plan", sources: "Mapping[Camera, Any]", ups: bool) -> None:
    """Write unsaved tags and cameras to the directory, else to the working or the temporary directory."""
    from lmd.formats.rigs import write_rig

    elsewhere = f"unsaved_{secrets.token_hex(4)}"
    for place, name in ((directory, UNSAVED), (Path.cwd(), elsewhere), (Path(tempfile.gettempdir()), elsewhere)):
        files = {f"{name}.csv": partial(plan.deployment.to_csv, ups=ups)}
        if plan.rig is not None:
            files[f"{name}_{RIG}"] = partial(write_rig, rig=plan.rig, sources=sources)
        try:
            written = write_all(place, files)
        except OSError as error:
            print(f"changes that were not saved cannot be written ({error})", file=sys.stderr)
        else:
            print(f"changes that were not saved are in {' and '.join(map(str, written))}", file=sys.stderr)
            return


command = Command("view", view)


def main() -> None:
    """Run the command; end at once after a signal."""
    try:
        command()
    except SystemExit as ended:
        if ended.code in CODES:  # otherwise Python would wait for threads that compile
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(int(ended.code))
        raise


if __name__ == "__main__":
    main()
