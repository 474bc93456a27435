"""Contenders of a comparison: an optimiser, a seed and a problem, whose result is kept in a folder of its own."""

import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import flat_settings, run_directory
from .building import budget_of, build_optimiser, build_problem
from .composing import RIG
from .operations.sweeps.names import DIGEST_LENGTH
from .optimise import SAME_WHEN_RESUMED
from .outputs import read_document, write_document
from .provenance import digest, resuming
from .score import columns_of
from .study import Earlier, Report, Study
from .workers import in_processes

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.problem import Problem

    from .operations.tracking import Tracker

LANDMARKS, HISTORY, RECORD = FILES = "landmarks.csv", "history.csv", "run.json"  # of each run, in a folder of its own
LONGEST = 120  # characters of the name of a folder, with a digest behind them if the name of the run is longer


@dataclass(frozen=True, eq=False)
class Contender:
    """An optimiser with a seed on a problem: a run that is compared with others."""

    optimiser: str
    """Its entry of `optimisers`."""
    cfg: DictConfig
    """Configuration of `optimise` for this entry."""
    seed: int
    """Seed of the run."""
    problem: str = ""
    """Problem of the suite; empty for the problem of `cfg`."""
    evaluations: int = 0
    """Budget of the run for a problem of the suite."""

    @property
    def name(self) -> str:
        """Name of the run."""
        of_suite = f"{self.problem} {self.evaluations} " if self.problem else ""
        return f"{of_suite}{self.optimiser} seed={self.seed}"

    @property
    def tags(self) -> dict[str, str]:
        """Tags of its tracked run."""
        return {"job": digest(self.name)[:DIGEST_LENGTH], "choice.optimiser": self.optimiser.split()[0]}

    @cached_property
    def digest(self) -> str:
        """A digest that is equal for runs with equal results."""
        if not self.problem:
            return digest(flat_settings(self.cfg, *SAME_WHEN_RESUMED, "budget", "validate"), self.seed)
        from lmd.suite import document

        settings = flat_settings(self.cfg, "optimiser", "encoding", "validate")
        return digest(settings, self.seed, document(self.problem).hash, self.evaluations)

    def folder(self, comparison: Path) -> Path:
        """The folder of the run below the folder of its comparison; a long name ends in a digest."""
        name = self.name.replace("/", "_")
        if len(name) > LONGEST:
            name = f"{name[:LONGEST]} {digest(self.name)[:DIGEST_LENGTH]}"
        return comparison / "runs" / self.problem / name

    def save(self, comparison: Path, run: "OptimiserRun", parent: str | None, ups: bool) -> None:
        """Write the result of the run.

        Args:
            comparison: folder of the comparison.
            parent: tracked run of the comparison, if any.
            ups: see `Deployment.to_csv`.
        """
        from lmd.core.tables import write_table
        from lmd.formats.rigs import write_rig

        folder = self.folder(comparison)
        folder.mkdir(parents=True, exist_ok=True)  # there already where a sweep repeats a lost job
        run.deployment.to_csv(folder / LANDMARKS, ups)
        if run.rig is not None:
            write_rig(folder / RIG, run.rig, dict.fromkeys(run.rig.cameras))
        write_table(folder / HISTORY, columns_of(run.history))
        of_run = {"name": self.name, "digest": self.digest, "metrics": dict(run.metrics)}
        self.note(comparison, **of_run, parent=parent, logged=False)

    def note(self, comparison: Path, **values: Any) -> None:
        """Write values to the record of the run in the folder of a comparison."""
        path = self.folder(comparison) / RECORD
        write_document(path, (read_document(path, dict) or {}) | values)

    def saved(self, comparison: Path) -> "tuple[OptimiserRun, Mapping[str, Any]] | None":
        """The result and the record of the run in the folder of a comparison; None if they are not there.

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
        run = OptimiserRun(self.optimiser, self.seed, record["metrics"], history, landmarks, None, self.problem)
        return run, record


@dataclass(frozen=True)
class Kept:
    """The results of an earlier comparison."""

    runs: "Mapping[Contender, OptimiserRun]"
    """Finished runs."""
    parent: str | None
    """Tracked run of that comparison, if any."""
    logged: Collection[Contender] = ()
    """Those of the runs that are recorded below the tracked run."""


def kept_of(resume: Any, jobs: Iterable[Contender], directory: Path) -> Kept:
    """Copy the finished runs in the folder of an earlier comparison to `directory`, and return them.

    Raises:
        InputError: there is no such folder, or its files are damaged.
    """
    from lmd.core.checks import InputError, file_path
    from lmd.evaluation.comparison import OptimiserRun

    earlier = file_path("resume", resume)
    if not earlier.is_dir():
        raise InputError(f"resume = {str(resume)!r} is no folder of a comparison.", "resume")
    folders = [earlier, *(path.parent for path in sorted(earlier.glob("*/runs")))]  # or the folder of a sweep of them
    runs, parent, logged = dict[Contender, OptimiserRun](), None, list[Contender]()
    for job in jobs:
        for folder in folders:
            if (saved := job.saved(folder)) is None:
                continue
            runs[job], record = saved
            parent = parent or record["parent"]
            logged += [job] * record["logged"]
            if folder.resolve() != directory.resolve():
                _copy(job, folder, directory)
            break
    return Kept(runs, parent, logged)


def _copy(job: Contender, earlier: Path, directory: Path) -> None:
    """Copy the files of a run from the folder of a comparison to another one."""
    folder = job.folder(directory)
    folder.mkdir(parents=True, exist_ok=True)
    for name in (*FILES, RIG):
        if (job.folder(earlier) / name).is_file():
            shutil.copyfile(job.folder(earlier) / name, folder / name)


def contend(
    cfg: DictConfig, jobs: Sequence[Contender], ups: Callable[[Contender], bool],
    report: "Callable[[Mapping[Contender, OptimiserRun]], Report]", saved: Callable[[], None],
    log: "Callable[[Contender, OptimiserRun, str | None], None] | None" = None, about: str = "",
    problem: "Problem | None" = None,
) -> Study:  # fmt: skip
    """Study of the runs of a comparison, which does those that the resumed comparison has not done.

    Args:
        cfg: configuration of `compare`.
        jobs: the runs.
        ups: function that returns `ups` of `Contender.save`.
        report: function that reports on the finished runs.
        saved: function that is called when the report on all runs is written.
        log: function that records a finished run below the tracked run; None to record none.
        about, problem: description and problem of the tracked run.

    Raises:
        InputError: the comparison to resume cannot be read.
    """
    from .operations.tracking import PARENT_TAG, RunStart

    directory = run_directory()
    kept = Kept({}, None) if cfg.resume is None else kept_of(cfg.resume, jobs, directory)
    earlier = None if kept.parent is None else Earlier(kept.parent, Path(cfg.resume))
    by_name, results = {job.name: job for job in jobs}, dict(kept.runs)
    left = [job for job in jobs if job not in results]

    def run(tracker: "Tracker") -> Iterator[Report]:
        def logged(job: Contender) -> None:
            if log is not None:
                log(job, results[job], tracker.run_id)
                job.note(directory, parent=tracker.run_id, logged=True)

        if results:
            yield Report(text=f"{len(results)}/{len(jobs)} done already in {cfg.resume}")
        for job in kept.runs:
            if tracker.run_id != kept.parent or job not in kept.logged:
                logged(job)
                tags = {**job.tags, PARENT_TAG: str(tracker.run_id)}
                tracker.settle(RunStart(job.name, directory, tags=tags), "FINISHED")  # one may be recorded in part
        try:
            with closing(in_processes(_named, left, cfg.workers, lambda job: job.name)) as finished:
                for name, done in finished:
                    job = by_name[name]
                    results[job] = done
                    job.save(directory, done, tracker.run_id, ups(job))
                    logged(job)
                    yield Report(text=f"{len(results)}/{len(jobs)} {name}: fitness {done.metrics['fitness']:.2%}")
        except KeyboardInterrupt:  # an interrupted comparison, too, has the files about its finished runs
            if results:
                yield report(results)
            raise
        yield report(results)
        saved()

    return Study("compare", run, about, problem, earlier, lambda: f"go on with: {resuming('compare', directory)}")


def _named(job: Contender) -> "tuple[str, OptimiserRun]":
    """Name and result of a run."""
    return job.name, run_contender(job)


def run_contender(job: Contender) -> "OptimiserRun":
    """Do one run, on one thread."""
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.evaluation.tradeoff import SAMPLE
    from lmd.evaluation.validation import Sample, headline_off_grid, validation_metrics
    from lmd.optimisers.ledger import Budget

    if job.problem:  # of a suite there are thousands of runs
        from lmd.suite import problem as of_suite

        problem, budget, sample = of_suite(job.problem).problem, Budget(job.evaluations), SAMPLE
    else:
        problem, budget, sample = build_problem(job.cfg), budget_of(job.cfg), Sample()
    result = build_optimiser(job.cfg, job.seed).run(problem, budget)
    scored = problem if result.rig is None else problem.with_rig(result.rig)
    metrics = dict(scored.metrics(result.deployment))
    if job.cfg.validate:
        metrics["off_grid"] = validation_metrics(scored, result.deployment, job.seed, sample)[headline_off_grid(scored)]
    return OptimiserRun(job.optimiser, job.seed, metrics, result.history, result.deployment, result.rig, job.problem)
