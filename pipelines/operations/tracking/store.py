"""Tracking store: the only module that writes to mlflow and reads runs back."""

import logging
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from lmd.core.checks import InputError
from lmd.core.words import escaped

from ..signals import stop
from .tracker import Entry
from .views import share, view_of

if TYPE_CHECKING:
    import pandas as pd
    from mlflow import MlflowClient
    from mlflow.entities import Run

SQLITE = "sqlite:///"
BATCH = 1000  # maximum number of metrics in one call of mlflow
PARAM_LENGTH = 6000  # maximum number of characters of a parameter; longer parameters are cut
TAG_LENGTH = 5000  # maximum number of characters of a tag; longer tags are cut
DESCRIPTION = "mlflow.note.content"  # tag that mlflow shows at the head of a run
ENDED = {status: f"**{status}**" for status in ("FAILED", "KILLED", "FINISHED")}
LOCK_SECONDS = 60.0  # maximum wait for another process that creates the tables of a database, seconds


class Store:
    """Experiment of mlflow in a tracking store; the connection is made at the first use.

    Args:
        uri: `sqlite:///path` (relative to the working directory) or the address of a server.
        experiment_name: mlflow experiment that holds the runs.

    Raises:
        InputError: `uri` is not the address of a tracking store.
    """

    def __init__(self, uri: str, experiment_name: str) -> None:
        if not isinstance(uri, str) or uri in ("", SQLITE):
            raise InputError(f"uri must be {SQLITE}PATH or the address of a server, got {uri!r}.", "uri")
        self.uri, self.experiment_name, self.is_local = uri, experiment_name, uri.startswith(SQLITE)

    @cached_property
    def experiment_id(self) -> str:
        """Id of the experiment, which is created if it does not exist."""
        return _prepared(self.client, self.experiment_name)

    @cached_property
    def client(self) -> "MlflowClient":
        """Client of mlflow, through which the store is read and written."""
        from mlflow import MlflowClient

        # mlflow logs each new table, and errors with their tracebacks.
        logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)

        if not self.is_local:
            return MlflowClient(tracking_uri=self.uri)
        database = Path(self.uri.removeprefix(SQLITE)).resolve()
        database.parent.mkdir(parents=True, exist_ok=True)
        from filelock import FileLock

        with tempfile.TemporaryFile(dir=database.parent):  # a test: FileLock would wait for a file that cannot be made
            pass
        # Several processes that create the tables of a database simultaneously would fail.
        with FileLock(f"{database}.lock", timeout=LOCK_SECONDS):
            artifacts = (database.parent / "artifacts").as_uri()
            partial = database.with_name(f"{database.name}.partial")
            if not database.exists():  # the database is written whole or not at all
                partial.unlink(missing_ok=True)
                _prepared(MlflowClient(tracking_uri=f"{SQLITE}{partial}"), self.experiment_name, artifacts)
                os.replace(partial, database)
            client = MlflowClient(tracking_uri=f"{SQLITE}{database}")
            _prepared(client, self.experiment_name, artifacts)
        return client

    @contextmanager
    def errors_reported(self) -> Iterator[None]:
        """Context that raises `InputError` in place of an error of the store."""
        try:
            yield
        except Exception as error:
            if not is_of_store(error):
                raise
            raise InputError(f"tracking.uri = {self.uri!r} cannot be used: {first_line(error)}") from error

    def undisturbed(self) -> AbstractContextManager[None]:
        """Context in which signals wait while the database is written, as writing locks it for other processes.

        For a store on a server the context has no effect: no file is locked, and a call may take minutes to fail.
        """
        return stop.postponed() if self.is_local else nullcontext()

    def create(self, name: str, params: Mapping[str, str], tags: Mapping[str, str], ago: float) -> str:
        """Create a run that began `ago` seconds ago, and return the id of the run.

        The name of the run is `name` followed by the beginning of this id. `params` and `tags` are recorded with the
        run.
        """
        from mlflow.entities import Param

        # Tags are set when the run is created, as a kill could otherwise leave a run without tags.
        shortened = {key: value[:TAG_LENGTH] for key, value in tags.items()}
        run = self.client.create_run(self.experiment_id, now() - int(1000 * ago), shortened, run_name=name)
        run_id = str(run.info.run_id)
        self.client.update_run(run_id, name=f"{name} #{run_id[:4]}")
        self.client.log_batch(run_id, params=[Param(key, value) for key, value in params.items()])
        return run_id

    def find(self, run_id: str) -> "Run | None":
        """Run of the experiment with the id `run_id`; None if there is no such run, or if it was deleted.

        Raises:
            InputError: the store cannot be used.
        """
        with self.errors_reported():
            return next(iter(self.client.search_runs([self.experiment_id], f"attributes.run_id = '{run_id}'")), None)

    def matching(self, wanted: str) -> "list[Run]":
        """Runs, in any experiment of the store, that match the filter `wanted` in mlflow's syntax."""
        experiments = [experiment.experiment_id for experiment in self.client.search_experiments()]
        return list(self.client.search_runs(experiments, filter_string=wanted))

    def send(self, run_id: str, entry: Entry) -> None:
        """Send one entry of a journal to the record of the run `run_id`; sending an entry again changes nothing."""
        from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, RunTag
        from mlflow.exceptions import MlflowException

        client, metrics, tags = self.client, list[Metric](), dict[str, str]()
        with self.undisturbed():
            is_asked = {"reopen", "curve"} & entry.keys() or entry.get("reason")
            known = client.get_run(run_id) if is_asked else None
            about = "" if known is None else known.data.tags.get(DESCRIPTION, "")
            if about.startswith(tuple(ENDED.values())):  # a paragraph about an earlier end of the run
                about = about.partition("\n\n")[2]
            if "curve" in entry and known is not None:
                name, began = entry["metric"], int(known.info.start_time)
                metrics = [Metric(name, value, began + int(1000 * at), step) for step, value, at in entry["curve"]]
            elif "metrics" in entry:
                metrics = [Metric(key, value, entry["at"], 0) for key, value in entry["metrics"].items()]
            elif "reopen" in entry and known is not None:
                client.update_run(run_id, status="RUNNING")
                tags = entry["reopen"]
                if "reason" in known.data.tags:
                    client.delete_tag(run_id, "reason")
                    tags = {DESCRIPTION: about, **tags}
            elif entry.get("end") and entry["reason"]:
                told = f"{ENDED[entry['end']]}: {escaped(entry['reason'])}\n\n{about}"
                tags = {"reason": entry["reason"], DESCRIPTION: told}
            if "dataset" in entry:
                problem = Dataset(entry["dataset"][0], entry["dataset"][1], "code", "{}")
                given = [DatasetInput(problem, [InputTag("mlflow.data.context", "problem")])]
                try:
                    client.log_inputs(run_id, given)
                except MlflowException:  # another process has recorded an equal problem in the meantime
                    client.log_inputs(run_id, given)
            for first in range(0, len(metrics), BATCH):
                client.log_batch(run_id, metrics=metrics[first : first + BATCH])
            if tags:
                client.log_batch(run_id, tags=[RunTag(key, value[:TAG_LENGTH]) for key, value in tags.items()])
            if "end" in entry:
                client.set_terminated(run_id, entry["end"], entry["at"])
            for file in filter(os.path.isfile, entry.get("files", ())):
                client.log_artifact(run_id, file)


def _prepared(client: "MlflowClient", name: str, artifacts: str | None = None) -> str:
    """Id of the mlflow experiment `name`, which is created if it does not exist.

    Args:
        client: client of the store.
        name: name of the experiment.
        artifacts: address for the files of a new experiment; None for the default of the store.

    Raises:
        InputError: the experiment was deleted.
    """
    from mlflow.exceptions import MlflowException

    if client.get_experiment_by_name(name) is None:
        try:
            share(client, str(client.create_experiment(name, artifact_location=artifacts)), view_of())
        except MlflowException:
            if client.get_experiment_by_name(name) is None:  # no other process has created the experiment meanwhile
                raise
    return _id_of(client, client.tracking_uri, name)


def _id_of(client: "MlflowClient", uri: str, name: str) -> str:
    """Id of the experiment `name` in the store `uri`.

    Raises:
        InputError: there is no such experiment, or it was deleted.
    """
    experiment = client.get_experiment_by_name(name)
    if experiment is None:
        raise InputError(f"{uri} has no experiment called {name!r} (tracking.experiment_name).")
    if experiment.lifecycle_stage != "active":
        again = f"`MLFLOW_TRACKING_URI={uri} mlflow experiments restore -x {experiment.experiment_id}` restores it"
        told = f"the experiment {name!r} was deleted in mlflow: {again}, or name another one"
        raise InputError(f"{told} (tracking.experiment_name).")
    return str(experiment.experiment_id)


def is_of_store(error: Exception) -> bool:
    """True if an error means that the tracking store does not work."""
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    return isinstance(error, MlflowException | SQLAlchemyError | OSError)


def first_line(error: Exception) -> str:
    """Return the line of an error's message that states the cause; lines `(raised as a result of ...` are skipped."""
    lines = (str(error) or type(error).__name__).splitlines()
    return next((line for line in lines if not line.startswith("(raised as a result of")), lines[0])


def now() -> int:
    """Present time in the unit of mlflow: milliseconds since 1970."""
    return int(1000 * time.time())


class MlflowReader(Store):
    """Reader of the runs that `MlflowTracker` has recorded.

    Args:
        uri: tracking store: `sqlite:///path` (relative to the working directory) or the address of a server.
        experiment_name: mlflow experiment that holds the runs.

    Raises:
        InputError: there is no such store or experiment, or the experiment was deleted.
    """

    def __init__(self, uri: str, experiment_name: str) -> None:
        from mlflow import MlflowClient

        super().__init__(uri, experiment_name)
        if self.is_local and not Path(database := uri.removeprefix(SQLITE)).exists():
            raise InputError(f"tracking.uri = {uri!r}: there is no file {database!r}.")
        with self.errors_reported():
            self._client = MlflowClient(tracking_uri=uri)
            self._experiment_id = _id_of(self._client, uri, experiment_name)

    def runs(self) -> "pd.DataFrame":
        """Table of all runs, the oldest first, indexed by their ids.

        The columns are `name`, `status` and `started` (UTC), and one column for each key that any run has:
        `params.<key>` and `tags.<key>` (text), `metrics.<key>` (last value). An entry is NaN if the run lacks the key.
        """
        import pandas as pd

        rows, token = {}, None
        while True:
            page = self._client.search_runs([self._experiment_id], order_by=["start_time"], page_token=token)
            for run in page:
                started = pd.to_datetime(run.info.start_time, unit="ms", utc=True, errors="coerce")
                rows[run.info.run_id] = {"name": run.info.run_name, "status": run.info.status, "started": started} | {
                    f"{kind}.{key}": value
                    for kind in ("params", "tags", "metrics")
                    for key, value in getattr(run.data, kind).items()
                }
            if not (token := page.token):
                return pd.DataFrame.from_dict(rows, orient="index")

    def artifact(self, run_id: str, name: str) -> Path:
        """Path of a local copy of the file `name` of a run.

        Raises:
            InputError: the run has no such file, or the store is a local database and the run has files on a server.
        """
        from mlflow.exceptions import MlflowException

        place = str(self._client.get_run(run_id).info.artifact_uri)
        if self.is_local and urlsplit(place).scheme not in ("", "file"):
            raise InputError(f"run {run_id} has its files at {place!r}, but only local files are read.")
        try:
            return Path(self._client.download_artifacts(run_id, name))
        except (MlflowException, OSError) as error:
            raise InputError(f"run {run_id} has no file {name!r} any more.") from error
