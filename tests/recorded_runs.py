"""Runs in a tracking store, for tests."""

import tempfile
from pathlib import Path

import stores  # noqa: F401 - new ones get their tables from it
from mlflow import MlflowClient

from pipelines.operations.tracking import MlflowTracker, RunStart
from pipelines.operations.tracking.journal import this_process

ANOTHER = this_process()["process"].replace(" ", " 1", 1)  # a process that had the same number as this one


def started(uri, run_id=None, folder=None, **values):
    tracker = MlflowTracker(uri, "tests")
    tracker.start(RunStart("a run", Path(folder or tempfile.mkdtemp(dir=".")), **values), run_id)
    return tracker


def stored(tracker):
    return MlflowClient(tracking_uri=tracker.store.uri).get_run(tracker.run_id)
