"""Records of a sweep and its jobs on disk; processes and machines share them, and later commands add to them."""

import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...app import LOCK
from ...outputs import JOB_VARIABLE, read_document, write_document


@dataclass(frozen=True)
class Sweep:
    """Record of a sweep, stored as `sweep.json` in the sweep's folder."""

    name: str
    """Name of the sweep: the name of its experiment, or else the varied keys."""
    varied: tuple[str, ...]
    """Config keys whose values differ between the jobs; the keys of earlier commands come first."""
    run_id: str | None = None
    """Id of the tracked run of the sweep, which is the parent of the jobs' runs; None if nothing is tracked."""
    round: int = 0
    """Number of commands that have worked on this sweep before the present command; 0 for the first command."""


@dataclass(frozen=True)
class Job:
    """Record of a job of a sweep, stored as `job.json` in the job's folder."""

    sweep: str
    """Name of the sweep."""
    parent: str | None
    """Id of the tracked run of the sweep; None if nothing is tracked."""
    number: int
    """Number of the job in the sweep; the first job has the number 0."""
    overrides: tuple[str, ...]
    """Overrides of the job, as on the command line."""
    varied: Mapping[str, str]
    """Overrides that differ between the jobs of the sweep, such as `{"objective.n": "2"}`."""
    status: str = "running"
    """`running`, `finished`, `interrupted`, `failed` (by an error of its own) or `killed`."""
    value: float | None = None
    """Value that the job's task has returned, for Hydra's sweeper; None before the job has finished."""
    reason: str = ""
    """Reason why the job did not finish; empty if there is no reason."""
    seconds: float = 0.0
    """Wall time of the job, including all earlier attempts that it continues, seconds."""
    round: int = 0
    """Value of `Sweep.round` for the last command that contains this job."""

    @property
    def label(self) -> str:
        """Text with the overrides that distinguish this job from the other jobs of the sweep."""
        return " ".join(f"{key}={value}" for key, value in self.varied.items()) or " ".join(self.overrides)

    def tags(self, name: str) -> dict[str, str]:
        """Labels of the job's tracked run (tags of mlflow): the sweep, the job, and the parent run if there is one.

        Args:
            name: name of the job's folder, which is the label of the job.
        """
        from ..tracking import PARENT_TAG

        return {"sweep": self.sweep, "job": name} | ({PARENT_TAG: self.parent} if self.parent else {})


class JobFolder:
    """Folder of one job.

    Args:
        path: path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.name = Path(path), Path(path).name
        self.record, self.metrics = self.path / "job.json", self.path / "metrics.json"
        self.output = self.path / "output.log"  # stdout and stderr of the job
        self.checkpoint = self.path / "checkpoint.npz"  # as in lmd.optimisers.checkpoint, which is slow to import

    def load(self) -> Job | None:
        """Read the record of the job; None if the folder has no record."""
        return read_document(self.record, lambda values: Job(**values | {"overrides": tuple(values["overrides"])}))

    def finished(self) -> Job | None:
        """Read the record of the job; None unless the job has finished and its metrics are complete."""
        job = self.load()
        is_lost = self.metrics.exists() and not self.figures()
        return None if job is None or job.status != "finished" or is_lost else job

    def save(self, job: Job) -> None:
        """Write the record of the job."""
        write_document(self.record, asdict(job))

    def figures(self) -> dict[str, Any]:
        """Metrics of the job in metrics.json, keyed by name; empty if there is no such file."""
        return read_document(self.metrics, dict) or {}


class SweepFolder:
    """Folder of a sweep, with a folder for each of its jobs.

    Args:
        path: path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.record = Path(path), Path(path, "sweep.json")
        self.table, self.groups = self.path / "jobs.csv", self.path / "by_group.md"
        self.picture = self.path / "groups.png"

    def load(self) -> Sweep | None:
        """Read the record of the sweep; None if the folder has no record."""
        return read_document(self.record, lambda values: Sweep(**values | {"varied": tuple(values["varied"])}))

    def save(self, sweep: Sweep) -> None:
        """Write the record of the sweep."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_document(self.record, asdict(sweep))

    def job_of(self, digest: str) -> JobFolder | None:
        """Folder of the job whose configuration has the digest `digest`; None if there is no such folder.

        The name of a job's folder ends with the digest.
        """
        return next((JobFolder(path) for path in self.path.glob(f"*{digest}")), None)

    def jobs(self) -> list[tuple[JobFolder, Job]]:
        """Jobs with their folders.

        The jobs of the last command come first, in the order of the command. Finished jobs of earlier commands follow.
        """
        last = 0 if (sweep := self.load()) is None else sweep.round
        found = [(folder, job) for folder in map(JobFolder, self.path.iterdir()) if (job := folder.load()) is not None]
        kept = [(folder, job) for folder, job in found if job.round == last or job.status == "finished"]
        return sorted(kept, key=lambda entry: (-entry[1].round, entry[1].number))

    def discard(self) -> None:
        """Remove the record of a sweep that has no job yet, and the folder unless it contains other files."""
        self.record.unlink(missing_ok=True)
        if {path.name for path in self.path.iterdir()} <= {"multirun.yaml", LOCK}:  # the first is Hydra's own file
            shutil.rmtree(self.path)


def current_job() -> tuple[JobFolder, Job] | None:
    """Folder and record of the job that this process runs; None outside of a sweep."""
    path = os.environ.get(JOB_VARIABLE)
    job = (folder := JobFolder(path)).load() if path else None
    return (folder, job) if job else None


def reason_of(error: BaseException) -> str:
    """Text of one line about the error that ended a run."""
    from lmd.core.checks import InputError

    if isinstance(error, SystemExit) and not isinstance(error.code, str):
        return f"exited with code {error.code or 0} before it had finished"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | SystemExit) else f"{type(error).__name__}: {text}".rstrip(": ")
