"""Find where the cameras of a robot go: `python -m pipelines.place_cameras [overrides]`."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .app import choices, run_directory
from .building import budget_of, build_optimiser, build_problem, camera_of
from .earlier_run import RIG, read_earlier_robot
from .nodes import instantiate, keyed, note, settings_of
from .operations.signals import Stopped, stop
from .optimise import checkpoint_of, figure_returned, run_optimiser, tell_how_to_go_on
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.cameras.problem import CameraProblem
    from lmd.geometry.camera import Camera
    from lmd.optimisers.base import Optimiser
    from lmd.scene.rig import Rig

    from .operations.tracking import Tracker

DRAWING = "body.png"


def place_cameras(cfg: DictConfig) -> float:
    """Place cameras as configured; returns the figure that sweepers are to go by."""
    from .tracked_run import record, title_of, tracked

    problem, sources = build_camera_problem(cfg)
    budget = budget_of(cfg)
    returned = figure_returned(cfg)
    optimiser = build_optimiser_of(cfg)
    optimiser.check(problem)
    in_turn = () if cfg.rounds is None else ("rounds", "tag_evaluations")
    checkpoint, earlier = checkpoint_of(cfg, optimiser, problem, "body", "cameras", *in_turn)
    subject = choices()["optimiser"]
    about = f"{problem.space.count} cameras, {title_of(problem, subject)}"
    try:
        with tracked(cfg, subject, about, earlier) as tracker:
            found, in_haste = run_optimiser(cfg, problem, budget, checkpoint, tracker)
            rounds = dict(optimiser.figures()) if in_turn else {}
            for turn, fitness in rounds.items():
                print(f"{turn.replace('_', ' '):<19} fitness {fitness:.4%}")
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
                    **({"rounds": rounds} if in_turn else {}),
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


def build_optimiser_of(cfg: DictConfig) -> "Optimiser":
    """What places the cameras, or both cameras and tags in `rounds`."""
    from lmd.core.checks import integer
    from lmd.optimisers.alternating import Alternating
    from lmd.optimisers.ledger import Budget

    tag_evaluations = integer("tag_evaluations", cfg.tag_evaluations, low=1)
    if cfg.rounds is None:
        return build_optimiser(cfg, cfg.seed)
    return Alternating(partial(build_optimiser, cfg), cfg.rounds, Budget(tag_evaluations), cfg.seed)


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
            note(camera.note)
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
    from lmd.plot.body_drawing import save_body_figure
    from lmd.scene.rig_sources import write_rig

    def write(folder: Path) -> None:
        write_rig(folder / RIG, rig, sources)
        if draw:
            save_body_figure(folder / DRAWING, problem.space.body, rig, title)

    with stop.shielded():
        tracker.log_artifacts(all_or_none(run_directory(), write))


main = Pipeline("place_cameras", place_cameras, (read_earlier_robot,))

if __name__ == "__main__":
    main()
