"""Calibration files of several ecosystems, restated in the keys of ROS's `camera_info`.

Which format a file has follows from its content. Sources: `sensor_msgs/CameraInfo`, `CameraCalibrationCoefficients`
of PhotonVision, "Cameras" of COLMAP's output format, Basalt's `calibration.hpp`, "lens models" of mrcal, ORB-SLAM3's
"Calibration_Tutorial", `calibration.fbs` of frc971.
"""

import ast
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from lmd.core.checks import InputError, vector
from lmd.core.files import LARGEST_YAML, read_keys, read_text
from lmd.geometry.lens import EQUIDISTANT

Keys = Mapping[str, Any]
COLMAP_CAMERA = re.compile(r"^\d+[ \t]+[A-Z_]+[ \t]+\d+[ \t]+\d+[ \t]+\S.*$", re.MULTILINE)
# What the parameters of a model are, in the order of the file. "f" stands for fx and fy.
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
# What files call the models of `lmd.geometry.lens`: ROS, Kalibr and OpenCV.
LENS_MODELS = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "none": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": EQUIDISTANT,
    "fisheye": EQUIDISTANT,
}
# Of the first pixel, from the image's border: ROS and OpenCV count from the centre, COLMAP from the border.
PIXEL_CENTRE = 0.5
MRCAL_LENSES = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
BROWN_CONRADY = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE_COEFFICIENTS = ("k1", "k2", "k3", "k4")


def read_cameras(path: Any) -> dict[str, Keys]:
    """The cameras of a file by name, each in the keys of ROS; one without a name is called "".

    Args:
        path: the file, at most `LARGEST_YAML` bytes.

    Raises:
        InputError: the file cannot be read, a key is missing, or the lens is of a model that is not known here.
    """
    text = read_text(path, "path", LARGEST_YAML)
    try:
        if rows := COLMAP_CAMERA.findall(text):
            return _colmap(rows)
        if re.search(r"^[{\s]*['\"]lensmodel['\"]\s*:", text, re.MULTILINE):
            return {"": _mrcal(text)}
        keys = _opencv_xml(text) if text.lstrip().startswith("<") else read_keys(path, "path")
        for marks, reader in READERS:
            if marks <= keys.keys():
                return reader(keys)
        return {"": keys}
    except InputError as error:
        raise error if error.argument == "path" else InputError(f"{path}: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the key or value {error} is missing or wrong.") from None


def _ros(size: Any, matrix: Any, lens: Any, model: str = "plumb_bob") -> Keys:
    """The keys of ROS; `size` is (width, height), `matrix` has nine numbers."""
    width, height = size
    return {
        "image_width": width,
        "image_height": height,
        "camera_matrix": {"data": matrix},
        "distortion_model": model,
        "distortion_coefficients": {"data": lens},
    }


def _opencv_xml(text: str) -> dict[str, Any]:
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


def _named(size: Any, values: Keys, fisheye: bool) -> Keys:
    """The keys of ROS from parameters by name: fx, fy, cx, cy, k1, ..."""
    matrix = [values["fx"], 0.0, values["cx"], 0.0, values["fy"], values["cy"], 0.0, 0.0, 1.0]
    lens = [values.get(name, 0.0) for name in (FISHEYE_COEFFICIENTS if fisheye else BROWN_CONRADY)]
    return _ros(size, matrix, lens, EQUIDISTANT if fisheye else "plumb_bob")


def known_lens(model: Any, known: Iterable[str]) -> str:
    """The name of a lens model if it is one of those known.

    Raises:
        InputError: it is not.
    """
    if model not in (names := tuple(known)):
        raise InputError(
            f"the lens model {model!r} is not known here, only {', '.join(names)}: calibrate as pinhole with radial "
            "and tangential distortion or as Kannala-Brandt fisheye, such as by Kalibr's pinhole-radtan and "
            "pinhole-equi, or convert it, such as by mrcal-convert-lensmodel."
        )
    return str(model)


def _colmap(rows: list[str]) -> dict[str, Keys]:
    cameras = {}
    for row in rows:
        name, model, width, height, *parameters = row.split()
        names = COLMAP_MODELS[known_lens(model, COLMAP_MODELS)].split()
        values = dict(zip(names, map(float, parameters), strict=True))
        if "f" in values:
            values["fx"] = values["fy"] = values["f"]
        for centre in ("cx", "cy"):
            values[centre] -= PIXEL_CENTRE
        cameras[f"cam{name}"] = _named((int(width), int(height)), values, model.endswith("FISHEYE"))
    return cameras


def _mrcal(text: str) -> Keys:
    try:
        keys = ast.literal_eval(text.strip())
    except Exception as error:  # whatever a parser of a broken file runs into
        raise InputError(
            f"it is no cameramodel of mrcal ({' '.join(str(error).split()) or type(error).__name__})."
        ) from None
    size = MRCAL_LENSES[known_lens(str(keys["lensmodel"]).removeprefix("LENSMODEL_"), MRCAL_LENSES)]
    fx, fy, cx, cy, *lens = vector("intrinsics", list(keys["intrinsics"]), 4 + size)
    return _ros(keys["imagersize"], [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], lens or [0.0] * 4)


def _message(keys: Keys) -> dict[str, Keys]:
    matrix, lens = (keys[name] if name in keys else keys[name.lower()] for name in "KD")
    return {"": _ros((keys["width"], keys["height"]), matrix, lens, keys.get("distortion_model", "plumb_bob"))}


def _photonvision(keys: Keys) -> dict[str, Keys]:
    size = keys["resolution"]
    return {"": _ros((size["width"], size["height"]), keys["cameraIntrinsics"]["data"], keys["distCoeffs"]["data"])}


def _frc971(keys: Keys) -> dict[str, Keys]:
    restated = _ros((None, None), keys["intrinsics"], keys["dist_coeffs"])  # which says no size
    return {"": {key: keys.get(key, value) for key, value in restated.items() if key in keys or value is not None}}


def _basalt(keys: Keys) -> dict[str, Keys]:
    known = {"pinhole": False, "pinhole-radtan8": False, "kb4": True}
    cameras = {}
    for index, (camera, size) in enumerate(
        zip(keys["value0"]["intrinsics"], keys["value0"]["resolution"], strict=True)
    ):
        fisheye = known[known_lens(camera["camera_type"], known)]
        cameras[f"cam{index}"] = _named(size, camera["intrinsics"], fisheye)
    return cameras


def _orb_slam(keys: Keys) -> dict[str, Keys]:
    known = {"PinHole": False, "KannalaBrandt8": True}
    fisheye = known[known_lens(keys["Camera.type"], known)]
    values = {key.split(".", 1)[1]: value for key, value in keys.items() if re.match(r"Camera1?\.", key)}
    return {"": _named((values["width"], values["height"]), values, fisheye)}


# By the keys that only files of this format have.
READERS: tuple[tuple[frozenset[str], Callable[[Keys], dict[str, Keys]]], ...] = (
    (frozenset({"width", "height", "K", "D"}), _message),
    (frozenset({"width", "height", "k", "d"}), _message),
    (frozenset({"cameraIntrinsics", "distCoeffs"}), _photonvision),
    (frozenset({"intrinsics", "dist_coeffs"}), _frc971),
    (frozenset({"value0"}), _basalt),
    (frozenset({"Camera.type"}), _orb_slam),
)
