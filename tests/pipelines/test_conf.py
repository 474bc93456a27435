"""Files of the configuration: each composes and builds, and states no default of its class; the page of settings."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from hydra.utils import get_object
from support.composing import composed
from support.paper import PAPER_CAMERA, PRINTED_EXPERIMENT_CAMERA

from lmd.core.checks import InputError
from lmd.geometry.camera import Camera
from lmd.objectives.localisation import Localisation
from lmd.optimisers.encoding import make_encoding
from pipelines.app import CONF, flat_settings
from pipelines.building import build_optimiser, build_problem, camera_of
from pipelines.nodes import instantiate

FILES = sorted(Path(CONF).rglob("*.yaml"))
GROUPS = sorted({path.parent.name for path in FILES if path.parent != Path(CONF)})
OPTIONS = [(path.parent.name, path.stem) for path in FILES if path.parent.name in GROUPS]
EXPERIMENTS = [option for group, option in OPTIONS if group == "experiment"]
SWEEPS = {  # the pipeline of each stored sweep, and its number of jobs
    "table2": ("optimise", 10),
    "table2_baselines": ("evaluate", 10),
    "table3": ("evaluate", 9),
    "table3_reoptimised": ("optimise", 27),
    "landmark_count": ("optimise", 11),
}
STUDIES = {  # the command and the study of groups that are no part of every problem
    **dict.fromkeys(("trajectory", "sensor", "estimator"), ("evaluate", "studies=[observe]")),
    "detectors": ("evaluate", "studies=[detect]"),
}
# A file, or the edge of a tag.
NEEDS_MORE = {
    *(("pdf", "samples"), ("pdf", "recorded"), ("poses", "recorded"), ("room", "mesh"), ("room", "occupancy_grid")),
    *(("deployment", "file"), ("visibility", "fiducial"), ("camera", "calibration"), ("trajectory", "file")),
    ("sensor", "rendered"),
}
# Defaults that a file states, as other values refer to them or as a run is known by them.
STATED = {("conf", "edge"), ("conf", "family"), ("visibility", "detector")}
SETTINGS = Path(CONF).parent / "docs" / "settings.md"


@pytest.mark.parametrize(("group", "option"), [each for each in OPTIONS if each[0] not in ("experiment", "studies")])
def test_every_option_composes_and_builds(group, option):
    command, *study = STUDIES.get(group, ("optimise",))
    several = group in ("estimator", "detectors")
    few = ["deployment.count=4"] if option == "greedy" else []
    cfg = composed(command, *study, f"{group}={f'[{option}]' if several else option}", *few)
    if (group, option) in NEEDS_MORE:
        return
    if group not in STUDIES:
        instantiate(cfg.tracking)
        build_problem(cfg)
        build_optimiser(cfg, 0)
        return
    for node in cfg[group].values() if several else [cfg[group]]:
        instantiate(node)


def stated_defaults(node, found=()):
    """Keys of a node, and of the nodes below it, whose values are the defaults of their classes."""
    if isinstance(node, dict):
        target = str(node.get("_target_", "${"))
        defaults = {} if "${" in target else inspect.signature(get_object(target)).parameters
        for key, value in node.items():
            default = defaults[key].default if key in defaults else inspect.Parameter.empty
            default = list(default) if isinstance(default, tuple) else default
            found = (*found, *([key] if default == value and type(default) is type(value) else []))
            found = stated_defaults(value, found)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_repeats_no_default_of_a_class(path):
    found = stated_defaults(yaml.safe_load(path.read_text()))
    assert {(path.parent.name, key) for key in found} <= STATED


def test_the_page_of_settings_has_every_group_with_its_options_and_the_keys_with_their_defaults():
    text = SETTINGS.read_text()
    for group in GROUPS:
        (row,) = (line for line in text.splitlines() if line.startswith(f"| `{group}` |"))
        named = {word.split("=")[-1] for word in re.findall(r"`([^`]+)`", row)}
        if "..." not in row:
            assert {option for at, option in OPTIONS if at == group} <= named
        assert named - {group} <= {option for at, option in OPTIONS if at == group}
    flat, keys = flat_settings(composed("optimise")), re.findall(r"^\| `([\w.]+)` \| ([^|]*) \|", text, re.MULTILINE)
    stated = {key: value for key, value in keys if key not in GROUPS}
    assert len(stated) == 10
    assert {key: str(flat[key]).lower().replace("none", "–") for key in stated} == stated


def test_every_promise_of_operations_names_a_test():
    named = re.findall(r"`(test_\w+\.py)::(\w+)`", SETTINGS.with_name("operations.md").read_text())
    assert len(named) > 15
    for file, name in named:
        assert f"def {name}(" in Path(__file__).with_name(file).read_text()


@pytest.mark.parametrize("experiment", sorted({*EXPERIMENTS} - {*SWEEPS}))
def test_every_experiment_composes_and_builds(experiment):
    for app in ("optimise", "evaluate"):
        path = [f"poses.path={SETTINGS.parents[1] / 'examples/frc/bump.path'}"] * (experiment == "frc_path")
        build_problem(composed(app, f"experiment={experiment}", *path))


@pytest.mark.parametrize("experiment", SWEEPS)
def test_every_job_of_a_stored_sweep_differs_and_builds(experiment):
    app, number = SWEEPS[experiment]
    stored = composed(app, f"experiment={experiment}", return_hydra_config=True).hydra
    assert stored.mode == RunMode.MULTIRUN
    swept = [f"{key}={value}" for key, value in stored.sweeper.params.items()]
    (jobs,) = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides(swept), None)
    assert len(set(map(tuple, jobs))) == number
    for job in (jobs[0], jobs[-1]):
        cfg = composed(app, f"experiment={experiment}", *job)
        if cfg.deployment.get("path", "") is not None:
            build_problem(cfg)


RECORDED = "time,x,y,z,yaw,pitch\n" + "".join(f"{t},2,2,2,{0.1 * t},0\n" for t in range(60))


def test_recorded_poses_take_the_place_of_grid_and_pdf(write):
    cfg = composed("optimise", "poses=recorded", f"poses.path={write(RECORDED)}", "room.spacing=0.4")
    problem = build_problem(cfg)
    assert problem.scene.recorded.spacing == 0.4
    np.testing.assert_allclose(problem.evaluator.positions, [[2.0, 2.0, 2.0]])
    np.testing.assert_allclose(problem.relevance, [49.0])  # less the held-out seconds 40 to 49


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("pdf=yaw", "poses=recorded needs pdf=recorded, the recorded directions"),
        ("poses.path=none.csv", "poses.path: there is no file 'none.csv'"),
        ("poses.path=null", "poses.path is missing"),
        ("poses.bandwidth=0", "poses.bandwidth must be greater than 0"),
        ("poses.block=60", "poses.held_out = 5: "),
        ("poses.spacing=0", "poses.spacing must be greater than 0"),
        ("room.size=[4,4,1.5]", "room.reachable_size"),
    ],
)
def test_bad_recorded_poses_name_the_whole_key(write, override, message):
    with pytest.raises(InputError, match="^" + re.escape(message)):
        build_problem(composed("optimise", "poses=recorded", f"poses.path={write(RECORDED)}", override))


def test_the_default_is_the_papers_simulation():
    problem = build_problem(composed("optimise"))
    assert camera_of(composed("optimise").camera) == Camera(**PAPER_CAMERA)
    assert len(problem.evaluator.positions) == 756
    assert len(problem.evaluator.axis_of) == 325
    assert (problem.count, problem.objective.n, problem.objective.thold_p) == (90, 2, 0.65)
    assert (problem.scene.visibility.thold, problem.scene.visibility.nu) == (0.28, 0.05)
    assert composed("optimise", "experiment=table2").budget.evaluations == 30 * 400


def test_the_papers_other_grids_cameras_and_chromosome_are_a_choice():
    problem = build_problem(composed("optimise", "room.positions=vertices", "pdf=grid_288"))
    assert len(problem.evaluator.positions) == 1040
    assert len(problem.evaluator.axis_of) == 288
    printed = camera_of(composed("optimise", "camera=paper_experiment_printed").camera)
    assert printed == Camera(**PRINTED_EXPERIMENT_CAMERA)
    cfg = composed("optimise", "optimiser=ega")
    assert 90 * make_encoding(cfg.encoding.kind, build_problem(cfg).scene.room, True).genes_per_landmark == 450


def test_the_papers_experiment_and_the_lab_are_one_word():
    problem = build_problem(composed("optimise", "experiment=paper_experiment"))
    assert len(problem.evaluator.positions) == 147
    assert (problem.count, problem.objective.thold_p, len(problem.scene.room.surfaces())) == (80, 0.7, 4)
    problem = build_problem(composed("optimise", "experiment=lab"))
    assert problem.objective == Localisation()
    assert (problem.count, problem.scene.tag.edge, problem.scene.room.size) == (24, 0.15, (6.0, 4.0, 2.8))
    assert problem.scene.footprints.edge > 0.15
    assert len(problem.scene.room.surfaces()) == 5  # no tags on the floor


def test_mlflows_own_variables_name_the_store_and_the_experiment(monkeypatch):
    for name in ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME"):
        monkeypatch.setenv(name, "")  # as if it were unset
    store = instantiate(composed("optimise").tracking).store
    assert (store.uri, store.experiment_name) == ("sqlite:///outputs/mlflow.db", "lmd")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:5000")
    monkeypatch.setenv("MLFLOW_EXPERIMENT_NAME", "mine")
    store = instantiate(composed("compare").tracking).store
    assert (store.uri, store.experiment_name) == ("http://127.0.0.1:5000", "mine")
