"""Views: settings of mlflow's page of runs, such as columns and charts, for an experiment or for a sweep.

A view is a text, stored under a name in the experiment; links to the page contain this name. `views.json` has settings
from which views are built.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .tracker import PARENT_TAG

if TYPE_CHECKING:
    from mlflow import MlflowClient

SHARED = "mlflow.sharedViewState."  # prefix of the tag for a shared view
VIEW = "lmd"  # name of the shared view in links
MOST_FIGURES = 12  # number of columns of figures in the view of an experiment
# Columns of runs in order: settings that often vary, the figure off the grid, further figures, then costs.
VARIED = (
    *("optimiser", "room", "camera", "objective", "objective.n", "objective.thold_p", "deployment.count"),
    *("budget.evaluations", "budget.seconds", "seed"),
)
FIGURES = ("off_grid", "qualified_ratio", "localised_share", "evaluations", "wall_time")


def view_of(figures: Sequence[str] = ()) -> str:
    """Text of settings for mlflow's page of runs, with a column for each of the metrics `figures`.

    If `figures` is empty or has one of the metrics `FIGURES` of deployments, other columns are used: those metrics and
    the metrics of sweeps.
    """
    if not figures or {*figures} & {*FIGURES}:
        figures = (FIGURES[0], "best/off_grid", "median/off_grid", *FIGURES[1:])
    return _state(VARIED, figures[:MOST_FIGURES], "page")


def sweep_view(run_id: str, params: Sequence[str]) -> str:
    """Text of settings for mlflow's page of runs, which then shows the jobs of one sweep.

    The charts average the jobs of a group. The sweep's own run is hidden, as its charts would come first.

    Args:
        run_id: id of the sweep's own run, the parent of the jobs.
        params: parameters of the jobs; jobs with equal parameters form a group.
    """
    keys = [{"mode": "param", "groupByData": param} for param in params]
    own = {
        "searchFilter": f"tags.`{PARENT_TAG}` = '{run_id}'",
        "groupBy": {"aggregateFunction": "average", "groupByKeys": keys} if keys else None,
        "runsVisibilityMap": {run_id: False},
    }
    return _state(list(dict.fromkeys([*params, "seed"])), FIGURES, "page", "sweep", **own)


def share(client: "MlflowClient", experiment_id: str, view: str, name: str = VIEW) -> None:
    """Store the settings `view` of mlflow's page of runs in an experiment, under the name that links use."""
    client.set_experiment_tag(experiment_id, f"{SHARED}{name}", view)


def link(address: str, experiment_id: str, view: str = VIEW, mode: str = "TABLE") -> str:
    """Address of mlflow's page of runs that shows an experiment with stored settings.

    Args:
        address: address of the server.
        experiment_id: id of the experiment.
        view: name under which the settings of the page are stored, see `share`.
        mode: `TABLE` or `CHART`.
    """
    query = f"workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey={view}"
    return f"{address}/#/experiments/{experiment_id}/runs?{query}"


def _state(params: Sequence[str], figures: Sequence[str], *parts: str, **changes: Any) -> str:
    """Settings of mlflow's page of runs, in the form used in links.

    Columns of parameters come first, then columns of metrics.

    Args:
        params: parameters that get a column.
        figures: metrics that get a column.
        parts: names of the blocks of settings in `views.json` that are included.
        changes: further settings, which replace settings of these blocks.
    """
    states = json.loads(Path(__file__).with_suffix(".json").read_text())
    columns = [*(f"params.`{param}`" for param in params), *(f"metrics.`{figure}`" for figure in figures)]
    state: dict[str, Any] = {"selectedColumns": columns, "columnOrder": ["attributes.`Run Name`", *columns]}
    state["columnWidths"] = {"attributes.`Run Name`": 280}  # pixels, as names are long
    for part in parts:
        state |= states[part]
    return f"deflate;{base64.b64encode(zlib.compress(json.dumps(state | changes).encode())).decode()}"
