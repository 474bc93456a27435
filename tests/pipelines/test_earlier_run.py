"""`run=DIR` takes the scene and the landmarks from an earlier run."""

import importlib
import json
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import composing
import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from processes import call, refused

from lmd.core.checks import InputError
from pipelines import accuracy
from pipelines.app import CONF
from pipelines.building import build_problem
from pipelines.deployments import composed_deployments, read_deployment_as_a_list
from pipelines.earlier_run import GROUPS, read_earlier_run
from pipelines.localise import _map
from pipelines.nodes import instantiate
from pipelines.points import Ladder

QUICK = ("tracking=none", "validate=false", "picture=false", "localisation=false", "losses=false")
LAB = ("room=lab", "room.spacing=1", "camera=lab", "pdf=yaw", "pdf.pitch=0.1", "objective.n=1", "objective.thold_p=0.4")
BOMB = b"a: &a [1, 1, 1, 1]\nb: &b [*a, *a, *a, *a, *a, *a]\nc: [*b, *b, *b, *b, *b, *b]\n"
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n1,6,2,1,-1,0,0\n"


@cache
def lab():
    """Configuration that a run with the overrides `LAB` records."""
    return OmegaConf.to_yaml(composing.composed("optimise", *LAB, "deployment.count=2"))


@pytest.fixture
def earlier(tmp_path, monkeypatch):
    """Folder of a run with the overrides `LAB`."""
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "a run, of old"
    (run / ".hydra").mkdir(parents=True)
    (run / ".hydra" / "config.yaml").write_text(lab())
    (run / "landmarks.csv").write_text(LANDMARKS)
    return run


def composed(monkeypatch, pipeline, *arguments, read=read_earlier_run):
    """Configuration that a pipeline composes with these arguments."""
    monkeypatch.setattr(sys, "argv", [pipeline, *arguments])
    read()
    return composing.composed(pipeline, *sys.argv[1:])


def test_the_scene_the_objective_and_the_landmarks_are_taken(earlier, monkeypatch):
    cfg = composed(monkeypatch, "evaluate", f"run='{earlier}'")
    before = OmegaConf.load(earlier / ".hydra" / "config.yaml")
    for group in ("room", "camera", "pdf", "poses", "tag", "visibility", "objective"):
        assert cfg[group] == before[group]
    assert cfg.deployment.path == str(earlier / "landmarks.csv")
    assert cfg.deployment.free is False


COMMANDS = sorted(path.stem for path in Path(CONF).glob("*.yaml") if "\nrun: null" in path.read_text())
OTHER = {"room": "hall", "camera": "hall", "pdf": "sphere", "poses": "recorded", "tag": "printed",
         "visibility": "fiducial", "objective": "robust"}  # fmt: skip


def told(monkeypatch, command, *arguments):
    """What a command hands over to Hydra."""
    module = importlib.import_module(f"pipelines.{command}")
    monkeypatch.setattr(sys, "argv", [command, *arguments])
    for change in getattr(module, "command", module.main).prepare:
        change()
    return sys.argv[1:]


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_loses_a_group_of_the_run_beside_what_else_is_told(earlier, monkeypatch, command):
    run, before = f"run='{earlier}'", OmegaConf.load(earlier / ".hydra" / "config.yaml")
    groups = [group for group in GROUPS if command != "export" or group in before]
    for group in groups:
        given = told(monkeypatch, command, run, f"{group}={OTHER[group]}")
        lost = {group, "pdf"} if group == "poses" else {group}
        assert {word for word in given if word.endswith("=run")} >= {f"{name}=run" for name in {*groups} - lost}
        assert not {f"{name}=run" for name in lost} & {*given}
    number = ["poses=200"] if command in ("detect", "calibrate_detector") else []
    given = told(monkeypatch, command, run, *number, "pdf.pitch=0.3", "objective.n=2", "seed=3")
    cfg = composing.composed(command, *given)
    before.pdf.pitch, before.objective.n = 0.3, 2
    assert cfg.seed == 3
    assert {group: cfg[group] for group in groups} == {group: before[group] for group in groups}
    assert cfg.get("frames", 200) == 200 or not number


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("detectors", {"aruco_fine": {}}, ["detectors=[aruco_fine]"]),
        ("detectors", {"aruco": {}, "apriltag": {}}, []),
        ("visibility", {"detector": "apriltag_decimate2"}, ["detectors=[apriltag_decimate2]"]),
        ("visibility", {"detector": "fitted/36h11_apriltag.yaml"}, ["detectors=[apriltag]"]),
        ("visibility", {"detector": "wpilib"}, []),
    ],
)
@pytest.mark.parametrize("command", ["detect", "survey", "localise", "lmd-localise", "evaluate"])
def test_a_command_that_reads_images_takes_the_detector_of_the_run(earlier, monkeypatch, command, key, value, found):
    before = OmegaConf.load(earlier / ".hydra" / "config.yaml")
    OmegaConf.update(before, key, value, force_add=True)
    OmegaConf.save(before, earlier / ".hydra" / "config.yaml")
    monkeypatch.setattr(sys, "argv", [command, f"run='{earlier}'"])
    read_earlier_run()
    assert [given for given in sys.argv if given.startswith("detectors")] == found * (command != "evaluate")


@pytest.mark.parametrize("more", [[], ["room=hall"]])
def test_the_folder_of_a_run_as_the_map_brings_its_room(earlier, monkeypatch, more):
    cfg = composing.composed("localise", *told(monkeypatch, "localise", f"map='{earlier}'", *more))
    assert (cfg.room == OmegaConf.load(earlier / ".hydra" / "config.yaml").room) == (not more)
    assert _map(cfg, instantiate(cfg.tag, edge=0.1)).ids.tolist() == [0, 1]


@pytest.mark.parametrize("command", ["bound", "compare", "tradeoff", "evaluate"])
def test_landmarks_placed_anew_are_as_many_as_those_of_the_run_and_beside_its_fixed_ones(earlier, monkeypatch, command):
    leave(earlier, "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n9,0,3,1,1,0,0,0\n", fixed="tags.csv")
    given = told(monkeypatch, command, f"run='{earlier}'", *(["deployment=random"] if command == "evaluate" else []))
    problem = build_problem(composing.composed(command, *given))
    assert (problem.count, problem.fixed.ids.tolist()) == (3, [5])
    assert "deployment.count=4" in told(monkeypatch, command, f"run='{earlier}'", "deployment.count=4")
    assert sys.argv.count("deployment.count=3") == 0


def test_a_run_and_an_experiment_that_choose_the_same_get_one_sentence(earlier):
    message = "and experiment=lab both choose room, camera, pdf, tag, visibility, objective: leave one of the two out"
    given = (f"run='{earlier}'", "experiment=lab", "hydra.run.dir=out")
    refused("evaluate", *given, message=message, cwd=earlier.parent, settings=())


def test_an_experiment_that_chooses_nothing_of_the_problem_goes_with_a_run(earlier):
    (earlier.parent / "mine" / "experiment").mkdir(parents=True)
    (earlier.parent / "mine" / "experiment" / "short.yaml").write_text("# @package _global_\nseed: 3\n")
    given = ("--config-dir", "mine", f"run='{earlier}'", "experiment=short", *QUICK)
    done = call("evaluate", *given, cwd=earlier.parent, settings=())
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["estimate_pdf", "report", "runs", "sync"])
def test_a_command_that_takes_no_run_says_what_it_takes(monkeypatch, command):
    monkeypatch.setattr(sys, "argv", [command, "run=outputs/lab"])
    with pytest.raises(SystemExit, match=rf"^error: run is no key of {command}: [\w.]+=\S+ \w+.*\.$"):
        importlib.import_module(f"pipelines.{command}").main()


def test_other_poses_bring_their_own_pdf(earlier, monkeypatch):
    recorded = composed(monkeypatch, "optimise", f"run='{earlier}'", "poses=recorded", "poses.path=drive.csv")
    assert recorded.pdf == {}
    assert recorded.room == OmegaConf.load(earlier / ".hydra" / "config.yaml").room


@pytest.mark.parametrize("order", [1, -1])
def test_the_command_line_still_wins(earlier, monkeypatch, order):
    arguments = [f"run='{earlier}'", "room=paper_simulation", "pdf.pitch=0.3", "deployment=random", "objective.n=2"]
    cfg = composed(monkeypatch, "optimise", *arguments[::order])
    assert cfg.room.size == [7.5, 5.0, 6.0]
    assert cfg.pdf.pitch == 0.3
    assert "path" not in cfg.deployment
    assert (cfg.objective.n, cfg.objective.thold_p) == (2, 0.4)


def test_a_key_that_only_the_run_has_can_be_overridden(earlier, monkeypatch):
    path = earlier / ".hydra" / "config.yaml"
    OmegaConf.save(OmegaConf.merge(OmegaConf.load(path), {"camera": {"distortion": [0.1, 0, 0, 0, 0]}}), path)
    cfg = composed(monkeypatch, "evaluate", f"run='{earlier}'", "camera.distortion=[0.2,0,0,0,0]")
    assert cfg.camera.distortion[0] == 0.2


def test_a_run_without_a_group_leaves_the_default(earlier, monkeypatch):
    path = earlier / ".hydra" / "config.yaml"
    before = OmegaConf.load(path)
    del before["tag"]
    OmegaConf.save(before, path)
    assert composed(monkeypatch, "evaluate", f"run='{earlier}'").tag.edge is None


def test_landmarks_that_were_free_stay_so(earlier, monkeypatch):
    path = earlier / ".hydra" / "config.yaml"
    OmegaConf.save(OmegaConf.merge(OmegaConf.load(path), {"deployment": {"free": True}}), path)
    assert composed(monkeypatch, "evaluate", f"run='{earlier}'").deployment.free is True


def leave(run, landmarks, **deployment):
    """Let the run have left these landmarks, and been told so of its deployment."""
    path = run / ".hydra" / "config.yaml"
    OmegaConf.save(OmegaConf.merge(OmegaConf.load(path), {"deployment": deployment}), path)
    (run / "landmarks.csv").write_text(landmarks)


@pytest.mark.parametrize("fixed", [None, "tags.csv"])
def test_tags_that_were_measured_are_taken_as_they_are(earlier, monkeypatch, fixed):
    """Papers overlap, hang over an edge and stand before their wall."""
    measured = "id,x,y,z,nx,ny,nz,fixed\n3,0,1,1,1,0,0,1\n1,0,1.18,1,1,0,0,1\n4,0,0.05,2,1,0,0,0\n0,0.08,2,1,1,0,0,0\n"
    leave(earlier, measured, measured="measured.csv", fixed=fixed)
    given = (f"run='{earlier}'", "tag.edge=0.15")
    problem = build_problem(composed(monkeypatch, "export", *given))
    assert problem.fixed_count == (0 if fixed is None else 2)
    drawn = problem.draw(np.random.default_rng(0))
    assert drawn.positions.tolist() == [[0, 1, 1], [0, 1.18, 1], [0, 0.05, 2], [0.08, 2, 1]]
    with pytest.raises(InputError, match=r"landmarks? (3 and 1 .* overlap|0 .* hangs in mid-air)"):
        build_problem(composed(monkeypatch, "export", *given, "deployment.free=false"))


@pytest.mark.parametrize("others", ["landmarks.csv", "moved.csv"])
def test_the_fixed_tags_of_a_run_are_those_it_marks(earlier, monkeypatch, others):
    marked = "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n"
    leave(earlier, marked, fixed="tags.csv")
    (earlier / "moved.csv").write_text(marked.replace("0,2,1", "0,2.5,1"))
    path = f"deployment.path='{earlier}/{others}'"
    problem = build_problem(composed(monkeypatch, "evaluate", f"run='{earlier}'", path))
    assert problem.fixed.ids.tolist() == [5]
    assert problem.labels.ids.tolist() == [5, 7]


def test_a_file_of_fixed_tags_that_is_named_is_all_of_them(earlier, monkeypatch):
    leave(earlier, "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n", fixed="tags.csv")
    hangs, more = f"deployment.fixed='{earlier}/landmarks.csv'", f"deployment.path='{earlier}/more.csv'"
    (earlier / "more.csv").write_text("id,x,y,z,nx,ny,nz\n9,0,3,1,1,0,0\n")
    problem = build_problem(composed(monkeypatch, "evaluate", f"run='{earlier}'", hangs, more))
    assert problem.labels.ids.tolist() == [5, 7, 9]


def test_tradeoff_places_others_beside_the_fixed_tags_of_a_run(earlier, monkeypatch):
    def problem_of(count):
        random = partial(read_earlier_run, "deployment=random")
        return Ladder(composed(monkeypatch, "tradeoff", f"run='{earlier}'", read=random), (0.0,), 0).problem(count)

    leave(earlier, "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n", fixed="tags.csv")
    problem = problem_of(3)
    assert problem.fixed.ids.tolist() == [5]
    assert problem.labels.ids.tolist() == [5, 0, 1]
    leave(earlier, LANDMARKS, fixed=None)
    assert problem_of(3).fixed is None


@pytest.mark.parametrize(
    ("arguments", "deployments"), [([], ["run"]), (["deployment=run,uniform"], ["run", "uniform"])]
)
def test_where_deployments_are_compared_the_run_is_one_of_them(earlier, monkeypatch, arguments, deployments):
    cfg = composed(monkeypatch, "observe", f"run='{earlier}'", *arguments, read=read_deployment_as_a_list)
    assert cfg.deployments == deployments


def test_deployments_beside_a_run_have_as_many_landmarks_and_its_fixed_ones(earlier, monkeypatch):
    marked = "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n9,0,3,1,1,0,0,0\n"
    leave(earlier, marked, fixed="tags.csv")
    (earlier.parent / "two.csv").write_text("id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n1,6,2,1,-1,0,0\n")
    entries = "deployments=[run,random,'more: uniform deployment.count=4','two: file deployment.path=two.csv']"
    problems = {}

    def build(cfg):
        problems.update({name: build_problem(own) for name, own in composed_deployments(cfg, "accuracy").items()})

    monkeypatch.setattr(accuracy, "main", replace(accuracy.main, task=build))
    monkeypatch.setattr(sys, "argv", ["accuracy", f"run='{earlier}'", entries])
    accuracy.main()
    assert {name: problem.count for name, problem in problems.items()} == {"run": 3, "random": 3, "more": 4, "two": 3}
    assert {tuple(problem.fixed.ids) for problem in problems.values()} == {(5,)}


def test_without_a_run_nothing_changes(monkeypatch):
    for arguments in (["seed=1"], ["run=null"]):
        assert composed(monkeypatch, "evaluate", *arguments).run is None
        assert sys.argv == ["evaluate", *arguments]


def test_a_directory_that_is_no_run_gets_one_sentence(earlier, monkeypatch, capsys):
    (earlier / "landmarks.csv").unlink()
    for directory, missing in (("nowhere", ".hydra/config.yaml"), (f"'{earlier}'", "landmarks.csv")):
        monkeypatch.setattr(sys, "argv", ["evaluate", f"run={directory}"])
        with pytest.raises(SystemExit):
            read_earlier_run()
        error = capsys.readouterr().err
        assert error.startswith("error: run = ")
        assert error.endswith(f"is no run to go on from: it holds no {missing}.\n")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"a: [\n", "cannot be read ("),
        (b"\x80", "cannot be read as text ("),
        (b"[1]", "is no configuration"),
        (BOMB, "cannot be read (its aliases stand for"),
    ],
)
def test_a_configuration_that_is_none_gets_one_sentence(earlier, monkeypatch, capsys, content, told):
    (earlier / ".hydra" / "config.yaml").write_bytes(content)
    monkeypatch.setattr(sys, "argv", ["evaluate", f"run='{earlier}'"])
    with pytest.raises(SystemExit):
        read_earlier_run()
    error = capsys.readouterr().err
    assert error.startswith(f"error: run: '{earlier}/.hydra/config.yaml' {told}")
    assert error.count("\n") == 1


@pytest.mark.slow
def test_a_run_is_scored_flown_and_improved_where_it_was(earlier):
    """As in docs/running.md; elsewhere its landmarks float."""
    cwd, run = earlier.parent, f"run='{earlier}'"
    file = ("deployment=file", f"deployment.path='{earlier}/landmarks.csv'")
    message = "landmark 1 at (6, 2, 1) hangs in mid-air, 1 m from the nearest surface that may carry it, floor (1 of 2"
    refused("evaluate", *file, *QUICK, "hydra.run.dir=../elsewhere", message=message, cwd=cwd, settings=())
    sweep = ("hydra.mode=MULTIRUN", "objective.thold_p=0.2,0.4")
    for pipeline, overrides in (
        ("evaluate", [*QUICK, "hydra.run.dir=score"]),
        ("evaluate", [*QUICK, *sweep]),
        ("optimise", [*QUICK[:3], "budget.evaluations=5", "hydra.run.dir=better"]),
        ("observe", ["tracking=none", "seeds=1", "trajectory.duration=2", "hydra.run.dir=flown"]),
    ):
        done = call(pipeline, run, *overrides, cwd=cwd, settings=())
        assert done.returncode == 0, done.stderr
    pd.testing.assert_frame_equal(
        *(pd.read_csv(path / "landmarks.csv", dtype=float) for path in (earlier, cwd / "score"))
    )
    score, better = (json.loads((cwd / name / "metrics.json").read_text()) for name in ("score", "better"))
    assert score["settings"]["room"]["size"] == [6.0, 4.0, 2.8]
    assert better["fitness"] >= score["fitness"]
    (jobs,) = cwd.glob("outputs/evaluate_sweep/*/jobs.csv")
    assert len(pd.read_csv(jobs)) == 2
    assert set(pd.read_csv(cwd / "flown" / "figures.csv").deployment) == {"run"}
