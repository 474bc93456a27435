"""Every number of every configuration: what cannot be is refused by one sentence that names its key."""

import copy
import importlib
import pickle
import warnings
import zlib
from functools import cache
from pathlib import Path

import hydra
import pytest
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf, open_dict
from support import composing
from support.thorough import SHARE

from lmd.core.checks import InputError
from pipelines.app import CONF
from pipelines.composing import editable

pytestmark = pytest.mark.long

VALUES = (1e300, -1, float("nan"), None, 10**9)
SMALL = ["room.spacing=1.5", "objective.n=1"]
UNIFORM = [*SMALL, "deployment=uniform"]
# Command, and what it needs to be composed; a study of `evaluate` by its name.
PIPELINES = {
    "optimise": ("optimise", *SMALL),
    "cameras": (
        *("optimise", "varies=cameras", "optimiser=camera_annealing", *UNIFORM, "pdf.divisions=6"),
        "body.boxes=[{low: [-0.1, -0.1, 0], high: [0.1, 0.1, 0.1]}]",
    ),
    "evaluate": ("evaluate", *SMALL),
    "export": ("export", *UNIFORM, "tag.edge=0.1"),
    "bound": ("evaluate", "studies=[bound]", *SMALL),
    "tradeoff": ("tradeoff", *SMALL, "counts=[6]"),
    "compare": ("compare", *SMALL),
    "observe": ("evaluate", "studies=[observe]", *UNIFORM, "sensor=noisy", "seeds=1"),
    "uncertainty": ("evaluate", "studies=[uncertainty]", *UNIFORM, "tag.edge=0.1"),
    "detect": ("evaluate", "studies=[detect]", *UNIFORM, "detectors=[apriltag]", "frames=2"),
    "calibrate_detector": ("calibrate_detector", *SMALL, "frames=2"),
    "estimate_pdf": ("estimate_pdf", "simulate={duration: 60.0}"),
    "survey": ("survey", "camera=lab", "detections=seen.csv"),
    "localise": ("localise", "camera=lab", "detections=seen.csv", "map=map.csv"),
    "view": ("view", *SMALL),
    "runs": ("runs",),
    "report": ("report",),
}
for _line in PIPELINES.values():  # before the patches below: a module that is imported under them would keep them
    importlib.import_module(f"pipelines.{_line[0]}")
importlib.import_module("pipelines.studies"), importlib.import_module("pipelines.sensed")
FUNCTIONS = {"calibrate_detector": "calibrate", "estimate_pdf": "estimate"}
# Options of groups that no pipeline has by default, nor one of the same class: the pipeline, the group, overrides that
# choose and complete it.
OPTIONS = [
    *(
        ("optimise", "optimiser", [f"optimiser={path.stem}"])
        for path in sorted(Path(CONF, "optimiser").glob("*.yaml"))
        if path.stem not in ("annealing", "camera_annealing")  # of optimise
    ),
    ("optimise", "room", ["room=floor_plan", "room.spacing=1"]),
    *(("optimise", "pdf", [f"pdf={name}"]) for name in ("grid_288", "sphere", "yaw")),
    ("optimise", "visibility", ["visibility=fiducial", "tag.edge=0.1", "deployment.count=20"]),
    *(("optimise", "objective", [f"objective={name}"]) for name in ("localisation", "mean", "robust")),
    ("optimise", "objective", ["objective=filtered", "objective.drives=2", "objective.fresh=1"]),
    ("optimise", "deployment", ["deployment=greedy", "deployment.count=2"]),
    *(("observe", "estimator", [f"estimator=[{name}]"]) for name in ("bound", "pnp", "iekf", "eqf", "smoother")),
    ("observe", "sensor", ["sensor=rendered", "tag.edge=0.1"]),
    ("detect", "detectors", ["detectors=[apriltag_decimate2]"]),
]
# The whole key is not in the sentence, but what it is called there.
CALLED = {"mean_interval": "mean interval", "export": "tag.edge must be given", "simulate": "recording.path"}
FOREIGN = "optimiser.algorithm."  # parameters of a library's, which has its own words for them


class BeganError(Exception):
    """All was checked."""


def _begin(*_args, **_kwargs):
    raise BeganError


INSTANTIATE, BUILT = hydra.utils.instantiate, {}


def _remembered(node, **given):
    """What a node describes, built once only, as a wrong value changes one of them and no other."""
    key = repr((OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node, given))
    if key not in BUILT:
        BUILT[key] = INSTANTIATE(node, **given)
    return copy.copy(BUILT[key]) if "seed" in given else BUILT[key]  # an optimiser is told its encoding later


@cache
def search():
    """Configuration of the runs of a comparison."""
    return composing.composed("optimise", "optimiser=random_search")


@pytest.fixture(autouse=True)
def _nothing_begins(monkeypatch, tmp_path):
    """What is checked runs; what computes, records or serves does not."""
    for name in (
        "pipelines.study.conduct",
        "pipelines.operations.tracking.MlflowReader",
        "lmd.planner.server.Planner",
        "lmd.survey.survey.survey",
        "lmd.localise.localise.localise",
    ):
        monkeypatch.setattr(name, _begin)
    monkeypatch.setattr("hydra.utils.instantiate", _remembered)
    monkeypatch.setattr("lmd.planner.session.PlanningSession.warm_up", lambda _: None)
    monkeypatch.setattr("pipelines.compare._composed", lambda *_: editable(search()))
    (tmp_path / "outputs").mkdir()
    (tmp_path / "seen.csv").write_text("time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,10,20,30,20,30,40,10,40\n")
    (tmp_path / "map.csv").write_text("id,x,y,z,nx,ny,nz,edge\n3,0,0,1,0,1,0,0.1\n")
    monkeypatch.chdir(tmp_path)
    yield
    HydraConfig.instance().cfg = None


def composed(pipeline, overrides, folder):
    whole = composing.composed(*PIPELINES[pipeline], *overrides, return_hydra_config=True)
    with open_dict(whole):
        whole.hydra.runtime.output_dir = str(folder)
    HydraConfig.instance().set_config(whole)
    cfg = copied(whole)
    OmegaConf.set_struct(cfg, False)
    cfg.pop("hydra")
    return cfg


def copied(cfg):
    """As deepcopy makes it, in a tenth of the time."""
    return pickle.loads(pickle.dumps(cfg))


def entries(node, prefix="", owner=""):
    """All numbers, what is null and what has keys of its own: the key, what it is to which class, and the value."""
    owner = node.get("_target_", owner) if OmegaConf.is_dict(node) else owner
    for key in node if OmegaConf.is_dict(node) else range(len(node)):
        value, path = node[key], f"{prefix}{key}"
        if OmegaConf.is_interpolation(node, key):
            continue
        if OmegaConf.is_config(value):
            kind = f"{owner}.{key if OmegaConf.is_dict(node) else 'row'}"
            if OmegaConf.is_dict(value):
                yield path, kind, value
            yield from entries(value, f"{path}.", kind)
        elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
            yield path, f"{owner}.{key} {type(value)}", value


def numbers(node, prefix=""):
    """Values to replace, by their keys: of several objects of one class, or rows of one table, those of the first."""
    first = {}
    for key, kind, value in entries(node, prefix):
        first.setdefault(kind, (key, value))
    return dict(first.values())


def wrong(pipeline, pickled, key, value):
    """Fault in the way a pipeline handles a value; None without a fault."""
    changed = pickle.loads(pickled)
    OmegaConf.update(changed, key, value)
    command = PIPELINES[pipeline][0]
    function = getattr(importlib.import_module(f"pipelines.{command}"), FUNCTIONS.get(command, command))
    try:
        with warnings.catch_warnings(action="error"):
            function(changed)
    except BeganError:
        return None
    except InputError as error:
        *parents, last = [word for word in key.split(".") if not word.isdigit()]
        named = any(word in str(error) for word in (last, CALLED.get(last, last), *parents[-1:]))
        return None if named and "\n" not in str(error) else f"{key}={value}: {error}"
    except Exception as error:
        return f"{key}={value}: {type(error).__name__}: {error}"
    return None


def all_wrong(pipeline, cfg, keys):
    pickled = pickle.dumps(cfg)
    found = [wrong(pipeline, pickled, key, value) for key, known in keys.items() for value in tried(key, known)]
    return [sentence for sentence in found if sentence]


def tried(key, known):
    """Values in place of a known one: three, another choice for each key, or all of them in thorough tests."""
    if OmegaConf.is_config(known):
        return [None]
    values = VALUES if known is None or isinstance(known, int) else VALUES[:4]
    first = zlib.crc32(key.encode())
    return values if SHARE >= 1.0 else [values[(first + i) % len(values)] for i in range(3)]


def test_every_number_of_every_pipeline(tmp_path):
    seen, found = {"run"}, []
    for pipeline in PIPELINES:
        cfg = composed(pipeline, [], tmp_path)
        keys = {key: value for key, value in numbers(cfg).items() if key not in seen and not key.startswith("tracking")}
        seen |= {*keys}
        found += [f"{pipeline} {sentence}" for sentence in all_wrong(pipeline, cfg, keys)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("pipeline", "group", "overrides"),
    OPTIONS,
    ids=lambda value: ",".join([value] if isinstance(value, str) else value),
)
def test_every_number_of_every_option(pipeline, group, overrides, tmp_path):
    cfg = composed(pipeline, overrides, tmp_path)
    keys = {key: value for key, value in numbers(cfg[group], f"{group}.").items() if not key.startswith(FOREIGN)}
    found = all_wrong(pipeline, cfg, keys)
    assert not found, "\n".join(found)
