"""Find a deployment: `python -m pipelines.optimise [overrides]`."""

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from .app import choices, flat_settings, run_directory
from .building import budget_of, build_optimiser, build_problem
from .earlier_run import read_earlier_run
from .export import build_export
from .operations.signals import Stopped, stop
from .outputs import space_reserved
from .pipeline import Pipeline
from .provenance import contents_of, resuming

if TYPE_CHECKING:
    from lmd.optimisers.base import Optimiser, Result
    from lmd.optimisers.checkpoint import Checkpoint
    from lmd.optimisers.ledger import Budget
    from lmd.problem import Problem

    from .operations.tracking import Tracker
    from .tracked_run import Earlier

# Settings that a resumed run shares with the run that it continues; files named in them must have equal contents.
SAME_WHEN_RESUMED = (
    "room", "camera", "pdf", "poses", "tag", "visibility", "objective", "encoding", "deployment", "optimiser", "seed"
)  # fmt: skip
RETURNS = {"fitness": "fitness", "grid_free": "off_grid"}  # figures of `record` that sweepers may maximise


def optimise(cfg: DictConfig) -> float:
    """Run one optimisation as configured, and return the figure for sweepers."""
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.objectives.localisation import Localisation

    from .tracked_run import Extras, record, title_of

    problem = build_problem(cfg)
    optimiser = build_optimiser(cfg, cfg.seed)
    export = build_export(cfg, "export", problem.scene.tag)
    extras, subject = Extras.of(cfg), choices()["optimiser"]

    def keep(tracker: "Tracker", found: "Result", in_haste: bool) -> dict[str, float]:
        def accuracy() -> dict[str, float]:
            wanted = extras.validate and isinstance(problem.objective, Localisation)
            return accuracy_metrics(problem, found.deployment, extras.seed) if wanted else {}

        summary = {**summary_of(found), **optimiser.figures()}
        return record(
            extras, problem, tracker, found.deployment, found.history, subject=subject, summary=summary,
            further=accuracy, export=export, in_haste=in_haste,
        )  # fmt: skip

    return searched(cfg, problem, optimiser, title_of(problem, subject), keep)


def searched(
    cfg: DictConfig, problem: "Problem", optimiser: "Optimiser", about: str,
    keep: "Callable[[Tracker, Result, bool], dict[str, float]]", further: Sequence[str] = (),
) -> float:  # fmt: skip
    """Run an optimiser as a tracked run that can be resumed, and return the figure for sweepers.

    Args:
        about: description of the run.
        keep: function that records the result and returns the figures; its argument is True in haste.
        further: groups that a resumed run must share, in addition to `SAME_WHEN_RESUMED`.

    Raises:
        InputError: a setting is refused, or the run to resume has other settings.
    """
    from .tracked_run import draw_room, tracked

    budget, returned = budget_of(cfg), _figure_returned(cfg.returns, cfg.validate)
    optimiser.check(problem)
    checkpoint, earlier = _checkpoint_of(cfg, optimiser, problem, further)
    try:
        with tracked(cfg, choices()["optimiser"], about, earlier, problem) as tracker:
            draw_room(cfg, problem, tracker)
            found, in_haste = _run(problem, budget, checkpoint, tracker, cfg.checkpoint_seconds)
            figures = keep(tracker, found, in_haste)
    except (Stopped, OSError):
        _print_how_to_go_on()
        raise
    if found.stopped == "interrupted":
        _print_how_to_go_on()
        sys.exit(stop.code)
    return figures[returned]


def summary_of(found: "Result") -> dict[str, Any]:
    """Entries of metrics.json about the search itself."""
    return {"evaluations": found.evaluations, "wall_time": found.seconds, "stopped": found.stopped}


def _figure_returned(returns: Any, validate: bool) -> str:
    """Name of the figure of `record` that sweepers maximise according to the setting `returns`.

    Raises:
        InputError: no figure has that name, or the run does not compute the figure.
    """
    from lmd.core.checks import InputError, choice

    returned = RETURNS[choice("returns", returns, list(RETURNS))]
    if returned == "off_grid" and not validate:
        raise InputError("returns = grid_free is a figure of the validation, which validate=false leaves out.")
    return returned


def _checkpoint_of(
    cfg: DictConfig, optimiser: "Optimiser", problem: "Problem", further: Sequence[str]
) -> "tuple[Checkpoint, Earlier | None]":
    """Make the checkpoint of a run; also return the run that is resumed, if any.

    Raises:
        InputError: the run to resume has other settings, or cannot be read.
    """
    from lmd.core.checks import real
    from lmd.optimisers.checkpoint import Checkpoint

    from .tracked_run import Earlier

    real("checkpoint_seconds", cfg.checkpoint_seconds, above=0.0)
    settings = flat_settings(cfg, *SAME_WHEN_RESUMED, *further)
    checkpoint = Checkpoint(optimiser, settings | contents_of(settings))
    if cfg.resume is None:
        return checkpoint, None
    checkpoint.resume(cfg.resume, problem)
    return checkpoint, Earlier(checkpoint.run_id, Path(cfg.resume))


def _run(
    problem: "Problem", budget: "Budget", checkpoint: "Checkpoint", tracker: "Tracker", every: float
) -> "tuple[Result, bool]":
    """Optimise; return the result, and True if a second signal ended the run in the middle of a batch.

    Args:
        every: time between checkpoints, seconds.
    """
    from lmd.core.compiled import is_compiling

    from .progress import Progress, Watch

    directory, optimiser = run_directory(), checkpoint.optimiser
    goes_on, before = tracker.run_id == checkpoint.run_id, optimiser.ledger.evaluations
    checkpoint.run_id = tracker.run_id
    progress = Progress(budget, tracker, checkpoint, directory, every, logged=goes_on)
    with space_reserved(directory), closing(progress):
        try:
            watch = Watch(optimiser, budget)

            def worth_waiting() -> bool:
                return optimiser.ledger.evaluations > before and not is_compiling() and not watch.is_overdue

            with stop.deferred(worth_waiting), watch:
                result = optimiser.run(problem, budget, progress)
                progress.flush(optimiser, ended=result.stopped != "interrupted")
            return result, False
        except Stopped:
            if optimiser.ledger.evaluations == 0:
                raise
            return optimiser.result(problem, "interrupted"), True


def _print_how_to_go_on() -> None:
    """Print the command that resumes this run, if it left a checkpoint."""
    from lmd.optimisers.checkpoint import CHECKPOINT_FILE

    directory = run_directory()
    if (directory / CHECKPOINT_FILE).exists():
        print(f"interrupted; go on with: {resuming(HydraConfig.get().job.name, directory)}", file=sys.stderr)


main = Pipeline("optimise", optimise, (read_earlier_run,))

if __name__ == "__main__":
    main()
