"""Experiment tracking: runs are recorded in a store, and read back from it."""

import os

from .mlflow_tracker import MlflowTracker
from .store import MlflowReader
from .tracker import PARENT_TAG, NoTracker, RunStart, Tracker

__all__ = ["PARENT_TAG", "MlflowReader", "MlflowTracker", "NoTracker", "RunStart", "Tracker"]

# mlflow, which is imported later, reads these variables. No data leaves the machine unless tracking.uri is a remote
# server. Attempts to reach a server end after seconds; mlflow's default is eight minutes.
os.environ |= {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
} | os.environ
