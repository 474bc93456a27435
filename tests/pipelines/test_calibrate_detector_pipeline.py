"""`pipelines.calibrate_detector` as a user meets it: a process, its messages, its exit code and the files it leaves."""

import json

import cv2
import numpy as np
import processes
import pytest
from test_detect_pipeline import CAMERA

from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial

SMALL = ["room.spacing=3", *CAMERA, "tag.edge=0.3", "views.count=200", "poses=10", "hydra.run.dir=run", "tracking=none"]
pytestmark = pytest.mark.slow


def call(*overrides, cwd, settings=SMALL):
    return processes.inside("calibrate_detector", *overrides, cwd=cwd, settings=settings)


def test_limits_with_their_evidence(tmp_path):
    done = call("detectors=[aruco,apriltag_decimate2]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    presets = {f"36h11_{name}.yaml" for name in ("aruco", "apriltag_decimate2")}
    files = {*presets, "calibration.md", "calibration.json", "calibration.png"}
    assert {path.name for path in (tmp_path / "run").iterdir()} == {*files, ".hydra"}
    assert (tmp_path / "run" / "calibration.md").read_text() in done.stdout
    figures = json.loads((tmp_path / "run" / "calibration.json").read_text())["figures"]
    for name in ("aruco", "apriltag_decimate2"):
        text = (tmp_path / "run" / f"36h11_{name}.yaml").read_text()
        assert "In 10 frames of a room" in text
        # As it is, it is a detector of visibility=fiducial.
        fiducial = Fiducial(Tag(0.3), str(tmp_path / "run" / f"36h11_{name}.yaml"))
        assert fiducial.limits.blur == pytest.approx(figures[name]["blur"], rel=1e-3)
        assert fiducial.limits.margin == 3.0
        assert figures[name]["accuracy"] > 0.8
        assert figures[name]["room_agreement_2"] >= 0.7
    # A smaller image is read: tags must be larger.
    limit = {name: np.hypot(row["pitch"], row["blur"]) for name, row in figures.items()}
    assert limit["apriltag_decimate2"] > limit["aruco"]


def test_images_of_a_board(tmp_path):
    camera = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 10.0, 1778.0)
    centres = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.2, 0.2, 0.0]])
    normals, ups = np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile([0.0, 1.0, 0.0], (4, 1))
    renderer = Renderer(camera, TaggedRoom(Tag(0.1), np.arange(4), centres, normals, ups), Imaging())
    (tmp_path / "images").mkdir()
    for i, height in enumerate(np.linspace(0.6, 3.0, 8)):
        pose = camera_pose([0.1, 0.1 - 0.3 * height, height], 0.0, -1.2)
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), renderer.frame(pose, np.random.default_rng(i)))
    rows = "".join(f"{i},{x},{y},{z},0,0,1\n" for i, (x, y, z) in enumerate(centres))
    (tmp_path / "tags.csv").write_text("id,x,y,z,nx,ny,nz\n" + rows)
    settings = [*(s for s in SMALL if not s.startswith(("views", "poses", "tag"))), "poses=0", "tag.edge=0.1"]
    images = ["board.folder=images", "board.tags=tags.csv"]
    done = call(*images, "detectors=[apriltag]", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    row = json.loads((tmp_path / "run" / "calibration.json").read_text())["figures"]["apriltag"]
    assert 20 <= row["views"] <= 32
    assert "room_frames" not in row
    assert "views of board" in (tmp_path / "run" / "36h11_apriltag.yaml").read_text()
