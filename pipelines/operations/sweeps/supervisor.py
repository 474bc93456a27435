"""One job of a sweep, in a process of its own."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import cache
from types import FrameType
from typing import TYPE_CHECKING

from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from ...app import PACKAGE, ends_reported, run_directory
from ...earlier_run import check_experiment
from ...nodes import instantiate
from ...overrides import config_dir, key_and_value, quoted, search_path
from ..signals import CODES, Stopped, stop
from . import forks
from .folder import JOB_VARIABLE, Job, JobFolder, SweepFolder, current_job, reason_of
from .names import override_tags

if TYPE_CHECKING:
    from ..tracking import Tracker

SWEEP_VARIABLE = "LMD_SWEEP"  # tells the processes of a sweep which one began it
THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SLURM_SIGNALS = (signal.SIGTERM, signal.SIGUSR2)  # the job is to end; its time is nearly up
LOST = "its process was killed, and the sweep with it"


def run(cfg: DictConfig, pipeline: Callable[[DictConfig], float | None]) -> float | None:
    """What the entry point of every pipeline does: run it here, or in a sweep as a process of its own."""
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        return _supervise(cfg)
    with ends_reported(), _outcome_reported() as report:
        check_experiment(cfg)
        value = pipeline(cfg)
        report(value)
    return value


@contextmanager
def _outcome_reported() -> Iterator[Callable[[float | None], None]]:
    """Within a job of a sweep, note its outcome in its folder, and stop when the sweep is gone."""
    working_for = current_job()
    if working_for is None:
        yield lambda _: None
        return
    folder, job = working_for
    threading.Thread(target=_stop_with_the_sweep, daemon=True).start()
    try:
        with stop.raising():
            yield lambda value: folder.save(replace(job, status="finished", value=value))
    except BaseException as error:
        told_to = isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemExit) and error.code in CODES)
        folder.save(replace(job, status="interrupted" if told_to else "failed", reason=reason_of(error)))
        raise


def _stop_with_the_sweep() -> None:
    """Tell this process to stop when standard input, which the sweep holds open, is closed."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)  # and not SIGINT, which shells let background jobs ignore


def _supervise(cfg: DictConfig) -> float | None:
    """Run one job of a sweep in a process of its own, unless it is done; returns its value, NaN if it failed.

    A failure is noted and not raised: so no job can end a sweep, whatever it does to its process, under any launcher.
    """
    folder, job = JobFolder(run_directory()), job_of(HydraConfig.get())
    if HydraConfig.get().launcher._target_.endswith("JoblibLauncher"):
        _end_with_the_sweep()
    with folder.held() as lock:
        if (done := folder.finished()) is not None:
            folder.save(replace(done, number=job.number, varied=job.varied, round=job.round))
            print(f"done already: {job.label}{_told(folder)}", flush=True)
            return done.value
        before = folder.load()
        continued = before is not None and before.status != "failed" and folder.checkpoint.exists()
        if before is not None:
            end_runs(cfg.tracking, folder, job, LOST)
        folder.save(job)
        began = time.monotonic()
        code, interrupted = _execute(cfg, _arguments(cfg, job, folder, continued), folder, lock)
        job = _settled(folder.load() or job, code)
        job = replace(job, seconds=time.monotonic() - began)
        folder.save(job)
        if job.status == "finished":
            print(f"finished in {job.seconds:.0f} s: {job.label}{_told(folder)}", flush=True)
            return job.value
        print(f"{job.status}: {job.label}: {job.reason} ({folder.output})", flush=True)
        if job.status != "interrupted":
            end_runs(cfg.tracking, folder, job, job.reason, name=f"{job.status} {job.label}")
        if interrupted:
            sys.exit(128 + signal.SIGINT)
        return float("nan")


def _told(folder: JobFolder) -> str:
    """What a job found, in the unit of the fitness; nothing of one that found no deployment."""
    figures = folder.figures()
    named = {"fitness": "on the grid", "off_grid": "off it"}
    told = [f"{figures[key]:.2%} {label}" for key, label in named.items() if key in figures]
    return f": {', '.join(told)}" if told else ""


@cache
def _end_with_the_sweep() -> None:
    """Let a process of joblib's end when the sweep's has, even by `kill -9`; its job then stops by itself."""
    sweep = int(os.environ[SWEEP_VARIABLE])

    def watch() -> None:
        while os.getppid() == sweep:
            time.sleep(1.0)
        os._exit(1)

    if os.getpid() != sweep:
        threading.Thread(target=watch, daemon=True).start()


def job_of(context: HydraConf) -> Job:
    """The job that Hydra describes in its own part of a job's configuration."""
    sweep = SweepFolder(context.sweep.dir).load()
    assert sweep is not None, "SweepRecord has written it before any job began"
    overrides = tuple(str(override) for override in context.overrides.task)
    values = dict(map(key_and_value, overrides))
    varied = {key: values[key] for key in sweep.varied if key in values}
    return Job(sweep.name, sweep.run_id, int(context.job.num), overrides, varied, round=sweep.round)


def _arguments(cfg: DictConfig, job: Job, folder: JobFolder, continued: bool) -> list[str]:
    """The arguments with which the pipeline does `job` and nothing else."""
    own = ["hydra.mode=RUN", f"hydra.run.dir={quoted(folder.path)}"]
    threads = _threads(cfg)
    if threads is not None and "threads" in cfg:  # not every pipeline has them
        own.append(f"threads={threads}")
    if continued:
        own.append(f"resume={quoted(folder.path)}")
    return [*config_dir(), *search_path(), *job.overrides, *own]


def _threads(cfg: DictConfig) -> int | None:
    """Threads of a job: as configured, or else one where jobs share a machine; None for every processor."""
    launcher, configured = HydraConfig.get().launcher, cfg.get("threads")
    if configured is not None or launcher._target_.endswith("BasicLauncher"):
        return None if configured is None else int(configured)
    return int(launcher.get("cpus_per_task") or 1)


def _execute(cfg: DictConfig, arguments: list[str], folder: JobFolder, lock: int | None) -> tuple[int, bool]:
    """Run a job's process to its end; returns its exit code, and whether the sweep was interrupted meanwhile.

    The process has a session of its own, so that Ctrl-C reaches it once and through the pipe only, and it inherits the
    lock of its folder, which so stays held should the sweep be killed.
    """
    threads, uri = _threads(cfg), cfg.tracking.get("uri")
    if threads is not None:  # for the server, too: what it imports reads them then
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    with folder.output.open("ab") as output:
        process = forks.Process(
            f"{PACKAGE}.{HydraConfig.get().job.config_name}",
            arguments,
            os.environ | {"HYDRA_FULL_ERROR": "1", JOB_VARIABLE: str(folder.path)},
            output.fileno(),
            () if lock is None else (lock,),
            store=None if uri is None else str(uri),
        )
        with closing(process), _told_by_slurm():
            try:
                with stop.raising():  # heard here: what fails later is another matter
                    with stop.postponed():  # or a process could be left that nobody knows of
                        process.start()
                    return process.wait(), False
            except KeyboardInterrupt:
                process.stdin.close()
                try:
                    with stop.raising():
                        return process.wait(), True
                except KeyboardInterrupt:
                    process.kill()
                    return process.wait(), True


@contextmanager
def _told_by_slurm() -> Iterator[None]:
    """While entered, what SLURM sends a job some time before it kills it is like Ctrl-C, once.

    It goes to this process, or to its process group, and not to that of the job.
    """

    def interrupt(number: int, _frame: FrameType | None) -> None:
        for other in before:
            signal.signal(other, signal.SIG_IGN)
        raise Stopped(number)

    told = SLURM_SIGNALS if os.environ.get("SUBMITIT_EXECUTOR") == "slurm" else ()
    before = {number: signal.signal(number, interrupt) for number in told}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _settled(job: Job, code: int) -> Job:
    """The job after its process has ended with `code`, perhaps without having said why."""
    if job.status != "running":
        return job
    if code in CODES:
        return replace(job, status="interrupted", reason="told to stop before it had begun")
    if code < 0:
        return replace(job, status="killed", reason=f"killed by {signal.Signals(-code).name}")
    return replace(job, status="failed", reason=f"exited with code {code} before it had finished")


def end_runs(tracking: DictConfig, folder: JobFolder, job: Job, reason: str, name: str | None = None) -> None:
    """Mark the job's runs that its process left running as FAILED; where it had none yet, record one called `name`."""
    from lmd.core.checks import InputError

    from ..tracking import RunStart

    if job.parent is None:
        return
    tracker: Tracker = instantiate(tracking)
    try:
        if not tracker.end_lost(job.tags(folder.name), reason) and name is not None:
            tracker.start(RunStart(name, folder.path, tags=job.tags(folder.name) | override_tags(job.overrides)))
            tracker.finish("FAILED", reason)
    except InputError as error:
        print(f"the run of {job.label} could not be marked as failed: {error}", file=sys.stderr)
