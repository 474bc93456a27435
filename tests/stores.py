"""mlflow's stores in files get their tables from one that has them: making them takes a second or two."""

import logging
import sqlite3
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

from mlflow.store.db import utils
from sqlalchemy import create_engine

make_tables = utils._initialize_tables


@cache
def tables():
    """A database with mlflow's tables and no runs."""
    logging.getLogger(utils.__name__).setLevel(logging.WARNING)  # it announces every new table
    path = Path(tempfile.mkdtemp()) / "empty.db"
    engine = create_engine(f"sqlite:///{path}")
    make_tables(engine)
    engine.dispose()
    return sqlite3.connect(path, check_same_thread=False)


def _copy_tables(engine):
    if engine.dialect.name != "sqlite" or not engine.url.database:
        make_tables(engine)
        return
    with closing(sqlite3.connect(engine.url.database)) as store:
        tables().backup(store)


utils._initialize_tables = _copy_tables
utils._get_latest_schema_revision = cache(utils._get_latest_schema_revision)  # it loads all of mlflow's migrations
