"""Find a deployment: `python -m pipelines.optimise [overrides]`."""

import shlex
import sys
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from .app import (
    CONF,
    build_optimiser,
    build_problem,
    choices,
    command_of,
    config_dir,
    flat_settings,
    keyed,
    run_directory,
    search_path,
)
from .earlier_run import read_earlier_run
from .input_files import contents_of
from .sweeps.supervisor import run

if TYPE_CHECKING:
    from lmd.checkpoint import Checkpoint
    from lmd.deployment import Deployment
    from lmd.optimisers.base import Budget, Result
    from lmd.problem import Problem

    from .tracking import Tracker

# What a resumed run must share with the run it continues, and with it the contents of the files that are named there.
SAME_WHEN_RESUMED = (
    "room", "camera", "pdf", "tag", "visibility", "objective", "encoding", "deployment", "optimiser", "seed"
)  # fmt: skip


def main() -> None:
    """Read `run=DIR`, then hand over to Hydra."""
    read_earlier_run()
    _main()


@hydra.main(version_base="1.3", config_path=CONF, config_name="optimise")
def _main(cfg: DictConfig) -> float | None:
    """Optimise, record and show; returns the best fitness, for sweepers."""
    return run(cfg, optimise)


def optimise(cfg: DictConfig) -> float:
    """Run one optimisation as configured."""
    from lmd.checkpoint import Checkpoint
    from lmd.checks import real
    from lmd.optimisers.base import Budget

    from .tracked_run import record, tracked_run

    problem = build_problem(cfg)
    with keyed("budget"):
        budget = Budget(cfg.budget.evaluations, cfg.budget.seconds)
    real("checkpoint_seconds", cfg.checkpoint_seconds, above=0.0)
    settings = flat_settings(cfg, *SAME_WHEN_RESUMED)
    settings |= contents_of(settings)
    checkpoint = Checkpoint(build_optimiser(cfg, cfg.seed), settings)
    if cfg.resume is not None:
        checkpoint.resume(cfg.resume)
    subject = choices()["optimiser"]
    with tracked_run(cfg, problem, subject, checkpoint.run_id) as tracker:
        checkpoint.run_id = tracker.run_id
        result = _run(cfg, problem, budget, checkpoint, tracker)
        interrupted = result.stopped == "interrupted"
        fitness = record(
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
                **_accuracy(cfg, problem, result.deployment),
            },
            status="KILLED" if interrupted else "FINISHED",
        )
    if interrupted:
        overrides = [o for o in HydraConfig.get().overrides.task if not o.startswith("resume=")]
        again = shlex.join([*config_dir(), *search_path(), *overrides, f"resume={run_directory()}"])
        print(f"interrupted; go on with: {command_of('optimise')} {again}", file=sys.stderr)
        sys.exit(130)
    return fitness


def _accuracy(cfg: DictConfig, problem: "Problem", deployment: "Deployment") -> dict[str, float]:
    """How well an image localises the camera, where that is what the deployment is for."""
    from lmd.accuracy import accuracy_metrics
    from lmd.objectives.localisation import Localisation

    wanted = cfg.validate and isinstance(problem.objective, Localisation)
    return accuracy_metrics(problem, deployment, cfg.seed) if wanted else {}


def _run(
    cfg: DictConfig, problem: "Problem", budget: "Budget", checkpoint: "Checkpoint", tracker: "Tracker"
) -> "Result":
    from .progress import Progress, StopOnSignal

    directory = run_directory()
    with StopOnSignal() as stop:
        progress = Progress(
            budget,
            tracker,
            save=lambda: checkpoint.save(directory),
            every=cfg.checkpoint_seconds,
            stop=stop,
            resumed=checkpoint.optimiser,
        )
        try:
            result = checkpoint.optimiser.run(problem, budget, progress)
            progress.flush(checkpoint.optimiser)
        finally:
            progress.close()
    return result


if __name__ == "__main__":
    main()
