"""Find a deployment: `python -m pipelines.optimise [overrides]`."""

import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

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
    from lmd.scene.deployment import Deployment

    from .operations.tracking import Tracker
    from .tracked_run import Earlier

# What a resumed run must share with the run it continues, and with it the contents of the files that are named there.
SAME_WHEN_RESUMED = (
    "room", "camera", "pdf", "poses", "tag", "visibility", "objective", "encoding", "deployment", "optimiser", "seed"
)  # fmt: skip
RETURNS = {"fitness": "fitness", "grid_free": "off_grid"}  # figures of `record` that sweepers may go by


def optimise(cfg: DictConfig) -> float:
    """Run one optimisation as configured; returns the figure that sweepers are to go by."""
    from .tracked_run import record, title_of, tracked

    problem = build_problem(cfg)
    budget = budget_of(cfg)
    returned = figure_returned(cfg)
    optimiser = build_optimiser(cfg, cfg.seed)
    export = build_export(cfg, "export", problem.scene.tag)
    optimiser.check(problem)
    checkpoint, earlier = checkpoint_of(cfg, optimiser, problem)
    subject = choices()["optimiser"]
    try:
        with tracked(cfg, subject, title_of(problem, subject), earlier) as tracker:
            result, in_haste = run_optimiser(cfg, problem, budget, checkpoint, tracker)
            interrupted = result.stopped == "interrupted"
            figures = record(
                cfg,
                problem,
                tracker,
                result.deployment,
                result.history,
                subject=subject,
                summary={
                    "evaluations": result.evaluations,
                    "wall_time": result.seconds,
                    "stopped": result.stopped,
                    **optimiser.figures(),
                },
                further=lambda: _accuracy(cfg, problem, result.deployment),
                export=export,
                status="KILLED" if interrupted else "FINISHED",
                in_haste=in_haste,
            )
    except (Stopped, OSError):
        tell_how_to_go_on("optimise")
        raise
    if interrupted:
        tell_how_to_go_on("optimise")
        sys.exit(stop.code)
    return figures[returned]


def figure_returned(cfg: DictConfig) -> str:
    """The figure of `record` that sweepers are to go by.

    Raises:
        InputError: there is none of that name, or it will not be there.
    """
    from lmd.core.checks import InputError, choice

    returned = RETURNS[choice("returns", cfg.returns, list(RETURNS))]
    if returned == "off_grid" and not cfg.validate:
        raise InputError("returns = grid_free is a figure of the validation, which validate=false leaves out.")
    return returned


def checkpoint_of(
    cfg: DictConfig, optimiser: "Optimiser", problem: "Problem", *further: str
) -> "tuple[Checkpoint, Earlier | None]":
    """The checkpoint of a run, and the run that it goes on with if one is resumed.

    Args:
        optimiser: what is kept.
        further: groups that a resumed run must share beside `SAME_WHEN_RESUMED`.

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


def tell_how_to_go_on(pipeline: str) -> None:
    """Say which command goes on with an interrupted run, if it left a checkpoint."""
    from lmd.optimisers.checkpoint import CHECKPOINT_FILE

    directory = run_directory()
    if (directory / CHECKPOINT_FILE).exists():
        print(f"interrupted; go on with: {resuming(pipeline, directory)}", file=sys.stderr)


def _accuracy(cfg: DictConfig, problem: "Problem", deployment: "Deployment") -> dict[str, float]:
    """How well an image localises the camera, where that is what the deployment is for."""
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.objectives.localisation import Localisation

    wanted = cfg.validate and isinstance(problem.objective, Localisation)
    return accuracy_metrics(problem, deployment, cfg.seed) if wanted else {}


def run_optimiser(
    cfg: DictConfig, problem: "Problem", budget: "Budget", checkpoint: "Checkpoint", tracker: "Tracker"
) -> "tuple[Result, bool]":
    """Optimise; returns what was found, and whether it was told to stop so urgently that it left a batch undone."""
    from lmd.core.compiled import is_compiling

    from .progress import Progress, Watch

    directory, optimiser = run_directory(), checkpoint.optimiser
    goes_on, before = tracker.run_id == checkpoint.run_id, optimiser.ledger.evaluations
    checkpoint.run_id = tracker.run_id
    progress = Progress(budget, tracker, checkpoint, directory, cfg.checkpoint_seconds, logged=goes_on)
    with space_reserved(directory), closing(progress):
        try:
            watch = Watch(optimiser, budget)

            def worth_waiting() -> bool:
                return optimiser.ledger.evaluations > before and not is_compiling() and not watch.is_overdue

            with stop.deferred(worth_waiting), watch:
                result = optimiser.run(problem, budget, progress)
                progress.flush(optimiser)
            return result, False
        except Stopped:
            if optimiser.ledger.evaluations == 0:
                raise
            return optimiser.result(problem, "interrupted"), True


main = Pipeline("optimise", optimise, (read_earlier_run,))

if __name__ == "__main__":
    main()
