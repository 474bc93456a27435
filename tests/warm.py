"""What the processes that tests start have imported and compiled already; see `processes`."""

import gc
import importlib
from pathlib import Path

import stores
from composing import composed
from hydra._internal.hydra import Hydra
from mlflow.store.db import utils

from pipelines.app import CONF
from pipelines.hyperparameters import FileConfigSource
from pipelines.operations.sweeps.forks import READY_MODULE, TRACKED

PIPELINES = (
    *("accuracy", "bound", "calibrate_detector", "compare", "detect", "estimate_pdf", "evaluate", "export"),
    *("observe", "optimise", "report", "runs", "size", "survey", "sync", "tradeoff", "view"),
)
# What they import when they need it, if it takes long.
LIBRARIES = (
    *("PIL.PngImagePlugin", "cv2", "pandas", "plotly.graph_objects", "psutil", "pyapriltags", "pymoo.core.algorithm"),
    *("mlflow.store.tracking.sqlalchemy_workspace_store", "nevergrad", "pyarrow.pandas_compat", "shapely.affinity"),
    *("reportlab.pdfgen.canvas", "scipy.ndimage", "scipy.optimize", "scipy.spatial", "scipy.stats"),
    *("lmd.detection.evaluation", "lmd.mapping.formats", "lmd.mapping.sheets", "lmd.estimation.study", "lmd.plot.page"),
    *(
        "lmd.detection.board",
        "lmd.evaluation.maps",
        "lmd.evaluation.losses",
        "lmd.plot.detection",
        "lmd.plot.localisation",
    ),
    *("lmd.estimation.observer", "lmd.evaluation.tradeoff", "lmd.optimisers.checkpoint", "lmd.optimisers.composition"),
    *("lmd.scene.carried", "lmd.scene.rig_sources", "pipelines.operations.sweeps.callback", "pipelines.progress"),
)
for name in (READY_MODULE, *TRACKED, "mlflow.tracking.client", *LIBRARIES, *(f"pipelines.{p}" for p in PIPELINES)):
    importlib.import_module(name)


def _compose():
    """Let Hydra find its plugins, its parser learn the grammar, and its loader read what there is."""
    composed("optimise", "room.spacing=1.5", "deployment=uniform", return_hydra_config=True)
    files = FileConfigSource("main", f"file://{CONF}")
    for path in Path(CONF).rglob("*.yaml"):
        files.load_config(str(path.relative_to(CONF)))


def _look_for_a_mode_only_where_one_may_be_set():
    """Hydra composes everything once more to see whether a configuration says that it is a sweep."""
    look = Hydra.get_mode
    may_set = ("experiment=", "+experiment=", "hydra.mode", "hydra.searchpath", "+hydra", "hydra/")

    def get_mode(self, config_name, overrides):
        own = any(source.provider == "command-line" for source in self.config_loader.get_sources())
        return look(self, config_name, overrides) if own or any(o.startswith(may_set) for o in overrides) else None

    Hydra.get_mode = get_mode


def _load_kernels():
    """Load what the main job calls."""
    from small import problem

    import lmd

    lmd.optimise(problem(), evaluations=60)


_compose()
_look_for_a_mode_only_where_one_may_be_set()
_load_kernels()
stores.tables()
utils._get_latest_schema_revision()
gc.freeze()  # what all share stays shared
