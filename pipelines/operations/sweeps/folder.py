"""What a sweep and its jobs keep on disk, so that processes and machines can share it and a later sweep can go on."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...documents import read_document, write_document
from .jobs import Job, Sweep

JOB_VARIABLE = "LMD_JOB"  # tells a process which job folder it works for


class JobFolder:
    """The folder of one job; what a run leaves there is named by the run.

    Args:
        path: where it is.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record = self.path / "job.json"
        self.output = self.path / "output.log"  # what the job printed
        self.metrics = self.path / "metrics.json"
        self.checkpoint = self.path / "checkpoint.npz"  # as in lmd.optimisers.checkpoint, which takes long to import

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
        """What the job's metrics.json says; nothing where there is none."""
        return read_document(self.metrics, dict) or {}

    @contextmanager
    def held(self, wait: bool = True) -> Iterator[int | None]:
        """Hold it for this process and those that inherit the descriptor; None if another holds it.

        Args:
            wait: whether to wait for the other.
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
        path: where it is.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record = self.path / "sweep.json"
        self.table = self.path / "jobs.csv"

    def load(self) -> Sweep | None:
        """The sweep; None where there is none."""
        return read_document(self.record, lambda values: Sweep(**values | {"varied": tuple(values["varied"])}))

    def save(self, sweep: Sweep) -> None:
        """Write the sweep."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_document(self.record, asdict(sweep))

    def job_of(self, digest: str) -> JobFolder | None:
        """The folder of the job whose configuration has this digest, with which its name ends; None for no such job."""
        return next((JobFolder(path) for path in self.path.glob(f"*{digest}")), None)

    def jobs(self) -> list[tuple[JobFolder, Job]]:
        """The jobs and their folders: those of the last command in its order, then those that earlier ones finished."""
        folders = [JobFolder(path) for path in self.path.iterdir()]
        found = [(folder, job) for folder in folders if (job := folder.load()) is not None]
        sweep = self.load()
        last = 0 if sweep is None else sweep.round
        kept = [(folder, job) for folder, job in found if job.round == last or job.status == "finished"]
        return sorted(kept, key=lambda entry: (-entry[1].round, entry[1].number))

    def discard(self) -> None:
        """Forget the sweep: no job has begun. What the user keeps there stays."""
        self.record.unlink(missing_ok=True)
        if {path.name for path in self.path.iterdir()} <= {"multirun.yaml"}:  # Hydra's
            shutil.rmtree(self.path)


def current_job() -> tuple[JobFolder, Job] | None:
    """The job this process works for and its folder; None outside a sweep."""
    path = os.environ.get(JOB_VARIABLE)
    folder = JobFolder(path) if path else None
    job = folder.load() if folder else None
    return (folder, job) if folder and job else None
