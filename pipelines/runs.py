"""List the newest runs, or send journals to the tracking store: `python -m pipelines.runs [last=20] [sync=FOLDER]`.

If the tracking store stops answering, a run continues and writes its entries to a journal in its folder. `sync` sends
the journals below a folder to `tracking.uri`. Before runs are listed, unfinished runs whose process has ended are
marked as failed.
"""

import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import quoted, say, task_overrides
from .command import Command
from .nodes import instantiate

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "name": "run",
    "tags.pipeline": "pipeline",
    "status": "status",
    "started": "started (UTC)",
    "metrics.fitness": "fitness",
    "metrics.off_grid": "off the grid",
    "metrics.evaluations": "evaluations",
}


def runs(cfg: DictConfig) -> None:
    """List the newest runs of the configured store, or send the journals below a folder.

    Raises:
        InputError: a setting has a value that is not allowed, or the store cannot be used.
    """
    from lmd.core.checks import InputError, integer, printable

    from .operations.tracking import MlflowReader, MlflowTracker
    from .operations.tracking.journal import end_those_gone
    from .operations.tracking.views import link

    tracker, last = instantiate(cfg.tracking), integer("last", cfg.last, low=1)
    if not isinstance(tracker, MlflowTracker):
        raise InputError("the list of runs is read from mlflow: set tracking=mlflow.")
    if cfg.sync is not None:
        hand_in_below(Path(str(cfg.sync)), tracker.store.uri)
        return
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    with tracker.store.errors_reported():
        end_those_gone(tracker.store)
    table = reader.runs().iloc[-last:]
    shown = table.reindex(columns=list(COLUMNS)).rename(columns=COLUMNS)
    for column in ("run", "pipeline"):
        shown[column] = shown[column].fillna("").astype(str).map(printable)
    shown["started (UTC)"] = shown["started (UTC)"].dt.strftime("%Y-%m-%d %H:%M:%S")
    percent = dict.fromkeys(("fitness", "off the grid"), "{:.2%}".format)
    say(shown.to_string(index=False, na_rep="", float_format="{:g}".format, formatters=percent))
    for run_id, run in table.iterrows():
        if command := going_on(run):
            name = printable(f"{run['name']} ({run_id})")
            say(f"\n{name} can be continued with this recorded command:\n{printable(command)}")
    say(f"\nin the browser, while `make ui` runs: {link(cfg.address, tracker.store.experiment_id)}")


def going_on(run: "pd.Series") -> str:
    """Shell command that resumes a run, taken from the record of the run; empty if the run cannot be resumed.

    A run cannot be resumed if it still runs, has finished or has left no checkpoint. A job of a sweep cannot be resumed
    alone; the command of the sweep resumes it.

    Args:
        run: row of `MlflowReader.runs`.
    """
    from lmd.optimisers.checkpoint import CHECKPOINT_FILE

    from .operations.tracking import PARENT_TAG

    command, folder = run.get("tags.command"), Path(str(run.get("tags.folder")))
    is_sweep, is_job = (isinstance(run.get(f"tags.{tag}"), str) for tag in ("sweep", PARENT_TAG))
    left = folder if is_sweep else folder / CHECKPOINT_FILE
    is_lost = run.get("tags.host") == socket.gethostname() and not left.exists()
    if run["status"] not in ("KILLED", "FAILED") or not isinstance(command, str) or is_lost or (is_sweep and is_job):
        return ""
    return command if is_sweep else f"{command} resume={quoted(folder)}"


def hand_in_below(folder: Path, uri: str) -> None:
    """Send all journals below a folder to the store `uri`; exit with code 1 if a journal could not be sent.

    The journal of a run that was recorded in another store is sent only if the command line gives `tracking.uri`.

    Raises:
        InputError: there is no such folder.
    """
    from lmd.core.checks import InputError, printable

    from .operations.tracking.journal import FILE, Journal, hand_in

    if not folder.is_dir():
        raise InputError(f"sync = {str(folder)!r} is not a folder.")
    paths, failed, is_named = sorted(folder.rglob(FILE)), False, "tracking.uri" in dict(task_overrides())
    for path in paths:
        try:
            journal = Journal.of(path.parent)
            if journal.store not in (None, uri) and not is_named:
                raise InputError(f"it was recorded for {journal.store!r}: set tracking.uri to the store that gets it.")
            say(printable(hand_in(journal, uri)))
        except InputError as error:
            print(printable(f"error: {path}: {error}"), file=sys.stderr)
            failed = True
    if not paths:
        say(f"nothing to hand in below {folder}")
    if failed:
        sys.exit(1)


main = Command("runs", runs)

if __name__ == "__main__":
    main()
