import inspect
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from composing import composed
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from hydra.utils import get_object
from omegaconf import OmegaConf
from paper import PAPER_CAMERA, PRINTED_EXPERIMENT_CAMERA

from lmd.core.checks import InputError
from lmd.geometry.camera import Camera
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing.stage import SINGLE_STAGE
from lmd.optimisers.ega import EGA
from lmd.optimisers.encoding import make_encoding
from pipelines.app import CONF, flat_settings
from pipelines.building import budget_of, build_optimiser, build_problem, camera_of
from pipelines.deployments import any_deployment
from pipelines.hyperparameters import GROUPS as COMPLETED
from pipelines.hyperparameters import FileConfigSource
from pipelines.nodes import instantiate

ONLY_OBSERVE = ("trajectory", "sensor", "estimator")
ONLY_RENDERED = ("detectors",)
OTHER_GROUPS = {"body", "experiment", *ONLY_OBSERVE, *ONLY_RENDERED}  # other tests build them
GROUPS = [
    (path.parent.name, path.stem)
    for path in sorted(Path(CONF).glob("*/*.yaml"))
    if path.parent.name not in OTHER_GROUPS
]
FLIGHT_GROUPS = [(group, path.stem) for group in ONLY_OBSERVE for path in sorted(Path(CONF, group).glob("*.yaml"))]
RENDERED_GROUPS = [(group, path.stem) for group in ONLY_RENDERED for path in sorted(Path(CONF, group).glob("*.yaml"))]
EXPERIMENTS = sorted(path.stem for path in Path(CONF, "experiment").glob("*.yaml"))
SWEEPS = {  # the pipeline of each stored sweep, and its number of jobs
    "table2": ("optimise", 10),
    "table2_baselines": ("evaluate", 10),
    "table3": ("evaluate", 9),
    "table3_reoptimised": ("optimise", 27),
    "landmark_count": ("optimise", 11),
    "optimisers": ("optimise", 100),
    "localisation_front": ("optimise", 6),
}
# A file, or the edge of a tag.
NEEDS_MORE = {
    *(
        ("pdf", "samples"),
        ("pdf", "recorded"),
        ("poses", "recorded"),
        ("room", "mesh"),
        ("room", "occupancy_grid"),
        ("deployment", "file"),
    ),
    *(("visibility", "fiducial"), ("camera", "calibration")),
}


OPTIMISERS = [option for group, option in GROUPS if group == "optimiser"]
OTHERS = [choice for choice in GROUPS if choice[0] != "optimiser"]


# As neither asks for the other, one composition is for both.
PAIRS = [
    (*OTHERS[number % len(OTHERS)], OPTIMISERS[number % len(OPTIMISERS)])
    for number in range(max(len(OPTIMISERS), len(OTHERS)))
]


@pytest.mark.parametrize(("group", "option", "optimiser"), PAIRS)
def test_every_option_composes_and_builds(group, option, optimiser):
    few = ["deployment.count=4"] if option == "greedy" else []
    cfg = composed("optimise", f"{group}={option}", f"optimiser={optimiser}", *few)
    instantiate(cfg.optimiser, seed=0)
    instantiate(cfg.tracking)
    if (group, option) not in NEEDS_MORE:
        build_problem(cfg)


@pytest.mark.parametrize(("group", "option"), FLIGHT_GROUPS)
def test_every_option_of_a_flight_composes_and_builds(group, option):
    cfg = composed("observe", f"{group}=[{option}]" if group == "estimator" else f"{group}={option}")
    for node in cfg.estimator.values() if group == "estimator" else [cfg[group]]:
        instantiate(node)


@pytest.mark.parametrize(("group", "option"), RENDERED_GROUPS)
def test_every_option_of_rendered_frames_composes_and_builds(group, option):
    cfg = composed("calibrate_detector", f"{group}=[{option}]" if group == "detectors" else f"{group}={option}")
    for node in cfg.detectors.values() if group == "detectors" else [cfg[group]]:
        if (group, option) not in NEEDS_MORE:
            instantiate(node)


def test_every_body_composes_and_the_robot_builds():
    assert composed("view", "body=none").body.boxes is None
    assert len(instantiate(composed("view", "body=robot").body).boxes) == 1


@pytest.mark.parametrize("experiment", sorted({*EXPERIMENTS} - {*SWEEPS}))
def test_every_experiment_composes_and_builds(experiment):
    for app in ("optimise", "evaluate"):
        build_problem(composed(app, f"experiment={experiment}"))


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
        ("pdf=yaw", "poses=recorded, which says how the camera looks, needs pdf=recorded"),
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


def test_table_2_has_the_papers_budget():
    assert composed("optimise", "experiment=table2").budget.evaluations == 30 * 400


def test_the_stored_optimisers_are_those_of_the_comparison():
    stored = (Path(CONF) / "experiment" / "optimisers.yaml").read_text()
    assert f"optimiser: {','.join(composed('compare').optimisers)}\n" in stored


def test_the_default_is_the_papers_simulation():
    problem = build_problem(composed("optimise"))
    assert camera_of(composed("optimise").camera) == Camera(**PAPER_CAMERA)
    assert len(problem.evaluator.positions) == 756
    assert len(problem.evaluator.axis_of) == 325
    assert (problem.count, problem.objective.n, problem.objective.thold_p) == (90, 2, 0.65)
    assert problem.scene.visibility.thold == 0.28
    assert problem.scene.visibility.nu == 0.05


def test_the_papers_other_grids_are_a_choice():
    problem = build_problem(composed("optimise", "room.positions=vertices", "pdf=grid_288"))
    assert len(problem.evaluator.positions) == 1040
    assert len(problem.evaluator.axis_of) == 288


def test_the_printed_experiment_camera_is_shipped_as_printed():
    assert camera_of(composed("optimise", "camera=paper_experiment_printed").camera) == Camera(
        **PRINTED_EXPERIMENT_CAMERA
    )


def test_the_papers_experiment_is_one_word():
    problem = build_problem(composed("optimise", "experiment=paper_experiment"))
    assert len(problem.evaluator.positions) == 147
    assert (problem.count, problem.objective.thold_p) == (80, 0.7)
    assert len(problem.scene.room.surfaces()) == 4


def test_the_lab_is_one_word_and_localises_by_the_defaults_of_the_class():
    problem = build_problem(composed("optimise", "experiment=lab"))
    assert problem.objective == Localisation()
    assert (problem.count, problem.scene.tag.edge, problem.scene.room.size) == (24, 0.15, (6.0, 4.0, 2.8))
    assert problem.scene.footprints.edge > 0.15
    assert len(problem.scene.room.surfaces()) == 5  # no tags on the floor


@pytest.mark.parametrize(
    "path",
    [path for group in COMPLETED for path in sorted(Path(CONF, group).glob("*.yaml"))],
    ids=lambda path: path.stem,
)
def test_a_file_repeats_no_default_of_its_class(path):
    given = OmegaConf.to_container(OmegaConf.load(path))
    given.pop("defaults", None)
    given = given.get("optimiser", given)
    defaults = inspect.signature(get_object(given.pop("_target_"))).parameters
    assert not [key for key, value in given.items() if defaults[key].default == value]


def test_every_hyperparameter_is_a_key_whoever_states_it():
    cfg = composed("optimise", "optimiser=ega_tuned", "optimiser.population=12")
    given = OmegaConf.to_container(OmegaConf.load(Path(CONF, "optimiser", "ega_tuned.yaml")))
    defaults = {
        key: p.default for key, p in inspect.signature(EGA).parameters.items() if key not in ("encoding", "seed")
    }
    assert OmegaConf.to_container(cfg.optimiser) == defaults | given | {"population": 12}
    assert build_optimiser(cfg, 0).population_size == 12
    assert composed("optimise", "optimiser.single.step=[0.2,0.01]").optimiser.single == asdict(SINGLE_STAGE) | {
        "step": [0.2, 0.01]
    }
    assert (
        composed("optimise", "optimiser=pymoo_ga", "optimiser.algorithm.n_offsprings=4").optimiser.algorithm.pop_size
        == 30
    )


def test_the_defaults_of_a_class_do_not_hide_what_a_file_builds_on(tmp_path):
    folder = tmp_path / "optimiser"
    folder.mkdir()
    (folder / "mine.yaml").write_text("defaults: [ega_tuned]\n_target_: lmd.optimisers.ega.EGA\n")
    (folder / "none.yaml").write_text("_target_: no.such.Class\nstep: 1\n")
    cfg = composed("optimise", f"hydra.searchpath=[file://{tmp_path}]", "optimiser=mine", "optimiser.mutation=gaussian")
    assert (cfg.optimiser.eliminated, cfg.optimiser.mutation) == (1, "gaussian")
    none = composed("optimise", f"hydra.searchpath=[file://{tmp_path}]", "optimiser=none")
    assert none.optimiser == {"_target_": "no.such.Class", "step": 1}


@pytest.mark.parametrize(
    ("overrides", "kind"),
    [
        (["optimiser=ega"], "paper"),
        (["optimiser=ega", "encoding.kind=wall"], "wall"),
        (["+optimiser.encoding=paper"], "paper"),
    ],
)
def test_the_encoding_that_is_used_is_the_one_that_is_recorded(overrides, kind):
    cfg = composed("optimise", "optimiser=random_search", *overrides)
    assert build_optimiser(cfg, 0).encoding == cfg.encoding.kind == kind


def test_mlflows_own_variables_name_the_store_and_the_experiment(monkeypatch):
    for name in ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME"):
        monkeypatch.setenv(name, "")  # as if it were unset
    store = instantiate(composed("optimise").tracking).store
    assert (store.uri, store.experiment_name) == ("sqlite:///outputs/mlflow.db", "lmd")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:5000")
    monkeypatch.setenv("MLFLOW_EXPERIMENT_NAME", "mine")
    store = instantiate(composed("compare").tracking).store
    assert (store.uri, store.experiment_name) == ("http://127.0.0.1:5000", "mine")
    given = composed("optimise", "tracking.uri=sqlite:///s.db", "+tracking.tags.study=abc").tracking
    assert (given.uri, given.tags.study) == ("sqlite:///s.db", "abc")


def test_the_literal_ega_has_the_printed_chromosome():
    cfg = composed("optimise", "optimiser=ega")
    assert 90 * make_encoding(cfg.encoding.kind, build_problem(cfg).scene.room, True).genes_per_landmark == 450


def test_settings_are_flattened_for_the_record():
    flat = flat_settings(composed("optimise"), "objective", "seed")
    assert flat == {
        "objective._target_": "lmd.objectives.coverage.Coverage",
        "objective.n": 2,
        "objective.thold_p": 0.65,
        "seed": 0,
    }


def test_tags_and_what_a_detector_sees_are_a_choice():
    problem = build_problem(composed("optimise", "tag.edge=0.2", "tag.quiet_zone=2", "visibility=fiducial"))
    assert problem.scene.tag == problem.scene.visibility.tag
    assert problem.scene.footprints.edge == pytest.approx(0.3)
    assert problem.settings()["tag"] == {"edge": 0.2, "family": "36h11", "quiet_zone": 2.0} | dict.fromkeys(
        ["edges", "counts", "paper", "costs", "budget"]
    )
    assert problem.settings()["detector"] == "aruco"
    assert build_problem(composed("optimise", "tag=printed")).scene.footprints.edge == pytest.approx(0.125)
    assert build_problem(composed("optimise")).scene.footprints.edge == 0.0


def test_a_model_of_points_takes_papers_that_overlap(write):
    path = write("id,x,y,z,nx,ny,nz\n0,0,2,3,1,0,0\n1,0,2.05,3,1,0,0\n2,0,4,3,1,0,0\n")
    overrides = ["tag.edge=0.1", "deployment=file", f"deployment.path={path}"]
    for model in ([], ["visibility=fiducial"]):
        with pytest.raises(InputError, match="overlap"):
            build_problem(composed("observe", *overrides, *model))
    assert build_problem(any_deployment(composed("observe", *overrides))).count == 3
    with pytest.raises(InputError, match="overlap"):
        build_problem(any_deployment(composed("observe", *overrides, "visibility=fiducial")))


def test_the_doors_and_windows_of_the_lab_are_where_they_always_were():
    cfg = composed("optimise", "experiment=lab_l_shape")
    door, one, other = (np.sort(ring, axis=0)[[0, -1]] for ring in instantiate(cfg.room).plan.kept_out)
    np.testing.assert_allclose(door, [[4.8, 0.0, 0.0], [5.7, 0.0, 2.1]], atol=1e-9)
    np.testing.assert_allclose(one, [[0.0, 1.3, 0.9], [0.0, 2.5, 2.1]], atol=1e-9)
    np.testing.assert_allclose(other, [[6.0, 0.4, 0.9], [6.0, 1.6, 2.1]], atol=1e-9)


def test_a_file_is_read_anew_where_it_changed(tmp_path):
    files = FileConfigSource("main", f"file://{tmp_path}")
    for text, value in (("x: 1", 1), ("x: 22", 22)):
        (tmp_path / "one.yaml").write_text(text)
        for _ in range(2):
            loaded = files.load_config("one").config
            assert loaded.x == value
            loaded.x = 5  # as Hydra may


def test_the_problem_of_debug_tells_whether_an_optimiser_works():
    """Random search finds something but far from all, and a method that works finds more."""
    found = {}
    for name in ("random_search", "ega", "annealing"):
        cfg = composed("optimise", "experiment=debug", f"optimiser={name}", "threads=1")
        problem, budget = build_problem(cfg), budget_of(cfg)
        found[name] = [build_optimiser(cfg, seed).run(problem, budget).fitness for seed in range(3)]
    assert min(found["random_search"]) > 0.1
    assert max(found["random_search"]) < 0.6
    assert max(found["random_search"]) <= min(found["ega"]) < max(found["ega"]) < 0.6 < min(found["annealing"])
