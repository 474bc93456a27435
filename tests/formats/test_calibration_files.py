import json
import re
from pathlib import Path

import numpy as np
import pytest
from format_samples import FILES, LENS, MRCAL, NAMES, SCRIPT

from lmd.core.checks import InputError
from lmd.core.files import LARGEST_YAML
from lmd.formats.calibrations import calibrated_camera, read_calibration

REAL = Path(__file__).parents[2] / ".." / "shared" / "real" / "calibration"


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
        (FILES["ROS's calibrator"].replace("pinhole", "fisheye").replace(str(LENS), str(FISHEYE)), FISHEYE),
        (
            re.sub(r"(.) = (.*)", r"('\1 = ', \2)", FILES["ROS's calibrator"]).replace(str(LENS), str(RATIONAL)),
            RATIONAL,
        ),
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


OUTCOMES = {
    "basalt_euroc_ds.json": None,
    "basalt_t265_kb4.json": None,
    "colmap_maupertuis_cameras.txt": None,
    "frc971_calibration_2024.json": "image_size must be given",
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


PRINTED = FILES["ROS's calibrator"].partition("#")[0]


@pytest.mark.parametrize("text", [FILES["frc971"].replace("image_", ""), json.dumps(SCRIPT), PRINTED])
def test_a_size_is_given_beside(text, write):
    with pytest.raises(InputError, match=r"^image_size must be given, \[width, height\] in pixels: .*is missing\.$"):
        read_calibration(write(text))
    assert read_calibration(write(text), image_size=[640, 480]) == read_calibration(write(FILES["frc971"]))


def test_the_calibrator_of_ros_prints_two_cameras(write):
    path = write(f"Left:\n{PRINTED}Right:\n{PRINTED.replace('600', '700')}self.T = [0.1, 0.0, 0.0]\n")
    with pytest.raises(InputError, match=r"^name must be given: .* has the cameras cam1, cam2"):
        read_calibration(path)
    assert read_calibration(path, "cam2", [640, 480]).focal_pixels == (700.0, 610.0)


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
