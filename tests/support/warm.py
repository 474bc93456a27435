"""What the processes that tests start have imported and compiled already; see `processes`."""

import gc
import importlib
import pkgutil

from mlflow.store.db import utils
from PIL import Image

import lmd
import pipelines
from pipelines.operations.sweeps.forks import TRACKED
from support import stores
from support.composing import composed

# What is imported when it is needed. The page of runs is mlflow's server, which nobody else needs.
LIBRARIES = (
    *("PIL.PngImagePlugin", "cv2", "hydra._internal.logging_config", "mlflow.tracking.client"),
    *("mlflow.store.tracking.sqlalchemy_workspace_store", "multiprocessing.synchronize", "nevergrad"),
    *("numba.core.boxing", "numba.core.runtime.context", "pandas", "pandas.core.methods.to_dict"),
    *("pandas.core.reshape.reshape", "pandas.io.formats.csvs", "pandas.io.formats.string"),
    *("psutil", "pyapriltags", "pyarrow.pandas_compat", "pymoo.core.algorithm", "reportlab.pdfgen.canvas"),
    *("scipy.ndimage", "scipy.optimize", "scipy.spatial", "scipy.stats", "zstandard"),
)
OWN = [found.name for own in (lmd, pipelines) for found in pkgutil.walk_packages(own.__path__, f"{own.__name__}.")]
for name in (*LIBRARIES, *TRACKED, *OWN):
    importlib.import_module(name)
Image.preinit()


def _compose():
    """Let Hydra find its plugins, and its parser learn the grammar."""
    composed("optimise", "room.spacing=1.5", "deployment=uniform", return_hydra_config=True)


def _load_kernels():
    """Load what the main job calls."""
    import lmd
    from support.small import problem

    lmd.optimise(problem(), evaluations=60)


_compose()
_load_kernels()
stores.tables()
utils._get_latest_schema_revision()
gc.freeze()  # what all share stays shared
