import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from lmd.core.checks import InputError
from lmd.formats.calibrations import Calibration, calibrated_camera, read_calibration
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.projection import project
from lmd.geometry.se3 import exp

RAYS = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.4, 0.25, 1.0], [0.1, 0.35, 1.0]])


def images(camera, rays=RAYS):
    """Images of rays, from the centre of the first pixel."""
    return project(camera, np.eye(4), rays) - PIXEL_CENTRE


def by_opencv(matrix, lens, rays=RAYS):
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(matrix, dtype=float), np.array(lens))[0][:, 0]


def radial(rays, k1, k2, k3):
    x, y = (rays[:, :2] / rays[:, 2:]).T
    s = x * x + y * y
    return x, y, s, 1 + k1 * s + k2 * s**2 + k3 * s**3


REAL = Path(__file__).parents[2] / ".." / "shared" / "real" / "calibration"
ROS, KALIBR = yaml.safe_load(Path(__file__).with_name("files").joinpath("cameras.yaml").read_text()).values()
MATRIX, LENS = np.reshape(ROS["camera_matrix"]["data"], (3, 3)), ROS["distortion_coefficients"]["data"]


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


def test_the_inverse_model_of_a_realsense_needs_a_word(write):
    """Its polynomial undistorts, or distorts: images of RAYS are compared with both."""
    stream = {"width": 640, "height": 480, "fx": 385.0, "fy": 386.0, "ppx": 321.0, "ppy": 244.0}
    k1, k2, p1, p2, k3 = lens = [-0.055, 0.06, 4e-4, -3e-4, -0.02]
    path = write(json.dumps(stream | {"model": "distortion.inverse_brown_conrady", "coeffs": lens}))
    with pytest.raises(InputError, match=r"^distortion_model must be given: .* undistorting .* distorting") as error:
        calibrated_camera(path)
    assert error.value.argument == "distortion_model"
    camera = calibrated_camera(path, distortion_model="plumb_bob")
    matrix = [[385, 0, 321], [0, 386, 244], [0, 0, 1]]
    np.testing.assert_allclose(images(camera), by_opencv(matrix, lens), atol=1e-9)
    camera = calibrated_camera(path, distortion_model="inverse_brown_conrady")
    x, y, s, f = radial(RAYS, k1, k2, k3)  # RAYS as images: their points by the polynomial
    points = np.stack([x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * f + 2 * p2 * x * y + p1 * (s + 2 * y * y)], 1)
    there = RAYS[:, :2] * [385, 386] + [321, 244]
    np.testing.assert_allclose(images(camera, np.column_stack([points, np.ones(4)])), there, atol=0.1)
    modified = calibrated_camera(write(json.dumps(stream | {"model": 1, "coeffs": lens})))
    x, y = x * f, y * f
    there = np.stack([x + 2 * p1 * x * y + p2 * (s + 2 * x * x), y + 2 * p2 * x * y + p1 * (s + 2 * y * y)], 1)
    np.testing.assert_allclose(images(modified), there * [385, 386] + [321, 244], atol=0.05)


@pytest.mark.skipif(not REAL.exists(), reason="the files of others are not here")
def test_real_files_are_read_or_refused_for_their_lens():
    refused = {}
    for path in sorted(REAL.iterdir()):
        try:
            calibrated_camera(path, "cam1" if path.name.startswith(("basalt", "kalibr")) else None)
        except InputError as error:
            refused[path.name] = str(error).partition(f"{path}: ")[2][:40]
    assert refused == {
        "frc971_calibration_2024.json": "image_width or image_height is missing.",
        "mrcal_cam0_splined.cameramodel": "the lens model 'LENSMODEL_SPLINED_STEREO",
    }


def test_sizes_and_names_choose_and_do_not_contradict(write):
    ftc = """<Calibrations><Camera vid="Logitech" pid="0x0825"><Calibration size="640 480" focalLength="600.0f, 610.0f"
    principalPoint="320, 240" distortionCoefficients="0 0 0 0"/><Calibration size="1280, 720" focalLength="900f 901f"
    principal_point="1 2" distortion_coefficients="0 0 0 0"/></Camera></Calibrations>"""
    path = write(ftc)
    assert read_calibration(path, image_size=[1280, 720]).focal_pixels == (900.0, 901.0)
    assert read_calibration(path, "Logitech:0x0825", [640, 480]).focal_pixels == (600.0, 610.0)
    assert read_calibration(path, "Logitech:0x0825/640x480").focal_pixels == (600.0, 610.0)
    with pytest.raises(InputError, match="has the cameras Logitech:0x0825/640x480, Logitech:0x0825/1280x720"):
        read_calibration(path)
    with pytest.raises(InputError, match="name = 'Logitech:0x0826' is not a camera"):
        read_calibration(path, "Logitech:0x0826", [640, 480])


@pytest.mark.parametrize("lens", [[-0.02, 0.01, -0.015, 0.004], [[-0.02], [0.01], [-0.015], [0.004]]])
def test_four_coefficients_without_a_model_are_asked_about(lens, write):
    path = write(json.dumps({"K": MATRIX.tolist(), "D": lens, "image_size": [640, 480]}), "camera.json")
    with pytest.raises(InputError, match=r"^distortion_model must be given: .*camera\.json: .* 4 coefficients may"):
        read_calibration(path)
    for model, found in (("fisheye", "equidistant"), ("plumb_bob", "plumb_bob")):
        assert read_calibration(path, distortion_model=model).distortion_model == found


def test_arrays_that_are_no_calibration_are_named(tmp_path):
    path = tmp_path / "camera.npz"
    for head, words in (
        (b"\x80\x04\x95", "is a pickle of Python, which may run code: write it by numpy.savez"),
        (b"MATLAB 5.0 MAT-file", r"is a file of MATLAB: for a calibration run writelines\(jsonencode\(toStruct"),
        (b"PK\x03\x04nothing", "cannot be read as arrays"),
    ):
        path.write_bytes(head)
        with pytest.raises(InputError, match=words):
            read_calibration(path)
    np.savez(path, mtx=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"has no array of at most \d+ numbers: use numpy\.savez"):
        read_calibration(path)


def test_a_lens_gives_pixels_their_size(tmp_path):
    ros(tmp_path / "info.yaml", LENS)
    camera = calibrated_camera(tmp_path / "info.yaml", focal_length=4.0, aperture=8.0, focus_distance=1500.0)
    assert (camera.focal_length, camera.aperture, camera.focus_distance) == (4.0, 8.0, 1500.0)
    np.testing.assert_allclose(camera.focal_pixels, [612.5, 608.0])
    assert camera.pixel_width == pytest.approx(4.0 / 612.5)
    near, far = camera.depth_of_field(2.0)
    assert 0.0 < near < 1.5 < far < math.inf


def test_a_calibration_checks_itself():
    assert Calibration(640, 480, (600, 600), (320, 240), (0.1, *[0] * 13)).distortion == (0.1, 0, 0, 0, 0)
