"""Reading back what was recorded."""

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from lmd.core.checks import InputError

from .store import SQLITE, first_line, is_of_store

if TYPE_CHECKING:
    import pandas as pd


class MlflowReader:
    """Reads back what `MlflowTracker` recorded; changes nothing.

    Args:
        uri: as for `MlflowTracker`.
        experiment_name: the mlflow experiment that holds the runs.

    Raises:
        InputError: there is no such store or experiment.
    """

    def __init__(self, uri: str, experiment_name: str) -> None:
        from mlflow import MlflowClient

        database = Path(uri.removeprefix(SQLITE))
        self._is_local = uri.startswith(SQLITE)
        if self._is_local and not database.exists():
            raise InputError(f"tracking.uri = {uri!r}: there is no file {str(database)!r}.")
        try:
            self._client = MlflowClient(tracking_uri=uri)
            experiment = self._client.get_experiment_by_name(experiment_name)
        except Exception as error:
            if not is_of_store(error):
                raise
            raise InputError(f"tracking.uri = {uri!r} cannot be read: {first_line(error)}") from error
        if experiment is None:
            raise InputError(f"{uri} has no experiment called {experiment_name!r} (tracking.experiment_name).")
        self._experiment_id = str(experiment.experiment_id)

    def runs(self) -> "pd.DataFrame":
        """All runs, the oldest first, indexed by their ids.

        Columns: `name`, `status`, `started` (UTC) and one for each key of any run: `params.<key>` and `tags.<key>`
        (text), `metrics.<key>` (last value); NaN where a run lacks the key.
        """
        import pandas as pd

        rows, token = {}, None
        while True:
            page = self._client.search_runs([self._experiment_id], order_by=["start_time"], page_token=token)
            for run in page:
                row = {"name": run.info.run_name, "status": run.info.status}
                row["started"] = pd.to_datetime(run.info.start_time, unit="ms", utc=True, errors="coerce")
                for kind in ("params", "tags", "metrics"):
                    row |= {f"{kind}.{key}": value for key, value in getattr(run.data, kind).items()}
                rows[run.info.run_id] = row
            if not (token := page.token):
                return pd.DataFrame.from_dict(rows, orient="index")

    def curve(self, run_id: str, metric: str) -> list[tuple[int, float, float]]:
        """A curve as it was logged: (step, value, seconds since the run began), by step."""
        start = int(self._client.get_run(run_id).info.start_time)
        history = self._client.get_metric_history(run_id, metric)
        return sorted((m.step, m.value, (m.timestamp - start) / 1000.0) for m in history)

    def artifact(self, run_id: str, name: str) -> Path:
        """A local copy of one of the files that a run kept.

        Raises:
            InputError: the run has no such file, or a store that is a file says that it lies on a server.
        """
        from mlflow.exceptions import MlflowException

        place = str(self._client.get_run(run_id).info.artifact_uri)
        if self._is_local and urlsplit(place).scheme not in ("", "file"):
            raise InputError(f"run {run_id} says that its files are at {place!r}, from where none are fetched.")
        try:
            return Path(self._client.download_artifacts(run_id, name))
        except (MlflowException, OSError) as error:
            raise InputError(f"run {run_id} has no file {name!r} any more.") from error
