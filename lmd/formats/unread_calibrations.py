"""Calibrations of other programs that are not read, each with the way to one that is."""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from lmd.core.checks import InputError
from lmd.formats.registry import File, Format, has_keys

AS_ROS = (
    "write it as ROS does, with image_width, image_height, camera_matrix: {data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]}, "
    "distortion_model and distortion_coefficients: {data: [k1, k2, p1, p2, k3]}"
)
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
HEAD = 2000  # characters that tell


def unknown_root(tag: str) -> InputError:
    """The error about an XML file that is none of OpenCV's."""
    other = f"it is XML with the element {tag[:80]!r}, and only OpenCV's opencv_storage is read: {AS_ROS}"
    return InputError(f"{ROOTS.get(tag, other)}.")


def unknown_keys(keys: Mapping[str, Any]) -> InputError:
    """The error about keys that are those of no calibration that is read."""
    return InputError(f"it is no calibration that is known here, it has {_few(keys)}: {AS_ROS}.")


def _few(keys: Iterable[str]) -> str:
    return ", ".join(keys)[:200] or "no keys"


def _begins(mark: str) -> Callable[[File], bool]:
    return lambda file: re.search(mark, file.text[:HEAD], re.MULTILINE) is not None


def _is_stereo(file: File) -> bool:
    small = {key.lower() for key in file.keys}
    return any(pair <= small for pair in STEREO)


UNREAD_TEXTS = tuple(Format("calibration", "a text", _begins(mark), why_not=sentence) for mark, sentence in TEXTS)
UNREAD_KEYS = (
    *(Format("calibration", "keys", has_keys(*marks), why_not=sentence) for marks, sentence in KEYS),
    Format(
        "calibration",
        "OpenCV's stereo calibration",
        _is_stereo,
        why_not=f"it holds two cameras of OpenCV's stereo calibration: for each, {AS_ROS}",
    ),
)
