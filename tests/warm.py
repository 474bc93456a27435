"""What the processes that tests start have imported and compiled already; see `processes`."""

import gc
import importlib
import logging
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path

from pipelines.app import GARBAGE
from pipelines.sweeps.forks import MODULES, TRACKED

gc.set_threshold(GARBAGE)
PIPELINES = (
    *("accuracy", "bound", "calibrate_detector", "compare", "detect", "estimate_pdf", "evaluate", "export"),
    *("observe", "optimise", "report", "runs", "sync", "tradeoff", "view"),
)
for name in (*MODULES, *TRACKED, "mlflow.tracking.client", "lmd.plot.page", *(f"pipelines.{p}" for p in PIPELINES)):
    importlib.import_module(name)


def _load_kernels():
    """Load what the main job calls."""
    from small import problem

    import lmd
    from lmd.compiled import load_compiler

    load_compiler()
    lmd.optimise(problem(), evaluations=60)


def _copy_tables():
    """Let new stores in a file get mlflow's tables from one that has them: making them takes two seconds."""
    from mlflow.store.db import utils
    from sqlalchemy import create_engine

    logging.getLogger(utils.__name__).setLevel(logging.WARNING)  # it announces every new table
    make = utils._initialize_tables
    path = Path(tempfile.mkdtemp()) / "empty.db"
    engine = create_engine(f"sqlite:///{path}")
    make(engine)
    engine.dispose()
    tables = sqlite3.connect(path, check_same_thread=False)

    def copy(engine):
        if engine.dialect.name != "sqlite" or not engine.url.database:
            make(engine)
            return
        with closing(sqlite3.connect(engine.url.database)) as store:
            tables.backup(store)

    utils._initialize_tables = copy


_load_kernels()
_copy_tables()
gc.freeze()  # what all share stays shared
