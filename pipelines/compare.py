"""Compare optimisers: `python -m pipelines.compare optimisers=[annealing,ega] seeds=10 [overrides]`."""

import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, ListConfig

from .app import flat_settings, run_directory, save_path
from .building import budget_of, build_optimiser, build_problem, seeds_of
from .earlier_run import read_earlier_problem
from .optimise import SAME_WHEN_RESUMED
from .outputs import columns_of, read_document, write_document
from .overrides import recompose, search_path, task_overrides
from .pipeline import Pipeline
from .provenance import digest, resuming
from .workers import in_processes

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.objectives.base import Headline
    from lmd.problem import Problem


LANDMARKS, HISTORY, RECORD = FILES = "landmarks.csv", "history.csv", "run.json"  # of each run, in a folder of its own
# Settings of the comparison itself; every other override is passed on to its runs.
OWN_KEYS = ("optimisers", "reference", "seeds", "workers", "save_as", "resume", "budget", "seed", "tracking")


@dataclass(frozen=True, eq=False)
class Contender:
    """An optimiser and a seed: a run that is compared with the others."""

    optimiser: str
    """Its entry of `optimisers`."""
    cfg: DictConfig
    """Configuration of `optimise` for this entry."""
    seed: int
    """Seed of the run."""

    @property
    def name(self) -> str:
        """Name of the run."""
        return f"{self.optimiser} seed={self.seed}"

    @cached_property
    def digest(self) -> str:
        """A digest that is equal for runs with equal results."""
        return digest(flat_settings(self.cfg, *SAME_WHEN_RESUMED, "budget", "validate"), self.seed)

    def folder(self, comparison: Path) -> Path:
        """The folder of the run below the folder of its comparison."""
        return comparison / "runs" / self.name.replace("/", "_")

    def save(self, comparison: Path, run: "OptimiserRun", parent: str | None, ups: bool) -> None:
        """Write the result of the run.

        Args:
            comparison: folder of the comparison.
            parent: tracked run of the comparison, if any.
            ups: see `Deployment.to_csv`.
        """
        from lmd.core.tables import write_table

        folder = self.folder(comparison)
        folder.mkdir(parents=True, exist_ok=True)  # there already where a sweep repeats a lost job
        run.deployment.to_csv(folder / LANDMARKS, ups)
        write_table(folder / HISTORY, columns_of(run.history))
        write_document(folder / RECORD, {"digest": self.digest, "parent": parent, "metrics": dict(run.metrics)})

    def saved(self, comparison: Path) -> "tuple[OptimiserRun, str | None] | None":
        """The result of the run in the folder of a comparison, and the tracked run of that; None if it is not there.

        Raises:
            InputError: its tables are damaged, or one of its files is a link that leads out of the comparison.
        """
        from lmd.core.checks import InputError
        from lmd.core.tables import read_numbers
        from lmd.evaluation.comparison import OptimiserRun
        from lmd.optimisers.ledger import Record
        from lmd.scene.deployment import Deployment

        folder = self.folder(comparison)
        for name in FILES:
            if not (folder / name).resolve().is_relative_to(comparison.resolve()):
                raise InputError(f"resume: {str(folder / name)!r} is a link that leads out of the folder.", "resume")
        record: dict[str, Any] = read_document(folder / RECORD, lambda values: {**values}) or {}
        if record.get("digest") != self.digest:
            return None
        rows = read_numbers(folder / HISTORY, [*columns_of([])], name="resume").tolist()
        history, landmarks = [Record(*row) for row in rows], Deployment.from_csv(folder / LANDMARKS)
        return OptimiserRun(self.optimiser, self.seed, record["metrics"], history, landmarks), record["parent"]


@dataclass(frozen=True)
class Kept:
    """The results of an earlier comparison."""

    runs: "Mapping[Contender, OptimiserRun]"
    """Finished runs."""
    parent: str | None
    """Tracked run of that comparison, if any."""


def kept_of(resume: Any, jobs: Iterable[Contender], directory: Path) -> Kept:
    """Copy the finished runs in the folder of an earlier comparison to `directory`, and return them.

    Raises:
        InputError: there is no such folder, or its files are damaged.
    """
    from lmd.core.checks import InputError, file_path

    earlier = file_path("resume", resume)
    if not earlier.is_dir():
        raise InputError(f"resume = {str(resume)!r} is no folder of a comparison.", "resume")
    found = {job: saved for job in jobs if (saved := job.saved(earlier)) is not None}
    if earlier.resolve() != directory.resolve():
        for job in found:
            _copy(job, earlier, directory)
    parent = next((parent for _, parent in found.values()), None)
    return Kept({job: run for job, (run, _) in found.items()}, parent)


def _copy(job: Contender, earlier: Path, directory: Path) -> None:
    """Copy the files of a run from the folder of a comparison to another one."""
    folder = job.folder(directory)
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(job.folder(earlier) / name, folder / name)


def compare(cfg: DictConfig) -> None:
    """Run the configured comparison."""
    from lmd.core.checks import InputError, choice

    from .operations.tracking import RunStart
    from .progress import thinned
    from .tracked_run import Earlier, log_child, title_of, tracked

    problem, save_as = build_problem(cfg), save_path(cfg.save_as)
    budget, seeds = budget_of(cfg), seeds_of(cfg)
    if not isinstance(cfg.optimisers, ListConfig) or not all(str(entry).split() for entry in cfg.optimisers):
        raise InputError(f"optimisers must be a list of names, got {cfg.optimisers!r}.")
    configs = {str(entry): _compose(str(entry), cfg, problem) for entry in cfg.optimisers}
    if not configs:
        raise InputError("optimisers must name at least one optimiser.")
    reference = None if cfg.reference is None else choice("reference", cfg.reference, list(configs))
    jobs = {(name, seed): Contender(name, configs[name], seed) for seed in seeds for name in configs}
    directory, headline = run_directory(), problem.objective.headline
    kept = Kept({}, None) if cfg.resume is None else kept_of(cfg.resume, jobs.values(), directory)
    earlier = None if kept.parent is None else Earlier(kept.parent, Path(cfg.resume))
    left = [job for job in jobs.values() if job not in kept.runs]
    finished, runs = in_processes(_run, left, cfg.workers, lambda job: job.name), list(kept.runs.values())
    axis, title = "evaluations" if budget.evaluations else "wall_time", title_of(problem, f"{len(seeds)} seeds,")

    def log(job: Contender, run: "OptimiserRun", parent: str | None) -> None:
        folder, tags = job.folder(directory), {"choice.optimiser": run.optimiser.split()[0]}
        params = {"optimiser": run.optimiser, "seed": run.seed}
        started = RunStart(job.name, folder, params, tags, ago=run.history[-1].wall_time)
        log_child(cfg.tracking, started, parent, run.metrics, folder / LANDMARKS, thinned(run.history))

    with closing(finished), tracked(cfg, "compare", title_of(problem, "compare"), earlier) as tracker:
        if runs:
            print(f"{len(runs)}/{len(jobs)} done already in {cfg.resume}", flush=True)
        if tracker.run_id != kept.parent:
            for job, run in kept.runs.items():
                log(job, run, tracker.run_id)
        try:
            for done in finished:
                runs.append(done)
                job = jobs[done.optimiser, done.seed]
                job.save(directory, done, tracker.run_id, not problem.scene.tag.is_point)
                log(job, done, tracker.run_id)
                print(f"{len(runs)}/{len(jobs)} {job.name}: {headline.text(done.metrics[headline.key])}", flush=True)
        except KeyboardInterrupt:
            print(f"interrupted; go on with: {resuming('compare', directory)}", file=sys.stderr)
            raise
        finally:  # an interrupted comparison, too, has a table of its finished runs
            if runs:
                tracker.log_artifacts(_write(directory, runs, reference, axis, headline, title))
        tracker.finish("FINISHED")
    if save_as is not None:
        for kind in ("md", "png"):
            Path(f"{save_as}.{kind}").write_bytes((directory / f"comparison.{kind}").read_bytes())


def _write(
    directory: Path, runs: "Sequence[OptimiserRun]", reference: str | None, axis: str, headline: "Headline", title: str
) -> list[Path]:
    """Write and print the comparison of runs; returns the files."""
    from lmd.evaluation.comparison import compared
    from lmd.plot.charts import save_comparison_figure

    from .reproduction.document import comparison_markdown

    comparison = compared(runs, headline.key, reference)
    table, text, picture = (directory / f"comparison.{kind}" for kind in ("csv", "md", "png"))
    comparison.table.to_csv(table, index=False)
    text.write_text(comparison_markdown(comparison, headline))
    save_comparison_figure(picture, runs, axis, headline, title)
    files = [table, text, picture]
    if comparison.pairs is not None:
        files.append(directory / "p_values.csv")
        comparison.pairs.to_csv(files[-1], index_label="optimiser")
    print(f"\n{text.read_text()}\nfiles: {directory}")
    return files


def _compose(entry: str, cfg: DictConfig, problem: "Problem") -> DictConfig:
    """The `optimise` configuration for one entry of `optimisers`: a name, then its own overrides."""
    shared = [override for key, override in task_overrides() if key.split(".")[0] not in OWN_KEYS]
    name, *own = entry.split()
    composed = recompose("optimise", [*shared, *search_path(), f"optimiser={name}", *own], "optimisers", entry)
    composed.budget, composed.threads = cfg.budget, 1
    build_optimiser(composed, cfg.seed).check(problem)  # before any search begins
    return composed


def _run(job: Contender) -> "OptimiserRun":
    """Do one run, on one thread."""
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.evaluation.validation import headline_off_grid, validation_metrics

    problem = build_problem(job.cfg)
    result = build_optimiser(job.cfg, job.seed).run(problem, budget_of(job.cfg))
    metrics = dict(problem.metrics(result.deployment))
    if job.cfg.validate:
        metrics["off_grid"] = validation_metrics(problem, result.deployment, job.seed)[headline_off_grid(problem)]
    return OptimiserRun(job.optimiser, job.seed, metrics, result.history, result.deployment)


main = Pipeline("compare", compare, (read_earlier_problem,))

if __name__ == "__main__":
    main()
