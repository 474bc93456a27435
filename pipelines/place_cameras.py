"""Find where the cameras of a robot go: `python -m pipelines.place_cameras [overrides]`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .app import choices, run_directory
from .building import build_optimiser, build_problem, camera_of
from .crowd import refuse_crowd
from .earlier_run import RIG, read_earlier_robot
from .nodes import instantiate, keyed, note, settings_of
from .operations.signals import stop
from .optimise import searched, summary_of
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.cameras.problem import CameraProblem
    from lmd.geometry.camera import Camera
    from lmd.optimisers.base import Optimiser, Result
    from lmd.scene.rig import Rig

    from .operations.tracking import Tracker

DRAWING = "body.png"


def place_cameras(cfg: DictConfig) -> float:
    """Place cameras as configured, and return the figure for sweepers."""
    from .tracked_run import Extras, record, title_of

    problem, sources = build_camera_problem(cfg)
    optimiser = build_optimiser_of(cfg)
    in_turn = () if cfg.rounds is None else ("rounds", "tag_evaluations")
    extras, subject = Extras.of(cfg), choices()["optimiser"]
    about = f"{problem.space.count} cameras, {title_of(problem, subject)}"

    def keep(tracker: "Tracker", found: "Result", in_haste: bool) -> dict[str, float]:
        rounds = dict(optimiser.figures()) if in_turn else {}
        for turn, fitness in rounds.items():
            print(f"{turn.replace('_', ' '):<19} fitness {fitness:.4%}")
        assert found.rig is not None, "cameras were placed"
        _write(problem, found.rig, sources, about, tracker, draw=bool(extras.picture) and not in_haste)
        summary = {**summary_of(found), "cameras": problem.space.count, **({"rounds": rounds} if in_turn else {})}
        figures = record(
            extras, problem.with_rig(found.rig), tracker, found.deployment, found.history, subject=subject,
            summary=summary, in_haste=in_haste,
        )  # fmt: skip
        print(f"rig                 {run_directory() / RIG}")
        return figures

    return searched(cfg, problem, optimiser, about, keep, ("body", "cameras", *in_turn))


def build_optimiser_of(cfg: DictConfig) -> "Optimiser":
    """Build the optimiser of the cameras, or of cameras and tags in turns if `rounds` is set."""
    from lmd.core.checks import integer
    from lmd.optimisers.alternating import Alternating
    from lmd.optimisers.ledger import Budget

    tag_evaluations = integer("tag_evaluations", cfg.tag_evaluations, low=1)
    if cfg.rounds is None:
        return build_optimiser(cfg, cfg.seed)
    return Alternating(partial(build_optimiser, cfg), cfg.rounds, Budget(tag_evaluations), cfg.seed)


def build_camera_problem(cfg: DictConfig) -> "tuple[CameraProblem, dict[Camera, Any]]":
    """Build the problem of a configuration; also return the calibration of each kind of camera.

    Raises:
        InputError: the parts of the problem do not fit together.
    """
    import numpy as np

    from lmd.cameras.mounts import MountSpace
    from lmd.cameras.problem import CameraProblem
    from lmd.core.checks import InputError
    from lmd.formats.rigs import camera_from
    from lmd.scene.rig import Rig
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
    refuse_crowd(tags, "place_cameras")
    body = instantiate(settings_of(cfg, "body"))
    space = made("cameras", MountSpace, {**given, "body": body, "lenses": lenses})
    start = camera_of(cfg.camera) if rig is not None else None
    with keyed("cameras", rig="camera.rig", boxes="body.boxes"):
        assert start is None or isinstance(start, Rig)
        return CameraProblem(tags, tags.draw(np.random.default_rng(cfg.seed)), space, start), sources


def _write(
    problem: "CameraProblem", rig: "Rig", sources: "dict[Camera, Any]", title: str, tracker: "Tracker", draw: bool
) -> None:
    """Write and log the rig file and the drawing."""
    from lmd.formats.rigs import write_rig
    from lmd.plot.body_drawing import save_body_figure

    def write(folder: Path) -> None:
        write_rig(folder / RIG, rig, sources)
        if draw:
            save_body_figure(folder / DRAWING, problem.space.body, rig, title)

    with stop.shielded():
        tracker.log_artifacts(all_or_none(run_directory(), write))


main = Pipeline("place_cameras", place_cameras, (read_earlier_robot,))

if __name__ == "__main__":
    main()
