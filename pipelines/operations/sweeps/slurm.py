"""Sweeps on SLURM: states of jobs come from the queue, and a job that SLURM ends does not end the sweep.

submitit by itself asks SLURM's accounting, which some clusters lack, and only every ten minutes.
"""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from submitit.core.utils import UncompletedJobError
from submitit.slurm import slurm

from lmd.core.checks import InputError

from ...outputs import held
from .folder import JobFolder
from .shared import parameters_of
from .supervisor import end_runs, job_of

PROGRAMS = ("sbatch", "srun", "squeue")  # which submitit and this module call
POLL_SECONDS = 10  # greatest time between two requests to the queue, seconds; shorter at first
GONE = "GONE"  # state of a job that is not in the queue: cancelled before it began, or ended long ago
ENDED = (
    GONE, "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY", "PREEMPTED",
    "TIMEOUT",
)  # fmt: skip


class QueueWatcher(slurm.SlurmInfoWatcher):
    """Watcher of jobs by `squeue`, which needs no accounting."""

    def _make_command(self) -> list[str] | None:
        if self._registered <= self._finished:
            return None
        return ["squeue", f"--user={os.getuid()}", "--states=all", "--array", "--noheader", "--format=%i|%T"]

    def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
        """States of the jobs by id, from the output of `squeue`."""
        text = string if isinstance(string, str) else string.decode()
        listed = dict(line.split("|") for line in text.split())
        return {job: {"State": listed.get(job, GONE)} for job in self._registered - self._finished}

    def is_done(self, job_id: str, mode: str = "standard") -> bool:
        """Return whether the job has ended."""
        return self.get_state(job_id, mode) in ENDED


class QueuedJob(slurm.SlurmJob[JobReturn]):
    """Job of a sweep; if SLURM ends the job, the job's record names the state, and the sweep continues."""

    watcher = QueueWatcher(delay_s=POLL_SECONDS)
    _results_timeout_s = 0  # a late result is in the job's record

    def results(self) -> list[JobReturn]:
        """Wait for the job; the value is NaN if the job returned none."""
        try:
            return super().results()
        except UncompletedJobError:
            self._note_end(self.state)
            return [JobReturn(status=JobStatus.COMPLETED, _return_value=float("nan"))]

    def _note_end(self, state: str) -> None:
        """Record that SLURM ended the job, possibly before the job began."""
        submitted = self.submission()
        launcher: Any = submitted.function  # the launcher that submitted the job
        overrides, _, number, *_ = submitted.args
        config = launcher.hydra_context.config_loader.load_sweep_config(launcher.config, overrides)
        config.hydra.job.num = number
        folder = JobFolder(Path(config.hydra.sweep.dir, config.hydra.sweep.subdir))
        folder.path.mkdir(exist_ok=True)
        folder.path.touch()  # makes a shared file system show the files of the node
        reason = "it left SLURM's queue" if state == GONE else f"SLURM says {state}"
        with held(folder.path):  # the job may still run on a node that is slow to end it
            job = folder.load() or job_of(config.hydra)
            if job.status == "interrupted":
                reason = "its time was nearly up" if state == "FAILED" else reason
                folder.save(replace(job, reason=reason))
            elif job.status == "running":
                log = f" ({self.paths.stderr})" if self.paths.stderr.exists() else ""
                job = replace(job, status="killed", reason=reason + log)
                folder.save(job)
                end_runs(config.tracking, folder, job, parameters_of(config))


def follow_the_queue() -> None:
    """Make submitit use the classes of this module, for which it has no setting.

    Raises:
        InputError: there is no SLURM here.
    """
    if lacking := [program for program in PROGRAMS if shutil.which(program) is None]:
        raise InputError(f"this launcher needs SLURM, and there is no {lacking[0]}; hydra/launcher=joblib needs none.")
    slurm.SlurmJob = slurm.SlurmExecutor.job_class = QueuedJob  # type: ignore[assignment, misc]
