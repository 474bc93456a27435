"""Plan in the browser: `python -m pipelines.view [run=DIR] [overrides]`."""

import os
import secrets
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import run_directory
from .building import budget_of, build_optimiser, build_problem, mounts_of
from .earlier_run import RIG, read_earlier_robot
from .export import build_export
from .nodes import instantiate, keyed
from .operations.signals import CODES, stop
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lmd.cameras.mounts import MountSpace
    from lmd.geometry.camera import Camera
    from lmd.mapping.formats import Export
    from lmd.planner.plan import Plan
    from lmd.problem import Problem

UNSAVED = "unsaved"  # how files of what was not saved begin


def view(cfg: DictConfig) -> None:
    """Let the configured deployment be changed in a browser."""
    import numpy as np

    from lmd.core.checks import integer
    from lmd.core.optional import optional
    from lmd.planner.app import Planner
    from lmd.planner.session import PlanningSession
    from lmd.planner.survey_map import SurveyMap

    optional("viser", "view")
    problem = build_problem(cfg)
    budget = budget_of(cfg)
    build_optimiser(cfg, cfg.seed).check(problem)  # what is wrong with it shows now, not at the first search
    tag, directory = problem.scene.tag, run_directory()
    nothing = tag.is_point and cfg.export is None  # of a point there is no map
    export = None if nothing else build_export(cfg, "export", tag)
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
        survey=None if cfg.survey is None else SurveyMap.read(cfg.survey),
    )
    try:
        print(f"planner {planner.address} (Ctrl-C ends it)", flush=True)
        planner.run()
    finally:
        if not session.is_saved:  # first of all, whatever may be in the way of ending well
            _keep_unsaved(directory, session.plan, sources, ups=not tag.is_point)
        planner.close()


def _space(cfg: DictConfig, problem: "Problem") -> "MountSpace | None":
    """Where the cameras of a rig may go; None for anywhere.

    Raises:
        InputError: the body is none.
    """
    from math import pi

    from lmd.cameras.mounts import MountSpace
    from lmd.scene.rig import Rig

    rig = problem.scene.camera
    if cfg.body.boxes is None or not isinstance(rig, Rig):
        return None
    body, lenses = instantiate(cfg.body), tuple(dict.fromkeys(rig.cameras))
    return MountSpace(body, lenses, len(rig.mounts), yaw=(-pi, pi), pitch=(-pi / 2, pi / 2), roll=(-pi, pi))


def _calibrations(cfg: DictConfig) -> "Mapping[Camera, Any]":
    """Which calibration each kind of camera of the rig has, as far as the rig says."""
    from lmd.scene.rig_sources import calibrations_of

    mounts = mounts_of(cfg.camera)
    return {} if mounts is None else calibrations_of(mounts)


def _save(
    directory: Path, problem: "Problem", export: "Export | None", plan: "Plan", sources: "Mapping[Camera, Any]"
) -> str:
    """Write landmarks.csv, the rig if cameras can be moved, and what is exported, all or nothing; says where."""
    from lmd.scene.rig_sources import write_rig

    scene = problem.scene
    writers = export.writers(scene.room, scene.tag, plan.deployment) if export else {}

    def write(folder: Path) -> None:
        plan.deployment.to_csv(folder / "landmarks.csv", ups=not scene.tag.is_point)
        if plan.rig is not None:
            write_rig(folder / RIG, plan.rig, sources)
        for name, write_one in writers.items():
            write_one(folder / name)

    with stop.postponed():
        files = all_or_none(directory, write)
    return f"{directory}: {', '.join(file.name for file in files)}"


def _keep_unsaved(directory: Path, plan: "Plan", sources: "Mapping[Camera, Any]", ups: bool) -> None:
    """Write unsaved tags and cameras to the directory, or else to the working or the temporary directory, or stdout."""
    from lmd.scene.rig_sources import rig_text

    elsewhere, rig = f"unsaved_{secrets.token_hex(4)}", None if plan.rig is None else rig_text(plan.rig, sources)

    def write(name: str, folder: Path) -> None:
        plan.deployment.to_csv(folder / f"{name}.csv", ups)
        if rig is not None:
            (folder / f"{name}_{RIG}").write_text(rig, encoding="utf-8")

    for place, name in ((str(directory), UNSAVED), (os.curdir, elsewhere), ("", elsewhere)):
        try:
            folder = Path(place or tempfile.gettempdir())  # there may be none
            files = all_or_none(folder.resolve(), partial(write, name))
        except OSError as error:
            print(f"changes that were not saved cannot be written ({error})", file=sys.stderr)
        else:
            print(f"changes that were not saved are in {' and '.join(map(str, files))}", file=sys.stderr)
            return
    print("the tags as they are now:", flush=True)
    plan.deployment.to_csv(sys.stdout, ups)
    if rig is not None:
        print(f"the cameras as they are now:\n{rig}")
    sys.stdout.flush()


command = Pipeline("view", view, (read_earlier_robot,))


def main() -> None:
    """Serve until told to stop."""
    try:
        command()
    except SystemExit as ended:
        if ended.code in CODES:  # Python would wait for threads that compile
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(int(ended.code))
        raise


if __name__ == "__main__":
    main()
