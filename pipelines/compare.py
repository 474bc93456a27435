"""Compare optimisers: `python -m pipelines.compare optimisers=[annealing,ega] seeds=5 [overrides]`."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, ListConfig

from .app import recompose, run_directory, save_path, search_path, task_overrides
from .building import budget_of, build_optimiser, build_problem, instantiate, seeds_of
from .earlier_run import read_earlier_problem
from .pipeline import Pipeline
from .workers import in_processes

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.optimisers.base import Budget

    from .operations.tracking import Tracker

# Settings of the comparison itself; every other override is passed on to its runs.
OWN_KEYS = ("optimisers", "seeds", "workers", "save_as", "budget", "seed", "tracking")


def compare(cfg: DictConfig) -> None:
    """Run the configured comparison."""
    from lmd.core.checks import InputError
    from lmd.evaluation.comparison import comparison_table
    from lmd.plot.comparison import save_comparison_figure

    from .reproduction.comparison import to_markdown
    from .tracked_run import title_of, tracked

    problem, save_as = build_problem(cfg), save_path(cfg.save_as)
    budget, seeds = budget_of(cfg), seeds_of(cfg)
    if not isinstance(cfg.optimisers, ListConfig) or not all(str(entry).split() for entry in cfg.optimisers):
        raise InputError(f"optimisers must be a list of names, got {cfg.optimisers!r}.")
    configs = {str(entry): _compose(str(entry), cfg) for entry in cfg.optimisers}
    if not configs:
        raise InputError("optimisers must name at least one optimiser.")
    jobs = [(name, configs[name], seed, budget) for seed in seeds for name in configs]
    finished = in_processes(_run, jobs, cfg.workers, lambda job: f"{job[0]} seed={job[2]}")
    directory, headline, runs = run_directory(), problem.objective.headline, []
    axis = "evaluations" if budget.evaluations else "wall_time"
    with closing(finished), tracked(cfg, "compare", title_of(problem, "compare")) as tracker:
        try:
            for done in finished:
                runs.append(done)
                _log_child(cfg, done, not problem.scene.tag.is_point, tracker.run_id, directory)
                figure = headline.text(done.metrics[headline.key])
                print(f"{len(runs)}/{len(jobs)} {done.optimiser} seed={done.seed}: {figure}", flush=True)
        finally:  # interrupted, what is finished is still worth a table
            if runs:
                table = comparison_table(runs, headline.key)
                table.to_csv(directory / "comparison.csv", index=False)
                (directory / "comparison.md").write_text(to_markdown(table, headline))
                title = title_of(problem, f"{len(seeds)} seeds,")
                save_comparison_figure(directory / "comparison.png", runs, axis, headline, title)
                tracker.log_artifacts([directory / f"comparison.{kind}" for kind in ("csv", "md", "png")])
                print(f"\n{to_markdown(table, headline)}\nfiles: {directory}")
        tracker.finish("FINISHED")
    if save_as is not None:
        for kind in ("md", "png"):
            Path(f"{save_as}.{kind}").write_bytes((directory / f"comparison.{kind}").read_bytes())


def _compose(entry: str, cfg: DictConfig) -> DictConfig:
    """The `optimise` configuration for one entry of `optimisers`: a name, then overrides of its own."""
    shared = [override for key, override in task_overrides() if key.split(".")[0] not in OWN_KEYS]
    name, *own = entry.split()
    composed = recompose("optimise", [*shared, *search_path(), f"optimiser={name}", *own], "optimisers", entry)
    composed.budget, composed.threads = cfg.budget, 1
    build_optimiser(composed, cfg.seed)  # what cannot be built fails before anything has run
    return composed


def _run(job: "tuple[str, DictConfig, int, Budget]") -> "OptimiserRun":
    """One run, on one thread."""
    from lmd.evaluation.comparison import OptimiserRun

    name, cfg, seed, budget = job
    problem = build_problem(cfg)
    result = build_optimiser(cfg, seed).run(problem, budget)
    return OptimiserRun(name, seed, problem.metrics(result.deployment), result.history, result.deployment)


def _log_child(cfg: DictConfig, run: "OptimiserRun", ups: bool, parent: str | None, directory: Path) -> None:
    """Record one run below the comparison's own, its landmarks in a folder of `directory`; `ups` as for `to_csv`."""
    from .operations.tracking import PARENT_TAG, RunStart
    from .progress import thinned

    tracker: Tracker = instantiate(cfg.tracking)
    tags = {"choice.optimiser": run.optimiser.split()[0]}
    if parent is not None:
        tags[PARENT_TAG] = parent
    params = {"optimiser": run.optimiser, "seed": run.seed}
    name = f"{run.optimiser} seed={run.seed}"
    landmarks = directory / "runs" / name.replace("/", "_") / "landmarks.csv"
    landmarks.parent.mkdir(parents=True, exist_ok=True)  # a sweep may do a lost job again
    run.deployment.to_csv(landmarks, ups)
    tracker.start(RunStart(name, landmarks.parent, params, tags, ago=run.history[-1].wall_time))
    tracker.log_curve("best_fitness", thinned(run.history))
    tracker.log_metrics(run.metrics)
    tracker.log_artifacts([landmarks])
    tracker.finish("FINISHED")


main = Pipeline("compare", compare, (read_earlier_problem,))

if __name__ == "__main__":
    main()
