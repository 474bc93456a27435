"""mlflow experiment whose pages show the figures of runs when opened."""

import base64
import json
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lmd.core.checks import InputError

from .tracker import PARENT_TAG

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Experiment

DEFAULT = "0"  # id of the experiment that mlflow makes in every fresh database
SHARED = "mlflow.sharedViewState."  # prefix of the tag of a shared view
VIEW = "lmd"  # name of the shared view in links
NAME = "attributes.`Run Name`"
# Widths of columns, pixels.
WIDTHS = {NAME: 280, "metrics.`off_grid`": 85} | {
    f"params.`{name}`": 90 for name in ("optimiser", "room", "camera", "objective")
}
NARROW = 58  # width of the column of any other setting, pixels
MOST_FIGURES = 12  # columns of figures in the view of an experiment
OF_SWEEPS = ("metrics.`best/off_grid`", "metrics.`median/off_grid`")
# Columns of runs in their order: what often varies, the figure off the grid, further figures, then costs.
VARIED = (
    *("optimiser", "room", "camera", "objective", "objective.n", "objective.thold_p", "deployment.count"),
    *("budget.evaluations", "budget.seconds", "seed"),
)
FIGURES = (
    *("metrics.`off_grid`", *OF_SWEEPS, "metrics.`qualified_ratio`", "metrics.`localised_share`"),
    *("metrics.`evaluations`", "metrics.`wall_time`"),
)


def prepare(client: "MlflowClient", name: str, artifacts: str | None = None, fresh: bool = False) -> str:
    """Id of the experiment `name`; a missing experiment is created.

    Args:
        artifacts: address for the files of a new experiment; None for the default of the store.
        fresh: True if the database was just created and holds only mlflow's own experiment.

    Raises:
        InputError: the experiment was deleted.
    """
    from mlflow.exceptions import MlflowException

    experiment = client.get_experiment_by_name(name)
    if experiment is None:
        tags = {"mlflow.experimentKind": "custom_model_development", f"{SHARED}{VIEW}": _view(VARIED, FIGURES)}
        try:
            made = str(client.create_experiment(name, artifact_location=artifacts, tags=tags))
        except MlflowException as error:
            experiment = client.get_experiment_by_name(name)
            if experiment is None:  # no other process has made it meanwhile
                raise error
        else:
            if fresh and made != DEFAULT:
                client.delete_experiment(DEFAULT)
            return made
    return id_of(experiment, client.tracking_uri)


def id_of(experiment: "Experiment", uri: str) -> str:
    """Id of an experiment of the store `uri`.

    Raises:
        InputError: the experiment was deleted.
    """
    if experiment.lifecycle_stage != "active":
        again = f"`MLFLOW_TRACKING_URI={uri} mlflow experiments restore -x {experiment.experiment_id}` restores it"
        deleted = f"the experiment {experiment.name!r} was deleted in mlflow"
        raise InputError(f"{deleted}: {again}, or name another one (tracking.experiment_name).")
    return str(experiment.experiment_id)


def link(address: str, experiment_id: str, view: str = VIEW, mode: str = "TABLE") -> str:
    """Address of the page of an experiment with a shared view.

    mlflow 3.17 ignores the tag with the kind of an experiment, so the address itself selects training runs.

    Args:
        address: address of the server.
        experiment_id: id of the experiment.
        view: name of the shared view.
        mode: `TABLE` or `CHART`.
    """
    query = f"workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey={view}"
    return f"{address}/#/experiments/{experiment_id}/runs?{query}"


def run_link(address: str, experiment_id: str, run_id: str) -> str:
    """Address of the page of a run, under model training; `address` as in `link`."""
    return f"{address}/#/experiments/{experiment_id}/runs/{run_id}?workflowType=machine_learning"


def sweep_view(client: "MlflowClient", experiment_id: str, run_id: str, params: Sequence[str]) -> str:
    """Make a view of the jobs of a sweep, and return its name for `link`.

    Args:
        experiment_id: experiment of the jobs.
        run_id: run of the sweep.
        params: parameters that group jobs; charts have bands from the worst to the best job of each group.
    """
    keys = [{"mode": "param", "groupByData": param} for param in params]
    view = _view(
        [*params, *(["seed"] if "seed" not in params else [])],
        [figure for figure in FIGURES if figure not in OF_SWEEPS],
        searchFilter=f"tags.`{PARENT_TAG}` = '{run_id}'",
        groupBy={"aggregateFunction": "average", "groupByKeys": keys} if keys else None,
        compareRunSections=[{"uuid": "sweep", "name": "Sweep", "display": True, "isReordered": False}],
        compareRunCharts=[_chart("LINE", "best_fitness"), _chart("BAR", "fitness"), _chart("BAR", "off_grid")],
        isAccordionReordered=True,  # otherwise mlflow sorts the sections by name
        runsHiddenMode="CUSTOM",
        runsVisibilityMap={run_id: False},  # hides the run of the sweep, whose charts would be first
    )
    client.set_experiment_tag(experiment_id, f"{SHARED}{run_id}", view)
    return run_id


def show_figures(client: "MlflowClient", experiment_id: str, figures: Sequence[str]) -> None:
    """Give an experiment a view with the figures of its runs, if these are others than those of deployments."""
    columns = [f"metrics.`{figure}`" for figure in figures]
    if columns and not set(columns).intersection(FIGURES):
        view = _view(VARIED, columns[:MOST_FIGURES])
        client.set_experiment_tag(experiment_id, f"{SHARED}{VIEW}", view)


def _chart(kind: str, metric: str) -> dict[str, Any]:
    """Chart of a metric in the form of mlflow's links."""
    chart = {"type": kind, "uuid": metric, "metricKey": metric, "metricSectionId": "sweep", "runsCountToCompare": 100}
    if kind == "LINE":
        axis = {"xAxisKey": "step", "xAxisScaleType": "log", "scaleType": "linear", "yAxisKey": "metric", "range": {}}
        chart |= axis | {"selectedMetricKeys": [metric], "yAxisExpressions": [], "lineSmoothness": 0}
        chart |= {"selectedXAxisMetricKey": "", "useGlobalXaxisKey": False, "useGlobalLineSmoothing": False}
    return chart | {"deleted": False, "isGenerated": False}


def _view(params: Sequence[str], figures: Sequence[str], **changes: Any) -> str:
    """State of mlflow's page of runs in the form of mlflow's links, with `changes`.

    Args:
        params: parameters that are the first columns.
        figures: columns behind them.
    """
    settings = [f"params.`{param}`" for param in params]
    state: dict[str, Any] = {
        "searchFilter": "",
        "orderByKey": "attributes.start_time",
        "orderByAsc": False,
        "startTime": "ALL",
        "lifecycleFilter": "Active",
        "datasetsFilter": [],
        "modelVersionFilter": "All Runs",
        "selectedColumns": [*settings, *figures],
        "columnOrder": [NAME, *settings, *figures],
        "columnWidths": dict.fromkeys(settings, NARROW) | WIDTHS,
        "runsExpanded": {},
        "runsPinned": [],
        "runsHidden": [],
        "runsVisibilityMap": {},
        "runsHiddenMode": "FIRST_10_RUNS",
        "viewMaximized": False,
        "runListHidden": False,
        "isAccordionReordered": False,
        "useGroupedValuesInCharts": True,
        "hideEmptyCharts": True,
        "groupBy": None,
        "groupsExpanded": {},
        "autoRefreshEnabled": True,
        "globalLineChartConfig": {"xAxisKey": "step", "lineSmoothness": 0, "selectedXAxisMetricKey": ""},
    }
    state |= changes
    return f"deflate;{base64.b64encode(zlib.compress(json.dumps(state).encode())).decode()}"
