"""What has run, how it ended and how to go on: `python -m pipelines.runs [last=20]`.

Runs whose process is gone are ended first: they would be shown as running for ever.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import application, ends_reported, instantiate
from .provenance import command_line

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
    for run_id, run in table.iterrows():
        again = _how_to_go_on(run)
        if again:
            print(f"\n{run['name']} ({run_id}) goes on with:\n{again}")
    print(f"\nin the browser, while `make ui` runs: {link(cfg.address, tracker.store.experiment_id)}")


def _listed(table: "pd.DataFrame") -> str:
    shown = table.reindex(columns=list(COLUMNS)).rename(columns=COLUMNS)
    shown["started (UTC)"] = shown["started (UTC)"].dt.strftime("%Y-%m-%d %H:%M:%S")
    return str(shown.to_string(index=False, na_rep="", float_format="{:g}".format))


def _how_to_go_on(run: "pd.Series") -> str:
    """The command that goes on with a run; empty where it has ended well, or has left nothing to go on from."""
    from lmd.checkpoint import FILE

    folder = Path(str(run.get("tags.folder")))
    if run["status"] not in ("KILLED", "FAILED") or not (folder / FILE).is_file():
        return ""
    overrides = [word for word in str(run["tags.overrides"]).split(" ") if not word.startswith("resume=")]
    return command_line(str(run["tags.pipeline"]), [*overrides, f"resume={folder}"])


if __name__ == "__main__":
    main()
