"""An mlflow experiment, made so that one sees the figures when it is opened."""

import base64
import json
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .tracker import PARENT_TAG

if TYPE_CHECKING:
    from mlflow import MlflowClient

DEFAULT = "0"  # the experiment that mlflow makes in every fresh database
SHARED = "mlflow.sharedViewState."  # begins the tag of a view
VIEW = "lmd"  # the shared view that links name
OF_SWEEPS = ("metrics.`best/fitness`", "metrics.`best/off_grid`", "metrics.`median/fitness`")
# Of training runs, first what they found and what that cost, then what they were about.
COLUMNS = (
    *("metrics.`qualified_ratio`", "metrics.`localised_share`", "metrics.`off_grid`"),
    *OF_SWEEPS,
    *("metrics.`evaluations`", "metrics.`wall_time`", "params.`optimiser`", "params.`deployment`"),
    *("params.`objective.n`", "params.`objective.thold_p`", "params.`deployment.count`", "params.`seed`"),
)


def prepare(client: "MlflowClient", name: str, artifacts: str | None = None, fresh: bool = False) -> str:
    """The id of the experiment `name`, which is made where there is none.

    Args:
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


def sweep_view(client: "MlflowClient", experiment_id: str, run_id: str, params: Sequence[str]) -> str:
    """Make a view of the jobs of a sweep; returns its name, for `link`.

    Args:
        experiment_id: where they are.
        run_id: the run of the sweep.
        params: those by which jobs are grouped; charts have bands from the worst to the best job of each group.
    """
    keys = [{"mode": "param", "groupByData": param} for param in params]
    view = _view(
        searchFilter=f"tags.`{PARENT_TAG}` = '{run_id}'",
        groupBy={"aggregateFunction": "average", "groupByKeys": keys} if keys else None,
        selectedColumns=[column for column in COLUMNS if column not in OF_SWEEPS],
        compareRunSections=[{"uuid": "sweep", "name": "Sweep", "display": True, "isReordered": False}],
        compareRunCharts=[_chart("LINE", "best_fitness"), _chart("BAR", "fitness"), _chart("BAR", "off_grid")],
        isAccordionReordered=True,  # or mlflow sorts the sections by their names
        runsHiddenMode="CUSTOM",
        runsVisibilityMap={run_id: False},  # whose charts would come first
    )
    client.set_experiment_tag(experiment_id, f"{SHARED}{run_id}", view)
    return run_id


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
