"""Calibrations that are recognised and refused: the reason, and advice on a supported format."""

from lmd.formats.opencv_calibrations import AS_ROS

TOPIC = "ros2 topic echo --once TOPIC/camera_info > info.yaml"
_NUMBER = r"[-+]?\.?\d[-+.\deE]*"
# Recognised by a pattern in the first characters.
TEXTS = (
    (
        r"\A(\s*#.*\n)*\s*\[(LEFT|RIGHT)_CAM_",
        f"it is the calibration that Stereolabs keeps of a ZED, for several resolutions: {TOPIC}, or {AS_ROS}",
    ),
    (r"\A\s*#?\s*oST version", "it is ROS's ost.txt: the ost.yaml beside it is read"),
    (
        r"\A(\s*[#;].*\n)*\s*\[[^\]\n\"'{,]+\][^\S\n]*\n\s*\w[\w ]*=",
        f"it has sections and keys, as an INI file: {AS_ROS}",
    ),
    (
        rf"\A(\s*#.*\n)*\s*{_NUMBER}([,;\s]+{_NUMBER})+\s*$",
        f"it holds numbers without names, such as a camera's matrix alone: {AS_ROS}",
    ),
)
# Recognised by the outermost element of XML.
ROOTS = {
    "root": f"it is a file such as ViSP's: of a model take px, py, u0, v0 as fx, fy, cx, cy, and {AS_ROS}",
}
# Recognised by keys that only files of this kind have.
KEYS = (
    ({"sfm_data_version"}, f"it is a scene of OpenMVG: COLMAP's cameras.txt is read, or {AS_ROS}"),
    ({"fx", "fy", "cx", "cy"}, f"it has fx, fy, cx, cy by themselves: {AS_ROS}"),
)
# Suffixes of two matrices with one name: M1 and M2, camera_matrix_left and camera_matrix_right.
_ENDS = (("1", "2"), ("_1", "_2"), ("left", "right"), ("_left", "_right"), ("l", "r"), ("_l", "_r"), ("0", "1"))
STEREO = [
    {f"{name}{end}" for end in ends} for name in ("m", "k", "mtx", "cameramatrix", "camera_matrix") for ends in _ENDS
]
