"""Compare optimisers: `python -m pipelines.compare optimisers=[annealing,ega] seeds=10 [overrides]`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, ListConfig

from .app import choices, run_directory, save_path
from .building import budget_of, build_optimiser, build_problem, seeds_of
from .contenders import LANDMARKS, Contender, contend
from .composing import changes_results, recompose, search_path, task_overrides
from .command import Command
from .provenance import parameters
from .tournament import hold_tournament

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.problem import Problem

    from .operations.tracking import Tracker

# Settings of the comparison itself; every other override is passed on to its runs.
OWN_KEYS = ("optimisers", "reference", "seeds", "budget", "seed")


def compare(cfg: DictConfig) -> None:
    """Run the configured comparison, or with `suite` a tournament."""
    from lmd.core.checks import InputError, choice

    if cfg.suite is not None:
        hold_tournament(cfg)
        return

    from .operations.tracking import RunStart
    from .progress import curve
    from .tracked_run import dataset_of, log_child, title_of

    problem, save_as = build_problem(cfg), save_path(cfg.save_as)
    budget, seeds = budget_of(cfg), seeds_of(cfg)
    if not isinstance(cfg.optimisers, ListConfig) or not all(str(entry).split() for entry in cfg.optimisers):
        raise InputError(f"optimisers must be a list of names, got {cfg.optimisers!r}.")
    configs = {str(entry): _compose(str(entry), cfg, problem) for entry in cfg.optimisers}
    if not configs:
        raise InputError("optimisers must name at least one optimiser.")
    reference = None if cfg.reference is None else choice("reference", cfg.reference, list(configs))
    jobs = [Contender(name, configs[name], seed) for seed in seeds for name in configs]
    directory = run_directory()
    axis, title = "evaluations" if budget.evaluations else "wall_time", title_of(problem, f"{len(seeds)} seeds,")
    dataset = dataset_of(cfg, problem)
    shared = parameters(cfg, choices())  # so that tables of runs have the same columns as those of optimise

    def log(job: Contender, run: "OptimiserRun", parent: str | None) -> None:
        folder, params = job.folder(directory), {**shared, "optimiser": run.optimiser, "seed": run.seed}
        started = RunStart(job.name, folder, params, job.tags, ago=run.history[-1].wall_time, dataset=dataset)
        log_child(cfg.tracking, started, parent, run.metrics, folder / LANDMARKS, curve(run.history, budget))

    def write(tracker: "Tracker", done: "Mapping[Contender, OptimiserRun]") -> list[Path]:
        files = _write(directory, list(done.values()), reference, axis, title)
        tracker.log_artifacts(files)
        return files

    is_oriented = not problem.scene.tag.is_point
    contend(cfg, jobs, lambda _: is_oriented, write, log, problem=problem)
    if save_as is not None:
        for kind in ("md", "png"):
            Path(f"{save_as}.{kind}").write_bytes((directory / f"comparison.{kind}").read_bytes())


def _write(directory: Path, runs: "Sequence[OptimiserRun]", reference: str | None, axis: str, title: str) -> list[Path]:
    """Write and print the comparison of runs; returns the files."""
    from lmd.evaluation.comparison import compared
    from lmd.objectives.base import figure_of
    from lmd.plot.charts import save_comparison_figure

    from .reproduction.document import comparison_markdown

    fitness = figure_of("fitness")  # the quantity that is maximised, as in the picture
    comparison = compared(runs, fitness.key, reference)
    table, text, picture = (directory / f"comparison.{kind}" for kind in ("csv", "md", "png"))
    comparison.table.to_csv(table, index=False)
    text.write_text(comparison_markdown(comparison, fitness))
    save_comparison_figure(picture, runs, axis, fitness, title)
    files = [table, text, picture]
    if comparison.pairs is not None:
        files.append(directory / "p_values.csv")
        comparison.pairs.to_csv(files[-1], index_label="optimiser")
    print(f"\n{text.read_text()}\nfiles: {directory}")
    return files


def _compose(entry: str, cfg: DictConfig, problem: "Problem") -> DictConfig:
    """The `optimise` configuration for one entry of `optimisers`: a name, then its own overrides."""
    shared = [o for key, o in task_overrides() if key.split(".")[0] not in OWN_KEYS and changes_results(key)]
    name, *own = entry.split()
    composed = recompose("optimise", [*shared, *search_path(), f"optimiser={name}", *own], "optimisers", entry)
    composed.budget, composed.threads = cfg.budget, 1
    build_optimiser(composed, cfg.seed).check(problem)  # before any search begins
    return composed


main = Command("compare", compare)

if __name__ == "__main__":
    main()
