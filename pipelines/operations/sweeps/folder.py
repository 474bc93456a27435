"""The records of a sweep and its jobs on disk, which processes and machines share and a later command continues."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...outputs import read_document, write_document

JOB_VARIABLE = "LMD_JOB"  # environment variable with the folder of the job that a process does


@dataclass(frozen=True)
class Sweep:
    """A sweep, as `sweep.json` holds it."""

    name: str
    """The experiment that it runs, or the keys that it varies."""
    varied: tuple[str, ...]
    """Config keys that differ between its jobs, those of earlier commands first."""
    run_id: str | None
    """Its tracked run, the parent of its jobs' runs; None where nothing is recorded."""
    round: int = 0
    """Number of commands that have grown it before the last one."""
    asked: int | None = None
    """Number of jobs that the last command asks for; None for a search, which proposes them one after the other."""


@dataclass(frozen=True)
class Job:
    """A job of a sweep, as `job.json` holds it."""

    sweep: str
    """Name of its sweep."""
    parent: str | None
    """Tracked run of its sweep, if any."""
    number: int
    """Its place in the sweep, from 0."""
    overrides: tuple[str, ...]
    """Its overrides, as on the command line."""
    varied: Mapping[str, str]
    """Overrides that differ between the jobs of the sweep, as `{"objective.n": "2"}`."""
    status: str = "running"
    """`running`, `finished`, `interrupted`, `failed` (by an error of its own) or `killed`."""
    value: float | None = None
    """The value that the finished job returned."""
    reason: str = ""
    """The reason why it did not finish."""
    seconds: float = 0.0
    """Wall time over all sittings that the job goes on from, seconds."""
    round: int = 0
    """`Sweep.round` of the last command that asked for it."""

    @property
    def label(self) -> str:
        """The overrides that tell it from the other jobs."""
        return " ".join(f"{key}={value}" for key, value in self.varied.items()) or " ".join(self.overrides)

    def tags(self, name: str) -> dict[str, str]:
        """Tags of its tracked run that lead to the sweep and to the job's folder `name`."""
        from ..tracking import PARENT_TAG

        return {"sweep": self.sweep, "job": name} | ({PARENT_TAG: self.parent} if self.parent else {})


class JobFolder:
    """The folder of one job.

    Args:
        path: path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record = self.path / "job.json"
        self.output = self.path / "output.log"  # stdout and stderr of the job
        self.metrics = self.path / "metrics.json"
        self.checkpoint = self.path / "checkpoint.npz"  # as in lmd.optimisers.checkpoint, which is slow to import

    @property
    def name(self) -> str:
        """Its name below the sweep's folder."""
        return self.path.name

    def load(self) -> Job | None:
        """The job; None where there is none."""
        return read_document(self.record, lambda values: Job(**values | {"overrides": tuple(values["overrides"])}))

    def finished(self) -> Job | None:
        """The job, if it has finished and its figures are whole."""
        job = self.load()
        lost = self.metrics.exists() and not self.figures()
        return None if job is None or job.status != "finished" or lost else job

    def save(self, job: Job) -> None:
        """Write the job."""
        write_document(self.record, asdict(job))

    def figures(self) -> dict[str, Any]:
        """The figures in metrics.json; empty where there is none."""
        return read_document(self.metrics, dict) or {}

    @contextmanager
    def held(self, wait: bool = True) -> Iterator[int | None]:
        """Lock the folder for this process and all that inherit the descriptor; None if another process holds it.

        Args:
            wait: wait for the other process.
        """
        import fcntl

        with (self.path / ".lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if not wait:
                    yield None
                    return
                print(f"{self.path} is still being worked on by another process; waiting for it", flush=True)
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield lock.fileno()


class SweepFolder:
    """The folder of a sweep, with a folder for each of its jobs.

    Args:
        path: path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record = self.path / "sweep.json"
        self.table = self.path / "jobs.csv"
        self.groups = self.path / "by_group.md"

    def load(self) -> Sweep | None:
        """The sweep; None where there is none."""
        return read_document(self.record, lambda values: Sweep(**values | {"varied": tuple(values["varied"])}))

    def save(self, sweep: Sweep) -> None:
        """Write the sweep."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_document(self.record, asdict(sweep))

    def job_of(self, digest: str) -> JobFolder | None:
        """The folder of the job whose configuration has this digest, the end of its name; None for no such job."""
        return next((JobFolder(path) for path in self.path.glob(f"*{digest}")), None)

    def jobs(self) -> list[tuple[JobFolder, Job]]:
        """Jobs with their folders: those of the last command in its order, then finished ones of earlier commands."""
        folders = [JobFolder(path) for path in self.path.iterdir()]
        found = [(folder, job) for folder in folders if (job := folder.load()) is not None]
        sweep = self.load()
        last = 0 if sweep is None else sweep.round
        kept = [(folder, job) for folder, job in found if job.round == last or job.status == "finished"]
        return sorted(kept, key=lambda entry: (-entry[1].round, entry[1].number))

    def discard(self) -> None:
        """Remove the record of a sweep that has begun no job, and the folder unless it holds files of the user."""
        self.record.unlink(missing_ok=True)
        if {path.name for path in self.path.iterdir()} <= {"multirun.yaml"}:  # Hydra's
            shutil.rmtree(self.path)


def current_job() -> tuple[JobFolder, Job] | None:
    """The job of this process and its folder; None outside a sweep."""
    path = os.environ.get(JOB_VARIABLE)
    folder = JobFolder(path) if path else None
    job = folder.load() if folder else None
    return (folder, job) if folder and job else None


def reason_of(error: BaseException) -> str:
    """The error that ended a run, in one line."""
    from lmd.core.checks import InputError

    if isinstance(error, SystemExit) and not isinstance(error.code, str):
        return f"exited with code {error.code or 0} before it had finished"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | SystemExit) else f"{type(error).__name__}: {text}".rstrip(": ")
