"""Lenses of other models, restated: what a pixel looks at by the closed inverses of their papers, and by ours."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from support.composing import composed

from lmd.formats.calibrations import calibrated_camera, read_calibration
from lmd.geometry.central_models import restated
from lmd.geometry.lens import Lens
from pipelines.building import camera_of

EUROC = Path(__file__).parents[2] / ".." / "shared" / "real" / "calibration" / "basalt_euroc_ds.json"
SIZE = (640, 480)
NARROW = {"fx": 300.0, "fy": 298.0, "cx": 325.0, "cy": 236.0}
WIDE = {"fx": 150.0, "fy": 151.0, "cx": 318.0, "cy": 243.0}
TANGENTIAL = {"k1": -0.07, "k2": 0.18, "p1": 4e-4, "p2": -3e-4}


def ray_of_sphere(x, y, xi, alpha):
    """Usenko, Demmel and Cremers, equations 46 to 50."""
    s = x * x + y * y
    z = (1 - alpha**2 * s) / (alpha * np.sqrt(1 - (2 * alpha - 1) * s) + 1 - alpha)
    k = (z * xi + np.sqrt(z * z + (1 - xi * xi) * s)) / (z * z + s)
    return k * x, k * y, k * z - xi


def ray_of_extended(x, y, alpha, beta):
    """Khomutenko, Garcia and Martinet, equation 18."""
    s = beta * (x * x + y * y)
    return x, y, (1 - alpha**2 * s) / (alpha * np.sqrt(1 - (2 * alpha - 1) * s) + 1 - alpha)


def ray_of_unified(x, y, xi, **distortion):
    """Ray by equation 5 of Mei and Rives, after OpenCV has removed the distortion."""
    lens = np.array([distortion.get(name, 0.0) for name in ("k1", "k2", "p1", "p2")])
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 500, 1e-14)
    flat = cv2.undistortPoints(np.stack([x, y], axis=-1)[:, None], np.eye(3), lens, criteria=criteria)
    x, y = flat[:, 0].T
    s = x * x + y * y
    k = (xi + np.sqrt(1 + (1 - xi * xi) * s)) / (s + 1)
    return k * x, k * y, k - xi


CASES = {
    "ds": ("ds", ray_of_sphere, NARROW, {"xi": -0.24, "alpha": 0.57}),
    "ds, wide": ("ds", ray_of_sphere, WIDE, {"xi": -0.18, "alpha": 0.59}),
    "eucm": ("eucm", ray_of_extended, NARROW, {"alpha": 0.55, "beta": 1.1}),
    "eucm, wide": ("eucm", ray_of_extended, WIDE, {"alpha": 0.62, "beta": 1.05}),
    "omni": ("omni", ray_of_unified, {name: 2 * number for name, number in NARROW.items() if name[0] == "f"}
             | {"cx": 325.0, "cy": 236.0}, {"xi": 1.2}),
    "omni, distorted": ("omni", ray_of_unified, {"fx": 1015.0, "fy": 1014.0, "cx": 311.0, "cy": 243.0},
                        {"xi": 1.97, **TANGENTIAL}),
}  # fmt: skip


@pytest.fixture
def coarse(monkeypatch):
    """A lens is fitted to a sixteenth of the directions, where it matters only that it is the same or far off."""
    monkeypatch.setattr("lmd.geometry.central_models.ANGLES", 40)
    monkeypatch.setattr("lmd.geometry.central_models.AROUND", 36)


@pytest.mark.parametrize(("name", "ray", "pinhole", "own"), CASES.values(), ids=CASES)
def test_a_pixel_looks_where_the_inverse_of_the_model_says(name, ray, pinhole, own):
    lens = restated(name, pinhole | own, SIZE)
    pixels = np.stack(np.meshgrid(np.arange(0.0, SIZE[0], 8.0), np.arange(0.0, SIZE[1], 8.0)), axis=-1).reshape(-1, 2)
    x, y = ((pixels - [pinhole["cx"], pinhole["cy"]]) / [pinhole["fx"], pinhole["fy"]]).T
    with np.errstate(invalid="ignore"):
        rays = np.stack(ray(x, y, **own), axis=-1)
    seen = np.isfinite(rays).all(axis=1)
    assert seen.mean() > 0.8
    there = Lens(lens.model, lens.coefficients).project(rays[seen]) * lens.focal_pixels + lens.principal_point
    off = np.hypot(*(there - pixels[seen]).T)
    assert off.max() <= 1.5 * lens.worst + 1e-3  # corners may lie between the directions that were looked at
    assert lens.worst < (0.3 if "k1" in own else 0.03)


@pytest.mark.usefixtures("coarse")
def test_kalibr_vins_and_basalt_say_the_same_of_one_camera(write):
    own = {"xi": 1.97, **TANGENTIAL}
    pinhole = {"fx": 1015.0, "fy": 1014.0, "cx": 311.0, "cy": 243.0}
    kalibr = {"camera_model": "omni", "distortion_model": "radtan", "resolution": SIZE,
              "intrinsics": [own["xi"], *pinhole.values()], "distortion_coeffs": [*TANGENTIAL.values()]}  # fmt: skip
    vins = "%YAML:1.0\n---\nmodel_type: MEI\nimage_width: 640\nimage_height: 480\nmirror_parameters:\n   xi: 1.97\n"
    vins += "distortion_parameters:\n" + "".join(f"   {name}: {number}\n" for name, number in TANGENTIAL.items())
    vins += "projection_parameters:\n   gamma1: 1015.0\n   gamma2: 1014.0\n   u0: 311.0\n   v0: 243.0\n"
    one, other = read_calibration(write(json.dumps({"cam0": kalibr}))), read_calibration(write(vins))
    assert one == other
    said = r"its lens model omni is approximated by rational_polynomial, which is up to 0\.0[5-9] pixels off"
    assert re.search(said, one.camera().note)
    sphere = {"xi": -0.24, "alpha": 0.57}
    kalibr = {"camera_model": "ds", "distortion_model": "none", "resolution": SIZE,
              "intrinsics": [*sphere.values(), *NARROW.values()]}  # fmt: skip
    basalt = {"intrinsics": [{"camera_type": "ds", "intrinsics": NARROW | sphere}], "resolution": [SIZE]}
    one, other = (read_calibration(write(json.dumps(keys))) for keys in ({"cam0": kalibr}, {"value0": basalt}))
    assert one == other
    assert one.note == ""  # as near as pixels are measured


@pytest.mark.usefixtures("coarse")
def test_the_terminal_says_how_far_a_lens_is_off(write, capsys):
    own = {"model_type": "MEI", "image_width": 640, "image_height": 480, "mirror_parameters": {"xi": 1.97},
           "distortion_parameters": TANGENTIAL,
           "projection_parameters": {"gamma1": 1015.0, "gamma2": 1014.0, "u0": 311.0, "v0": 243.0}}  # fmt: skip
    path = write(yaml.safe_dump(own), "vins.yaml")
    camera_of(composed("optimise", "camera=calibration", f"camera.path='{path}'").camera)
    assert re.search(r"^note: .*vins\.yaml: its lens .* pixels off$", capsys.readouterr().err, re.MULTILINE)


def test_a_real_double_sphere_looks_where_another_calibration_of_the_camera_does():
    """EuRoC's left camera: Basalt's calibration, and that of its authors, by Kalibr's pinhole-radtan."""
    if not EUROC.exists():
        pytest.skip(f"{EUROC} is not here")
    camera = calibrated_camera(EUROC, "cam0")
    matrix = np.array([[458.654, 0.0, 367.215], [0.0, 457.296, 248.375], [0.0, 0.0, 1.0]])
    distortion = np.array([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05])
    pixels = np.stack(np.meshgrid(np.arange(40.0, 720.0, 40.0), np.arange(40.0, 460.0, 40.0)), axis=-1).reshape(-1, 2)
    theirs = np.pad(cv2.undistortPoints(pixels[:, None], matrix, distortion)[:, 0], ((0, 0), (0, 1)), constant_values=1)
    ours = camera.lens.directions((pixels + 0.5 - camera.principal_point) / camera.focal_pixels)
    cosines = (ours * theirs).sum(axis=1) / np.linalg.norm(theirs, axis=1)
    assert_allclose(np.degrees(np.arccos(cosines)), 0.0, atol=0.5)
