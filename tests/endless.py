"""Runs without an end, stopped by a signal, and their files; the fixtures `begin` and `endless` start them."""

import json
import time

from mlflow import MlflowClient
from processes import WHOLE

SETTINGS = ("optimiser=ega", "deployment.count=40", "tracking.uri=sqlite:///store.db")
ENDLESS = ("budget.evaluations=100000000", "checkpoint_seconds=0.2", "threads=1", "hydra.run.dir=run")


def wait_for(path, process):
    deadline = time.monotonic() + WHOLE
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)


def ended(process):
    """Exit code, stdout and stderr of a process; there is no traceback among it."""
    out, err = process.communicate(timeout=WHOLE)
    assert "Traceback" not in err, err
    return process.returncode, out, err


def runs(cwd):
    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"], order_by=["start_time"])


def metrics_in(folder):
    return json.loads((folder / "metrics.json").read_text())
