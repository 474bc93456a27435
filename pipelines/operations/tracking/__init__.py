"""Experiment tracking: what a run records, where it is kept, and reading it back."""

import os

from .mlflow_tracker import MlflowTracker
from .store import MlflowReader
from .tracker import PARENT_TAG, NoTracker, RunStart, Tracker

__all__ = ["PARENT_TAG", "MlflowReader", "MlflowTracker", "NoTracker", "RunStart", "Tracker"]

# mlflow reads these when it is imported, which is later. Nothing leaves the machine unless tracking.uri says so, and a
# server that does not answer is given up after seconds, not after the eight minutes that mlflow waits by itself.
for _name, _value in {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
}.items():
    os.environ.setdefault(_name, _value)
