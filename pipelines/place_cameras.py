"""Find where the cameras of a robot go: `python -m pipelines.place_cameras [overrides]`."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .app import choices, run_directory
from .building import budget_of, build_optimiser, build_problem, camera_of, instantiate, keyed, settings_of
from .earlier_run import RIG, read_earlier_run
from .operations.signals import Stopped, stop
from .optimise import checkpoint_of, figure_returned, run_optimiser, tell_how_to_go_on
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.cameras.problem import CameraProblem
    from lmd.optimisers.base import Result
    from lmd.optimisers.ledger import Ledger, Record
    from lmd.scene.camera import Camera
    from lmd.scene.rig import Rig

    from .operations.tracking import Tracker

DRAWING = "body.png"


def place_cameras(cfg: DictConfig) -> float:
    """Place cameras as configured; returns the figure that sweepers are to go by."""
    from lmd.core.checks import InputError, integer

    from .tracked_run import record, title_of, tracked

    problem, sources = build_camera_problem(cfg)
    budget = budget_of(cfg)
    returned = figure_returned(cfg)
    rounds = 0 if cfg.rounds is None else integer("rounds", cfg.rounds, low=1)
    integer("tag_evaluations", cfg.tag_evaluations, low=1)
    if rounds and cfg.resume is not None:
        raise InputError("resume cannot go on within rounds; run=DIR begins with the cameras and tags of that run.")
    optimiser = build_optimiser(cfg, cfg.seed)
    optimiser.check(problem)
    checkpoint, earlier = checkpoint_of(cfg, optimiser, problem, "body", "cameras")
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
            print(f"rig                 {run_directory() / RIG}")
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
    """Place cameras, then tags, and so on; each turn begins with the best so far, and is dropped if it is no better.

    Returns:
        the best; the fitness after each turn; whether it was told to stop so urgently that it left a batch undone.
    """
    from lmd.cameras.problem import CameraProblem
    from lmd.optimisers.annealing import Annealing
    from lmd.optimisers.base import Optimiser
    from lmd.optimisers.ledger import Budget
    from lmd.problem import Problem
    from lmd.scene.deployment_sources import GivenDeployment

    best: Result | None = None
    history: list[Record] = []
    told: dict[str, float] = {}
    for turn in range(2 * rounds):
        seed, name = cfg.seed + turn // 2, f"round_{1 + turn // 2}_{'tags' if turn % 2 else 'cameras'}"
        optimiser: Optimiser
        posed: Problem
        if turn % 2:
            assert best is not None
            assert best.rig is not None
            optimiser, budget = Annealing(seed=seed), Budget(cfg.tag_evaluations)
            posed = problem.with_rig(best.rig, GivenDeployment(problem.free(best.deployment)))
        else:
            optimiser, budget = build_optimiser(cfg, seed), budget_of(cfg)
            posed = problem if best is None else CameraProblem(problem, best.deployment, problem.space, best.rig)
        ledger, found, in_haste = optimiser.ledger, None, False
        try:
            with stop.deferred(partial(_is_worth_waiting, optimiser.ledger)):
                found = optimiser.run(posed, budget, lambda _: stop.requested)
        except Stopped:
            if best is None and not ledger.evaluations:
                raise
            in_haste = True
            found = optimiser.result(posed, "interrupted") if ledger.evaluations else None
        if found is not None:
            history += _after(history, found.history)
            if best is None or found.fitness > best.fitness:
                best = replace(found, rig=best.rig if turn % 2 and best else found.rig)
            told[name] = best.fitness
            print(f"{name.replace('_', ' ')}: fitness {best.fitness:.4%}")
        if found is None or found.stopped == "interrupted":
            break
    assert best is not None
    last, stopped = history[-1], "interrupted" if stop.requested else "budget"
    whole = replace(
        best, evaluations=last.evaluations, seconds=last.wall_time, history=tuple(history), stopped=stopped
    )  # fmt: skip
    return whole, {"rounds": told}, in_haste


def _is_worth_waiting(ledger: "Ledger") -> bool:
    """Whether a turn that is told to stop should end its batch first."""
    from lmd.core.compiled import is_compiling

    return ledger.evaluations > 0 and not is_compiling()


def _after(before: "list[Record]", then: "Sequence[Record]") -> "list[Record]":
    """What comes after a history, as a part of it."""
    if not before:
        return list(then)
    last = before[-1]
    return [
        replace(
            record,
            evaluations=last.evaluations + record.evaluations,
            best_fitness=max(last.best_fitness, record.best_fitness),
            wall_time=last.wall_time + record.wall_time,
        )
        for record in then
    ]


main = Pipeline("place_cameras", place_cameras, (read_earlier_run,))

if __name__ == "__main__":
    main()
