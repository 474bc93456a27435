"""The formats of calibrations, in the order in which they are tried."""

from collections.abc import Callable

from lmd.formats.calibration_readers import (
    COLMAP_CAMERA,
    KALIBR_CAMERA,
    MRCAL,
    Keys,
    basalt,
    camodocal,
    colmap,
    euroc,
    frc971,
    kalibr,
    message,
    mrcal,
    okvis,
    orb_slam,
    photonvision,
    stella_vslam,
)
from lmd.formats.opencv_calibrations import has_matrix, opencv
from lmd.formats.registry import Format, has_keys
from lmd.formats.unread_calibrations import UNREAD_KEYS, UNREAD_TEXTS


def _marked(read: Callable[[Keys], dict[str, Keys]], name: str, *keys: str, row: tuple[str, ...] = ()) -> Format:
    """A format that is recognised by keys that no other has."""
    return Format("calibration", name, has_keys(*keys), lambda file: read(file.keys), row=row)


FORMATS = (
    Format(
        "calibration",
        "COLMAP",
        lambda file: COLMAP_CAMERA.search(file.text) is not None,
        lambda file: colmap(COLMAP_CAMERA.findall(file.text)),
        row=("COLMAP `cameras.txt`", "models without a prism; `name=cam1` has the id 1"),
    ),
    Format(
        "calibration",
        "mrcal",
        lambda file: MRCAL.match(file.text) is not None,
        lambda file: {"": mrcal(file.text)},
        row=("mrcal `cameramodel`", "pinhole, `OPENCV4` to `OPENCV12`"),
    ),
    *UNREAD_TEXTS,
    Format(
        "calibration",
        "Kalibr",
        lambda file: any(KALIBR_CAMERA.fullmatch(name) for name in file.keys),
        lambda file: kalibr(file.keys, file.asked["name"]),
        row=(
            "Kalibr `camchain` (YAML)",
            "`cam0`, or `name=cam1`: `pinhole` with `radtan`, `equidistant` or `none`; `ds`, `eucm`, `omni`",
        ),
    ),
    _marked(
        message,
        "ROS",
        *("width", "height", "K", "D"),
        row=(
            "ROS `camera_info` (YAML), its message (YAML, JSON)",
            "of the topic `image_raw`, not of a rectified image",
        ),
    ),
    _marked(message, "ROS", "width", "height", "k", "d"),
    _marked(
        photonvision,
        "PhotonVision",
        *("cameraIntrinsics", "distCoeffs"),
        row=("PhotonVision, WPIcal, frc971 (JSON)", "only PhotonVision's has a size"),
    ),
    _marked(frc971, "frc971", "intrinsics", "dist_coeffs"),
    _marked(
        basalt,
        "Basalt",
        "value0",
        row=("Basalt (JSON)", "`pinhole`, `pinhole-radtan8`, `kb4`, `ds`, `eucm`; `name=cam0` is the first"),
    ),
    _marked(
        orb_slam,
        "ORB-SLAM",
        "Camera.type",
        row=(
            "ORB-SLAM2 and 3 (YAML)",
            "`PinHole`, `KannalaBrandt8`, `Rectified`; the first camera; often no size",
        ),
    ),
    _marked(
        stella_vslam,
        "stella_vslam",
        "Camera.model",
        row=("stella_vslam, OpenVSLAM (YAML)", "`perspective`, `fisheye`"),
    ),
    _marked(orb_slam, "ORB-SLAM", "Camera.fx"),
    _marked(okvis, "OKVIS", "cameras", "camera_params"),
    _marked(okvis, "OKVIS2", "cameras", "camera_parameters"),
    _marked(
        camodocal,
        "VINS",
        *("model_type", "projection_parameters"),
        row=("VINS (YAML)", "`PINHOLE`, `KANNALA_BRANDT`, `MEI`"),
    ),
    _marked(camodocal, "VINS", "model_type", "mirror_parameters"),
    _marked(
        euroc,
        "EuRoC",
        *("camera_model", "intrinsics", "distortion_model", "resolution"),
        row=("EuRoC `sensor.yaml`, OKVIS and OKVIS2 (YAML)", "OKVIS: `name=cam0` is the first"),
    ),
    Format(
        "calibration",
        "OpenCV",
        lambda file: has_matrix(file.keys),
        lambda file: {"": opencv(file.keys)},
        row=(
            "OpenCV `FileStorage` (YAML, XML, JSON), scripts",
            "`fisheye_model: 1`, `fisheye: true`, `model: fisheye` or `DIM` for a fisheye; four coefficients without "
            "a word of the model need `distortion_model` (`fisheye`, `plumb_bob`)",
        ),
    ),
    *UNREAD_KEYS,
)
