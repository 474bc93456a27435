"""The configuration of a command: what its keys choose, and which words win."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import ReadonlyConfigError
from support import composing
from support.processes import inside, refused

import lmd.suite
import pipelines
from lmd.core.checks import InputError
from pipelines.app import CONF, spelled
from pipelines.building import build_optimiser, build_problem
from pipelines.composing import GROUPS
from pipelines.nodes import instantiate, keyed
from pipelines.points import Ladder

LAB = ("room=lab", "room.spacing=1", "camera=lab", "pdf=yaw", "pdf.pitch=0.1", "objective.n=1", "objective.thold_p=0.4")
BOMB = b"a: &a [1, 1, 1, 1]\nb: &b [*a, *a, *a, *a, *a, *a]\nc: [*b, *b, *b, *b, *b, *b]\n"
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n1,6,2,1,-1,0,0\n"
MARKED = "id,x,y,z,nx,ny,nz,fixed\n5,0,1,1,1,0,0,1\n7,0,2,1,1,0,0,0\n9,0,3,1,1,0,0,0\n"
COMMANDS = sorted(path.stem for path in Path(CONF).glob("*.yaml") if "\nrun: null" in path.read_text())
OTHER = {"room": "hall", "camera": "ov9281", "pdf": "sphere", "poses": "recorded",
         "visibility": "fiducial", "objective": "robust"}  # fmt: skip


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


def leave(run, landmarks=LANDMARKS, **keys):
    """Let the run have left these landmarks, and have recorded these keys."""
    path = run / ".hydra" / "config.yaml"
    OmegaConf.save(OmegaConf.merge(OmegaConf.load(path), keys), path)
    (run / "landmarks.csv").write_text(landmarks)
    return OmegaConf.load(path)


def after(earlier, command, *words):
    return composing.composed(command, f"run='{earlier}'", *words)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_run_brings_every_group_but_what_is_named_beside_it(earlier, command):
    before = leave(earlier)
    for group, other in OTHER.items() if command == "evaluate" else [("room", "hall")]:
        cfg = after(earlier, command, f"{group}={other}")
        lost = {group, "pdf"} if group == "poses" else {group}
        assert all(cfg[name] == before[name] for name in {*GROUPS} - lost)
        assert not any(cfg[name] == before[name] for name in lost)
    cfg = after(earlier, command, "pdf.pitch=0.3", "objective.n=2", "seed=3")
    assert (cfg.pdf.pitch, cfg.objective.n, cfg.objective.thold_p, cfg.seed) == (0.3, 2, 0.4, 3)


@pytest.mark.parametrize("order", [1, -1])
def test_the_command_line_wins_in_any_order(earlier, order):
    words = [f"run='{earlier}'", "room=paper_simulation", "pdf.pitch=0.3", "deployment=random", "objective.n=2"]
    cfg = composing.composed("optimise", *words[::order])
    assert cfg.room.size == [7.5, 5.0, 6.0]
    assert "path" not in cfg.deployment
    assert (cfg.pdf.pitch, cfg.objective.n, cfg.deployment.count) == (0.3, 2, 2)


def test_a_key_that_only_the_run_has_can_be_overridden_and_a_lacking_group_keeps_its_default(earlier):
    before = leave(earlier, camera={"distortion": [0.1, 0, 0, 0, 0]}, deployment={"free": True})
    del before["tag"]
    OmegaConf.save(before, earlier / ".hydra" / "config.yaml")
    cfg = after(earlier, "evaluate", "camera.distortion=[0.2,0,0,0,0]")
    assert (cfg.camera.distortion[0], cfg.tag.edge, cfg.deployment.free) == (0.2, None, True)


@pytest.mark.parametrize("fixed", [None, "tags.csv"])
def test_tags_that_were_measured_are_taken_as_they_are(earlier, fixed):
    """Papers overlap, hang over an edge and stand before their wall."""
    measured = "id,x,y,z,nx,ny,nz,fixed\n3,0,1,1,1,0,0,1\n1,0,1.18,1,1,0,0,1\n4,0,0.05,2,1,0,0,0\n0,0.08,2,1,1,0,0,0\n"
    leave(earlier, measured, deployment={"measured": "measured.csv", "fixed": fixed})
    problem = build_problem(after(earlier, "export", "tag.edge=0.15"))
    assert problem.fixed_count == (0 if fixed is None else 2)
    drawn = problem.draw(np.random.default_rng(0))
    assert drawn.positions.tolist() == [[0, 1, 1], [0, 1.18, 1], [0, 0.05, 2], [0.08, 2, 1]]
    with pytest.raises(InputError, match=r"landmarks? (3 and 1 .* overlap|0 .* hangs in mid-air)"):
        build_problem(after(earlier, "export", "tag.edge=0.15", "deployment.free=false"))


@pytest.mark.parametrize("command", ["tradeoff", "evaluate"])
def test_landmarks_placed_anew_are_as_many_as_those_of_the_run_and_beside_its_fixed_ones(earlier, command):
    leave(earlier, MARKED, deployment={"fixed": "tags.csv"})
    words = ["deployment=random"] if command == "evaluate" else []
    problem = build_problem(after(earlier, command, *words))
    assert (problem.count, problem.fixed.ids.tolist()) == (3, [5])
    assert build_problem(after(earlier, command, *words, "deployment.count=4")).count == 4
    if command == "tradeoff":
        assert Ladder(after(earlier, command), 0.0, 0).problem(3).labels.ids.tolist() == [5, 0, 1]


def test_the_fixed_tags_of_a_run_are_those_it_marks_unless_a_file_is_named(earlier):
    leave(earlier, MARKED, deployment={"fixed": "tags.csv"})
    (earlier / "moved.csv").write_text(MARKED.replace("0,2,1", "0,2.5,1"))
    problem = build_problem(after(earlier, "evaluate", f"deployment.path='{earlier}/moved.csv'"))
    assert (problem.fixed.ids.tolist(), problem.labels.ids.tolist()) == ([5], [5, 7, 9])
    (earlier / "more.csv").write_text("id,x,y,z,nx,ny,nz\n8,0,3.5,1,1,0,0\n")
    words = (f"deployment.fixed='{earlier}/landmarks.csv'", f"deployment.path='{earlier}/more.csv'")
    assert build_problem(after(earlier, "evaluate", *words)).labels.ids.tolist() == [5, 7, 9, 8]


def test_a_command_that_reads_images_takes_the_detector_of_the_run(earlier):
    leave(earlier, detectors={"apriltag_decimate2": {}})
    assert list(after(earlier, "survey").detectors) == ["apriltag_decimate2"]
    leave(earlier, detectors={"aruco": {}})
    assert list(after(earlier, "survey").detectors) == ["apriltag"]  # of several, none: the default of the command


@pytest.mark.parametrize("more", [[], ["room=hall"]])
def test_the_folder_of_a_run_as_the_map_brings_its_room(earlier, more):
    cfg = composing.composed("localise", f"map='{earlier}'", *more)
    assert (cfg.room == leave(earlier).room) == (not more)


def test_deployments_beside_a_run_have_as_many_landmarks_and_its_fixed_ones(earlier):
    leave(earlier, MARKED, deployment={"fixed": "tags.csv"})
    (earlier.parent / "two.csv").write_text(LANDMARKS)
    entries = "deployments=[run,random,'more: uniform deployment.count=4','two: file deployment.path=two.csv']"
    quick = ("losses=false", "localisation=false", "picture=false", "validate=false", "tracking=none")
    done = inside("evaluate", f"run='{earlier}'", entries, *quick, "hydra.run.dir=out", cwd=earlier.parent, settings=())
    assert done.returncode == 0, done.stderr
    for name, count in {"run": 3, "random": 3, "more": 4, "two": 3}.items():
        found = json.loads((earlier.parent / "out" / name / "metrics.json").read_text())["settings"]
        assert (found["landmarks"], found["fixed_landmarks"]) == (count, 1)


def test_a_run_and_an_experiment_that_choose_the_same_get_one_sentence(earlier):
    message = "and experiment=lab both choose the problem: leave one of the two out"
    given = (f"run='{earlier}'", "experiment=lab", "hydra.run.dir=out")
    refused("evaluate", *given, message=message, cwd=earlier.parent, settings=())


def test_a_directory_that_is_no_run_gets_one_sentence(earlier):
    for content, told in (
        (b"a: [\n", "cannot be read ("),
        (b"\x80", "cannot be read as text ("),
        (b"[1]", "is not a configuration"),
        (BOMB, "cannot be read (its YAML aliases expand to"),
    ):
        (earlier / ".hydra" / "config.yaml").write_bytes(content)
        with pytest.raises(InputError, match=re.escape(f"run: '{earlier}/.hydra/config.yaml' {told}")):
            after(earlier, "evaluate")
    (earlier / "landmarks.csv").unlink()
    for directory, missing in (("nowhere", ".hydra/config.yaml"), (f"'{earlier}'", "landmarks.csv")):
        with pytest.raises(InputError, match=rf"^run = .* is not a run: there is no '.*/{missing}'\.$"):
            composing.composed("evaluate", f"run={directory}")


def test_a_path_alone_means_a_file():
    assert composing.composed("optimise", "deployment.path=a.csv").deployment.path == "a.csv"
    assert "FileDeployment" in composing.composed("evaluate", "deployment.path=a.csv").deployment._target_
    assert "Uniform" in composing.composed("evaluate", "deployment=uniform", "deployment.free=true").deployment._target_


def test_cameras_vary_from_given_tags_by_an_optimiser_of_their_own():
    cfg = composing.composed("optimise", "varies=cameras")
    assert cfg.optimiser._target_.endswith("CameraAnnealing")
    assert (cfg.deployment.path, cfg.budget.evaluations, cfg.cameras.count) == (None, 2000, 2)
    other = composing.composed("optimise", "varies=cameras", "optimiser=ega", "budget.evaluations=7", "cameras.count=3")
    assert (other.optimiser._target_[-3:], other.budget.evaluations, other.cameras.count) == ("EGA", 7, 3)
    assert not {"cameras", "body"} & {*composing.composed("optimise")}


def test_a_frozen_problem_is_composed_by_its_name():
    problem = build_problem(pipelines.compose("optimise", "suite=tiny_mean"))
    box = lmd.suite.problem("tiny_mean")
    assert problem.fitness_of(box.deployment(box.start())) == box(box.start())
    names = [name for name in lmd.suite.names() if "cameras" in lmd.suite.document(name).problem]
    cfg = pipelines.compose("optimise", f"suite={names[0]}")
    assert cfg.cameras.count == lmd.suite.document(names[0]).problem["cameras"]["count"]
    with pytest.raises(InputError, match="places cameras: use the command optimise"):
        pipelines.compose("tradeoff", f"suite={names[0]}")


def test_a_command_is_composed_without_being_run_and_cannot_be_changed():
    cfg = pipelines.compose(
        "optimise", "experiment=debug", "optimiser=ega", "deployment.count=20", "optimiser.partner=pool"
    )
    problem = build_problem(cfg)
    assert (problem.count, cfg.objective.thold_p, cfg.optimiser.partner) == (20, 0.3, "pool")
    assert build_optimiser(cfg, cfg.seed).population_size == 30
    with pytest.raises(ReadonlyConfigError):
        cfg.room.spacing = 1.0
    with pytest.raises(HydraException, match="Could not find 'optimiser/egg'"):
        pipelines.compose("optimise", "optimiser=egg")


@pytest.mark.parametrize(
    ("override", "read"),
    [
        ("deployment.count=+5", "deployment.count='+5'"),
        ("deployment.count=+1,+20", "deployment.count='+1','+20'"),
        ("deployment.count='+5'", "deployment.count='+5'"),
        ("deployment.count=5", "deployment.count=5"),
        ("objective.n=+2", "objective.n=+2"),
    ],
)
def test_a_count_with_a_plus_is_text(override, read):
    assert spelled(override) == read


OWN = """
class Mine:
    def __init__(self, width=1, seed=0):
        if width > 1:
            raise KeyError("wide")
"""
GA = "pymoo.algorithms.soo.nonconvex.ga"


@pytest.mark.parametrize(
    ("target", "given", "message"),
    [
        (f"{GA}.GAA", {}, f"part._target_ = '{GA}.GAA': {GA} has no GAA"),
        ("own_modul.Mine", {}, ": there is no module own_modul"),
        ("own_module.Other", {}, ": own_module has no Other"),
        ("own_failing.Mine", {}, ": own_failing.Mine cannot be imported: ZeroDivisionError: division by zero ("),
        ("own_lacking.Mine", {}, ": ModuleNotFoundError: No module named 'lmd.nothing' (own_lacking.py, line 1)"),
        ("own_module.Mine", {"widht": 2}, "part.widht is not a known setting; did you mean part.width?"),
        ("own_module.Mine", {"step": 2}, "part.step is not a known setting; own_module.Mine takes width"),
        ("own_module.Mine", {"width": 2}, "part: own_module.Mine failed: KeyError: 'wide' (own_module.py, line 5)"),
        ("lmd.optimisers.ledger.Ledger", {}, "part: lmd.optimisers.ledger.Ledger must accept the argument seed."),
    ],
)
def test_a_misspelt_class_or_argument_is_told_what_there_is(target, given, message, tmp_path, monkeypatch):
    for name, text in (("module", OWN), ("failing", "1 / 0"), ("lacking", "import lmd.nothing")):
        (tmp_path / f"own_{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError) as told:
        instantiate(OmegaConf.create({"part": {"_target_": target, **given}}).part, seed=0)
    assert message in str(told.value)


def test_a_message_names_the_key_of_the_argument():
    def told(error, group="", **keys):
        with pytest.raises(InputError) as caught, keyed(group, **keys):
            raise error
        return str(caught.value)

    assert told(InputError("n is odd.", "n"), "objective") == "objective.n is odd."
    assert told(InputError("size[0] is odd.", "size[0]"), "room") == "room.size[0] is odd."
    assert told(InputError("kind is odd.", "kind"), "objective", kind="encoding.kind") == "encoding.kind is odd."
    assert told(InputError("gain is odd.", "gain").within("a").within("all"), all="each") == "each.a.gain is odd."
    assert told(InputError("The file is odd."), "room") == "The file is odd."


def test_the_page_on_running_shows_how_from_python():
    page = Path(__file__).parents[2] / "docs" / "running.md"
    names: dict = {}
    exec("".join(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)), names)
    assert names["problem"].fitness_of(names["deployment"]) == names["fitness"].max()
