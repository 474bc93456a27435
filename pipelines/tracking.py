"""Experiment tracking: the only importer of mlflow."""

import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from lmd.checks import InputError

from .app import IN_CHECKOUT

if TYPE_CHECKING:
    import pandas as pd
    from mlflow import MlflowClient

# mlflow reads these once, when it is imported. Nothing leaves the machine unless tracking.uri says so.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("DO_NOT_TRACK", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")

BATCH = 1000  # metrics mlflow takes in one call
PARAM_LENGTH = 6000  # characters mlflow takes in one parameter
TAG_LENGTH = 5000  # and in one tag
PARENT_TAG = "mlflow.parentRunId"  # names the run that this one is shown below


class Tracker(Protocol):
    """Where a run is recorded."""

    @property
    def run_id(self) -> str | None:
        """Identifies the started run; None where nothing is recorded."""

    def start(
        self, name: str, params: Mapping[str, Any], tags: Mapping[str, str], run_id: str | None, ago: float = 0.0
    ) -> None:
        """Begin a run (`ago` seconds before now), or continue the one called `run_id`.

        Raises:
            InputError: the store cannot be used, or does not have the run to continue.
        """

    def discard(self) -> None:
        """Forget the run: it should not have been started."""

    def end_lost(self, tags: Mapping[str, str], reason: str) -> bool:
        """End as FAILED the runs with these tags that are still RUNNING; False if no run at all has these tags.

        Raises:
            InputError: the store cannot be used.
        """

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """Log a curve of (step, value, seconds since the run began)."""

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """Log final figures."""

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """Keep copies of files."""

    def finish(self, status: str, reason: str = "") -> None:
        """End the run as FINISHED, KILLED or FAILED, with the reason as a tag."""

    def describe(self) -> str:
        """One line that tells the user where the run is."""


class NoTracker:
    """Records nothing (`tracking=none`)."""

    run_id = None

    def start(
        self, name: str, params: Mapping[str, Any], tags: Mapping[str, str], run_id: str | None, ago: float = 0.0
    ) -> None:
        """Do nothing."""

    def discard(self) -> None:
        """Do nothing."""

    def end_lost(self, tags: Mapping[str, str], reason: str) -> bool:
        """Do nothing."""
        return True

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """Do nothing."""

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """Do nothing."""

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """Do nothing."""

    def finish(self, status: str, reason: str = "") -> None:
        """Do nothing."""

    def describe(self) -> str:
        """See `Tracker.describe`."""
        return "not tracked (tracking=none)"


class MlflowTracker:
    """Records runs in mlflow, by default in a sqlite file that needs no server.

    Args:
        uri: tracking store: `sqlite:///path` (relative to the working directory) or the address of a server.
        experiment_name: the mlflow experiment that holds the runs.
    """

    def __init__(self, uri: str, experiment_name: str) -> None:
        self.uri = uri
        self.experiment_name = experiment_name
        self._run_id: str | None = None
        self._start_ms = 0
        self._client: MlflowClient | None = None

    @property
    def run_id(self) -> str | None:
        """See `Tracker.run_id`."""
        return self._run_id

    @property
    def client(self) -> "MlflowClient":
        """The mlflow client, connected on first use."""
        if self._client is None:
            self._client = self._connect()
        return self._client

    def _connect(self) -> "MlflowClient":
        import logging

        from mlflow import MlflowClient

        logging.getLogger("mlflow.store.db.utils").setLevel(logging.WARNING)  # it announces every new table

        if not self.uri.startswith("sqlite:///"):
            return MlflowClient(tracking_uri=self.uri)
        database = Path(self.uri.removeprefix("sqlite:///")).resolve()
        database.parent.mkdir(parents=True, exist_ok=True)
        from filelock import FileLock

        # Processes that create the tables of one fresh database at the same time kill each other.
        with FileLock(f"{database}.lock"):
            client = MlflowClient(tracking_uri=f"sqlite:///{database}")
            self._experiment_id(client, (database.parent / "artifacts").as_uri())
        return client

    def _experiment_id(self, client: "MlflowClient", artifacts: str | None = None) -> str:
        """The experiment, made with its artifacts at `artifacts` (by default where the store says) if there is none."""
        from mlflow.exceptions import MlflowException

        experiment = client.get_experiment_by_name(self.experiment_name)
        if experiment is None:
            try:
                return str(client.create_experiment(self.experiment_name, artifact_location=artifacts))
            except MlflowException as error:
                experiment = client.get_experiment_by_name(self.experiment_name)
                if experiment is None:  # it was not another process that was faster
                    raise error
        return str(experiment.experiment_id)

    def start(
        self, name: str, params: Mapping[str, Any], tags: Mapping[str, str], run_id: str | None, ago: float = 0.0
    ) -> None:
        """See `Tracker.start`."""
        with self._store_errors_reported():
            self._start(name, params, tags, run_id, ago)

    @contextmanager
    def _store_errors_reported(self) -> Iterator[None]:
        from mlflow.exceptions import MlflowException

        try:
            yield
        except (MlflowException, OSError) as error:
            raise InputError(f"tracking.uri = {self.uri!r} cannot be used: {str(error).splitlines()[0]}") from error

    def _start(
        self, name: str, params: Mapping[str, Any], tags: Mapping[str, str], run_id: str | None, ago: float
    ) -> None:
        from mlflow.entities import Param, RunTag

        if run_id is not None:
            self.client.update_run(run_id, status="RUNNING")
            self._run_id = run_id
            run = self.client.get_run(run_id)
            if "reason" in run.data.tags:  # why it had ended
                self.client.delete_tag(run_id, "reason")
            self._start_ms = int(run.info.start_time)
            return
        start_time = int(1000 * (time.time() - ago))
        run = self.client.create_run(self._experiment_id(self.client), run_name=name, start_time=start_time)
        self._run_id, self._start_ms = run.info.run_id, int(run.info.start_time)
        self.client.log_batch(
            self._run_id,
            params=[Param(key, str(value)[:PARAM_LENGTH]) for key, value in params.items()],
            tags=[RunTag(key, value[:TAG_LENGTH]) for key, value in tags.items()],
        )

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """See `Tracker.log_curve`."""
        from mlflow.entities import Metric

        curve = [Metric(metric, value, self._start_ms + int(1000 * at), step) for step, value, at in points]
        for first in range(0, len(curve), BATCH):
            self.client.log_batch(self._id, metrics=curve[first : first + BATCH])

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """See `Tracker.log_metrics`."""
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        self.client.log_batch(self._id, metrics=[Metric(key, value, now, 0) for key, value in metrics.items()])

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """See `Tracker.log_artifacts`."""
        for path in paths:
            self.client.log_artifact(self._id, str(path))

    def finish(self, status: str, reason: str = "") -> None:
        """See `Tracker.finish`."""
        if self._run_id is not None:
            self._end(self._run_id, status, reason)

    def _end(self, run_id: str, status: str, reason: str) -> None:
        if reason:
            self.client.set_tag(run_id, "reason", reason[:TAG_LENGTH])
        self.client.set_terminated(run_id, status)

    def end_lost(self, tags: Mapping[str, str], reason: str) -> bool:
        """See `Tracker.end_lost`."""
        with self._store_errors_reported():
            wanted = " and ".join(f"tags.`{key}` = '{value}'" for key, value in tags.items())
            runs = self.client.search_runs([self._experiment_id(self.client)], filter_string=wanted)
            for run in runs:
                if run.info.status == "RUNNING":
                    self._end(run.info.run_id, "FAILED", reason)
        return bool(runs)

    def discard(self) -> None:
        """See `Tracker.discard`."""
        if self._run_id is not None:
            self.client.delete_run(self._run_id)
            self._run_id = None

    def describe(self) -> str:
        """See `Tracker.describe`."""
        shown_by = "make ui" if IN_CHECKOUT else f"mlflow ui --backend-store-uri {self.uri}"
        return f"run {self._run_id} in {self.uri}" + (f" ({shown_by})" if self.uri.startswith("sqlite:") else "")

    @property
    def _id(self) -> str:
        if self._run_id is None:
            raise RuntimeError("the run has not been started")
        return self._run_id


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
        from mlflow.exceptions import MlflowException

        database = Path(uri.removeprefix("sqlite:///"))
        if uri.startswith("sqlite:///") and not database.exists():
            raise InputError(f"tracking.uri = {uri!r}: there is no file {str(database)!r}.")
        try:
            self._client = MlflowClient(tracking_uri=uri)
            experiment = self._client.get_experiment_by_name(experiment_name)
        except (MlflowException, OSError) as error:
            raise InputError(f"tracking.uri = {uri!r} cannot be read: {str(error).splitlines()[0]}") from error
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
                row["started"] = pd.Timestamp(run.info.start_time, unit="ms", tz="UTC")
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
            InputError: the run has no such file.
        """
        from mlflow.exceptions import MlflowException

        try:
            return Path(self._client.download_artifacts(run_id, name))
        except (MlflowException, OSError) as error:
            raise InputError(f"run {run_id} has no file {name!r} any more.") from error
