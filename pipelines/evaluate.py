"""Score a deployment: `python -m pipelines.evaluate deployment=uniform|random|greedy|file [overrides]`."""

from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import application, build_problem, choices, run_directory
from .earlier_run import read_earlier_run
from .sweeps.supervisor import run

if TYPE_CHECKING:
    from lmd.deployment import Deployment
    from lmd.losses import Losses
    from lmd.problem import Problem
    from lmd.sensitivity import Sensitivity

    from .tracking import Tracker


def main() -> None:
    """Read `run=DIR`, then hand over to Hydra."""
    read_earlier_run()
    _main()


@application("evaluate")
def _main(cfg: DictConfig) -> float | None:
    """Score, record and show; returns the fitness."""
    return run(cfg, evaluate)


def evaluate(cfg: DictConfig) -> float:
    """Score the configured deployment."""
    import numpy as np

    from lmd.checks import integer
    from lmd.compiled import clock
    from lmd.optimisers.base import Record

    from .tracked_run import record, title_of, tracked

    began = clock()
    problem = build_problem(cfg)
    seed = integer("seed", cfg.seed, low=0)
    deployment = problem.draw(np.random.default_rng(seed))
    history = [Record(1, problem.metrics(deployment)["fitness"], clock() - began)]
    subject = choices()["deployment"]
    with tracked(cfg, subject, title_of(problem, subject)) as tracker:
        summary: dict[str, Any] = localise(problem, deployment, seed, tracker) if cfg.localisation else {}
        fallen = lose(problem, deployment, tracker) if cfg.losses else None
        summary |= fallen.metrics() if fallen else {}
        varied = vary(problem, deployment, seed, tracker) if cfg.sensitivity else None
        summary |= {"sensitivity": varied.metrics()} if varied else {}
        fitness = record(cfg, problem, tracker, deployment, history, subject=subject, summary=summary)
        if fallen:
            print(f"\n{fallen.to_text()}")
        if varied:
            print(f"\n{varied.to_text()}")
        return fitness


def localise(problem: "Problem", deployment: "Deployment", seed: int, tracker: "Tracker") -> dict[str, float]:
    """Write and log the maps of how well a single frame is localised; returns the figures."""
    from lmd.accuracy import accuracy_metrics, save_accuracy_map
    from lmd.localisation.cramer_rao import cramer_rao_map
    from lmd.plot.localisation import save_cramer_rao_map

    from .tracked_run import title_of

    bounds = cramer_rao_map(problem.scene, problem.evaluator, deployment)
    table, picture = (run_directory() / f"localisation.{kind}" for kind in ("csv", "png"))
    bounds.to_csv(table)
    save_cramer_rao_map(picture, problem.scene.room, bounds, title_of(problem, "Cramer-Rao bound of one frame,"))
    accuracy = run_directory() / "accuracy.csv"
    save_accuracy_map(accuracy, problem, deployment)
    tracker.log_artifacts([table, picture, accuracy])
    return bounds.metrics() | accuracy_metrics(problem, deployment, seed)


def lose(problem: "Problem", deployment: "Deployment", tracker: "Tracker") -> "Losses | None":
    """Write and log what is lost without each landmark; None, and a line that says why, where that cannot be told."""
    from lmd.checks import InputError
    from lmd.losses import losses

    try:
        found = losses(problem, deployment)
    except InputError as error:
        print(f"no losses: {error}")
        return None
    file = run_directory() / "losses.csv"
    found.table.to_csv(file, index=False)
    tracker.log_artifacts([file])
    return found


def vary(problem: "Problem", deployment: "Deployment", seed: int, tracker: "Tracker") -> "Sensitivity":
    """Write and log how much the figures hang on what was assumed."""
    from lmd.plot.sensitivity import save_sensitivity_figure
    from lmd.sensitivity import sensitivity

    from .tracked_run import title_of

    found, directory = sensitivity(problem, deployment, seed), run_directory()
    for name, table in found.tables.items():
        table.to_csv(directory / f"{name}.csv", index=False)
    picture = directory / "sensitivity.png"
    save_sensitivity_figure(picture, found, title_of(problem, "sensitivity,"))
    tracker.log_metrics({f"sensitivity/{name}": value for name, value in found.metrics().items()})
    tracker.log_artifacts([*(directory / f"{name}.csv" for name in found.tables), picture])
    return found


if __name__ == "__main__":
    main()
