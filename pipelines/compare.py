"""Compare optimisers: `python -m pipelines.compare optimisers=[annealing,ega] seeds=10 [overrides]`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, ListConfig

from .app import choices, run_directory, save_path
from .building import budget_of, build_optimiser, build_problem, seeds_of
from .command import Command
from .composing import editable, recompose
from .contenders import LANDMARKS, Contender, contend
from .overrides import changes_results, task_overrides
from .provenance import parameters
from .study import Report, Study
from .tournament import tournament_of

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.problem import Problem

# Settings of the comparison itself; every other override is passed on to its runs.
OWN_KEYS = ("optimisers", "reference", "seeds", "budget", "seed")


def compare(cfg: DictConfig) -> Study:
    """Prepare the configured comparison, or with `suite` a tournament."""
    from lmd.core.checks import InputError, choice

    if cfg.suite is not None:
        return tournament_of(cfg)

    from lmd.optimisers.ledger import curve

    from .operations.tracking import RunStart
    from .tracked_run import dataset_of, derived, log_child, title_of

    problem, save_as = build_problem(cfg), save_path(cfg.save_as)
    budget, seeds = budget_of(cfg), seeds_of(cfg)
    if not isinstance(cfg.optimisers, ListConfig) or not all(str(entry).split() for entry in cfg.optimisers):
        raise InputError(f"optimisers must be a list of names, got {cfg.optimisers!r}.")
    configs = {str(entry): _compose(str(entry), cfg, problem) for entry in cfg.optimisers}
    if not configs:
        raise InputError("optimisers must name at least one optimiser.")
    reference = None if cfg.reference is None else choice("reference", cfg.reference, list(configs))
    jobs = [Contender(name, configs[name], seed) for seed in seeds for name in configs]
    directory, dataset = run_directory(), dataset_of(cfg, problem)
    axis, title = "evaluations" if budget.evaluations else "wall_time", title_of(problem, f"{len(seeds)} seeds,")
    # So that tables of runs have the same columns as those of optimise.
    shared = parameters(cfg, choices()) | derived(problem)

    def log(job: Contender, run: "OptimiserRun", parent: str | None) -> None:
        folder, params = job.folder(directory), {**shared, "optimiser": run.optimiser, "seed": run.seed}
        started = RunStart(job.name, folder, params, job.tags, ago=run.history[-1].wall_time, dataset=dataset)
        log_child(cfg.tracking, started, parent, run.metrics, folder / LANDMARKS, curve(run.history, budget))

    def report(done: "Mapping[Contender, OptimiserRun]") -> Report:
        return _compared(list(done.values()), reference, axis, title)

    def saved() -> None:
        for kind in ("md", "png") if save_as is not None else ():
            Path(f"{save_as}.{kind}").write_bytes((directory / f"comparison.{kind}").read_bytes())

    return contend(cfg, jobs, report, saved, log, problem=problem)


def _compared(runs: "Sequence[OptimiserRun]", reference: str | None, axis: str, title: str) -> Report:
    """Tables and picture of the comparison of runs."""
    from lmd.evaluation.comparison import compared, comparison_markdown
    from lmd.objectives.base import figure_of
    from lmd.plot.charts import save_comparison_figure

    fitness = figure_of("fitness")  # the quantity that is maximised, as in the picture
    comparison = compared(runs, fitness.key, reference)
    markdown = comparison_markdown(comparison, fitness)
    files = {
        "comparison.csv": comparison.table,
        "comparison.md": markdown,
        "comparison.png": lambda path: save_comparison_figure(path, runs, axis, fitness, title),
    }
    if comparison.pairs is not None:
        files["p_values.csv"] = comparison.pairs.rename_axis("optimiser")
    return Report(files, text=f"\n{markdown}")


def _compose(entry: str, cfg: DictConfig, problem: "Problem") -> DictConfig:
    """The `optimise` configuration for one entry of `optimisers`: a name, then its own overrides."""
    shared = [o for key, o in task_overrides() if key.split(".")[0] not in OWN_KEYS and changes_results(key)]
    name, *own = entry.split()
    composed = editable(recompose("optimise", [*shared, f"optimiser={name}", *own], "optimisers", entry))
    composed.budget, composed.threads = cfg.budget, 1
    build_optimiser(composed, cfg.seed).check(problem)  # before any search begins
    return composed


main = Command("compare", compare)

if __name__ == "__main__":
    main()
