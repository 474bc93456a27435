import json
import math
import re

import cv2
import numpy as np
import pytest
import yaml
from processes import inside

from lmd.core.checks import InputError
from lmd.formats.calibrations import Calibration, calibrated_camera, read_calibration
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.projection import project
from lmd.geometry.se3 import exp

MATRIX = np.array([[612.5, 0.0, 317.25], [0.0, 608.0, 244.5], [0.0, 0.0, 1.0]])
LENS = [-0.21, 0.06, 0.0012, -0.0008, 1e-5]
ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "narrow_stereo",
    "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": LENS},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
}
KALIBR = {
    "camera_model": "pinhole",
    "intrinsics": [612.5, 608.0, 317.25, 244.5],
    "distortion_model": "radtan",
    "distortion_coeffs": LENS[:4],
    "resolution": [640, 480],
    "rostopic": "/cam0/image_raw",
}


def opencv(path, lens):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array([lens]))
    storage.release()


def ros(path, lens):
    path.write_text(yaml.safe_dump({**ROS, "distortion_coefficients": {"rows": 1, "cols": 5, "data": list(lens)}}))


def old_opencv(path, lens):
    opencv(path, lens)
    path.write_text("%YAML:1.0\n" + path.read_text().partition("\n")[2])


def kalibr(path, lens):
    path.write_text(yaml.safe_dump({"cam0": {**KALIBR, "distortion_coeffs": lens[:4]}}))


@pytest.mark.parametrize("lens", [LENS, [0.0] * 5, [*LENS, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize(
    ("write", "name"),
    [(ros, "info.yaml"), (opencv, "camera.yml"), (opencv, "camera.json"), (old_opencv, "old.yaml"), (kalibr, "k.yaml")],
)
def test_a_calibrated_camera_images_as_opencv_does(write, name, lens, tmp_path):
    path = tmp_path / name
    write(path, lens)
    used = np.array(lens[:4] if write is kalibr else lens)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 3.0], (200, 3))
    pose = exp(np.array([0.02, -0.03, 0.05, 0.1, -0.05, 0.2]))  # camera to world
    turn, shift = cv2.Rodrigues(pose[:3, :3].T)[0], -pose[:3, :3].T @ pose[:3, 3]
    expected = cv2.projectPoints(points, turn, shift, MATRIX, used)[0][:, 0] + PIXEL_CENTRE
    camera = calibrated_camera(path)
    np.testing.assert_allclose(project(camera, pose, points), expected, atol=1e-9)
    assert (camera.image_width, camera.image_height) == (640.0, 480.0)
    assert camera.is_pinhole


FISHEYE = {
    "ros": ROS | {"distortion_model": "equidistant"},
    "opencv": {key: value for key, value in ROS.items() if key != "distortion_model"} | {"fisheye_model": 1},
    "kalibr": {"cam0": KALIBR | {"distortion_model": "equidistant"}},
}


def fisheye(path, kind, lens):
    keys = json.loads(json.dumps(FISHEYE[kind]))
    if kind == "kalibr":
        keys["cam0"]["distortion_coeffs"] = lens
    else:
        keys["distortion_coefficients"] = {"data": lens}
    path.write_text(yaml.safe_dump(keys))


@pytest.mark.parametrize("kind", FISHEYE)
@pytest.mark.parametrize("lens", [[0.0, 0.0, 0.0, 0.0], [-0.02, 0.01, -0.004, 0.001], [0.3, -0.1, 0.05, 0.0]])
def test_a_fisheye_images_as_opencvs_does(kind, lens, tmp_path):
    path = tmp_path / "camera.yaml"
    fisheye(path, kind, lens)
    camera = calibrated_camera(path)
    rng = np.random.default_rng(0)
    rays = np.concatenate([rng.uniform(-1.2, 1.2, (4000, 2)), np.ones((4000, 1))], axis=1)
    expected = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), MATRIX, np.array(lens))[0][:, 0]
    expected = expected + PIXEL_CENTRE
    inside = ((expected >= 0.0) & (expected <= [640.0, 480.0])).all(axis=1)
    assert inside.mean() > 0.1
    np.testing.assert_allclose(project(camera, np.eye(4), rays)[inside], expected[inside], atol=1e-9)


def test_a_fisheye_may_see_what_is_behind_it(tmp_path):
    path = tmp_path / "camera.yaml"
    wide = {**KALIBR, "intrinsics": [200.0, 200.0, 319.5, 239.5], "distortion_model": "equidistant"}
    path.write_text(yaml.safe_dump({"cam0": wide | {"distortion_coeffs": [0.0] * 4}}))
    camera = calibrated_camera(path)
    assert camera.widest_angle == pytest.approx(2.0)  # 400 pixels from the centre to a corner
    behind = np.array([[math.sin(1.9) * 0.8, math.sin(1.9) * 0.6, math.cos(1.9)]])
    np.testing.assert_allclose(project(camera, np.eye(4), behind), [[320 + 380 * 0.8, 240 + 380 * 0.6]])


def test_a_lens_gives_pixels_their_size(tmp_path):
    ros(tmp_path / "info.yaml", LENS)
    camera = calibrated_camera(tmp_path / "info.yaml", focal_length=4.0, aperture=8.0, focus_distance=1500.0)
    assert (camera.focal_length, camera.aperture, camera.focus_distance) == (4.0, 8.0, 1500.0)
    np.testing.assert_allclose(camera.focal_pixels, [612.5, 608.0])
    assert camera.pixel_width == pytest.approx(4.0 / 612.5)
    near, far = camera.depth_of_field(2.0)
    assert 0.0 < near < 1.5 < far < math.inf


def test_one_camera_of_several_is_named(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": KALIBR, "cam1": {**KALIBR, "resolution": [320, 400]}}))
    assert read_calibration(path, "cam1").image_width == 320
    with pytest.raises(InputError, match=r"^name must be given: .*camchain\.yaml has the cameras cam0, cam1\.$"):
        read_calibration(path)
    with pytest.raises(InputError, match=r"^name = 'cam2' is no camera of .*camchain\.yaml, which has cam0, cam1\.$"):
        read_calibration(path, "cam2")


def test_a_camera_of_a_chain_is_read_beside_one_of_a_lens_that_is_not(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": {**KALIBR, "camera_model": "fov"}, "cam1": KALIBR}))
    assert read_calibration(path, "cam1").image_width == KALIBR["resolution"][0]
    with pytest.raises(InputError, match="the lens model 'fov' is not known here"):
        read_calibration(path, "cam0")


def test_a_lens_that_does_not_distort_has_no_coefficients(tmp_path):
    path = tmp_path / "camchain.yaml"
    keys = KALIBR | {"distortion_model": "none", "distortion_coeffs": []}
    for cam0 in (keys, without(keys, "distortion_coeffs")):
        path.write_text(yaml.safe_dump({"cam0": cam0}))
        assert calibrated_camera(path).distortion == ()


def test_json_may_be_indented_with_tabs(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(ROS, indent="\t"))
    assert read_calibration(path).image_width == 640


def without(keys, *path):
    keys = json.loads(json.dumps(keys))
    inner = keys
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]
    return keys


def data(*values):
    return {"data": list(values)}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (without(ROS, "camera_matrix", "data"), "the key camera_matrix.data is missing."),
        (without(ROS, "distortion_coefficients"), "the key distortion_coefficients is missing."),
        (ROS | {"image_height": 480.5}, "image_height must be a whole number, got 480.5."),
        (ROS | {"camera_matrix": data(1, 2)}, "camera_matrix.data must be a list of 9 numbers, got [1, 2]."),
        (ROS | {"camera_matrix": data(600, 3, 320, 0, 600, 240, 0, 0, 1)}, "camera_matrix.data must be [fx, 0, cx, 0,"),
        (ROS | {"camera_matrix": data(-6, 0, 320, 0, 600, 240, 0, 0, 1)}, "focal_pixels[0] must be greater than 0"),
        (
            ROS | {"camera_matrix": data(600, 0, 900, 0, 600, 240, 0, 0, 1)},
            "principal_point must lie inside the 640 x 480",
        ),
        (
            ROS | {"distortion_model": "thin_prism"},
            "the lens model 'thin_prism' is not known here, only plumb_bob, radtan, none, rational_polynomial, ",
        ),
        (
            ROS | {"distortion_coefficients": data(*LENS, *[0.1] * 9)},
            "distortion [-0.21, 0.06, 0.0012, -0.0008, 1e-05, ",
        ),
        (ROS | {"distortion_coefficients": data(1, "a")}, "distortion_coefficients.data[1] must be a number, got 'a'."),
        (ROS | {"distortion_coefficients": data(1, 2)}, "distortion must be [] or [k1, k2, p1, p2], with k3, "),
        (ROS | {"distortion_coefficients": data(-9, 0, 0, 0)}, "distortion must show what is farther"),
        (ROS | {"distortion_coefficients": {"data": 3}}, "distortion_coefficients.data must be a list of 5 numbers"),
        (ROS | {"fisheye_model": 1}, "distortion of an equidistant lens must be [k1, k2, k3, k4], got (-0.21"),
        ({"cam0": without(KALIBR, "resolution")}, "the key cam0.resolution is missing."),
        (
            {"cam0": KALIBR | {"camera_model": "fov"}},
            "the lens model 'fov' is not known here, only pinhole, ds, eucm, omni: ",
        ),
        (
            {"cam0": KALIBR | {"distortion_model": "fov"}},
            "the lens model 'fov' is not known here, only plumb_bob, radtan",
        ),
        ({"cam0": [1, 2]}, "the key cam0.camera_model is missing."),
    ],
)
def test_what_is_wrong_names_file_and_key(keys, message, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(keys))
    with pytest.raises(InputError, match=f"^{re.escape(f'{path}: {message}')}") as caught:
        calibrated_camera(path)
    assert caught.value.argument is None


@pytest.mark.parametrize(
    ("text", "message"), [("a: [", "cannot be read as YAML or JSON"), ("", "has no keys"), ("- 1", "has no keys")]
)
def test_what_is_no_calibration_is_said(text, message, write):
    with pytest.raises(InputError, match=rf"^path: .*{message}"):
        read_calibration(write(text))


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(InputError, match=r"^path is missing"):
        read_calibration(None)
    with pytest.raises(InputError, match=r"^path: there is no file 'none\.yaml'\.$"):
        read_calibration("none.yaml")
    with pytest.raises(InputError, match=r"^path must be the path of a file"):
        read_calibration(5)
    ros(tmp_path / "info.yaml", LENS)
    with pytest.raises(InputError, match=r"^name = 'cam0' is no camera of .*, which has one\.$"):
        read_calibration(tmp_path / "info.yaml", "cam0")
    for optics, message in (
        ({"aperture": 2.0}, "focal_length must be given"),
        ({"focus_distance": 900.0}, "aperture must be given"),
        ({"focal_length": -1.0}, "focal_length must be greater than 0"),
        ({"focal_length": 4.0, "aperture": -1.0}, "aperture must be at least 0"),
    ):
        with pytest.raises(InputError, match=f"^{message}") as caught:
            calibrated_camera(tmp_path / "info.yaml", **optics)
        assert caught.value.argument in ("focal_length", "aperture")


def test_a_calibration_checks_itself():
    assert Calibration(640, 480, (600, 600), (320, 240), (0.1, *[0] * 13)).distortion == (0.1, 0, 0, 0, 0)
    with pytest.raises(InputError, match=r"^principal_point\[0\] must be finite"):
        Calibration(640, 480, (600, 600), (math.nan, 240))


def test_a_run_says_that_nothing_is_out_of_focus(tmp_path):
    ros(tmp_path / "info.yaml", [0.0] * 5)  # for a lens that distorts much would be compiled
    overrides = ("camera=calibration", "camera.path=info.yaml", "localisation=false", "losses=false", "tracking=none")
    done = inside("evaluate", *overrides, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no criterion: the camera has no aperture" in done.stdout
