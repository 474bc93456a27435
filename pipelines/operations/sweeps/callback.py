"""Hydra callback for the beginning and the end of a sweep: the tracked parent run, and the table of the jobs."""

import atexit
import os
import sys
from dataclasses import replace
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from ...app import say
from ...nodes import instantiate
from ...outputs import held
from ...provenance import repeating, source_tags
from ..signals import stop
from ..tracking import RunStart, Tracker
from .folder import Sweep, SweepFolder, reason_of
from .names import override_tags, pin_sweep_folder, sweep_name, sweep_title, swept, varied_keys
from .summary import best_group, by_group, draw_groups, grouping_keys, outcomes, write_jobs
from .supervisor import STOPPED, SWEEP_VARIABLE, lost, settle


class SweepRecord(Callback):
    """Hydra callback that starts the tracked parent run of a sweep; at the end, it writes the table of the jobs."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Start the tracked parent run of the sweep, or continue that of an earlier sweep that this command extends."""
        folder = SweepFolder(pin_sweep_folder(config))
        folder.path.mkdir(parents=True, exist_ok=True)
        with held(folder.path):  # another process may begin an equal command
            is_extended = _begin(config, folder)
        os.environ[SWEEP_VARIABLE] = "begun"
        atexit.register(_cut_short, config)
        done = f", continuing after {len(folder.jobs())} finished jobs (delete the folder to start again)"
        say(f"sweep {sweep_name(config)} in {folder.path}{done if is_extended else ''}")

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write the table, end the parent run, and exit with code 1 if a job has failed."""
        atexit.unregister(_cut_short)
        try:
            failed = _close(config)
        except Exception as error:  # Hydra would print a warning
            sys.exit(f"error: the sweep's run could not be ended: {reason_of(error)}")
        if failed:
            sys.exit(1)


def _begin(config: DictConfig, folder: SweepFolder) -> bool:
    """Start the tracked parent run of a sweep, or continue the parent run of the earlier sweep in this folder.

    Returns:
        True if there is an earlier sweep in this folder.
    """
    from lmd.core.checks import InputError

    before, overrides = folder.load(), swept(config)
    sweep = Sweep(sweep_name(config), varied_keys(overrides))
    if before:
        varied = tuple(dict.fromkeys([*before.varied, *sweep.varied]))
        sweep = replace(sweep, varied=varied, run_id=before.run_id, round=before.round + 1)
    tags = {"sweep": sweep.name, "pipeline": config.hydra.job.name} | override_tags(overrides)
    try:
        tracker: Tracker = instantiate(config.tracking)
        tags |= source_tags(config.hydra.job.name)
        tracker.start(RunStart(sweep_title(config), folder.path, tags=tags), sweep.run_id)
    except InputError as error:
        if before is None:
            folder.discard()
        sys.exit(f"error: {error}{f' (to start the sweep again, delete {folder.path})' if before else ''}")
    folder.save(replace(sweep, run_id=tracker.run_id or sweep.run_id))
    return before is not None


def _cut_short(config: DictConfig) -> None:
    """Write the table and end the tracked run of a sweep that was stopped before all of its jobs had ended."""
    folder = SweepFolder(config.hydra.sweep.dir)
    sweep = folder.load()
    if sweep is not None and sweep.round == 0 and not folder.jobs():  # the first job was refused
        if sweep.run_id is not None:
            tracker: Tracker = instantiate(config.tracking)
            tracker.start(RunStart(sweep.name, folder.path), sweep.run_id)
            tracker.discard()
        folder.discard()
        return
    _close(config, STOPPED if stop.requested else "the sweep was cut short")
    print("run the same command again to finish it", file=sys.stderr)


def _close(config: DictConfig, reason: str = "") -> bool:
    """Write the table of a sweep and end its tracked run; return True unless the run ended as FINISHED.

    Args:
        config: configuration of the sweep.
        reason: reason why the run has failed; if it is empty, the run counts as failed only if one of its jobs failed
            or there are no jobs.
    """
    from lmd.core.words import as_code

    folder = SweepFolder(config.hydra.sweep.dir)
    sweep = folder.load()
    assert sweep is not None
    for its_folder, job in folder.jobs():
        if job.status == "running":
            with held(its_folder.path, wait=False) as lock:
                if lock is not None:
                    its_folder.save(ended := lost(job, stop.requested))
                    settle(config.tracking, its_folder, ended)
    found = outcomes(folder.jobs())
    failed = [each for each in found if each.job.status not in ("finished", "running")]
    finished = sum(each.job.status == "finished" for each in found)  # jobs of an equal command may still run
    write_jobs(folder.table, sweep, found)
    folder.groups.write_text(f"{(groups := by_group(sweep, found))}\n")
    say(f"{(done := f'{finished} of {len(found)} jobs finished')}: {folder.table}")
    for each in failed:
        print(f"{each.job.status}: {each.job.label}: {each.job.reason} ({each.folder.output})", file=sys.stderr)
    if failed or not found:
        reason = reason or (f"{len(failed)} of {len(found)} jobs failed" if found else "the sweep had no jobs")
    tracker: Tracker = instantiate(config.tracking)
    command = repeating(source_tags(config.hydra.job.name))
    about = f"{done}\n\n{groups}\n\n{command}\n\nfiles: {as_code(folder.path)}"
    tracker.start(RunStart(sweep.name, folder.path, tags={"mlflow.note.content": about}), sweep.run_id)
    tracker.log_metrics({"jobs": len(found), "failed": len(failed)} | best_group(sweep, found))
    tracker.log_artifacts([folder.groups, folder.table, *draw_groups(folder.picture, sweep, found)])
    tracker.finish("KILLED" if reason == STOPPED else "FAILED" if reason else "FINISHED", reason)
    say("\n".join(tracker.views(grouping_keys(sweep))))
    return bool(reason)
