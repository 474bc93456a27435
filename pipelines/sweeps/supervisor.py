"""Sweeps: each job in a process of its own, one parent run, a table, and going on where a sweep was cut short."""

import atexit
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from ..app import PACKAGE, config_dir, input_errors_reported, instantiate, run_directory, search_path
from .jobs import (
    JOB_VARIABLE,
    Job,
    Sweep,
    current_job,
    held,
    key_and_value,
    override_tags,
    pin_sweep_folder,
    quoted,
    reason_of,
    sweep_name,
    swept,
    varied_keys,
)

if TYPE_CHECKING:
    from ..tracking import Tracker

THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
FIGURES = ("qualified_ratio", "average_coverage_probability", "maximum_coverage_probability")
INTERRUPTED = 130  # exit code of a run that was told to stop
OUTPUT = "output.log"  # what a job printed
CHECKPOINT = "checkpoint.pkl"  # as in lmd.checkpoint, which takes long to import
LOST = "its process was killed, and the sweep with it"


def run(cfg: DictConfig, pipeline: Callable[[DictConfig], float | None]) -> float | None:
    """What the entry point of every pipeline does: run it here, or in a sweep as a process of its own."""
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        return _supervise(cfg)
    with input_errors_reported(), _outcome_reported() as report:
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
        yield lambda value: replace(job, status="finished", value=value).save(folder)
    except BaseException as error:
        told_to = isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemExit) and error.code == INTERRUPTED)
        replace(job, status="interrupted" if told_to else "failed", reason=reason_of(error)).save(folder)
        raise


def _stop_with_the_sweep() -> None:
    """Interrupt this process when standard input, which the sweep holds open, is closed."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


def _supervise(cfg: DictConfig) -> float | None:
    """Run one job of a sweep in a process of its own, unless it is done; returns its value, NaN if it failed.

    A failure is noted and not raised: so no job can end a sweep, whatever it does to its process, under any launcher.
    """
    folder, job = run_directory(), _this_job()
    with held(folder) as lock:
        before = Job.load(folder)
        if before is not None and before.status == "finished":
            print(f"done already: {job.label}", flush=True)
            return before.value
        continued = before is not None and before.status != "failed" and (folder / CHECKPOINT).exists()
        if before is not None:
            _end_runs(cfg.tracking, folder, job, LOST)
        job.save(folder)
        began = time.monotonic()
        code, interrupted = _execute(_command(cfg, job, folder, continued), folder, _threads(cfg), lock)
        job = _settled(Job.load(folder) or job, code)
        job = replace(job, seconds=time.monotonic() - began)
        job.save(folder)
        if job.status == "finished":
            print(f"finished in {job.seconds:.0f} s: {job.label}", flush=True)
            return job.value
        print(f"{job.status}: {job.label}: {job.reason} ({folder / OUTPUT})", flush=True)
        if job.status != "interrupted":
            _end_runs(cfg.tracking, folder, job, job.reason, name=f"{job.status} {job.label}")
        if interrupted:
            sys.exit(INTERRUPTED)
        return float("nan")


def _this_job() -> Job:
    """The job that Hydra has given this process."""
    context = HydraConfig.get()
    sweep = Sweep.load(Path(context.sweep.dir))
    assert sweep is not None, "SweepRecord has written it before any job began"
    overrides = tuple(str(override) for override in context.overrides.task)
    values = dict(map(key_and_value, overrides))
    varied = {key: values[key] for key in sweep.varied if key in values}
    return Job(sweep.name, sweep.run_id, int(context.job.num), overrides, varied)


def _command(cfg: DictConfig, job: Job, folder: Path, continued: bool) -> list[str]:
    """The command line that does `job` and nothing else."""
    own = ["hydra.mode=RUN", f"hydra.run.dir={quoted(folder)}"]
    threads = _threads(cfg)
    if threads is not None and "threads" in cfg:  # not every pipeline has them
        own.append(f"threads={threads}")
    if continued:
        own.append(f"resume={quoted(folder)}")
    return [
        sys.executable,
        "-m",
        f"{PACKAGE}.{HydraConfig.get().job.config_name}",
        *config_dir(),
        *search_path(),
        *job.overrides,
        *own,
    ]


def _threads(cfg: DictConfig) -> int | None:
    """Threads of a job: as configured, or else one where jobs share a machine; None for every processor."""
    launcher, configured = HydraConfig.get().launcher, cfg.get("threads")
    if configured is not None or launcher._target_.endswith("BasicLauncher"):
        return None if configured is None else int(configured)
    return int(launcher.get("cpus_per_task") or 1)


def _execute(command: list[str], folder: Path, threads: int | None, lock: int | None) -> tuple[int, bool]:
    """Run a job's process to its end; returns its exit code, and whether the sweep was interrupted meanwhile.

    The process has a session of its own, so that Ctrl-C reaches it once and through the pipe only, and it inherits the
    lock of its folder, which so stays held should the sweep be killed.
    """
    environment = os.environ | {JOB_VARIABLE: str(folder), "HYDRA_FULL_ERROR": "1"}
    if threads is not None:
        environment |= dict.fromkeys(THREAD_VARIABLES, str(threads))
    descriptors = () if lock is None else (lock,)
    with (folder / OUTPUT).open("ab") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            pass_fds=descriptors,
            start_new_session=True,
        )
    with process:
        try:
            return process.wait(), False
        except KeyboardInterrupt:
            assert process.stdin is not None
            process.stdin.close()
            try:
                return process.wait(), True
            except KeyboardInterrupt:
                process.kill()
                return process.wait(), True


def _settled(job: Job, code: int) -> Job:
    """The job after its process has ended with `code`, perhaps without having said why."""
    if job.status != "running":
        return job
    if code < 0:
        return replace(job, status="killed", reason=f"killed by {signal.Signals(-code).name}")
    return replace(job, status="failed", reason=f"exited with code {code} before it had finished")


def _end_runs(tracking: DictConfig, folder: Path, job: Job, reason: str, name: str | None = None) -> None:
    """Mark the job's runs that its process left running as FAILED; where it had none yet, record one called `name`."""
    from lmd.checks import InputError

    if job.parent is None:
        return
    tracker: Tracker = instantiate(tracking)
    try:
        if not tracker.end_lost(job.tags(folder), reason) and name is not None:
            tracker.start(name, {}, job.tags(folder) | override_tags(job.overrides), None)
            tracker.finish("FAILED", reason)
    except InputError as error:
        print(f"the run of {job.label} could not be marked as failed: {error}", file=sys.stderr)


class SweepRecord(Callback):
    """Hydra callback that gives a sweep its parent run and, at its end, its table."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Start the parent run, or continue that of the same sweep before."""
        from lmd.checks import InputError

        folder = pin_sweep_folder(config)
        before = Sweep.load(folder)
        overrides = swept(config)
        sweep = Sweep(sweep_name(config), varied_keys(overrides), before.run_id if before else None)
        try:
            tracker: Tracker = instantiate(config.tracking)
            tags = {"sweep": sweep.name, "pipeline": config.hydra.job.name, "folder": str(folder.resolve())}
            tracker.start(f"sweep {sweep.name}", {}, tags | override_tags(overrides), sweep.run_id)
        except InputError as error:
            hint = f" (to start the sweep afresh, delete {folder})" if before else ""
            print(f"error: {error}{hint}", file=sys.stderr)
            sys.exit(1)
        replace(sweep, run_id=tracker.run_id).save(folder)
        atexit.register(_cut_short, config)
        done = sum(job.status == "finished" for _, job in _jobs(folder))
        going_on = f", going on after {done} finished jobs (delete the folder to start afresh)" if before else ""
        print(f"sweep {sweep.name} in {folder}{going_on}", flush=True)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write the table, end the parent run, and exit with 1 if a job has failed."""
        atexit.unregister(_cut_short)
        try:
            failed = _close(config)
        except Exception as error:  # Hydra would make it a warning
            print(f"error: the sweep's run could not be ended: {reason_of(error)}", file=sys.stderr)
            failed = True
        if failed:
            sys.exit(1)


def _cut_short(config: DictConfig) -> None:
    """Close a sweep that ended before all its jobs had."""
    folder = Path(config.hydra.sweep.dir)
    if not _jobs(folder):  # the first job was refused
        sweep = Sweep.load(folder)
        tracker: Tracker = instantiate(config.tracking)
        if sweep is not None and sweep.run_id is not None:
            tracker.start(sweep.name, {}, {}, sweep.run_id)
            tracker.discard()
        (folder / "sweep.json").unlink(missing_ok=True)
        if {path.name for path in folder.iterdir()} <= {"multirun.yaml"}:  # Hydra's, and nothing of the user's
            shutil.rmtree(folder)
        return
    _close(config, "the sweep was cut short")
    print("the same command again does what is missing", file=sys.stderr)


def _close(config: DictConfig, reason: str = "") -> bool:
    """Write the table of a sweep and end its run, as FAILED if `reason` is given or a job failed; returns which."""
    folder = Path(config.hydra.sweep.dir)
    sweep = Sweep.load(folder)
    assert sweep is not None
    for path, job in _jobs(folder):
        if job.status == "running":
            with held(path, wait=False) as lock:
                if lock is not None:
                    replace(job, status="killed", reason=LOST).save(path)
                    _end_runs(config.tracking, path, job, LOST)
    jobs = _jobs(folder)
    failed = [(path, job) for path, job in jobs if job.status != "finished"]
    table = folder / "jobs.csv"
    write_table(table, sweep, jobs)
    print(f"{len(jobs) - len(failed)} of {len(jobs)} jobs finished: {table}", flush=True)
    for path, job in failed:
        print(f"{job.status}: {job.label}: {job.reason} ({path / OUTPUT})", file=sys.stderr)
    if failed:
        reason = reason or f"{len(failed)} of {len(jobs)} jobs failed"
    tracker: Tracker = instantiate(config.tracking)
    tracker.start(sweep.name, {}, {}, sweep.run_id)
    tracker.log_metrics({"jobs": len(jobs), "failed": len(failed)})
    tracker.log_artifacts([table])
    tracker.finish("FAILED" if reason else "FINISHED", reason)
    return bool(reason)


def _jobs(folder: Path) -> list[tuple[Path, Job]]:
    """The jobs of a sweep and their folders, in the order of the sweep."""
    found = ((path.parent, Job.load(path.parent)) for path in folder.glob("*/job.json"))
    return sorted(((path, job) for path, job in found if job is not None), key=lambda entry: entry[1].number)


def write_table(path: Path, sweep: Sweep, jobs: list[tuple[Path, Job]]) -> None:
    """A row for each job: its folder, what varies, its status, its figures, seconds, and why it failed."""
    rows = []
    for folder, job in jobs:
        metrics = folder / "metrics.json"
        figures = json.loads(metrics.read_text()) if job.status == "finished" and metrics.exists() else {}
        rows.append(
            {"folder": folder.name, **job.varied, "status": job.status}
            | {key: figures.get(key, "") for key in FIGURES}
            | {"seconds": round(job.seconds, 1), "reason": job.reason}
        )
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["folder", *sweep.varied, "status", *FIGURES, "seconds", "reason"])
        writer.writeheader()
        writer.writerows(rows)
