"""Calibrations by programs of reconstruction and calibration, against the formulas of their sources."""

import json

import numpy as np
import pytest
from camera_samples import ARRAYS, LENS, MATLAB, METASHAPE, NERF, REPORT
from numpy.testing import assert_allclose
from rays import RAYS, by_opencv, images, radial
from scipy.io import loadmat

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera, read_calibration
from lmd.formats.extrinsics import read_chain
from lmd.formats.rigs import rig_of


def test_matlab_counts_from_one(write):
    """`stereoParametersToOpenCV`: rows of points are multiplied from the right."""
    assert read_calibration(write(json.dumps(MATLAB))).principal_point == (320.0, 240.0)
    upright = {key: value for key, value in MATLAB.items() if key != "IntrinsicMatrix"} | {
        "K": np.transpose(MATLAB["IntrinsicMatrix"]).tolist()
    }
    assert read_calibration(write(json.dumps(upright))) == read_calibration(write(json.dumps(MATLAB)))
    turn, shift = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [-100.0, 2.0, 3.0]
    pair = {"CameraParameters1": MATLAB, "CameraParameters2": MATLAB}
    path = write(json.dumps({"stereo": pair | {"RotationOfCamera2": turn, "TranslationOfCamera2": shift}}))
    point = np.array([0.2, -0.1, 1.5])
    second = point @ turn + np.array(shift) / 1000.0
    assert_allclose((read_chain(path)["cam2"] @ [*second, 1.0])[:3], point, atol=1e-12)


def test_the_arrays_are_those_of_scipy(tmp_path):
    path = tmp_path / "Calib_Results.mat"
    path.write_bytes(ARRAYS["caltech"])
    theirs, ours = loadmat(path), read_calibration(path)
    assert_allclose(ours.focal_pixels, theirs["fc"].ravel())
    assert_allclose(ours.principal_point, theirs["cc"].ravel())


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"\x80\x04\x95", r"is a pickle of Python, which may run code: write it by numpy.savez"),
        (b"\x93NUMPY\x01", r"is a single array of NumPy, without the other half"),
        (b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n", r"is a file of MATLAB's version 7.3: save"),
        (b"PK\x03\x04nothing", r"cannot be read as arrays"),
    ],
)
def test_arrays_that_are_not_read_are_named_with_a_way(head, words, tmp_path):
    path = tmp_path / "camera.npz"
    path.write_bytes(head)
    with pytest.raises(InputError, match=words):
        read_calibration(path)


def test_objects_of_python_are_not_loaded(tmp_path):
    path = tmp_path / "camera.npz"
    np.savez(path, mtx=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="holds only objects of Python or large arrays"):
        read_calibration(path)
    np.savez(
        path,
        camMatrix=np.diag([600.0, 600.0, 1.0]),
        distCoef=np.zeros((1, 5)),
        rvecs=np.array([{"a": 1}], dtype=object),
    )
    with pytest.raises(InputError, match="image_size must be given"):
        read_calibration(path)


def test_metashape_with_more_terms_is_fitted(write):
    """Frame cameras of Metashape's manual: P1 and P2 are swapped, and B2 is a skew."""
    text = METASHAPE.replace("<k3>", "<b2>0.4</b2><k4>0.02</k4><k3>")
    camera = calibrated_camera(write(text, "camera.xml"))
    x, y, s, f = radial(RAYS, -0.2, 0.05, 0.01)
    f += 0.02 * s**4
    u = x * f + -0.002 * (s + 2 * x * x) + 2 * 0.001 * x * y
    v = y * f + 0.001 * (s + 2 * y * y) + 2 * -0.002 * x * y
    there = np.stack([320 + 0.5 + 610 * u - 10 * u + 0.4 * v, 240 + 0.5 + 610 * v], axis=1) - 0.5
    assert_allclose(images(camera), there, atol=0.15)


def test_sensors_of_metashape_have_names(write):
    sensors = "".join(
        f'<sensor id="{i}"><calibration class="initial" type="frame"><resolution width="640" height="480"/><f>{f}</f>'
        "</calibration></sensor>"
        for i, f in enumerate((600, 700))
    )
    path = write(f"<document><chunk><sensors>{sensors}</sensors></chunk></document>", "cameras.xml")
    assert read_calibration(path, "sensor1").focal_pixels == (700.0, 700.0)
    assert read_calibration(path, "sensor1").principal_point == (319.5, 239.5)


def test_fields_of_view_of_nerf_are_focal_lengths(write):
    angle = 2 * np.arctan(320 / 600)
    found = read_calibration(write(json.dumps({"camera_angle_x": angle, "w": 640, "h": 480, "frames": []})))
    assert_allclose(found.focal_pixels, 600.0)
    assert found.principal_point == (319.5, 239.5)
    radial_4 = NERF | {"k4": 0.05}
    x, y, s, f = radial(RAYS, NERF["k1"], NERF["k2"], NERF["k3"])
    f += 0.05 * s**4
    u = x * f + 2 * NERF["p1"] * x * y + NERF["p2"] * (s + 2 * x * x)
    v = y * f + 2 * NERF["p2"] * x * y + NERF["p1"] * (s + 2 * y * y)
    there = np.stack([600 * u + 320, 610 * v + 240], axis=1)
    assert_allclose(images(calibrated_camera(write(json.dumps(radial_4)))), there, atol=0.1)
    frames = [
        {"file_path": "a", "fl_x": 600.0, "w": 640, "h": 480},
        {"file_path": "b", "fl_x": 700.0, "w": 640, "h": 480},
    ]
    assert read_calibration(write(json.dumps({"frames": frames})), "cam1").focal_pixels == (700.0, 700.0)


def test_open3d_writes_matrices_by_columns(write):
    intrinsic = {"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 610, 0, 320, 240, 1]}
    found = read_calibration(write(json.dumps(intrinsic)))
    assert (found.focal_pixels, found.principal_point) == ((600.0, 610.0), (320.0, 240.0))
    part = {"class_name": "PinholeCameraParameters", "extrinsic": [0] * 16, "intrinsic": intrinsic}
    path = write(json.dumps({"class_name": "PinholeCameraTrajectory", "parameters": [part, part]}))
    assert read_calibration(path) == found


def test_a_report_of_kalibr_is_a_rig(write):
    """q of the baseline from cam0 to cam1 is JPL's: its matrix is the transpose of Hamilton's."""
    second = REPORT[REPORT.index("cam0 (") :].replace("cam0", "cam1")
    half = np.sqrt(0.5)
    baseline = (
        f"baseline T_1_0:\n    q: [0. 0. {half} {half}] +- [0.1 0.1 0.1]\n    t: [-0.1  0.02 0.003] +- [0.1 0.1 0.1]\n"
    )
    path = write(REPORT + second + baseline, "results-cam.txt")
    camera = calibrated_camera(path, "cam1", [640, 480])
    assert_allclose(images(camera), by_opencv([[600, 0, 320], [0, 610, 240], [0, 0, 1]], LENS[:4]), atol=1e-9)
    poses = read_chain(path, image_size=[640, 480])
    there = [2.0 - 0.1, -1.0 + 0.02, 3.0 + 0.003]  # of (1, 2, 3): a quarter turn clockwise
    assert_allclose((np.linalg.inv(poses["cam1"]) @ [1.0, 2.0, 3.0, 1.0])[:3], there, atol=1e-9)
    assert len(rig_of({"path": path, "image_size": [640, 480]}).mounts) == 2
