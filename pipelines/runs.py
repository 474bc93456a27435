"""What has run, how it ended and how to go on: `python -m pipelines.runs [last=20]`.

Runs whose process is gone are ended first: they would be shown as running for ever.
"""

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .building import instantiate
from .going_on import GoingOn, going_on
from .pipeline import Pipeline, alone
from .trust import Trust

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
    """List the newest runs of the configured store."""
    from lmd.core.checks import InputError, integer, printable

    from .operations.tracking import MlflowReader, MlflowTracker
    from .operations.tracking.experiment import link
    from .operations.tracking.hand_in import end_those_gone

    tracker, last = instantiate(cfg.tracking), integer("last", cfg.last, low=1)
    if not isinstance(tracker, MlflowTracker):
        raise InputError("runs are read where they were tracked: it needs tracking=mlflow.")
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    with tracker.store.errors_reported():
        end_those_gone(tracker.store)
    table = reader.runs().iloc[-last:]
    print(_listed(table))
    trust = Trust.given()
    unfinished = {str(run_id): again for run_id, run in table.iterrows() if (again := going_on(run, trust))}
    for run_id, again in unfinished.items():
        name = printable(f"{table['name'][run_id]} ({run_id})")
        if again.process:
            print(f"\n{name} goes on with:\n{again.command}")
        else:
            print(f"\n{name} does not go on from here: {again.why_not}. Read before you run it:\n{again.command}")
    if cfg.resume is not None:
        _resume(unfinished, str(cfg.resume))
    print(f"\nin the browser, while `make ui` runs: {link(cfg.address, tracker.store.experiment_id)}")


def _listed(table: "pd.DataFrame") -> str:
    from lmd.core.checks import printable

    shown = table.reindex(columns=list(COLUMNS)).rename(columns=COLUMNS)
    for column in ("run", "pipeline"):
        shown[column] = shown[column].fillna("").astype(str).map(printable)
    shown["started (UTC)"] = shown["started (UTC)"].dt.strftime("%Y-%m-%d %H:%M:%S")
    return str(shown.to_string(index=False, na_rep="", float_format="{:g}".format))


def _resume(unfinished: Mapping[str, GoingOn], wanted: str) -> None:
    """Become the command that goes on with the run called `wanted`, or with the last one."""
    from lmd.core.checks import InputError

    found = list(unfinished) if wanted == "last" else [run_id for run_id in unfinished if run_id.startswith(wanted)]
    if not found:
        raise InputError(f"resume = {wanted!r} is no run among these that can go on.")
    again = unfinished[found[-1]]
    if not again.process:
        raise InputError(f"resume = {wanted!r}: {found[-1]} does not go on from here: {again.why_not}.")
    print(f"\n{again.command}", flush=True)
    os.execv(again.process[0], again.process)


main = Pipeline("runs", runs, runner=alone)

if __name__ == "__main__":
    main()
