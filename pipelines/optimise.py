"""Find a deployment: `python -m pipelines.optimise [overrides]`.

With `varies=cameras` the tags are given, and the poses of a robot's cameras are optimised.
"""

import sys
from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from .app import choices, flat_settings, quoted, run_directory
from .building import budget_of, build_optimiser, build_problem, camera_of, refuse_crowd
from .command import Command
from .composing import GROUPS, RIG, editable
from .export import build_export
from .nodes import instantiate, keyed, note, plain, settings_of
from .operations.signals import Stopped, stop
from .outputs import space_reserved
from .provenance import command_line, contents_of
from .score import room_report, scored
from .study import Report, Study, title_of

if TYPE_CHECKING:
    from lmd.cameras.problem import CameraProblem
    from lmd.geometry.camera import Camera
    from lmd.optimisers.base import Optimiser, Result
    from lmd.optimisers.checkpoint import Checkpoint
    from lmd.optimisers.ledger import Budget
    from lmd.problem import Problem

    from .operations.tracking import Tracker

# Settings that must equal those of the run that is resumed; files named in them must have equal contents.
SAME_WHEN_RESUMED = (*GROUPS, "encoding", "deployment", "optimiser", "seed")


def optimise(cfg: DictConfig) -> Study:
    """Return the study that searches for the best landmarks or, with `varies=cameras`, the best camera poses."""
    from lmd.core.checks import choice

    is_rig = choice("varies", cfg.varies, ("tags", "cameras")) == "cameras"
    cameras = build_camera_problem(cfg) if is_rig else None
    problem: Problem = build_problem(cfg) if cameras is None else cameras[0]
    optimiser = build_optimiser(cfg, cfg.seed)
    export = build_export(cfg, "export", problem.scene.tag) if cfg.export != [] else None
    budget = budget_of(cfg)
    optimiser.check(problem)
    checkpoint = _checkpoint_of(cfg, optimiser, problem)
    earlier = checkpoint.run_id, Path(cfg.resume or "")
    subject = choices()["optimiser"]
    about = f"{f'{cfg.cameras.count} cameras, ' if is_rig else ''}{title_of(problem, subject)}"

    def run(tracker: "Tracker") -> Iterator[Report]:
        yield room_report(cfg, problem)
        found, in_haste = _run(problem, budget, checkpoint, tracker, cfg.checkpoint_seconds)
        summary: dict[str, Any] = {
            **{"evaluations": found.evaluations, "wall_time": found.seconds, "stopped": found.stopped},
            **optimiser.figures(),
        }
        result = found.deployment, found.history, subject
        if found.rig is None or cameras is None:
            yield from scored(cfg, problem, *result, summary, partial(_accuracy, cfg, problem, found), export, in_haste)
            return
        from lmd.formats.rigs import write_rig

        files: dict[str, Any] = {RIG: partial(write_rig, rig=found.rig, sources=cameras[1])}
        with stop.shielded():
            yield Report(files, lines={"rig": str(run_directory() / RIG)})
        summary["cameras"] = cfg.cameras.count
        yield from scored(cfg, problem.with_rig(found.rig), *result, summary, export=export, in_haste=in_haste)

    return Study(subject, run, about, problem, earlier, _how_to_go_on, "fitness")


def _accuracy(cfg: DictConfig, problem: "Problem", found: "Result") -> Mapping[str, float]:
    """Accuracy with which single images localise the camera, as metrics.

    The result is empty unless the objective is `Localisation` and validation is switched on.
    """
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.objectives.localisation import Localisation

    wanted = cfg.validate and isinstance(problem.objective, Localisation)
    return accuracy_metrics(problem, found.deployment, cfg.seed) if wanted else {}


def _checkpoint_of(cfg: DictConfig, optimiser: "Optimiser", problem: "Problem") -> "Checkpoint":
    """Make the checkpoint of a run; a run that resumes an earlier run continues from the earlier run's checkpoint.

    Raises:
        InputError: the run to resume has other settings, or cannot be read.
    """
    from lmd.core.checks import real
    from lmd.optimisers.checkpoint import Checkpoint

    real("checkpoint_seconds", cfg.checkpoint_seconds, above=0.0)
    settings = flat_settings(cfg, *SAME_WHEN_RESUMED, *(("body", "cameras") if "cameras" in cfg else ()))
    checkpoint = Checkpoint(optimiser, settings | contents_of(settings))
    if cfg.resume is not None:
        checkpoint.resume(cfg.resume, problem)
    return checkpoint


def _run(
    problem: "Problem", budget: "Budget", checkpoint: "Checkpoint", tracker: "Tracker", every: float
) -> "tuple[Result, bool]":
    """Run the optimiser; return the result, and True if a second signal ended the run in the middle of a batch.

    Args:
        problem: problem of the run.
        budget: budget of the run.
        checkpoint: checkpoint of the optimiser.
        tracker: tracker that records the curve of the best fitness.
        every: time between checkpoints, seconds.
    """
    from lmd.core.compiled import is_compiling

    from .progress import Progress

    directory, optimiser = run_directory(), checkpoint.optimiser
    goes_on, before = tracker.run_id == checkpoint.run_id, optimiser.ledger.evaluations
    checkpoint.run_id = tracker.run_id
    progress = Progress(budget, tracker, checkpoint, directory, every, logged=goes_on)
    with space_reserved(directory), closing(progress):
        try:
            with stop.deferred(lambda: optimiser.ledger.evaluations > before and not is_compiling()):
                result = optimiser.run(problem, budget, progress)
                progress.flush(optimiser, ended=result.stopped != "interrupted")
            return result, False
        except Stopped:
            if optimiser.ledger.evaluations == 0:
                raise
            return optimiser.result(problem, "interrupted"), True


def _how_to_go_on() -> str:
    """Text with the shell command that resumes this run; empty if there is no checkpoint."""
    from lmd.optimisers.checkpoint import CHECKPOINT_FILE

    if not ((folder := run_directory()) / CHECKPOINT_FILE).exists():
        return ""
    given = [word for word in sys.argv[1:] if not word.startswith("resume=")]
    return f"resume with: {command_line(HydraConfig.get().job.name, [*given, f'resume={quoted(folder)}'])}"


def build_camera_problem(cfg: DictConfig) -> "tuple[CameraProblem, dict[Camera, Any]]":
    """Return the problem of placing cameras, and for each kind of camera the file or keys of its calibration.

    Raises:
        InputError: the parts of the problem do not fit together.
    """
    import numpy as np

    from lmd.cameras.body import Body
    from lmd.cameras.mounts import MountSpace
    from lmd.cameras.problem import CameraProblem
    from lmd.core.checks import InputError
    from lmd.formats.rigs import camera_from
    from lmd.scene.rig import Rig
    from lmd.space.parts import made

    alone = editable(cfg.camera)
    rig = alone.pop("rig", None)
    given, body = (plain(settings_of(cfg, key)) for key in ("cameras", "body"))
    sources: dict[Camera, Any] = {}
    for i, source in enumerate(given["lenses"]):
        with keyed(camera=f"cameras.lenses[{i}]"):
            if (camera := camera_from(source)) is None:
                raise InputError(f"cameras.lenses[{i}] must be a calibration file, got null.")
        sources[camera] = source
        note(camera.note)
    lenses = list(sources) or [instantiate(alone)]
    tags = build_problem(cfg)
    refuse_crowd(tags, "optimise varies=cameras")
    space = made("cameras", {**given, "body": made("body", body, Body), "lenses": lenses}, MountSpace)
    start = None if rig is None else camera_of(cfg.camera)
    assert start is None or isinstance(start, Rig)
    with keyed("cameras", rig="camera.rig", boxes="body.boxes"):
        return CameraProblem(tags, tags.draw(np.random.default_rng(cfg.seed)), space, start), sources


main = Command("optimise", optimise)

if __name__ == "__main__":
    main()
