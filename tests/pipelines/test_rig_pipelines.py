"""`camera.rig` in a configuration and on the command line."""

import json

import numpy as np
import pytest
from support import composing
from support.paper import PAPER_CAMERA
from support.processes import inside

from lmd.core.checks import InputError
from lmd.geometry.camera import Camera
from lmd.scene.rig import Mount, Rig
from pipelines.building import build_problem, camera_of

BACK_TO_BACK = "camera.rig=[{translation: [0.1, 0, 0]}, {translation: [-0.1, 0, 0], yaw: 3.14159}]"
KALIBR = """
cam0: {camera_model: pinhole, intrinsics: [400, 400, 319.5, 239.5], distortion_model: none, resolution: [640, 480]}
cam1: {camera_model: pinhole, intrinsics: [500, 500, 319.5, 239.5], distortion_model: none, resolution: [640, 480]}
"""


def composed(*overrides, pipeline="optimise"):
    return composing.composed(pipeline, "room.spacing=1.5", *overrides)


def test_without_a_rig_there_is_one_camera():
    assert camera_of(composed().camera) == Camera(**PAPER_CAMERA)


def test_a_rig_takes_the_camera_of_the_group():
    camera = Camera(**PAPER_CAMERA)
    expected = Rig((Mount(camera, (0.1, 0, 0)), Mount(camera, (-0.1, 0, 0), yaw=3.14159)))
    problem = build_problem(composed(BACK_TO_BACK, "pdf=yaw"))
    assert problem.scene.camera == expected
    assert [mount["yaw"] for mount in problem.settings()["camera"]["mounts"]] == [0.0, 3.14159]


def test_cameras_of_their_own_need_none_of_the_group(tmp_path):
    (tmp_path / "chain.yaml").write_text(KALIBR)
    own = [f"{{camera: {{path: {tmp_path}/chain.yaml, name: {name}}}}}" for name in ("cam0", "cam1")]
    rig = camera_of(composed("camera=calibration", f"camera.rig=[{','.join(own)}]").camera)
    assert [camera.focal_pixels[0] for camera in rig.cameras] == pytest.approx([400.0, 500.0])
    unchained = f"camera.rig={tmp_path}/chain.yaml"
    with pytest.raises(InputError, match=r"^camera\.rig\.path: .*chain\.yaml has no T_cam_imu"):
        camera_of(composed("camera=calibration", unchained).camera)
    with pytest.raises(InputError, match=r"^camera.path is missing"):
        camera_of(composed("camera=calibration", f"camera.rig=[{own[0]},{{yaw: 1.0}}]").camera)


def test_a_rig_of_one_camera_is_a_rig():
    mount = "camera.rig=[{translation: [0.1,0,0.3], pitch: -0.3}]"
    problem = build_problem(composed("experiment=lab", "room.spacing=1", "pdf.divisions=4", mount))
    found = problem.metrics(problem.draw(np.random.default_rng(0)))
    assert 0.0 < found["localised_share"] < 1.0


@pytest.mark.slow
def test_a_rig_is_optimised_and_judged(tmp_path):  # other optimisers, and losses, need no process
    common = (BACK_TO_BACK, "pdf=yaw", "deployment.count=12", "tracking=none", "optimiser=random_search")
    done = inside("optimise", *common, "budget.evaluations=60", "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "run" / "metrics.json").read_text())
    settings = ("tracking=none", "validate=false", "losses=false", "picture=false")
    done = inside("evaluate", "run=run", "hydra.run.dir=again", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    again = json.loads((tmp_path / "again" / "metrics.json").read_text())
    assert again["qualified_ratio"] == found["qualified_ratio"]
    assert (tmp_path / "again" / "localisation.csv").is_file()
    assert not list((tmp_path / "again").glob("*.png"))
