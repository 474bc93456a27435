"""Contenders of a comparison.

A contender is a run of one optimiser with one seed on one problem, and has a folder for its result.
"""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from lmd.core.workers import in_processes
from lmd.optimisers.ledger import columns_of

from .app import flat_settings, run_directory
from .building import budget_of, build_optimiser, build_problem
from .composing import RIG
from .operations.sweeps.names import DIGEST_LENGTH
from .optimise import SAME_WHEN_RESUMED
from .outputs import HISTORY_FILE, read_history
from .provenance import digest, kept
from .study import LANDMARKS, Report, Study

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun

    from .operations.tracking import Tracker

GOING_ON = "the same command continues from the results in {}"
LONGEST = 120  # maximum number of characters of a folder's name; a longer name is cut and ends in a digest


@dataclass(frozen=True, eq=False)
class Contender:
    """Run of a comparison: one optimiser with one seed on one problem."""

    optimiser: str
    """Entry of `optimisers` that names the optimiser, with its overrides."""
    cfg: DictConfig
    """Configuration of `optimise` for this entry."""
    seed: int
    """Seed of the run."""
    problem: str = ""
    """Name of the problem in the suite; empty if the run is on the problem that `cfg` describes."""
    evaluations: int = 0
    """Number of evaluations that the run may use on a problem of the suite."""

    @property
    def name(self) -> str:
        """Name of the run in tables and messages."""
        of_suite = f"{self.problem} {self.evaluations} " if self.problem else ""
        return f"{of_suite}{self.optimiser} seed={self.seed}"

    @property
    def tags(self) -> dict[str, str]:
        """Labels of the tracked run (tags of mlflow)."""
        return {"job": digest(self.name)[:DIGEST_LENGTH], "choice.optimiser": self.optimiser.split()[0]}

    @property
    def parts(self) -> tuple[Any, ...]:
        """Settings that determine the result of the run; a stored result is found by these settings."""
        if not self.problem:
            return flat_settings(self.cfg, *SAME_WHEN_RESUMED, "budget", "validate"), self.seed
        from lmd.suite import document

        frozen = document(self.problem).hash, self.evaluations
        return flat_settings(self.cfg, "optimiser", "encoding", "validate"), self.seed, *frozen

    def folder(self, comparison: Path) -> Path:
        """Folder of the run within the folder `comparison`.

        A name longer than `LONGEST` characters is cut and ends in a digest.
        """
        name, ending = self.name.replace("/", "_"), f" {digest(self.name)[:DIGEST_LENGTH]}"
        return comparison / "runs" / self.problem / (name if len(name) <= LONGEST else name[:LONGEST] + ending)


Told = Callable[["Mapping[Contender, OptimiserRun]"], Report]
Log = Callable[[Contender, "OptimiserRun", str | None], None]


def contend(
    cfg: DictConfig, jobs: Sequence[Contender], report: Told, log: Log = lambda *_: None, **about: Any
) -> Study:
    """Return the study that does the runs of a comparison and reports on them.

    A result is reused if an earlier comparison has stored it for equal settings.

    Args:
        cfg: configuration of `compare`.
        jobs: the runs to be compared.
        report: function that makes the report from the results of the finished runs.
        log: function that records a finished run as a child of the tracked run.
        about: the field `about` or `problem` of the returned `Study`.
    """
    from lmd.core.checks import file_path

    file_path("kept", cfg.kept)

    def run(tracker: "Tracker") -> Iterator[Report]:
        results: dict[Contender, OptimiserRun] = {}
        by_name = {job.name: job for job in jobs}
        do = partial(_done, run_directory(), str(cfg.kept))
        try:
            with closing(in_processes(do, jobs, cfg.workers, lambda job: job.name)) as finished:
                for name, done in finished:
                    results[job := by_name[name]] = done
                    log(job, done, tracker.run_id)
                    yield Report(text=f"{len(results)}/{len(jobs)} {name}: fitness {done.metrics['fitness']:.2%}")
        except KeyboardInterrupt:  # files about the finished runs are written after an interruption, too
            if results:
                yield report(results)
            raise
        yield report({job: results[job] for job in jobs})

    return Study("compare", run, hint=partial(GOING_ON.format, cfg.kept), **about)


def _done(directory: Path, folder: str, job: Contender) -> "tuple[str, OptimiserRun]":
    """Return the name and the result of the run `job`, and write the files of the run.

    The run is done first unless its result is already stored on disk.

    Args:
        directory: folder of the comparison.
        folder: folder of the stored results.
        job: the run.
    """
    from lmd.core.files import write_whole
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.scene.deployment import Deployment

    document, own = kept(folder, job.parts, partial(_searched, job), dict), job.folder(directory)
    own.mkdir(parents=True, exist_ok=True)  # exists if a sweep repeats a lost job
    for name, text in document["files"].items():
        write_whole(own / name, text.encode())
    found = document["metrics"], read_history(own / HISTORY_FILE), Deployment.from_csv(own / LANDMARKS)
    return job.name, OptimiserRun(job.optimiser, job.seed, *found, None, job.problem)


def _searched(job: Contender) -> dict[str, Any]:
    """Do a run on one thread; return a document for JSON with the run's name, its metrics and its files' contents."""
    from lmd.core.tables import write_table
    from lmd.evaluation.tradeoff import SAMPLE
    from lmd.evaluation.validation import Sample, headline_off_grid, validation_metrics
    from lmd.formats.rigs import rig_text
    from lmd.optimisers.ledger import Budget

    if job.problem:  # a suite has thousands of runs
        from lmd.suite import problem as of_suite

        problem, budget, sample = of_suite(job.problem).problem, Budget(job.evaluations), SAMPLE
    else:
        problem, budget, sample = build_problem(job.cfg), budget_of(job.cfg), Sample()
    result = build_optimiser(job.cfg, job.seed).run(problem, budget)
    scored = problem if result.rig is None else problem.with_rig(result.rig)
    metrics = dict(scored.metrics(result.deployment))
    if job.cfg.validate:
        metrics["off_grid"] = validation_metrics(scored, result.deployment, job.seed, sample)[headline_off_grid(scored)]
    landmarks, history = io.StringIO(), io.StringIO()
    result.deployment.to_csv(landmarks, ups=not problem.scene.tag.is_point)
    write_table(history, columns_of(result.history))
    files = {LANDMARKS: landmarks.getvalue(), HISTORY_FILE: history.getvalue()}
    if result.rig is not None:
        files[RIG] = rig_text(result.rig, dict.fromkeys(result.rig.cameras))
    return {"name": job.name, "metrics": metrics, "files": files}
