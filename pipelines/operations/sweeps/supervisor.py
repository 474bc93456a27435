"""Execution of one job of a sweep, in a process of its own."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from ...app import PACKAGE, choices, config_dir, ends_reported, key_and_value, quoted, run_directory, say, search_path
from ...nodes import instantiate
from ...outputs import JOB_VARIABLE, held
from ...provenance import parameters
from ..signals import CODES, stop
from ..tracking import RunStart, Tracker
from . import forks
from .folder import Job, JobFolder, SweepFolder, current_job, reason_of
from .names import short_name

SWEEP_VARIABLE = "LMD_SWEEP"  # environment variable that is set while a sweep goes on
THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
STOPPED = "the sweep was stopped"
LOST = "its process was killed, and the sweep with it"


def run(cfg: DictConfig, pipeline: Callable[[DictConfig], float | None]) -> float | None:
    """Run a pipeline, and return the pipeline's result, the number that Hydra's sweeper gets.

    A job of a sweep that `SweepRecord` began runs in a new process. If such a job fails, the result is NaN. All other
    pipelines run in this process. The process of a job writes the outcome to the job's folder, and stops when the sweep
    has ended.
    """
    if HydraConfig.get().mode == RunMode.MULTIRUN and SWEEP_VARIABLE in os.environ:
        return _supervise(cfg)
    with ends_reported():
        if (current := current_job()) is None:
            return pipeline(cfg)
        folder, job = current
        threading.Thread(target=_stop_with_the_sweep, daemon=True).start()
        try:
            with stop.raising():
                value = pipeline(cfg)
                folder.save(replace(job, status="finished", value=value))
                return value
        except BaseException as error:
            is_stopped = isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemExit) and error.code in CODES)
            folder.save(replace(job, status="interrupted" if is_stopped else "failed", reason=reason_of(error)))
            raise


def _stop_with_the_sweep() -> None:
    """Stop this process by a signal when its standard input is closed.

    The sweep keeps this input open, so it is closed when the sweep ends.
    """
    while os.read(0, 1):
        pass
    stop.why = STOPPED
    os.kill(os.getpid(), signal.SIGTERM)  # shells let background jobs ignore SIGINT


def _supervise(cfg: DictConfig) -> float | None:
    """Run one job of a sweep in a process of its own, unless the job has finished before.

    A failure is recorded but not raised, so that a failed job does not end the sweep; this holds for every launcher of
    Hydra.

    Returns:
        number that the job returned to Hydra's sweeper; NaN after a failure.
    """
    folder, job, launcher = JobFolder(run_directory()), _job(), HydraConfig.get().launcher
    # Number of threads: as configured, else 1 if jobs share a machine; None stands for every processor.
    alone = None if launcher._target_.endswith("BasicLauncher") else int(launcher.get("cpus_per_task") or 1)
    threads = alone if cfg.get("threads") is None else int(cfg.threads)
    with held(folder.path) as lock:
        if (done := folder.finished()) is not None:
            folder.save(replace(done, number=job.number, varied=job.varied, round=job.round))
            say(f"done already: {job.label}")
            return done.value
        own = ["hydra.mode=RUN", f"hydra.run.dir={quoted(folder.path)}"]
        if threads is not None and "threads" in cfg:  # some pipelines lack the key
            own.append(f"threads={threads}")
        if (before := folder.load()) is not None:
            settle(cfg.tracking, folder, lost(job))
            if before.status != "failed" and folder.checkpoint.exists():
                own.append(f"resume={quoted(folder.path)}")
                job = replace(job, seconds=before.seconds)  # earlier attempts count
        folder.save(job)
        began = time.monotonic()
        code, interrupted = _execute([*config_dir(), *search_path(), *job.overrides, *own], threads, folder, lock)
        job, seconds = _settled(folder.load() or job, code), time.monotonic() - began
        if interrupted and job.status in ("killed", "interrupted"):
            job = lost(job, stopped=True)
        folder.save(job := replace(job, seconds=job.seconds + seconds))
        failure = f"{job.status}: {job.label}: {job.reason} ({folder.output})"
        say(f"finished in {seconds:.0f} s: {job.label}" if (is_done := job.status == "finished") else failure)
        settle(cfg.tracking, folder, job, {} if job.status == "interrupted" else parameters(cfg, choices()))
        if interrupted and not is_done:
            sys.exit(128 + signal.SIGINT)
        return job.value if is_done else float("nan")


def _job() -> Job:
    """Record of the present job, made from the node `hydra` of the job's configuration."""
    context = HydraConfig.get()
    sweep = SweepFolder(context.sweep.dir).load()
    assert sweep is not None, "SweepRecord has written it before any job began"
    overrides = tuple(map(str, context.overrides.task))
    varied = {key: value for key, value in map(key_and_value, overrides) if key in sweep.varied}
    return Job(sweep.name, sweep.run_id, int(context.job.num), overrides, varied, round=sweep.round)


def _execute(arguments: list[str], threads: int | None, folder: JobFolder, lock: int | None) -> tuple[int, bool]:
    """Run the process of a job to its end.

    The process has a session of its own, so Ctrl-C in the terminal does not reach it directly. The process is told to
    stop only once, when the pipe to its standard input is closed. The process inherits the lock of its folder, so the
    folder stays locked if the sweep is killed.

    Args:
        arguments: arguments of the job's command line.
        threads: number of threads; None for every processor.
        folder: folder of the job.
        lock: file descriptor of the lock of the folder; None if there is no lock.

    Returns:
        exit code; True if the sweep was interrupted while the job ran.
    """
    if threads is not None:  # set before the server starts, as its packages read the variables at import
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    environment = os.environ | {"HYDRA_FULL_ERROR": "1", JOB_VARIABLE: str(folder.path)}
    module, (reads, writes) = f"{PACKAGE}.{HydraConfig.get().job.config_name}", os.pipe()
    with folder.output.open("ab") as output, os.fdopen(reads), os.fdopen(writes, "wb") as its_stdin:
        streams = {0: reads, 1: output.fileno(), 2: output.fileno()}
        process = forks.process(module, arguments, environment, streams, [] if lock is None else [lock])
        try:
            with stop.raising():
                with stop.postponed():  # otherwise an unknown process could remain
                    process.start()
                process.join()
        except KeyboardInterrupt:
            its_stdin.close()
            try:
                with stop.raising():
                    process.join()
            except KeyboardInterrupt:
                process.kill()
                process.join()
        return int(process.exitcode or 0), its_stdin.closed


def _settled(job: Job, code: int) -> Job:
    """Record of a job whose process has ended with the exit code `code`.

    If the job has not recorded its own end, the code gives the status and the reason.
    """
    if job.status != "running":
        return job
    if code in CODES:
        return replace(job, status="interrupted", reason="told to stop before it had begun")
    if code < 0:
        return replace(job, status="killed", reason=f"killed by {signal.Signals(-code).name}")
    return replace(job, status="failed", reason=f"exited with code {code} before it had finished")


def lost(job: Job, stopped: bool = False) -> Job:
    """Record of a job whose process ended together with the whole sweep, before the process wrote the outcome.

    `stopped` is True if a signal ended the sweep.
    """
    return replace(job, status="interrupted" if stopped else "killed", reason=STOPPED if stopped else LOST)


def settle(tracking: DictConfig, folder: JobFolder, job: Job, params: Mapping[str, Any] | None = None) -> None:
    """End the tracked runs of a job whose process has ended.

    If the job has no tracked run and did not finish, a new run is recorded for it, with the parameters `params`.
    """
    from lmd.core.checks import InputError

    if job.parent is None:
        return
    status = {"finished": "FINISHED", "interrupted": "KILLED"}.get(job.status, "FAILED")
    name = short_name(job.status, [f"{key}={value}" for key, value in job.varied.items()])
    try:
        tracker: Tracker = instantiate(tracking)
        run = RunStart(name, folder.path, params or {}, job.tags(folder.name))
        tracker.settle(run, status, job.reason, [folder.output])
    except InputError as error:
        print(f"the run of {job.label} could not be marked as {status}: {error}", file=sys.stderr)
