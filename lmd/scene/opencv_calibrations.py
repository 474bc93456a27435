"""Calibrations by OpenCV's samples, and by scripts of its users, who call the same things otherwise."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import Any

from lmd.core.checks import InputError
from lmd.core.files import flat

# What OpenCV's samples of other years and scripts of its users call the keys of ROS, in small letters.
OPENCV_NAMES = {
    "image_width": ("image_width",),
    "image_height": ("image_height",),
    "camera_matrix": ("camera_matrix", "cameramatrix", "mtx", "k"),
    "distortion_coefficients": (
        "distortion_coefficients",
        "dist_coeffs",
        "distortion_coeffs",
        "dist_coeff",
        "distcoeffs",
        "distortion",
        "dist",
        "d",
    ),
}
OPENCV_SIZES = ("image_size", "img_size")
# What scripts call the model of the lens, where others have the name of a product; and those of wide lenses.
OPENCV_LENSES = ("lens_model", "camera_model", "camera_type", "model")
OPENCV_FISHEYES = ("fisheye_model", "fisheye", "is_fisheye")  # 1 or true; OpenCV's own sample has the first
WIDE = re.compile(r"fish|omni|equidist|kannala|unified|double.?sphere|scaramuzza|^(mei|ds|eucm|kb4?|fov)$")


def opencv_xml(text: str) -> dict[str, Any]:
    """The numbers and matrices of OpenCV's `FileStorage`; entities could stand for gigabytes, so none are taken."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("an XML file with a document type or entities is not taken.")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"it cannot be read as XML ({error}).") from None
    keys: dict[str, Any] = {}
    for child in root:
        data = child.find("data")
        if data is not None and child.get("type_id") == "opencv-matrix":
            keys[child.tag] = {"data": [float(number) for number in (data.text or "").split()]}
        elif re.fullmatch(r"\s*\d{1,9}\s*", child.text or ""):
            keys[child.tag] = int(child.text or "")
    return keys


def opencv(keys: Mapping[str, Any]) -> Mapping[str, Any]:
    """The keys of ROS from those of OpenCV's samples and scripts, where a matrix may be a list of rows."""
    plain = {key.lower(): value for key, value in keys.items()}
    found = dict(keys)
    for name, others in OPENCV_NAMES.items():
        values = [plain[other] for other in others if other in plain]
        if values and name not in keys:
            found[name] = values[0]
    for name in ("camera_matrix", "distortion_coefficients"):
        if isinstance(found.get(name), list):
            found[name] = {"data": flat(found[name])}
    if "distortion_model" not in found:
        for model in (str(plain[name]).lower() for name in OPENCV_LENSES if name in plain):
            if WIDE.search(model):
                found["distortion_model"] = model
    if any(plain.get(name) == 1 for name in OPENCV_FISHEYES):
        found["distortion_model"] = "fisheye"
    for name in OPENCV_SIZES:
        if isinstance(size := keys.get(name), list) and len(size) == 2:
            found = dict(zip(("image_width", "image_height"), size, strict=True)) | found
    if "camera_matrix" not in found and "distortion_coefficients" not in found:
        raise InputError(
            f"it is no calibration that is known here, it has {', '.join(keys)[:200] or 'no keys'}: write it as ROS "
            "does, with image_width, image_height, camera_matrix, distortion_model and distortion_coefficients."
        )
    return found
