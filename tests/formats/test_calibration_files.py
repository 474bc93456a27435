import json
import re
from pathlib import Path

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.core.files import LARGEST_YAML
from lmd.formats.calibrations import calibrated_camera, read_calibration

REAL = Path(__file__).parents[2] / ".." / "shared" / "real" / "calibration"
MATRIX = [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0]
LENS = [-0.2, 0.05, 0.001, -0.002, 0.01]
NAMES = dict(zip(["fx", "fy", "cx", "cy"], [600.0, 610.0, 320.0, 240.0], strict=True))
BASALT = {
    "camera_type": "pinhole-radtan8",
    "intrinsics": NAMES | dict(zip(["k1", "k2", "p1", "p2", "k3"], LENS, strict=True)),
}
MRCAL = "{{ 'lensmodel': 'LENSMODEL_{}',\n 'intrinsics': [600, 610, 320, 240, {},],\n 'imagersize': [640, 480] }}"
XML = """<?xml version="1.0"?>
<opencv_storage><image_width>640</image_width><image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>600. 0. 320. 0. 610. 240. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><data>-0.2 0.05 1e-3 -2e-3 0.01</data></distortion_coefficients>
</opencv_storage>"""
SCRIPT = {
    "camera_matrix": [MATRIX[:3], MATRIX[3:6], MATRIX[6:]],
    "distortion_coefficients": LENS,
    "avg_reprojection_error": 0.2,
}
FILES = {
    "OpenCV XML": XML,
    "OpenCV 2": XML.replace("camera_matrix", "Camera_Matrix")
    .replace("distortion_c", "Distortion_C")
    .replace("_w", "_W"),
    "script of OpenCV": json.dumps({"mtx": SCRIPT["camera_matrix"], "dist": [LENS], "img_size": [640, 480]}),
    "ros topic echo": "width: 640\nheight: 480\ndistortion_model: plumb_bob\n" + f"d: {LENS}\nk: {MATRIX}\n---\n",
    "EuRoC": "%YAML:1.0\nT_BS:\n  data: [1.0]\ncamera_model: pinhole\ndistortion_model: radial-tangential\n"
    f"resolution: [640, 480]\nintrinsics: {list(NAMES.values())}\ndistortion_coefficients: {LENS}\n",
    "OKVIS": "cameras:\n  - {T_SC: [1.0], image_dimension: [640, 480], distortion_type: radialtangential,\n"
    f"     distortion_coefficients: {LENS}, focal_length: [600, 610],\n"
    "     principal_point: [320, 240]}\ncamera_params: {}\n",
    "VINS": "%YAML:1.0\n---\nmodel_type: PINHOLE\nimage_width:640\nimage_height: 480\ndistortion_parameters:\n"
    "   k1: -0.2\n   k2: 0.05\n   p1: 0.001\n   p2: -0.002\n   k3: 0.01\n"
    "projection_parameters:\n   fx:600.0\n   fy: 610.0\n   cx: 320.0\n   cy: 240.0\n",
    "message": json.dumps({"width": 640, "height": 480, "K": MATRIX, "D": LENS}),
    "another script": json.dumps(
        {
            "model": "Raspberry Pi 3 wide",
            "image_size": [640, 480],
            "fisheye": False,
            "camera_matrix": SCRIPT["camera_matrix"],
            "distortion_coeffs": LENS,
        }
    ),
    "message of ROS 2": json.dumps({"width": 640, "height": 480, "k": MATRIX, "d": [*LENS, 0.0, 0.0, 0.0]}),
    "PhotonVision": json.dumps(
        {
            "resolution": {"width": 640.0, "height": 480.0},
            "cameraIntrinsics": {"rows": 3, "cols": 3, "data": MATRIX},
            "distCoeffs": {"rows": 1, "cols": 5, "data": LENS},
        }
    ),
    "COLMAP": "# cameras\n1 FULL_OPENCV 640 480 600 610 320.5 240.5 -0.2 0.05 0.001 -0.002 0.01 0 0 0\n",
    "Basalt": json.dumps({"value0": {"intrinsics": [BASALT], "resolution": [[640, 480]]}}),
    "ORB-SLAM3": '%YAML:1.0\nCamera.type: "PinHole"\nCamera1.fx: 600.0\nCamera1.fy: 610.0\nCamera1.cx: 320.0\n'
    "Camera1.cy: 240.0\nCamera1.k1: -0.2\nCamera1.k2: 0.05\nCamera1.p1: 0.001\nCamera1.p2: -0.002\nCamera1.k3: 0.01\n"
    "Camera.width: 640\nCamera.height: 480\n",
    "OpenVSLAM": 'Camera.model: "perspective"\nCamera.fx: 600.0\nCamera.fy: 610.0\nCamera.cx: 320.0\nCamera.cy: 240.0\n'
    "Camera.k1: -0.2\nCamera.k2: 0.05\nCamera.p1: 0.001\nCamera.p2: -0.002\nCamera.k3: 0.01\n"
    "Camera.cols: 640\nCamera.rows: 480\n",
    "stella_vslam": "Camera:\n  {model: perspective, fx: 600.0, fy: 610.0, cx: 320.0, cy: 240.0, k1: -0.2, k2: 0.05,\n"
    "   p1: 0.001, p2: -0.002, k3: 0.01, cols: 640, rows: 480}\nMapping: {backend: g2o}\n",
    "mrcal": MRCAL.format("OPENCV5", "-0.2, 0.05, 0.001, -0.002, 0.01"),
    "frc971": json.dumps({"intrinsics": MATRIX, "dist_coeffs": LENS, "image_width": 640, "image_height": 480}),
}
FILES["OKVIS2"] = FILES["OKVIS"].replace("camera_params", "camera_parameters")


@pytest.mark.parametrize("kind", FILES)
def test_every_format_says_the_same_of_one_camera(kind, write):
    found = read_calibration(write(FILES[kind]))
    assert (found.image_width, found.image_height) == (640, 480)
    np.testing.assert_allclose(found.focal_pixels, (600.0, 610.0))
    np.testing.assert_allclose(found.principal_point, (320.0, 240.0))
    np.testing.assert_allclose(found.distortion, LENS)


RATIONAL = [*LENS, 0.3, -0.1, 0.02]
FISHEYE = [0.01, -0.02, 0.005, -0.001]


def colmap(model, lens):
    return f"1 {model} 640 480 600 610 320.5 240.5 {' '.join(map(str, lens))}\n"


def basalt(kind, names, lens):
    keys = {"camera_type": kind, "intrinsics": NAMES | dict(zip(names.split(), lens, strict=True))}
    return json.dumps({"value0": {"intrinsics": [keys], "resolution": [[640, 480]]}})


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        (FILES["message"].replace(str(LENS), str(RATIONAL)), RATIONAL),
        (FILES["PhotonVision"].replace(str(LENS), str(RATIONAL)), RATIONAL),
        (colmap("FULL_OPENCV", [*LENS[:4], *RATIONAL[4:]]), RATIONAL),
        (basalt("pinhole-radtan8", "k1 k2 p1 p2 k3 k4 k5 k6", RATIONAL), RATIONAL),
        (MRCAL.format("OPENCV8", str(RATIONAL)[1:-1]), RATIONAL),
        (MRCAL.format("OPENCV12", str([*RATIONAL, *FISHEYE])[1:-1]), [*RATIONAL, *FISHEYE]),
        (colmap("OPENCV_FISHEYE", FISHEYE), FISHEYE),
        (colmap("RADIAL_FISHEYE", FISHEYE[:2]).replace("600 610", "600"), [*FISHEYE[:2], 0.0, 0.0]),
        (basalt("kb4", "k1 k2 k3 k4", FISHEYE), FISHEYE),
        (
            '%YAML:1.0\nCamera.type: "KannalaBrandt8"\nCamera1.fx: 600.0\nCamera1.fy: 610.0\nCamera1.cx: 320.0\n'
            "Camera1.cy: 240.0\nCamera1.k1: 0.01\nCamera1.k2: -0.02\nCamera1.k3: 0.005\nCamera1.k4: -0.001\n"
            "Camera.width: 640\nCamera.height: 480\n",
            FISHEYE,
        ),
        (
            "Camera: {model: fisheye, fx: 600.0, fy: 610.0, cx: 320.0, cy: 240.0, k1: 0.01, k2: -0.02, k3: 0.005,"
            " k4: -0.001, cols: 640, rows: 480}\n",
            FISHEYE,
        ),
        (
            "model_type: KANNALA_BRANDT\nimage_width: 640\nimage_height: 480\nprojection_parameters:\n"
            "  {k2: 0.01, k3: -0.02, k4: 0.005, k5: -0.001, mu: 600.0, mv: 610.0, u0: 320.0, v0: 240.0}\n",
            FISHEYE,
        ),
    ],
)
def test_rational_lenses_and_fisheyes_are_taken_as_they_are(text, lens, write):
    found = read_calibration(write(text))
    assert (found.distortion_model == "equidistant") == (len(lens) == 4)
    assert found.distortion == tuple(lens)
    np.testing.assert_allclose(found.principal_point, (320.0, 240.0))


@pytest.mark.parametrize(
    "said",
    [
        {"model": "Fisheye"},
        {"camera_model": "equidistant"},
        {"fisheye": True},
        {"fisheye_model": 1},
        {"distortion_model": "kannala_brandt"},
    ],
)
def test_a_script_may_say_in_words_of_its_own_that_it_is_a_fisheye(said, write):
    keys = {"camera_matrix": SCRIPT["camera_matrix"], "D": FISHEYE, "image_size": [640, 480]}
    found = read_calibration(write(json.dumps(keys | said)))
    assert (found.distortion_model, found.distortion) == ("equidistant", tuple(FISHEYE))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "an XML file with a document type or entities is not taken."),
        ("<a><b>", "it cannot be read as XML"),
        (FILES["Basalt"].replace("pinhole-radtan8", "fov"), "the lens model 'fov' is not known here"),
        (FILES["Basalt"].replace("pinhole-radtan8", "ds"), "the key or value 'xi' is missing or wrong"),
        (FILES["COLMAP"].replace("FULL_OPENCV", "FOV"), "the lens model 'FOV' is not known here"),
        (FILES["ORB-SLAM3"].replace("PinHole", "Stereo"), "the lens model 'Stereo' is not known here"),
        (
            FILES["OpenVSLAM"].replace("perspective", "radial_division"),
            "the lens model 'radial_division' is not known here",
        ),
        (FILES["another script"].replace("Raspberry Pi 3 wide", "MEI"), "the lens model 'mei' is not known here"),
        (FILES["VINS"].replace("PINHOLE", "SCARAMUZZA"), "the lens model 'SCARAMUZZA' is not known here"),
        ("cams: [{a: 1}]\n", "it is no calibration that is known here, it has cams: write it as ROS does, with"),
        (f"{{'lensmodel': {'0' * (1 << 20)}}}", "a cameramodel has at most 1048576 characters"),
        (MRCAL.format("CAHVOR", "1"), "the lens model 'CAHVOR' is not known here"),
        (MRCAL.format("OPENCV4", "1"), "intrinsics must be a list of 8 numbers"),
        ("{'lensmodel': __import__('os')}", "it is no cameramodel of mrcal (malformed node or string on line 1)."),
        (FILES["frc971"].replace("image_width", "w"), "image_width or image_height is missing: give image_size, [wi"),
        (FILES["Basalt"].replace('"fx"', '"f"'), "the key or value 'fx' is missing or wrong"),
        ("1 OPENCV 640 480 600 610\n", "the key or value"),
    ],
)
def test_what_is_wrong_is_one_sentence(text, message, write):
    with pytest.raises(InputError, match=re.escape(f": {message}")):
        read_calibration(write(text))


OUTCOMES = {
    "basalt_euroc_ds.json": None,
    "basalt_t265_kb4.json": None,
    "colmap_maupertuis_cameras.txt": None,
    "frc971_calibration_2024.json": "give image_size",
    "isaac_ros_camera_info.json": None,
    "kalibr_tumvi_equidistant_512.yaml": None,
    "mrcal_cam0_opencv8.cameramodel": None,
    "mrcal_cam0_splined.cameramodel": "the lens model 'SPLINED",
    "opencv_left_intrinsics.yml": None,
    "opencv_tutorial_camera_charuco.yml": None,
    "ros_clover_fisheye_plumb_bob_14coeff.yaml": None,
    "ros_clover_ov7251_rational.yaml": None,
    "ros_image_common_test.yaml": None,
    "ros_isaac_narrow_stereo.yaml": None,
    "ros_tello_960x720.yaml": None,
    "ros_zed_right.yaml": None,
}
PAIRS = ("basalt_euroc_ds.json", "basalt_t265_kb4.json", "kalibr_tumvi_equidistant_512.yaml")


@pytest.mark.parametrize("name", OUTCOMES)
def test_a_real_file_is_read_or_refused_for_its_lens(name):
    if not (path := REAL / name).exists():
        pytest.skip(f"{path} is not here")
    camera = "cam1" if name in PAIRS else None
    if (message := OUTCOMES[name]) is None:
        calibrated_camera(path, camera)
    else:
        with pytest.raises(InputError, match=message):
            calibrated_camera(path, camera)


def test_settings_of_rectified_images_have_no_distortion(write):
    for kind in ('Camera.type: "Rectified"\n', ""):  # ORB-SLAM2 names no type
        keys = "".join(f"Camera.{name}:{value}\n" for name, value in NAMES.items())
        found = read_calibration(write(f"%YAML:1.0\n{kind}{keys}"), image_size=[640, 480])
        assert (found.distortion, found.focal_pixels) == ((), (600.0, 610.0))


def test_a_file_may_hold_every_point_that_was_seen(write):
    many = json.dumps(json.loads(FILES["PhotonVision"]) | {"observations": [[0.1234567, 1.5]] * 40_000})
    assert len(many) > LARGEST_YAML
    assert read_calibration(write(many)) == read_calibration(write(FILES["PhotonVision"]))


@pytest.mark.parametrize("text", [FILES["frc971"].replace("image_", ""), json.dumps(SCRIPT)], ids=["frc971", "WPIcal"])
def test_a_size_is_given_beside(text, write):
    with pytest.raises(InputError, match=r"give image_size, \[width, height\] in pixels\.$"):
        read_calibration(write(text))
    assert read_calibration(write(text), image_size=[640, 480]) == read_calibration(write(FILES["frc971"]))


def test_a_fisheye_that_is_not_called_one_is_taken_as_what_it_is_said_to_be(write):
    script = write(json.dumps(SCRIPT | {"distortion_coefficients": FISHEYE, "image_size": [640, 480]}))
    message = r"^distortion_model must be given: .* names no model, and its 4 coefficients may be those of cv2\.fisheye"
    with pytest.raises(InputError, match=message):
        read_calibration(script)
    assert read_calibration(script, distortion_model="plumb_bob").distortion_model == "plumb_bob"
    assert read_calibration(script, distortion_model="fisheye").distortion_model == "equidistant"
    with pytest.raises(InputError, match=r"^distortion_model must be plumb_bob, as the file has it, got fisheye\.$"):
        read_calibration(write(FILES["PhotonVision"]), distortion_model="fisheye")
    with pytest.raises(InputError, match=r"the lens model 'omni' is not known here"):
        read_calibration(script, distortion_model="omni")


def test_a_size_is_given_where_the_file_has_none_and_never_another(write):
    path = write(FILES["frc971"].replace("image_width", "w").replace("image_height", "h"))
    found = read_calibration(path, image_size=[640, 480])
    assert (found.image_width, found.image_height) == (640, 480)
    for size, message in (
        ([640], r"^image_size must be a list of 2 numbers, got \[640\]\.$"),
        ([640.5, 480], r": image_width must be a whole number, got 640\.5\.$"),
    ):
        with pytest.raises(InputError, match=message):
            read_calibration(path, image_size=size)
    whole = write(FILES["OpenCV XML"])
    assert read_calibration(whole, image_size=[640, 480]) == read_calibration(whole)
    with pytest.raises(InputError, match=r"^image_size must be \[640, 480\], as .* has it, got \[480\.0, 640\.0\]\.$"):
        read_calibration(whole, image_size=[480, 640])
