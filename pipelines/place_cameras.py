"""Find where the cameras of a robot go: `python -m pipelines.place_cameras [overrides]`."""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .app import choices, flat_settings, run_directory
from .building import budget_of, build_optimiser, build_problem, camera_of, instantiate, keyed, settings_of
from .earlier_run import RIG, read_earlier_run
from .earlier_settings import settings_now
from .input_files import contents_of
from .operations.signals import Stopped, stop
from .optimise import RETURNS, SAME_WHEN_RESUMED, run_optimiser, tell_how_to_go_on
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.cameras.problem import CameraProblem
    from lmd.optimisers.base import Result
    from lmd.optimisers.ledger import Record
    from lmd.scene.camera import Camera
    from lmd.scene.deployment import Deployment
    from lmd.scene.rig import Rig

    from .operations.tracking import Tracker

DRAWING = "body.png"


def place_cameras(cfg: DictConfig) -> float:
    """Place cameras as configured; returns the figure that sweepers are to go by."""
    from lmd.core.checks import InputError, choice, integer, real
    from lmd.optimisers.checkpoint import Checkpoint

    from .tracked_run import Earlier, record, title_of, tracked

    problem, sources = build_camera_problem(cfg)
    budget = budget_of(cfg)
    real("checkpoint_seconds", cfg.checkpoint_seconds, above=0.0)
    returned = RETURNS[choice("returns", cfg.returns, list(RETURNS))]
    if returned == "off_grid" and not cfg.validate:
        raise InputError("returns = grid_free is a figure of the validation, which validate=false leaves out.")
    rounds = 0 if cfg.rounds is None else integer("rounds", cfg.rounds, low=1)
    integer("tag_evaluations", cfg.tag_evaluations, low=1)
    if rounds and cfg.resume is not None:
        raise InputError("resume cannot go on within rounds; run=DIR begins with the cameras and tags of that run.")
    optimiser = build_optimiser(cfg, cfg.seed)
    as_now = partial(settings_now, optimiser=cfg.optimiser)
    settings = as_now(flat_settings(cfg, *SAME_WHEN_RESUMED, "body", "cameras"))
    settings |= contents_of(settings)
    optimiser.check(problem)
    checkpoint, earlier = Checkpoint(optimiser, settings, settings_now=as_now), None
    if cfg.resume is not None:
        checkpoint.resume(cfg.resume, problem)
        earlier = Earlier(checkpoint.run_id, Path(cfg.resume))
    subject = choices()["optimiser"]
    about = f"{problem.space.count} cameras, {title_of(problem, subject)}"
    try:
        with tracked(cfg, subject, about, earlier) as tracker:
            if rounds:
                found, further, in_haste = _in_turn(cfg, problem, rounds)
            else:
                (found, in_haste), further = run_optimiser(cfg, problem, budget, checkpoint, tracker), {}
            interrupted = found.stopped == "interrupted"
            assert found.rig is not None, "cameras were placed"
            _write(problem, found.rig, sources, about, tracker, draw=bool(cfg.picture) and not in_haste)
            figures = record(
                cfg,
                problem.with_rig(found.rig),
                tracker,
                found.deployment,
                found.history,
                subject=subject,
                summary={
                    "evaluations": found.evaluations,
                    "wall_time": found.seconds,
                    "stopped": found.stopped,
                    "cameras": problem.space.count,
                    **further,
                },
                status="KILLED" if interrupted else "FINISHED",
                in_haste=in_haste,
            )
    except (Stopped, OSError):
        tell_how_to_go_on("place_cameras")
        raise
    if interrupted:
        tell_how_to_go_on("place_cameras")
        sys.exit(stop.code)
    return figures[returned]


def build_camera_problem(cfg: DictConfig) -> "tuple[CameraProblem, dict[Camera, Any]]":
    """The problem a composed configuration describes, and which calibration each kind of camera has.

    Raises:
        InputError: its parts do not fit together.
    """
    import numpy as np

    from lmd.cameras.mounts import MountSpace
    from lmd.cameras.problem import CameraProblem
    from lmd.core.checks import InputError
    from lmd.scene.rig import Rig
    from lmd.scene.rig_sources import camera_from
    from lmd.space.parts import made

    alone = cfg.camera.copy()
    with open_dict(alone):
        rig = alone.pop("rig", None)
    given = OmegaConf.to_container(settings_of(cfg, "cameras"), resolve=True)
    assert isinstance(given, dict)
    sources: dict[Camera, Any] = {}
    if given["lenses"]:
        for i, source in enumerate(given["lenses"]):
            with keyed(camera=f"cameras.lenses[{i}]"):
                camera = camera_from(source)
            if camera is None:
                raise InputError(f"cameras.lenses[{i}] must be a calibration file, got null.")
            sources[camera] = source
        lenses = list(sources)
    else:
        lenses = [instantiate(alone)]
    tags = build_problem(cfg)
    body = instantiate(settings_of(cfg, "body"))
    space = made("cameras", MountSpace, {**given, "body": body, "lenses": lenses})
    start = camera_of(cfg.camera) if rig is not None else None
    with keyed("cameras", rig="camera.rig", boxes="body.boxes"):
        assert start is None or isinstance(start, Rig)
        return CameraProblem(tags, tags.draw(np.random.default_rng(cfg.seed)), space, start), sources


def _write(
    problem: "CameraProblem", rig: "Rig", sources: "dict[Camera, Any]", title: str, tracker: "Tracker", draw: bool
) -> None:
    """Write the rig file and the drawing, and log them."""
    from lmd.plot.body import save_body_figure
    from lmd.scene.rig_sources import write_rig

    def write(folder: Path) -> None:
        write_rig(folder / RIG, rig, sources)
        if draw:
            save_body_figure(folder / DRAWING, problem.space.body, rig, title)

    with stop.shielded():
        tracker.log_artifacts(all_or_none(run_directory(), write))


def _in_turn(cfg: DictConfig, problem: "CameraProblem", rounds: int) -> "tuple[Result, dict[str, Any], bool]":
    """Place cameras, then tags, and so on; each turn begins with the best so far, and is dropped if it is no better."""
    from lmd.cameras.problem import CameraProblem
    from lmd.optimisers.annealing import Annealing
    from lmd.optimisers.ledger import Budget
    from lmd.scene.deployment_sources import GivenDeployment

    tags: Deployment = problem.tags
    best: Result | None = None
    history: list[Record] = []
    told: dict[str, float] = {}

    def better(found: "Result", turn: str) -> "Result":
        spent, by_then = (history[-1].evaluations, history[-1].wall_time) if history else (0, 0.0)
        least = best.fitness if best else -1.0
        history.extend(
            replace(r, evaluations=spent + r.evaluations, best_fitness=max(r.best_fitness, least),
                    wall_time=by_then + r.wall_time)
            for r in found.history
        )  # fmt: skip
        kept = found if best is None or found.fitness > best.fitness else best
        told[turn] = kept.fitness
        print(f"{turn.replace('_', ' ')}: fitness {kept.fitness:.4%}")
        return replace(kept, evaluations=history[-1].evaluations, seconds=history[-1].wall_time)

    for i in range(1, rounds + 1):
        placing = CameraProblem(problem, tags, problem.space, best.rig if best else None) if best else problem
        best = better(build_optimiser(cfg, cfg.seed + i - 1).run(placing, budget_of(cfg)), f"round_{i}_cameras")
        assert best.rig is not None
        hanging = problem.with_rig(best.rig, GivenDeployment(problem.free(tags)))
        moved = Annealing(seed=cfg.seed + i - 1).run(hanging, Budget(cfg.tag_evaluations))
        best = better(replace(moved, rig=best.rig), f"round_{i}_tags")
        tags = best.deployment
    assert best is not None
    return replace(best, history=tuple(history)), {"rounds": told}, False


main = Pipeline("place_cameras", place_cameras, (read_earlier_run,))

if __name__ == "__main__":
    main()
