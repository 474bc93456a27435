"""An mlflow experiment, made so that one sees the figures when it is opened."""

import base64
import json
import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mlflow import MlflowClient

DEFAULT = "0"  # the experiment that mlflow makes in every fresh database
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
        tags = {"mlflow.experimentKind": "custom_model_development", f"mlflow.sharedViewState.{VIEW}": _view()}
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


def link(address: str, experiment_id: str) -> str:
    """The page of an experiment with the view that was made for it, on the server at `address`.

    The experiment's tag says that it holds training runs, but mlflow 3.17 opens what its address says.
    """
    return f"{address}/#/experiments/{experiment_id}/runs?workflowType=machine_learning&viewStateShareKey={VIEW}"


def _view() -> str:
    """The state of mlflow's table of runs, as its own links share it."""
    state = {
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
    return f"deflate;{base64.b64encode(zlib.compress(json.dumps(state).encode())).decode()}"
