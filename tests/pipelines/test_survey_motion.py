"""`pipelines.survey` of a drive, with odometry: a process, its messages and the files it leaves."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import drives, processes, walks

from lmd.core.tables import write_table
from lmd.formats.detection_formats import write_detections

SETTINGS = ["detections=detections.csv", "camera.path=camera.yaml", f"tag.edge={drives.EDGE}", "tracking=none",
            "hydra.run.dir=out"]  # fmt: skip
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cwd(tmp_path_factory):
    """A drive and its odometry, of the camera and of a body that carries it."""
    folder, rng = tmp_path_factory.mktemp("drive"), np.random.default_rng(5)
    driven = drives.drive(8.0, 6, rng, alone=1.0, dark=0.1)
    odometry = drives.odometry(driven, rng)
    walks.calibration(folder / "camera.yaml", drives.CAMERA)
    write_detections(folder / "detections.csv", driven.detected)
    write_detections(folder / "family.csv", replace(driven.detected, family="16h5"))

    def write(name, poses, later=0.0):
        turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        rows = np.hstack([odometry.time[:, None] + later, poses[:, :3, 3], turns])
        names = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
        write_table(folder / name, dict(zip(names, rows.T, strict=True)))

    body = np.eye(4)
    body[:3, :3], body[:3, 3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [0.1, 0.2, -0.5]
    write("odometry.csv", odometry.poses)
    write("body.csv", odometry.poses @ body)
    write("late.csv", odometry.poses, later=500.0)
    return folder


def call(*overrides, cwd):
    return processes.inside("survey", *overrides, cwd=cwd, settings=SETTINGS)


def places(folder):
    rows = json.loads((folder / "survey.json").read_text())
    table = (folder / "map.csv").read_text().splitlines()
    return rows["motion"], np.array([[float(x) for x in line.split(",")[1:4]] for line in table[1:]])


def test_odometry_maps_a_drive_whose_images_show_one_tag_each(cwd):
    done = call("survey.odometry=odometry.csv", cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert "; it joins 5 groups of tags" in done.stdout
    _, here = places(cwd / "out")
    assert "odometry drifts" in done.stdout
    assert len(here) >= 5
    mount = "[0.5,0.1,0.2,0,0,0]"
    done = call(f"survey.odometry={{path: body.csv, frame: body, mount: {mount}}}", "hydra.run.dir=by_body", cwd=cwd)
    assert done.returncode == 0, done.stderr
    _, there = places(cwd / "by_body")
    np.testing.assert_allclose(there, here, atol=0.02)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["survey.odometry=late.csv"], "survey.odometry has poses from 500 to"),
        (["survey.odometry=body.csv"], "survey.odometry contradicts the motion in the images"),
        (["survey.odometry=missing.csv"], "survey.odometry"),
        (["survey.odometry={path: odometry.csv, drift: 3}"], "survey.odometry key must be one of path, "),
        (["survey.motion=maybe"], "survey.motion must be"),
        (["survey.every=0"], "survey.every must be"),
        (["survey.every=often"], "survey.every must be"),
        (["survey.motion=false"], "detections"),
        (["detections=family.csv"], "tag.family=16h5 is needed: the tags of family.csv are of that family, not of"),
    ],
)
def test_bad_input_is_named_in_one_sentence(cwd, overrides, said):
    done = call(*overrides, "hydra.run.dir=refused", cwd=cwd)
    assert done.returncode != 0
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (cwd / "refused" / "map.csv").exists()
