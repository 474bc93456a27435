"""Hydra callback that begins and ends a sweep: its tracked run, and its table."""

import atexit
import logging
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from ...composing import key_and_value
from ...nodes import instantiate
from ...outputs import held
from ...provenance import repeating, source_tags
from ..signals import stop
from .folder import Sweep, SweepFolder, reason_of
from .names import SEED, fixed, override_tags, pin_sweep_folder, sweep_name, sweep_title, swept, varied_keys
from .shared import Values, asked_values, shared_parameters
from .summary import (
    best_and_median,
    by_group,
    description,
    draw_groups,
    found_by,
    grouping_keys,
    pivot,
    why_nothing,
    write_jobs,
)
from .supervisor import STOPPED, SWEEP_VARIABLE, end_runs, lost

if TYPE_CHECKING:
    from ..tracking import Tracker

# Loggers of Hydra's launchers, which print all overrides of a job.
LAUNCHERS = ("hydra._internal.core_plugins.basic_launcher", "hydra_plugins.hydra_joblib_launcher._core")


class Shortened(logging.Filter):
    """Filter of a launcher's lines, `#3 : optimiser=ega seed=1 room=hall`, that leaves what varies."""

    def __init__(self, varied: Sequence[str]) -> None:
        super().__init__()
        self.varied = varied

    def filter(self, record: logging.LogRecord) -> bool:
        """Shorten a line; see `logging.Filter.filter`."""
        number, colon, overrides = str(record.msg).partition(" : ")
        if colon:
            shown = [word for word in overrides.split() if key_and_value(word)[0] in self.varied]
            record.msg = f"{number}: {' '.join(shown)}"
        return True


class SweepRecord(Callback):
    """Hydra callback that gives a sweep its parent run and, at its end, its table."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Start the parent run, or continue the parent run of the sweep that this command extends."""
        from lmd.core.checks import InputError

        folder = SweepFolder(pin_sweep_folder(config))
        try:
            values = asked_values(config)
        except InputError as error:  # Hydra would print a warning and continue
            sys.exit(f"error: {error}")
        folder.path.mkdir(parents=True, exist_ok=True)
        with held(folder.path):  # an equal command may begin at this moment
            before = self._begin(config, folder, values)
        os.environ[SWEEP_VARIABLE] = str(os.getpid())
        atexit.register(_cut_short, config)
        done = len(folder.jobs())
        going_on = f", going on after {done} finished jobs (delete the folder to start afresh)" if before else ""
        print(f"sweep {sweep_name(config)} in {folder.path}{going_on}", flush=True)
        if before is None and (sweep := folder.load()) is not None and (told := folder.like(sweep)):
            print(told, flush=True)
        for name in LAUNCHERS:
            logging.getLogger(name).addFilter(Shortened(varied_keys(swept(config))))

    @staticmethod
    def _begin(config: DictConfig, folder: SweepFolder, values: Values) -> Sweep | None:
        """Start the parent run, or continue the parent run of the sweep before in this folder, which is returned."""
        from lmd.core.checks import InputError

        from ..tracking import RunStart

        before, overrides = folder.load(), swept(config)
        asked = math.prod(map(len, values.values()))
        sweep = Sweep(sweep_name(config), varied_keys(overrides), None, asked=asked, given=fixed(config))
        try:
            tracker: Tracker = instantiate(config.tracking)
            if before:
                varied = tuple(dict.fromkeys([*before.varied, *sweep.varied]))
                known = before.run_id if before.run_id is not None and tracker.has(before.run_id) else None
                sweep = replace(sweep, varied=varied, run_id=known, round=before.round + 1)
            tags = {"sweep": sweep.name, "pipeline": config.hydra.job.name}
            tags |= override_tags(overrides) | source_tags(config.hydra.job.name)
            params = shared_parameters(config, values)
            started = RunStart(sweep_title(config), folder.path, params, tags)
            tracker.start(started, sweep.run_id)  # a run keeps its first params
        except InputError as error:
            hint = f" (to start the sweep afresh, delete {folder.path})" if before else ""
            if before is None:
                folder.discard()
            sys.exit(f"error: {error}{hint}")
        folder.save(replace(sweep, run_id=tracker.run_id or sweep.run_id))
        return before

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write the table, end the parent run, and exit with 1 if a job has failed."""
        atexit.unregister(_cut_short)
        try:
            failed = _close(config)
        except Exception as error:  # Hydra would print a warning
            sys.exit(f"error: the sweep's run could not be ended: {reason_of(error)}")
        if failed:
            sys.exit(1)


def _cut_short(config: DictConfig) -> None:
    """Close a sweep that ended before all its jobs had ended."""
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
    _close(config, STOPPED if stop.requested else "the sweep was cut short")
    print("the same command again does what is missing", file=sys.stderr)


def _close(config: DictConfig, reason: str = "") -> bool:
    """Write the table of a sweep and end its run; True unless the run ended as FINISHED.

    Args:
        reason: reason of the failure of the run; if empty, the run fails if a job failed.
    """
    from lmd.core.words import as_code

    from ..tracking import RunStart

    folder = SweepFolder(config.hydra.sweep.dir)
    sweep = folder.load()
    assert sweep is not None
    for its_folder, job in folder.jobs():
        if job.status == "running":
            with held(its_folder.path, wait=False) as lock:
                if lock is not None:
                    its_folder.save(ended := lost(job, stop.requested))
                    end_runs(config.tracking, its_folder, ended)
    jobs = folder.jobs()
    running = sum(job.status == "running" for _, job in jobs)  # jobs that another process with this command runs
    failed = [(its_folder, job) for its_folder, job in jobs if job.status not in ("finished", "running")]
    begun = sum(job.round == sweep.round for _, job in jobs)
    missing = max((sweep.asked or 0) - begun, 0) if reason else 0  # an equal job may be asked for twice
    found, total = found_by(jobs), len(jobs) + missing
    write_jobs(folder.table, sweep, found)
    across = pivot(sweep, found)
    tables = [f"Medians over {SEED}s, on the grid and off it:", across] if across else []
    folder.groups.write_text("\n\n".join([*tables, by_group(sweep, found)]) + "\n")
    left = f", {missing} had not begun" if missing else ""
    print(f"{len(jobs) - len(failed) - running} of {total} jobs finished{left}: {folder.table}", flush=True)
    for its_folder, job in failed:
        print(f"{job.status}: {job.label}: {job.reason} ({its_folder.output})", file=sys.stderr)
    if told := why_nothing(found):
        print(told, flush=True)
    if failed or not jobs:
        reason = reason or (f"{len(failed)} of {len(jobs)} jobs failed" if jobs else "the sweep had no jobs")
    tracker: Tracker = instantiate(config.tracking)
    command = repeating(source_tags(config.hydra.job.name))
    about = f"{description(sweep, found, total)}\n\n{command}\n\nfiles: {as_code(folder.path)}"
    if sweep.round:
        about += "\n\nparameters: those that the jobs of the first command share"
    tracker.start(RunStart(sweep.name, folder.path, tags={"mlflow.note.content": about}), sweep.run_id)
    tracker.log_metrics({"jobs": total, "failed": len(failed)} | best_and_median(sweep, found))
    tracker.log_artifacts([folder.groups, folder.table, *draw_groups(folder.picture, sweep, found)])
    tracker.finish("KILLED" if reason == STOPPED else "FAILED" if reason else "FINISHED", reason)
    for line in tracker.views(grouping_keys(sweep)):
        print(line, flush=True)
    return bool(reason)
