"""Calibrations that devices are shipped with, against the formulas of their sources."""

import json

import cv2
import numpy as np
import pytest
from camera_samples import FTC, KINECT_CAMERA, KINECT_LENS, LENS, OAK, OAK_EXTRINSICS, REALSENSE, SIZES
from format_samples import SAMPLES, content
from numpy.testing import assert_allclose
from rays import RAYS, by_opencv, images, radial

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera, read_calibration
from lmd.formats.extrinsics import read_chain
from lmd.formats.rigs import rig_of

SAME = [  # samples of one camera: fx 600, fy 610, and the centre of the first pixel at (0, 0)
    *("FTC", "Metashape", "rs-enumerate-devices", "realsense", "matlab", "nerfstudio"),
    *("visual marker mapping", "numpy", "caltech", "mat"),
]
INVERSE = {"model": "distortion.inverse_brown_conrady", "coeffs": [-0.055, 0.06, 4e-4, -3e-4, -0.02]}
EXTRINSIC = 'Extrinsic from "{}"\t  To\t  "{}" :\n Rotation Matrix:\n{}\n\n Translation Vector: {}\n'
STREAM = {"width": 640, "height": 480, "fx": 385.0, "fy": 386.0, "ppx": 321.0, "ppy": 244.0}


@pytest.mark.parametrize("name", SAME)
def test_all_write_one_camera(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(content(SAMPLES["calibration"][name]))
    camera = calibrated_camera(path, image_size=SIZES.get(name))
    matrix = [[600, 0, 320], [0, 610, 240], [0, 0, 1]]
    assert_allclose(images(camera), by_opencv(matrix, LENS), atol=1e-9)
    assert (camera.image_width, camera.image_height) == (640, 480)


def test_a_webcam_of_ftc_is_chosen_by_its_size(write):
    other = '<Calibration size="1280, 720" focalLength="900f 901f" '
    other += 'principal_point="1 2" distortion_coefficients="0 0 0 0"/>'
    path = write(FTC.replace("</Camera>", f"{other}</Camera>"))
    assert read_calibration(path, image_size=[1280, 720]).focal_pixels == (900.0, 901.0)
    assert read_calibration(path, "Logitech:0x0825", [640, 480]).focal_pixels == (600.0, 610.0)
    assert read_calibration(path, "Logitech:0x0825/640x480").focal_pixels == (600.0, 610.0)
    with pytest.raises(InputError, match="has the cameras Logitech:0x0825/640x480, Logitech:0x0825/1280x720"):
        read_calibration(path)
    with pytest.raises(InputError, match="name = 'Logitech:0x0826' is no camera"):
        read_calibration(path, "Logitech:0x0826", [640, 480])


def test_an_oak_images_by_opencv_s_rational_model(write):
    camera = calibrated_camera(write(json.dumps({"cameraData": [[0, OAK]]})))
    assert_allclose(images(camera), by_opencv(OAK["intrinsicMatrix"], OAK["distortionCoeff"]), atol=1e-9)
    fisheye = OAK | {"cameraType": 1, "distortionCoeff": [0.1, -0.02, 0.003, -0.001, *[0.0] * 10]}
    camera = calibrated_camera(write(json.dumps({"cameraData": [[0, fisheye]]})))
    there = cv2.fisheye.projectPoints(
        RAYS[:, None], np.zeros(3), np.zeros(3), np.array(OAK["intrinsicMatrix"]), np.array([0.1, -0.02, 0.003, -0.001])
    )[0][:, 0]
    assert_allclose(images(camera), there, atol=1e-9)


def test_a_pole_in_the_image_of_an_oak_is_noted(write):
    """1 + k4 s = 0 at s = 0.25."""
    lens = [-4.0, 0.0, 0.0, 0.0, 0.0, -4.0, 0.0, 0.0, *[0.0] * 6]
    camera = calibrated_camera(write(json.dumps({"cameraData": [[0, OAK | {"distortionCoeff": lens}]]})))
    assert "has a pole at 27 degrees from the axis, and shows nothing beyond" in camera.note
    assert calibrated_camera(write(json.dumps({"cameraData": [[0, OAK]]}))).note == ""


def test_an_oak_is_a_rig_in_metres(write):
    """Socket 1 refers to 0, and 2 to 1: points go to the next camera, in centimetres."""
    chained = OAK | {"extrinsics": OAK_EXTRINSICS | {"toCameraSocket": 1}}
    data = [[0, OAK], [1, OAK | {"extrinsics": OAK_EXTRINSICS}], [2, chained], [3, OAK | {"intrinsicMatrix": []}]]
    path = write(json.dumps({"cameraData": data}))
    point = np.array([0.3, 0.1, 2.0])
    for _ in range(2):  # from socket 2 to 1 to 0
        point = np.array([-point[1] - 0.075, point[0], point[2] + 0.01])
    poses = read_chain(path)
    assert list(poses) == ["CAM_A", "CAM_B", "CAM_C"]
    assert_allclose((poses["CAM_C"] @ [0.3, 0.1, 2.0, 1.0])[:3], point, atol=1e-12)
    rig = rig_of({"path": path})
    assert_allclose(rig.extrinsics[2], rig.extrinsics[0] @ poses["CAM_C"], atol=1e-12)
    assert list(read_chain(path, ["CAM_C", "CAM_A"])) == ["CAM_C", "CAM_A"]
    with pytest.raises(InputError, match="has no camera 'CAM_D', only CAM_A, CAM_B, CAM_C"):
        read_chain(path, ["CAM_D"])
    alone = OAK | {"extrinsics": {"rotationMatrix": [], "toCameraSocket": -1}}
    with pytest.raises(InputError, match="does not say how CAM_A, CAM_B sit to each other"):
        read_chain(write(json.dumps({"cameraData": [[0, OAK], [1, alone]]})))


def test_the_modes_of_an_azure_kinect(write):
    """Pixels of a unit interval from the border; of 1280 x 720 the first row is 120 below that of 1280 x 960."""
    path = write(json.dumps({"CalibrationInformation": {"Cameras": [KINECT_CAMERA]}}))
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = KINECT_LENS
    matrix = [[fx * 1280, 0, cx * 1280 - 0.5], [0, fy * 960, cy * 960 - 120 - 0.5], [0, 0, 1]]
    camera = calibrated_camera(path, "color", [1280, 720])
    assert_allclose(images(camera), by_opencv(matrix, [k1, k2, p1, p2, k3, k4, k5, k6]), atol=1e-9)
    depth = KINECT_CAMERA | {"Location": "CALIBRATION_CameraLocationD0", "SensorWidth": 1024, "SensorHeight": 1024}
    path = write(json.dumps({"CalibrationInformation": {"Cameras": [depth | {"MetricRadius": 1.1}]}}))
    camera = calibrated_camera(path, "depth/640x576")
    matrix = [[fx * 1024, 0, cx * 1024 - 192.5], [0, fy * 1024, cy * 1024 - 180.5], [0, 0, 1]]
    assert_allclose(images(camera), by_opencv(matrix, [k1, k2, p1, p2, k3, k4, k5, k6]), atol=1e-9)
    s = 1.21
    r = 1.1 * (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
    camera = calibrated_camera(path, "depth/1024x1024")
    assert camera.image_circle == pytest.approx(2 * fy * 1024 * r)
    assert np.tan(camera.widest_angle) == pytest.approx(1.1, abs=0.05)
    assert calibrated_camera(path, "depth/1024x1024", image_circle=700.0).image_circle == 700.0


def test_a_kinect_with_a_centre_of_distortion_of_its_own_is_fitted(write):
    """Rational6KT, by the formula of `transformation_project_internal`: no factor 2 of x y."""
    lens = [*KINECT_LENS[:10], 2e-3, -1e-3, *KINECT_LENS[12:]]
    intrinsics = {"ModelParameters": lens, "ModelType": "CALIBRATION_LensDistortionModelRational6KT"}
    camera = KINECT_CAMERA | {"Intrinsics": intrinsics}
    camera = calibrated_camera(write(json.dumps({"CalibrationInformation": {"Cameras": [camera]}})), "color/2048x1536")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = lens
    x, y = RAYS[:, 0] - codx, RAYS[:, 1] - cody
    s = x * x + y * y
    d = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
    u = x * d + (s + 2 * x * x) * p2 + x * y * p1 + codx
    v = y * d + (s + 2 * y * y) * p1 + x * y * p2 + cody
    there = np.stack([u * fx * 2048 + cx * 2048 - 0.5, v * fy * 1536 + cy * 1536 - 0.5], axis=1)
    assert_allclose(images(camera), there, atol=0.3)


def test_streams_of_a_realsense_are_a_rig(write):
    """The printed rotation is row by row, and takes points from one stream to the other."""
    depth = REALSENSE[REALSENSE.index(" Intrinsic") :].replace('"Color" / 640x480', '"Depth" / 1280x720')
    depth = (
        depth.replace("640", "1280")
        .replace("480", "720")
        .replace("\t-0.2  \t0.05  \t0.001  \t-0.002  \t0.01", "0 0 0 0 0")
    )
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    printed = "\n".join("  ".join(f"{number:.6f}" for number in row) for row in turn)
    extrinsic = EXTRINSIC.format("Depth", "Color", printed, "0.015  0  1e-3")
    back = EXTRINSIC.format("Color", "Depth", "0 1 0\n-1 0 0\n0 0 1", "0  0.015  -1e-3")
    path = write(REALSENSE + depth + extrinsic + back, "cameras.txt")
    assert read_calibration(path, "Depth").distortion == ()
    assert read_calibration(path, image_size=[640, 480]).distortion == tuple(LENS)
    poses = read_chain(path, ["Color/640x480", "Depth/1280x720"])
    twice = write(REALSENSE + depth + depth.replace("640", "641") + REALSENSE.replace("600", "601"), "twice.txt")
    with pytest.raises(InputError, match=r"names must be given, as \[A, B\]: .*twice.txt has Color/640x480, Depth"):
        read_chain(twice)
    assert read_calibration(twice, "Color/640x480/2").focal_pixels == (601.0, 610.0)
    assert_allclose(
        (poses["Depth/1280x720"] @ [1.0, 2.0, 3.0, 1.0])[:3], turn @ [1, 2, 3] + [0.015, 0, 1e-3], atol=1e-12
    )


def test_the_inverse_model_of_a_realsense_needs_a_word(write):
    path = write(json.dumps(STREAM | INVERSE))
    matrix = [[385, 0, 321], [0, 386, 244], [0, 0, 1]]
    with pytest.raises(InputError, match=r"^distortion_model must be given: .* undistorting .* distorting") as error:
        calibrated_camera(path)
    assert error.value.argument == "distortion_model"
    k1, k2, p1, p2, k3 = INVERSE["coeffs"]
    camera = calibrated_camera(path, distortion_model="plumb_bob")
    assert_allclose(images(camera), by_opencv(matrix, INVERSE["coeffs"]), atol=1e-9)
    camera = calibrated_camera(path, distortion_model="inverse_brown_conrady")
    x, y, s, f = radial(RAYS, k1, k2, k3)  # RAYS as images: their points by the polynomial
    points = np.stack([x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * f + 2 * p2 * x * y + p1 * (s + 2 * y * y)], 1)
    there = RAYS[:, :2] * [385, 386] + [321, 244]
    assert_allclose(images(camera, np.column_stack([points, np.ones(4)])), there, atol=0.1)
    zero = write(json.dumps(STREAM | INVERSE | {"coeffs": [0.0] * 5}))
    assert read_calibration(zero).distortion == ()


def test_the_modified_model_of_a_realsense_is_fitted(write):
    camera = calibrated_camera(write(json.dumps(STREAM | INVERSE | {"model": 1})))
    k1, k2, p1, p2, k3 = INVERSE["coeffs"]
    x, y, s, f = radial(RAYS, k1, k2, k3)
    x, y = x * f, y * f
    there = np.stack([x + 2 * p1 * x * y + p2 * (s + 2 * x * x), y + 2 * p2 * x * y + p1 * (s + 2 * y * y)], 1)
    assert_allclose(images(camera), there * [385, 386] + [321, 244], atol=0.05)
