"""An mlflow experiment, made so that one sees the figures when it is opened."""

import base64
import json
import zlib
from typing import TYPE_CHECKING, Any

from .tracker import PARENT_TAG

if TYPE_CHECKING:
    from mlflow import MlflowClient

DEFAULT = "0"  # the experiment that mlflow makes in every fresh database
SHARED = "mlflow.sharedViewState."  # begins the tag of a view
VIEW = "lmd"  # the shared view that links name
# Of training runs, first what they found and what that cost, then what they were about.
COLUMNS = (
    *("metrics.`qualified_ratio`", "metrics.`localised_share`", "metrics.`off_grid`"),
    *("metrics.`best/fitness`", "metrics.`best/off_grid`", "metrics.`median/fitness`"),  # of sweeps
    *("metrics.`evaluations`", "metrics.`wall_time`", "params.`optimiser`", "params.`deployment`"),
    *("params.`objective.n`", "params.`objective.thold_p`", "params.`deployment.count`", "params.`seed`"),
)


def prepare(client: "MlflowClient", name: str, artifacts: str | None = None, fresh: bool = False) -> str:
    """The id of the experiment `name`, which is made where there is none.

    Args:
        client: of the store.
        name: of the experiment.
        artifacts: where a new one keeps its files; None for where the store says.
        fresh: whether the database was made just now, and holds nothing but mlflow's own experiment.
    """
    from mlflow.exceptions import MlflowException

    experiment = client.get_experiment_by_name(name)
    if experiment is None:
        tags = {"mlflow.experimentKind": "custom_model_development", f"{SHARED}{VIEW}": _view()}
        try:
            made = str(client.create_experiment(name, artifact_location=artifacts, tags=tags))
        except MlflowException as error:
            experiment = client.get_experiment_by_name(name)
            if experiment is None:  # it was not another process that was faster
                raise error
        else:
            if fresh and made != DEFAULT:
                client.delete_experiment(DEFAULT)
            return made
    return str(experiment.experiment_id)


def link(address: str, experiment_id: str, view: str = VIEW, mode: str = "TABLE") -> str:
    """The page of an experiment with a view that was made for it, on the server at `address`.

    The experiment's tag says that it holds training runs, but mlflow 3.17 opens what its address says.

    Args:
        address: of the server.
        experiment_id: the experiment.
        view: the name of the shared view.
        mode: `TABLE` or `CHART`.
    """
    query = f"workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey={view}"
    return f"{address}/#/experiments/{experiment_id}/runs?{query}"


def sweep_views(client: "MlflowClient", experiment_id: str, run_id: str) -> dict[str, str]:
    """Make two views of the jobs of a sweep; returns their modes by their names, for `link`.

    One is the table. The other has charts grouped by optimiser, with bands from the worst to the best run of each.
    """
    jobs: dict[str, Any] = {"searchFilter": f"tags.`{PARENT_TAG}` = '{run_id}'"}
    grouped = {"aggregateFunction": "average", "groupByKeys": [{"mode": "param", "groupByData": "optimiser"}]}
    section = {"uuid": "sweep", "name": "Sweep", "display": True, "isReordered": False}
    charts = {
        "groupBy": grouped,
        "compareRunSections": [section],
        "compareRunCharts": [_chart("LINE", "best_fitness"), _chart("BAR", "fitness"), _chart("BAR", "off_grid")],
    }
    views: dict[str, tuple[str, dict[str, Any]]] = {
        "TABLE": (f"{run_id}_table", jobs),
        "CHART": (f"{run_id}_charts", jobs | charts),
    }
    for name, state in views.values():
        client.set_experiment_tag(experiment_id, f"{SHARED}{name}", _view(**state))
    return {name: mode for mode, (name, _) in views.items()}


def _chart(kind: str, metric: str) -> dict[str, Any]:
    """A chart of a metric, as mlflow's own links describe it."""
    chart = {"type": kind, "uuid": metric, "metricKey": metric, "metricSectionId": "sweep", "runsCountToCompare": 100}
    if kind == "LINE":
        axis = {"xAxisKey": "step", "xAxisScaleType": "log", "scaleType": "linear", "yAxisKey": "metric", "range": {}}
        chart |= axis | {"selectedMetricKeys": [metric], "yAxisExpressions": [], "lineSmoothness": 0}
        chart |= {"selectedXAxisMetricKey": "", "useGlobalXaxisKey": False, "useGlobalLineSmoothing": False}
    return chart | {"deleted": False, "isGenerated": False}


def _view(**changes: Any) -> str:
    """The state of mlflow's page of runs, as its own links share it; `changes` replace what it says."""
    state: dict[str, Any] = {
        "searchFilter": "",
        "orderByKey": "attributes.start_time",
        "orderByAsc": False,
        "startTime": "ALL",
        "lifecycleFilter": "Active",
        "datasetsFilter": [],
        "modelVersionFilter": "All Runs",
        "selectedColumns": list(COLUMNS),
        "columnOrder": [],
        "columnWidths": {},
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
