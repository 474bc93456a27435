"""Calibrations whose lens model is said by their kind or asked for, and those of other programs, named."""

import json

import cv2
import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera, read_calibration
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.projection import project

K = [[290.0, 0.0, 320.0], [0.0, 292.0, 240.0], [0.0, 0.0, 1.0]]
D = [[-0.02], [0.01], [-0.015], [0.004]]  # a column, as cv2.fisheye.calibrate writes it
FISHEYE = {"DIM": [640, 480], "K": K, "D": D}


def test_the_recipe_for_cv2_fisheye_is_a_fisheye(write):
    """`DIM`, `K` and `D` are what it prints."""
    camera = calibrated_camera(write(json.dumps(FISHEYE)))
    angle = np.radians(40.0)
    rays = np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.3, -0.2, 1.0]])
    there = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), np.array(K), np.array(D))[0][:, 0]
    np.testing.assert_allclose(project(camera, np.eye(4), rays), there + PIXEL_CENTRE, atol=1e-9)
    # The angle itself times the focal length, but for the small coefficients.
    t = angle * (1 - 0.02 * angle**2 + 0.01 * angle**4 - 0.015 * angle**6 + 0.004 * angle**8)
    assert there[0, 0] == pytest.approx(320 + 290 * t)
    assert read_calibration(write(json.dumps(FISHEYE | {"D": [[0.1, 0.01, 0.0, 0.0, 0.0]]}))).distortion_model == (
        "plumb_bob"  # which five coefficients are
    )


def without_size(keys):
    return {key: value for key, value in keys.items() if key != "DIM"} | {"image_size": [640, 480]}


UNCLEAR = {
    "a column": without_size(FISHEYE),
    "a row": without_size(FISHEYE | {"D": [[row[0] for row in D]]}),
    "a list": without_size(FISHEYE | {"D": [row[0] for row in D]}),
    "a message": {"width": 640, "height": 480, "K": K, "D": [row[0] for row in D]},
    "a driver that leaves it empty": {
        "width": 640,
        "height": 480,
        "K": K,
        "D": [row[0] for row in D],
        "distortion_model": "",
    },
    "a script": {"intrinsics": K, "dist_coeffs": D, "image_width": 640, "image_height": 480},
    "ROS without a model": {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": {"data": np.ravel(K).tolist()},
        "distortion_coefficients": {"data": [row[0] for row in D]},
    },
    "a pinhole of whatever lens": without_size(FISHEYE) | {"camera_model": "pinhole"},
}


@pytest.mark.parametrize("kind", UNCLEAR)
def test_four_coefficients_without_a_model_are_asked_about(kind, write):
    path = write(json.dumps(UNCLEAR[kind]), "camera.json")
    message = r"^distortion_model must be given: .*camera\.json names no model, and its 4 coefficients may be those of"
    with pytest.raises(InputError, match=message):
        read_calibration(path)
    for model, found in (("fisheye", "equidistant"), ("plumb_bob", "plumb_bob")):
        assert read_calibration(path, distortion_model=model).distortion_model == found


@pytest.mark.parametrize(
    ("said", "model"),
    [
        ({"fisheye": False}, "plumb_bob"),
        ({"model": "radtan"}, "plumb_bob"),
        ({"distortion_type": "equidistant"}, "equidistant"),
        ({"fisheye": "true"}, "equidistant"),
        ({"D": [0.0] * 4}, "plumb_bob"),  # nothing distorts
    ],
)
def test_what_a_script_says_of_the_model_is_taken(said, model, write):
    assert read_calibration(write(json.dumps(without_size(FISHEYE) | said))).distortion_model == model


def test_xml_may_say_the_model_in_words(write):
    text = f"""<?xml version="1.0"?><opencv_storage><image_size>640 480</image_size><model>"fisheye"</model>
    <camera_matrix type_id="opencv-matrix"><data>{" ".join(str(v) for v in np.ravel(K))}</data></camera_matrix>
    <D type_id="opencv-matrix"><data>-0.02 0.01 -0.015 0.004</data></D></opencv_storage>"""
    found = read_calibration(write(text))
    assert (found.image_width, found.image_height, found.distortion_model) == (640, 480, "equidistant")


PHOTONVISION = {
    "resolution": {"width": 640.0, "height": 480.0},
    "cameraIntrinsics": {"rows": 3, "cols": 3, "data": np.ravel(K).tolist()},
    "distCoeffs": {"rows": 1, "cols": 5, "data": [0.1, 0.0, 0.0, 0.0, 0.0]},
    "lensmodel": "LENSMODEL_OPENCV",
}


def test_lines_of_a_json_file_may_be_broken_anywhere(write):
    plain, pretty = (read_calibration(write(json.dumps(PHOTONVISION, indent=n))) for n in (None, 2))
    assert plain == pretty
    assert plain.focal_pixels == (290.0, 292.0)


def test_the_first_of_several_messages_of_ros_is_read(write):
    one = "header:\n  frame_id: cam\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\n"
    one += f"d: [0.1, 0, 0, 0, 0]\nk: {np.ravel(K).tolist()}\n---\n"
    assert read_calibration(write(one * 3)) == read_calibration(write(one))
