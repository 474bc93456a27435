"""mlflow's stores in files get their tables from one that has them: making them takes a second or two."""

import logging
import os
import sqlite3
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.store.db import utils
from mlflow.version import VERSION
from sqlalchemy import create_engine

from pipelines.operations.tracking import MlflowTracker, RunStart
from pipelines.operations.tracking.journal import this_process

make_tables = utils._initialize_tables


@cache
def tables():
    """A database with mlflow's tables and no runs, which one process makes for all and for the next time."""
    root = Path(__file__).parents[2]
    folder = root / ".pytest_cache" if os.access(root, os.W_OK) else Path(tempfile.mkdtemp())
    folder.mkdir(exist_ok=True)
    path = folder / f"mlflow_{VERSION}.db"
    with FileLock(f"{path}.lock"):
        if not path.exists():
            logging.getLogger(utils.__name__).setLevel(logging.WARNING)  # it announces every new table
            partial = path.with_suffix(".partial")
            partial.unlink(missing_ok=True)
            engine = create_engine(f"sqlite:///{partial}")
            make_tables(engine)
            engine.dispose()
            partial.rename(path)
    return sqlite3.connect(f"file:{path}?mode=ro", uri=True, check_same_thread=False)


def _copy_tables(engine):
    if engine.dialect.name != "sqlite" or not engine.url.database:
        make_tables(engine)
        return
    with closing(sqlite3.connect(engine.url.database)) as store:
        tables().backup(store)


utils._initialize_tables = _copy_tables
utils._get_latest_schema_revision = cache(utils._get_latest_schema_revision)  # it loads all of mlflow's migrations

ANOTHER = this_process()["process"].replace(" ", " 1", 1)  # a process that had the same number as this one


def started(uri, run_id=None, folder=None, **values):
    tracker = MlflowTracker(uri, "tests")
    tracker.start(RunStart("a run", Path(folder or tempfile.mkdtemp(dir=".")), **values), run_id)
    return tracker


def stored(tracker):
    return MlflowClient(tracking_uri=tracker.store.uri).get_run(tracker.run_id)
