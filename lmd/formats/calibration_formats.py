"""The formats of calibrations, in the order in which they are tried."""

import re
from collections.abc import Callable
from functools import cached_property
from typing import Any
from xml.etree.ElementTree import Element

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
from lmd.formats.opencv_calibrations import AS_ROS, has_matrix, opencv, opencv_xml, xml_of
from lmd.formats.registry import File, Format, anything, begins, has_keys

# ROS's tools print one message after the other.
FIRST_MESSAGE = re.compile(r"(?<=\n)---[ \t]*\n(?=header:)")
TOPIC = "ros2 topic echo --once TOPIC/camera_info > info.yaml"
_NUMBER = r"[-+]?\.?\d[-+.\deE]*"
# By what the first characters hold.
TEXTS = (
    (
        r"^Calibration results\s*$|^Camera-system parameters",
        "it is Kalibr's report: the camchain*.yaml beside it is read",
    ),
    (
        r"\A(\s*#.*\n)*\s*\[(LEFT|RIGHT)_CAM_",
        f"it is the calibration that Stereolabs keeps of a ZED, for several resolutions: {TOPIC}, or {AS_ROS}",
    ),
    (r"\A\s*#?\s*oST version", "it is ROS's ost.txt: the ost.yaml beside it is read"),
    (r"\A(\s*[#;].*\n)*\s*\[[^\]\n\"'{,]+\]\s*\n\s*[\w ]+=", f"it has sections and keys, as an INI file: {AS_ROS}"),
    (
        rf"\A(\s*#.*\n)*\s*{_NUMBER}([,;\s]+{_NUMBER})+\s*$",
        f"it holds numbers without names, such as a camera's matrix alone: {AS_ROS}",
    ),
)
# By the element that holds all others of an XML file.
ROOTS = {
    "Calibrations": (
        "it holds webcams of FTC: of the one with the right size take focalLength as fx, fy, principalPoint as cx, cy, "
        f"and {AS_ROS}"
    ),
    "root": f"it is a file such as ViSP's: of a model take px, py, u0, v0 as fx, fy, cx, cy, and {AS_ROS}",
    "calibration": "it is Metashape's own calibration: export the camera as OpenCV's XML, which is read",
}
# By keys that only files of this kind have.
KEYS = (
    ({"cameraData"}, f"it is DepthAI's calibration of an OAK: {TOPIC}, or {AS_ROS}"),
    ({"ppx", "ppy"}, f"it holds the intrinsics of a RealSense: {TOPIC}, or take ppx, ppy as cx, cy, and {AS_ROS}"),
    (
        {"fl_x"},
        "it is a file of nerfstudio or instant-ngp: COLMAP's cameras.txt beside it is read (colmap model_converter "
        f"--output_type TXT), or {AS_ROS}",
    ),
    (
        {"vertical_resolution", "horizontal_resolution"},
        f"it is a calibration of Visual Marker Mapping, with numbers as texts: {AS_ROS}",
    ),
    ({"sfm_data_version"}, f"it is a scene of OpenMVG: COLMAP's cameras.txt is read, or {AS_ROS}"),
    ({"intrinsic_matrix"}, f"it is a camera of Open3D, whose matrix is written by columns: {AS_ROS}"),
    ({"fx", "fy", "cx", "cy"}, f"it has fx, fy, cx, cy by themselves: {AS_ROS}"),
)
# Two matrices of one name with an end that tells them apart: M1 and M2, camera_matrix_left and camera_matrix_right.
_ENDS = (("1", "2"), ("_1", "_2"), ("left", "right"), ("_left", "_right"), ("l", "r"), ("_l", "_r"), ("0", "1"))
STEREO = [
    {f"{name}{end}" for end in ends} for name in ("m", "k", "mtx", "cameramatrix", "camera_matrix") for ends in _ENDS
]


class CalibrationFile(File):
    """A calibration; its keys may be those of OpenCV's XML."""

    @cached_property
    def text(self) -> str:
        """The text, of several messages of ROS the first."""
        return FIRST_MESSAGE.split(super().text)[0]

    @cached_property
    def root(self) -> Element | None:
        """The element that holds all others of XML; None for another text."""
        return xml_of(self.text)

    @cached_property
    def keys(self) -> Keys:
        """The keys of YAML, JSON or OpenCV's XML; those of a section `Camera` as `Camera.fx`, too.

        Raises:
            InputError: the text is neither.
        """
        keys = super().keys if self.root is None else opencv_xml(self.root)
        if isinstance(section := keys.get("Camera"), dict):  # stella_vslam's, as OpenVSLAM's with dots
            keys = {**keys, **{f"Camera.{name}": value for name, value in section.items()}}
        return keys


def _marked(read: Callable[[Keys], dict[str, Keys]], name: str, *keys: str, row: str = "") -> Format:
    """A format that is recognised by keys that no other has."""
    return Format("calibration", name, has_keys(*keys), lambda file: read(file.keys), row=row)


def _refused(recognises: Callable[[Any], bool], why_not: str | Callable[[Any], str]) -> Format:
    return Format("calibration", "of another program", recognises, why_not=why_not)


def _has_root(tag: str) -> Callable[[CalibrationFile], bool]:
    """A test for XML with this element around all others, and without matrices of OpenCV."""
    return lambda file: (
        file.root is not None and file.root.tag == tag and file.root.find("*[@type_id='opencv-matrix']") is None
    )


def _is_stereo(file: File) -> bool:
    small = {key.lower() for key in file.keys}
    return any(pair <= small for pair in STEREO)


FORMATS = (
    Format(
        "calibration",
        "COLMAP",
        lambda file: COLMAP_CAMERA.search(file.text) is not None,
        lambda file: colmap(COLMAP_CAMERA.findall(file.text)),
        row="COLMAP `cameras.txt` | models without a prism; `name=cam1` has the id 1",
    ),
    Format(
        "calibration",
        "mrcal",
        lambda file: MRCAL.match(file.text) is not None,
        lambda file: {"": mrcal(file.text)},
        row="mrcal `cameramodel` | pinhole, `OPENCV4` to `OPENCV12`",
    ),
    *(_refused(begins(mark), sentence) for mark, sentence in TEXTS),
    *(_refused(_has_root(tag), sentence) for tag, sentence in ROOTS.items()),
    Format(
        "calibration",
        "Kalibr",
        lambda file: any(KALIBR_CAMERA.fullmatch(name) for name in file.keys),
        lambda file: kalibr(file.keys, file.asked["name"]),
        row=(
            "Kalibr `camchain` (YAML) | `cam0`, or `name=cam1`: `pinhole` with `radtan`, `equidistant` or `none`; "
            "`ds`, `eucm`, `omni`"
        ),
    ),
    _marked(
        message,
        "ROS",
        *("width", "height", "K", "D"),
        row="ROS `camera_info` (YAML), its message (YAML, JSON) | of the topic `image_raw`, not of a rectified image",
    ),
    _marked(message, "ROS", "width", "height", "k", "d"),
    _marked(
        photonvision,
        "PhotonVision",
        *("cameraIntrinsics", "distCoeffs"),
        row="PhotonVision, WPIcal, frc971 (JSON) | only PhotonVision's has a size",
    ),
    _marked(frc971, "frc971", "intrinsics", "dist_coeffs"),
    _marked(
        basalt,
        "Basalt",
        "value0",
        row="Basalt (JSON) | `pinhole`, `pinhole-radtan8`, `kb4`, `ds`, `eucm`; `name=cam0` is the first",
    ),
    _marked(
        orb_slam,
        "ORB-SLAM",
        "Camera.type",
        row="ORB-SLAM2 and 3 (YAML) | `PinHole`, `KannalaBrandt8`, `Rectified`; the first camera; often no size",
    ),
    _marked(
        stella_vslam, "stella_vslam", "Camera.model", row="stella_vslam, OpenVSLAM (YAML) | `perspective`, `fisheye`"
    ),
    _marked(orb_slam, "ORB-SLAM", "Camera.fx"),
    _marked(okvis, "OKVIS", "cameras", "camera_params"),
    _marked(okvis, "OKVIS2", "cameras", "camera_parameters"),
    _marked(
        camodocal,
        "VINS",
        *("model_type", "projection_parameters"),
        row="VINS (YAML) | `PINHOLE`, `KANNALA_BRANDT`, `MEI`",
    ),
    _marked(camodocal, "VINS", "model_type", "mirror_parameters"),
    _marked(
        euroc,
        "EuRoC",
        *("camera_model", "intrinsics", "distortion_model", "resolution"),
        row="EuRoC `sensor.yaml`, OKVIS and OKVIS2 (YAML) | OKVIS: `name=cam0` is the first",
    ),
    Format(
        "calibration",
        "OpenCV",
        lambda file: has_matrix(file.keys),
        lambda file: {"": opencv(file.keys)},
        row=(
            "OpenCV `FileStorage` (YAML, XML, JSON), scripts | `fisheye_model: 1`, `fisheye: true`, `model: fisheye` "
            "or `DIM` for a fisheye; four coefficients without a word of the model need `distortion_model` "
            "(`fisheye`, `plumb_bob`)"
        ),
    ),
    *(_refused(has_keys(*marks), sentence) for marks, sentence in KEYS),
    _refused(_is_stereo, f"it holds two cameras of OpenCV's stereo calibration: for each, {AS_ROS}"),
    _refused(
        anything,
        lambda file: (
            f"it is no calibration that is known here, it has {', '.join(file.keys)[:200] or 'no keys'}: {AS_ROS}"
        ),
    ),
)
