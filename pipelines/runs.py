"""What has run, how it ended and how to go on: `python -m pipelines.runs [last=20]`.

Runs whose process is gone are ended first: they would be shown as running for ever.
"""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import application, ends_reported
from .building import instantiate

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "name": "run",
    "tags.pipeline": "pipeline",
    "status": "status",
    "started": "started (UTC)",
    "metrics.fitness": "fitness",
    "metrics.evaluations": "evaluations",
}


@application("runs")
def main(cfg: DictConfig) -> None:
    """List the newest runs."""
    with ends_reported():
        runs(cfg)


def runs(cfg: DictConfig) -> None:
    """List the newest runs of the configured store."""
    from lmd.checks import InputError, integer

    from .tracking import MlflowReader, MlflowTracker
    from .tracking.experiment import link
    from .tracking.hand_in import end_those_gone

    tracker, last = instantiate(cfg.tracking), integer("last", cfg.last, low=1)
    if not isinstance(tracker, MlflowTracker):
        raise InputError("runs are read where they were tracked: it needs tracking=mlflow.")
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    with tracker.store.errors_reported():
        end_those_gone(tracker.store)
    table = reader.runs().iloc[-last:]
    print(_listed(table))
    unfinished = {str(run_id): again for run_id, run in table.iterrows() if (again := _how_to_go_on(run))}
    names = table["name"].to_dict()
    for run_id, again in unfinished.items():
        print(f"\n{names[run_id]} ({run_id}) goes on with:\n{shlex.join(again)}")
    if cfg.resume is not None:
        _resume(unfinished, str(cfg.resume))
    print(f"\nin the browser, while `make ui` runs: {link(cfg.address, tracker.store.experiment_id)}")


def _listed(table: "pd.DataFrame") -> str:
    shown = table.reindex(columns=list(COLUMNS)).rename(columns=COLUMNS)
    shown["started (UTC)"] = shown["started (UTC)"].dt.strftime("%Y-%m-%d %H:%M:%S")
    return str(shown.to_string(index=False, na_rep="", float_format="{:g}".format))


def _how_to_go_on(run: "pd.Series") -> list[str]:
    """The command that goes on with a run, in words; none where it has ended well, or has left nothing to go on from.

    A sweep goes on with the same command, and with it its jobs.
    """
    from lmd.checkpoint import FILE

    from .tracking import PARENT_TAG

    command, folder = run.get("tags.command"), Path(str(run.get("tags.folder")))
    if run["status"] not in ("KILLED", "FAILED") or not isinstance(command, str):
        return []
    words = [word for word in shlex.split(command) if not word.startswith("resume=")]
    if isinstance(run.get("tags.sweep"), str):
        return [] if isinstance(run.get(f"tags.{PARENT_TAG}"), str) else words
    return [*words, f"resume={folder}"] if (folder / FILE).is_file() else []


def _resume(unfinished: Mapping[str, list[str]], wanted: str) -> None:
    """Become the command that goes on with the run called `wanted`, or with the last one."""
    from lmd.checks import InputError

    found = list(unfinished) if wanted == "last" else [run_id for run_id in unfinished if run_id.startswith(wanted)]
    if not found:
        raise InputError(f"resume = {wanted!r} is no run among these that can go on.")
    words = unfinished[found[-1]]
    print(f"\n{shlex.join(words)}", flush=True)
    program = sys.executable if words[0] == "python" else words[0]
    os.execvp(program, [program, *words[1:]])


if __name__ == "__main__":
    main()
