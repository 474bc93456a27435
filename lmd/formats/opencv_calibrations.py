"""Calibrations by OpenCV's samples, and by users' scripts, which have other names for the keys."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import Any

from lmd.core.checks import InputError, bounded
from lmd.core.files import flat

AS_ROS = (
    "write it as ROS does, with image_width, image_height, camera_matrix: {data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]}, "
    "distortion_model and distortion_coefficients: {data: [k1, k2, p1, p2, k3]}"
)
# Keys of ROS by their names in OpenCV's samples of several years and in users' scripts, in small letters without `_`.
OPENCV_NAMES = {
    "image_width": ("imagewidth",),
    "image_height": ("imageheight",),
    "camera_matrix": ("cameramatrix", "cammatrix", "cammtx", "mtx", "k", "matrix"),
    "distortion_coefficients": (
        "distortioncoefficients",
        "distortioncoeffs",
        "distortioncoeff",
        "distcoeffs",
        "distcoeff",
        "distcoefs",
        "distcoef",
        "distortion",
        "dist",
        "d",
    ),
}
DEEPEST = 64  # greatest number of elements of XML in each other; searches of deeper ones would take hours
VAGUE = "matrix"  # a camera matrix only if there is a distortion, too
OPENCV_SIZES = ("image_size", "img_size", "dim")
DIMENSIONS = "dim"  # key that only the recipe for cv2.fisheye writes, beside K and D
# Names of keys with the lens model in scripts, which may also hold the name of a product; and values for wide lenses.
OPENCV_LENSES = (
    "lens_model",
    "camera_model",
    "camera_type",
    "distortion_type",
    "lens_type",
    "projection",
    "projection_model",
    "projection_type",
    "model",
    "type",
)
OPENCV_FISHEYES = ("fisheye_model", "fisheye", "is_fisheye")  # keys with 1 or true; OpenCV's sample has the first
NARROW = re.compile(r"rad_?tan|plumb.?bob|brown|radial.tangential|rational")
WIDE = re.compile(
    r"fish|omni|equidist|kannala|unified|double.?sphere|scaramuzza|f.?theta|division|inverse|stereographic|equisolid"
    r"|^(mei|ds|eucm|kb4?|fov)$"
)

# Lines of ROS's calibrator, with parentheses by Python 2; and the size in the text that follows them.
PRINTED = re.compile(r"^\W{0,3}([DK])\s?=\W{0,4}?\[([^\]\n]*)\]", re.MULTILINE)
PRINTED_SIZE = re.compile(r"^width\s{1,9}(\d{1,9})\s{1,9}height\s{1,9}(\d{1,9})$", re.MULTILINE)


def printed(text: str) -> dict[str, Mapping[str, Any]]:
    """Cameras that ROS's calibrator printed, in the keys of ROS: one, or `cam1`, `cam2`, ... in their order."""
    known: dict[str, list[list[float]]] = {"K": [], "D": []}
    for name, values in PRINTED.findall(text):
        known[name].append([float(value) for value in values.replace(",", " ").split()])
    more: dict[str, Any] = {"fisheye": True} if "fisheye calibration" in text else {}
    if (size := PRINTED_SIZE.search(text)) is not None:
        more["image_size"] = [int(size[1]), int(size[2])]
    found = [opencv({"K": matrix, "D": lens, **more}) for matrix, lens in zip(*known.values(), strict=True)]
    return {f"cam{i}" if len(found) > 1 else "": keys for i, keys in enumerate(found, 1)}


def xml_of(text: str) -> ElementTree.Element | None:
    """Outermost element of XML, None for another text; entities are refused, as they could expand to gigabytes.

    Raises:
        InputError: the text has entities, or is broken.
    """
    if not text.lstrip().startswith("<"):
        return None
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("an XML file with a document type or entities is not taken.")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"it cannot be read as XML ({error}).") from None
    level, depth = [root], 0
    while level:
        bounded("elements in each other", depth, DEEPEST, "it")
        level, depth = [child for element in level for child in element], depth + 1
    return root


def opencv_xml(root: ElementTree.Element) -> dict[str, Any]:
    """Numbers and matrices of OpenCV's `FileStorage`.

    Raises:
        InputError: the XML is no `FileStorage`.
    """
    keys: dict[str, Any] = {}
    for child in root:
        data = child.find("data")
        if data is not None and child.get("type_id") == "opencv-matrix":
            keys[child.tag] = {"data": [float(number) for number in (data.text or "").split()]}
        elif (said := (child.text or "").strip().strip('"')) and not len(child):
            keys[child.tag] = _value(said)
    if root.tag != "opencv_storage" and not any(isinstance(value, dict) for value in keys.values()):
        raise InputError(
            f"it is XML with the element {root.tag[:80]!r}, and only OpenCV's opencv_storage is read: {AS_ROS}."
        )
    return keys


def _value(text: str) -> Any:
    """Value of a text: a number, a list of numbers, or the text itself."""
    if not all(re.fullmatch(r"[-+]?\d{1,9}(\.\d{0,17})?", part) for part in text.split()):
        return text
    numbers = [float(part) if "." in part else int(part) for part in text.split()]
    return numbers[0] if len(numbers) == 1 else numbers


def has_matrix(keys: Mapping[str, Any]) -> bool:
    """True for keys that have the matrix of a camera under one of its names."""
    plain = {_plain(key) for key in keys}
    found = plain & set(OPENCV_NAMES["camera_matrix"])
    return bool(found - {VAGUE}) or (bool(found) and not plain.isdisjoint(OPENCV_NAMES["distortion_coefficients"]))


def _plain(key: str) -> str:
    return key.lower().replace("_", "")


def opencv(keys: Mapping[str, Any]) -> Mapping[str, Any]:
    """Keys of ROS from the keys of OpenCV's samples and scripts, in which a matrix may be a list of rows."""
    plain = {key.lower(): value for key, value in keys.items()}
    short = {_plain(key): value for key, value in keys.items()}
    found = dict(keys)
    for name, others in OPENCV_NAMES.items():
        values = [short[other] for other in others if other in short]
        if values and name not in keys:
            found[name] = values[0]
    for name in ("camera_matrix", "distortion_coefficients"):
        if isinstance(found.get(name), list):
            found[name] = {"data": flat(found[name])}
    if (model := model_of(plain, found.get("distortion_coefficients"))) is not None:
        found["distortion_model"] = model
    for name in OPENCV_SIZES:
        if isinstance(size := plain.get(name), list) and len(size) == 2:
            found = dict(zip(("image_width", "image_height"), size, strict=True)) | found
    return found


def model_of(plain: Mapping[str, Any], lens: Any) -> Any:
    """Model of the lens; None if nothing in the file determines it.

    Args:
        plain: keys of the file, in small letters.
        lens: coefficients in ROS's order.
    """
    flags = [str(plain[name]).lower() in ("1", "true", "yes") for name in OPENCV_FISHEYES if name in plain]
    if any(flags):
        return "fisheye"
    if "distortion_model" in plain:
        return plain["distortion_model"]
    if "xi" in plain:
        return "omnidir, which its key xi stands for,"
    said = [str(plain[name]).lower() for name in OPENCV_LENSES if name in plain]
    for kind, model in ((WIDE, None), (NARROW, "plumb_bob")):
        for word in said:
            if kind.search(word):
                return model or word
    four = isinstance(lens, Mapping) and isinstance(lens.get("data"), list) and len(lens["data"]) == 4
    if DIMENSIONS in plain and four:
        return "fisheye"
    return "plumb_bob" if flags else None
