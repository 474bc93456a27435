"""`place_cameras` from the command line."""

import json

import composing
import pytest
from processes import inside, refused

from lmd.core.checks import InputError
from lmd.scene.rig import Rig
from pipelines.building import camera_of
from pipelines.place_cameras import build_camera_problem

TAGS = ("deployment=uniform", "deployment.count=12", "pdf=yaw", "pdf.divisions=3", "objective.thold_p=0.3")
KALIBR = """
cam0: {camera_model: pinhole, intrinsics: [400, 400, 319.5, 239.5], distortion_model: none, resolution: [640, 480]}
cam1: {camera_model: pinhole, intrinsics: [500, 500, 319.5, 239.5], distortion_model: none, resolution: [640, 480]}
"""


def composed(*overrides):
    return composing.composed("place_cameras", "room.spacing=1.5", *TAGS, *overrides)


def test_the_configuration_makes_the_problem(tmp_path):
    (tmp_path / "chain.yaml").write_text(KALIBR)
    lenses = ",".join(f"{{path: {tmp_path}/chain.yaml, name: {name}}}" for name in ("cam0", "cam1"))
    problem, sources = build_camera_problem(composed("cameras.count=3", f"cameras.lenses=[{lenses}]"))
    assert (problem.space.count, problem.count, problem.space.names[-1]) == (3, 12, "lens")
    assert [source["name"] for source in sources.values()] == ["cam0", "cam1"]
    assert [camera.focal_pixels[0] for camera in problem.space.lenses] == pytest.approx([400.0, 500.0])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("cameras.count=0", r"^cameras\.count must be"),
        ("cameras.apart=-1", r"^cameras\.apart must be at least 0"),
        ("cameras.pitch=[1]", r"^cameras\.pitch must be a list of 2 numbers"),
        ("cameras.lenses=[none.yaml]", r"^cameras\.lenses\[0\]\.path: there is no file 'none.yaml'"),
        ("body.margin=-1", r"^body\.margin must be at least 0"),
        ("body.boxes=[{low: [0, 0, 0], high: [1, 1, 0]}]", r"^body\.boxes\[0\]\.low"),
        ("body.boxes=[{low: [0, 0, 0], high: [9, 1, 1]}]", r"^body\.boxes leave the room: "),
        ("camera.rig=[{translation: [0.1, 0, 0]},{}]", r"^camera\.rig.* is not where and how a camera may be mounted"),
        ("camera.rig=[{translation: [0.42, 0, 0.3]}]", r"^cameras\.count = 2, but 1 cameras are given"),
        ("camera.rig=none.yaml", r"^camera\.rig: there is no file 'none.yaml'"),
    ],
)
def test_what_is_refused_is_named_by_its_key(override, message):
    with pytest.raises(InputError, match=message):
        build_camera_problem(composed(override))


@pytest.mark.slow  # three seconds, and what compiles
def test_cameras_are_placed_scored_and_gone_on_from(tmp_path):
    common = (*TAGS, "tracking=none", "budget.evaluations=12", "body.margin=0.05")
    settings = ("room.spacing=1.5", "validate=false")
    done = inside("place_cameras", *common, "hydra.run.dir=run", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (found["cameras"], found["evaluations"]) == (2, 12)
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {
        "rig.yaml", "body.png", "landmarks.csv", "history.csv", "convergence.png", "scene.png", "checkpoint.npz"
    }  # fmt: skip
    rig = camera_of(composed(f"camera.rig={tmp_path}/run/rig.yaml").camera)
    assert isinstance(rig, Rig)
    assert len(rig.mounts) == 2
    quick, quiet = ("localisation=false", "losses=false"), ("tracking=none", "validate=false", "picture=false")
    done = inside("evaluate", "run=run", *quick, "hydra.run.dir=again", cwd=tmp_path, settings=quiet)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "again" / "metrics.json").read_text())["fitness"] == found["fitness"]
    more = ("run=run", "rounds=2", "tag_evaluations=12", "budget.evaluations=6", "hydra.run.dir=rounds")
    done = inside("place_cameras", *more, cwd=tmp_path, settings=quiet)
    assert done.returncode == 0, done.stderr
    assert "margin: 0.05" in (tmp_path / "rounds" / ".hydra" / "config.yaml").read_text()  # the body is that of the run
    turns = json.loads((tmp_path / "rounds" / "metrics.json").read_text())
    told = list(turns["rounds"].values())
    assert len(told) == 4
    assert [found["fitness"], *told] == sorted([found["fitness"], *told])
    assert turns["fitness"] == told[-1]
    refused(
        "place_cameras", *common, "optimiser=greedy", "hydra.run.dir=none", cwd=tmp_path, settings=settings,
        message="Greedy places landmarks, not cameras",
    )  # fmt: skip
