"""What Hydra calls when a sweep begins and ends: its tracked run, and its table."""

import atexit
import csv
import os
import sys
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from ...building import instantiate
from ...provenance import source_tags
from .folder import JobFolder, SweepFolder
from .jobs import Job, Sweep, reason_of
from .names import override_tags, pin_sweep_folder, sweep_name, swept, varied_keys
from .supervisor import LOST, SWEEP_VARIABLE, end_runs

if TYPE_CHECKING:
    from ..tracking import Tracker

# Figures of a job that its row has, if any job of the sweep has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)


class SweepRecord(Callback):
    """Hydra callback that gives a sweep its parent run and, at its end, its table."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Start the parent run, or continue that of the same sweep before."""
        from lmd.core.checks import InputError

        from ..tracking import RunStart

        folder = SweepFolder(pin_sweep_folder(config))
        before = folder.load()
        overrides = swept(config)
        sweep = Sweep(sweep_name(config), varied_keys(overrides), None)
        if before:
            varied = tuple(dict.fromkeys([*before.varied, *sweep.varied]))
            sweep = replace(sweep, varied=varied, run_id=before.run_id, round=before.round + 1)
        try:
            tracker: Tracker = instantiate(config.tracking)
            tags = {"sweep": sweep.name, "pipeline": config.hydra.job.name}
            tags |= override_tags(overrides) | source_tags(config.hydra.job.name)
            tracker.start(RunStart(f"sweep {sweep.name}", folder.path, tags=tags), sweep.run_id)
        except InputError as error:
            hint = f" (to start the sweep afresh, delete {folder.path})" if before else ""
            print(f"error: {error}{hint}", file=sys.stderr)
            sys.exit(1)
        folder.save(replace(sweep, run_id=tracker.run_id))
        os.environ[SWEEP_VARIABLE] = str(os.getpid())
        atexit.register(_cut_short, config)
        if config.hydra.launcher._target_.endswith("SlurmLauncher"):
            from .slurm import follow_the_queue

            follow_the_queue()
        done = len(folder.jobs())
        going_on = f", going on after {done} finished jobs (delete the folder to start afresh)" if before else ""
        print(f"sweep {sweep.name} in {folder.path}{going_on}", flush=True)

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
    from ..tracking import RunStart

    folder = SweepFolder(config.hydra.sweep.dir)
    sweep = folder.load()
    if sweep is not None and sweep.round == 0 and not folder.jobs():  # the first job was refused
        tracker: Tracker = instantiate(config.tracking)
        if sweep.run_id is not None:
            tracker.start(RunStart(sweep.name, folder.path), sweep.run_id)
            tracker.discard()
        folder.discard()
        return
    _close(config, "the sweep was cut short")
    print("the same command again does what is missing", file=sys.stderr)


def _close(config: DictConfig, reason: str = "") -> bool:
    """Write the table of a sweep and end its run, as FAILED if `reason` is given or a job failed; returns which."""
    from ..tracking import RunStart

    folder = SweepFolder(config.hydra.sweep.dir)
    sweep = folder.load()
    assert sweep is not None
    for its_folder, job in folder.jobs():
        if job.status == "running":
            with its_folder.held(wait=False) as lock:
                if lock is not None:
                    its_folder.save(replace(job, status="killed", reason=LOST))
                    end_runs(config.tracking, its_folder, job, LOST)
    jobs = folder.jobs()
    elsewhere = [its_folder for its_folder, job in jobs if job.status == "running"]  # by the same command once more
    failed = [(its_folder, job) for its_folder, job in jobs if job.status not in ("finished", "running")]
    write_table(folder.table, sweep, jobs)
    done = len(jobs) - len(failed) - len(elsewhere)
    print(f"{done} of {len(jobs)} jobs finished: {folder.table}", flush=True)
    for its_folder, job in failed:
        print(f"{job.status}: {job.label}: {job.reason} ({its_folder.output})", file=sys.stderr)
    if failed:
        reason = reason or f"{len(failed)} of {len(jobs)} jobs failed"
    tracker: Tracker = instantiate(config.tracking)
    tracker.start(RunStart(sweep.name, folder.path), sweep.run_id)
    tracker.log_metrics({"jobs": len(jobs), "failed": len(failed)} | _best_and_median(jobs))
    tracker.log_artifacts([folder.table])
    tracker.finish("FAILED" if reason else "FINISHED", reason)
    return bool(reason)


def _best_and_median(jobs: list[tuple[JobFolder, Job]]) -> dict[str, float]:
    """The best and the median of what the finished jobs returned, and of their figures."""
    found = [folder.figures() for folder, job in jobs if job.status == "finished"]
    summary: dict[str, float] = {}
    for key in FIGURES:
        values = [figures[key] for figures in found if key in figures]
        if values:
            summary |= {f"best/{key}": max(values), f"median/{key}": median(values)}
    return summary


def write_table(path: Path, sweep: Sweep, jobs: list[tuple[JobFolder, Job]]) -> None:
    """A row for each job: its folder, what varies, its status, its figures, seconds, and why it failed."""
    found = {folder.name: folder.figures() if job.status == "finished" else {} for folder, job in jobs}
    known = [key for key in FIGURES if any(key in figures for figures in found.values())]
    rows = [
        {"folder": folder.name, **job.varied, "status": job.status}
        | {key: found[folder.name].get(key, "") for key in known}
        | {"seconds": round(job.seconds, 1), "reason": job.reason}
        for folder, job in jobs
    ]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["folder", *sweep.varied, "status", *known, "seconds", "reason"])
        writer.writeheader()
        writer.writerows(rows)
