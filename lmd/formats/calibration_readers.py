"""Readers of calibration files of several ecosystems; calibrations are restated in the keys of ROS's `camera_info`.

The format of a file follows from its content. Sources: `sensor_msgs/CameraInfo`, "YAML formats" of Kalibr, the
calibration samples of OpenCV, `CameraCalibrationCoefficients` of PhotonVision, `cameracalibration.cpp` of WPIcal,
"Cameras" of COLMAP's output format, Basalt's `calibration.hpp`, "lens models" of mrcal, ORB-SLAM3's
"Calibration_Tutorial", stella_vslam's examples, `calibration.fbs` of frc971, `CameraFactory` of camodocal (VINS),
`sensor.yaml` of EuRoC. Lenses of other models are fitted, see `lmd.geometry.central_models`.
"""

import ast
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from lmd.core.checks import InputError, vector
from lmd.core.files import flat
from lmd.formats.opencv_calibrations import model_of
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.central_models import GOOD_PIXELS, MODELS, PINHOLE, Model, Restated, nearest_lens, restated
from lmd.geometry.lens import EQUIDISTANT

Keys = Mapping[str, Any]
# Cameras by name, each as keys of ROS, or as a function that returns the keys or raises an error about this camera
# only.
Cameras = dict[str, Keys | Callable[[], Keys]]
COLMAP_CAMERA = re.compile(r"^\d+[ \t]+[A-Z_]+[ \t]+\d+[ \t]+\d+[ \t]+\S.*$", re.MULTILINE)
# Parameters of each model in the order of the file; "f" stands for fx and fy.
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
# Models of `lmd.geometry.lens` by their names in files of ROS, Kalibr, EuRoC and OpenCV.
LENS_MODELS = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "none": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": EQUIDISTANT,
    "fisheye": EQUIDISTANT,
    "kannala_brandt": EQUIDISTANT,
    "radial-tangential": "plumb_bob",
    "brown_conrady": "plumb_bob",
}
# Keys in addition to those of ROS: a sentence about the lens; the diameter of the image circle, pixels; a frame and the
# pose `(4, 4)` of the camera in this frame, None if unknown; True if the reader has used the lens model that the user
# named.
NOTE, CIRCLE, POSE, ANSWERED = "(note)", "(image circle)", "(pose)", "(answered)"
MRCAL = re.compile(r"\s*(#[^\n]*\n\s*)*\{\s*['\"]lensmodel['\"]\s*:")  # the first key
MRCAL_LENSES = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
BROWN_CONRADY = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE_COEFFICIENTS = ("k1", "k2", "k3", "k4")
# Names of the parameters of camodocal's fisheye, by their usual names.
CAMODOCAL_FISHEYE = {"fx": "mu", "fy": "mv", "cx": "u0", "cy": "v0", "k1": "k2", "k2": "k3", "k3": "k4", "k4": "k5"}
CAMODOCAL_UNIFIED = {"fx": "gamma1", "fy": "gamma2", "cx": "u0", "cy": "v0"}
KALIBR_CAMERA = re.compile(r"cam\d+")
LONGEST = 64  # greatest length of a list or mapping that is searched for cameras
LARGEST_LITERAL = 1 << 20  # greatest length of a Python literal, characters; literals take more memory than JSON


def ros_keys(size: Any, matrix: Any, lens: Any, model: str | None = "plumb_bob") -> Keys:
    """Keys of ROS for a camera; `size` and `model` are None if the file has none; `matrix` has nine numbers."""
    matrix, lens = (flat(values) if isinstance(values, list) else values for values in (matrix, lens))
    keys = {"camera_matrix": {"data": matrix}, "distortion_coefficients": {"data": lens}}
    named = zip(("image_width", "image_height", "distortion_model"), (*size, model), strict=True)
    return keys | {name: value for name, value in named if value is not None}


def no_size() -> InputError:
    """Error about a file that lacks the size of the image."""
    return InputError(
        "image_size must be given, [width, height] in pixels: image_width or image_height is missing.", "image_size"
    )


def section(keys: Any, name: str) -> Keys:
    """Mapping below the key `name`; raises `InputError` if there is none."""
    if not isinstance(keys, Mapping) or name not in keys:
        raise InputError(f"the key {name} is missing.")
    if not isinstance(section := keys[name], Mapping):
        raise InputError(f"{name} must have keys, got {section!r}.")
    return section


def entries(keys: Any, name: str) -> list[Any]:
    """List below the key `name`; raises `InputError` if there is none."""
    if not isinstance(keys, Mapping) or not isinstance(values := keys.get(name), list):
        raise InputError(f"the key {name} must be a list.")
    return values


def camera_of_chain(prefix: str, camera: Any, lens: str = "distortion_coeffs") -> Keys:
    """Keys of ROS for one camera of a chain. `prefix` is for messages; a resolution of None means unknown."""

    def entry(key: str) -> Any:
        if not isinstance(camera, Mapping) or key not in camera:
            raise InputError(f"the key {prefix}{key} is missing.")
        return camera[key]

    projection = known_lens(entry("camera_model"), ("pinhole", *MODELS))
    own = MODELS[projection][1] if projection in MODELS else ()
    distorts = {"omni": ("none", "radtan", "radial-tangential"), "pinhole": tuple(LENS_MODELS)}.get(
        projection, ("none",)
    )
    model = known_lens(entry("distortion_model"), distorts)
    names = (*own, *PINHOLE)
    values = dict(zip(names, vector(f"{prefix}intrinsics", entry("intrinsics"), len(names)), strict=True))
    coefficients = entry(lens) if model != "none" else []
    resolution = entry("resolution")
    if resolution is None and own:
        raise no_size()
    size = (None, None) if resolution is None else vector(f"{prefix}resolution", resolution, 2)
    if not own:
        return ros_keys(size, _matrix(values), coefficients, model)
    if coefficients:
        values |= zip(BROWN_CONRADY, vector(f"{prefix}{lens}", coefficients, 4), strict=False)
    return central(size, values, projection)


def euroc(keys: Keys) -> dict[str, Keys]:
    """Camera of EuRoC's `sensor.yaml`."""
    return {"": camera_of_chain("", keys, "distortion_coefficients")}


def okvis(keys: Keys) -> dict[str, Keys]:
    """Cameras of OKVIS and OKVIS2."""
    cameras = {}
    for index, camera in enumerate(entries(keys, "cameras")):
        if not isinstance(camera, Mapping):
            raise InputError(f"cameras[{index}] must have keys, got {camera!r}.")
        (fx, fy), (cx, cy) = (vector(name, camera[name], 2) for name in ("focal_length", "principal_point"))
        model = known_lens(camera["distortion_type"], ("radialtangential", EQUIDISTANT))
        model, lens = "plumb_bob" if model != EQUIDISTANT else model, camera["distortion_coefficients"]
        matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        cameras[f"cam{index}"] = ros_keys(camera["image_dimension"], matrix, lens, model)
    return cameras


def camodocal(keys: Keys) -> dict[str, Keys]:
    """Camera in the settings of VINS, whose fisheye is the Kannala-Brandt model with other names."""
    known = {"PINHOLE": {}, "KANNALA_BRANDT": CAMODOCAL_FISHEYE, "MEI": CAMODOCAL_UNIFIED}
    model, size = known_lens(keys["model_type"], known), (keys["image_width"], keys["image_height"])
    values: dict[str, Any] = {}
    for name in ("projection_parameters", "distortion_parameters", "mirror_parameters"):
        values |= section(keys, name) if name in keys else {}
    values |= {name: values[theirs] for name, theirs in known[model].items()}
    return {"": central(size, values, "omni") if model == "MEI" else named(size, values, model == "KANNALA_BRANDT")}


def named(size: Any, values: Keys, fisheye: bool) -> Keys:
    """Keys of ROS from parameters by name: fx, fy, cx, cy, k1, ..."""
    lens = [values.get(name, 0.0) for name in (FISHEYE_COEFFICIENTS if fisheye else BROWN_CONRADY)]
    return ros_keys(size, _matrix(values), lens, EQUIDISTANT if fisheye else "plumb_bob")


def _matrix(values: Keys) -> list[float]:
    return [values["fx"], 0.0, values["cx"], 0.0, values["fy"], values["cy"], 0.0, 0.0, 1.0]


def central(size: Any, values: Keys, model: str) -> Keys:
    """Keys of ROS for a lens fitted to a model with parameters by name: fx, fy, cx, cy, xi, ..., k1, ..."""
    return _noted(restated(model, values, size), size, f"of the model {model}")


def fitted(model: Model, focal: Any, centre: Any, size: Any, name: str, guess: Sequence[float]) -> Keys:
    """Keys of ROS for a lens fitted to a model, see `nearest_lens`; `name` is for a note."""
    return _noted(nearest_lens(model, focal, centre, size, guess), size, name)


def _noted(lens: Restated, size: Any, name: str) -> Keys:
    pinhole = zip(PINHOLE, (*lens.focal_pixels, *lens.principal_point), strict=True)
    keys = ros_keys(size, _matrix(dict(pinhole)), list(lens.coefficients), lens.model)
    off = f"its lens {name} is taken for {lens.model}, which is up to {lens.worst:.2f} pixels off"
    return {**keys, NOTE: off} if lens.worst > GOOD_PIXELS else keys


def within(keys: Any, wanted: Any, name: str = "", depth: int = 4) -> Iterable[tuple[str, Keys]]:
    """Mappings within `keys` that are `wanted`, by the path of keys above them with `/` between; long lists are not
    searched.
    """
    if isinstance(keys, Mapping) and wanted(keys):
        yield name, keys
    elif depth and isinstance(keys, Mapping | list) and len(keys) <= LONGEST:
        inner = keys.items() if isinstance(keys, Mapping) else enumerate(keys)
        for key, value in inner:
            yield from within(value, wanted, f"{name}/{key}" if name else str(key), depth - 1)


def matrix_of(name: str, values: Any) -> tuple[float, ...]:
    """Nine numbers of a matrix, which may be a list of rows."""
    return vector(name, flat(values) if isinstance(values, list) else values, 9)


def row_by_row(name: str, values: Any) -> tuple[float, ...]:
    """Camera matrix row by row, from nine numbers by rows or by columns; the last row must be 0, 0, 1."""
    matrix = matrix_of(name, values)
    return tuple(matrix[3 * (i % 3) + i // 3] for i in range(9)) if matrix[6] or matrix[7] else matrix


def known_lens(model: Any, known: Iterable[str]) -> str:
    """Return the name of a lens model if it is `known`.

    Raises:
        InputError: the model is not known.
    """
    if model not in (names := tuple(known)):
        raise InputError(
            f"the lens model {model!r} is not known here, only {', '.join(names)}: calibrate as pinhole with radial "
            "and tangential distortion or as Kannala-Brandt fisheye, such as by Kalibr's pinhole-radtan and "
            "pinhole-equi, or convert it, such as by mrcal-convert-lensmodel."
        )
    return str(model)


def colmap(rows: list[str]) -> dict[str, Keys]:
    """Cameras of COLMAP's `cameras.txt`, with a row for each camera."""
    cameras = {}
    for row in rows:
        name, model, width, height, *parameters = row.split()
        names = COLMAP_MODELS[known_lens(model, COLMAP_MODELS)].split()
        values = dict(zip(names, map(float, parameters), strict=True))
        if "f" in values:
            values["fx"] = values["fy"] = values["f"]
        for centre in ("cx", "cy"):
            values[centre] -= PIXEL_CENTRE
        cameras[f"cam{name}"] = named((int(width), int(height)), values, model.endswith("FISHEYE"))
    return cameras


def mrcal(text: str) -> Keys:
    """Camera of mrcal's `cameramodel`, a Python literal."""
    if len(text) > LARGEST_LITERAL:
        raise InputError(f"a cameramodel has at most {LARGEST_LITERAL} characters, it has {len(text)}.")
    try:
        keys = ast.literal_eval(text.strip())
    except Exception as error:  # Python's parser raises errors of many kinds for a broken file
        reason = " ".join(str(error).partition(": <ast.")[0].split())  # without the address of a node in memory
        raise InputError(f"it is no cameramodel of mrcal ({reason or type(error).__name__}).") from None
    size = MRCAL_LENSES[known_lens(str(keys["lensmodel"]).removeprefix("LENSMODEL_"), MRCAL_LENSES)]
    fx, fy, cx, cy, *lens = vector("intrinsics", keys["intrinsics"], 4 + size)
    return ros_keys(keys["imagersize"], [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], lens or [0.0] * 4)


def message(keys: Keys) -> dict[str, Keys]:
    """Camera of a ROS message."""
    matrix, lens = (keys[name] if name in keys else keys[name.lower()] for name in "KD")
    model = model_of({key.lower(): value for key, value in keys.items()}, {"data": lens})
    return {"": ros_keys((keys["width"], keys["height"]), matrix, lens, model)}


def photonvision(keys: Keys) -> dict[str, Keys]:
    """Camera of PhotonVision and WPIcal."""
    size, matrix, lens = (section(keys, name) for name in ("resolution", "cameraIntrinsics", "distCoeffs"))
    return {"": ros_keys((size["width"], size["height"]), matrix["data"], lens["data"])}


def frc971(keys: Keys) -> dict[str, Keys]:
    """Camera of frc971."""
    size = keys.get("image_width"), keys.get("image_height")  # the file of frc971 has no size
    return {"": ros_keys(size, keys["intrinsics"], keys["dist_coeffs"], keys.get("distortion_model"))}


def basalt(keys: Keys) -> dict[str, Keys]:
    """Cameras of Basalt."""
    known = {"pinhole": False, "pinhole-radtan8": False, "kb4": True, "ds": None, "eucm": None}
    cameras = {}
    inner = section(keys, "value0")
    for index, (camera, size) in enumerate(
        zip(entries(inner, "intrinsics"), entries(inner, "resolution"), strict=True)
    ):
        values, fisheye = section(camera, "intrinsics"), known[model := known_lens(camera["camera_type"], known)]
        size = vector("resolution", size, 2)
        cameras[f"cam{index}"] = central(size, values, model) if fisheye is None else named(size, values, fisheye)
    return cameras


def orb_slam(keys: Keys) -> dict[str, Keys]:
    """First camera of ORB-SLAM3 or ORB-SLAM2. ORB-SLAM2 has no type, and often no size. Rectified images have no
    distortion.
    """
    known = {"PinHole": False, "KannalaBrandt8": True, "Rectified": False}
    fisheye = known[known_lens(keys.get("Camera.type", "PinHole"), known)]
    values = {key.split(".", 1)[1]: value for key, value in keys.items() if re.match(r"Camera1?\.", key)}
    return {"": named((values.get("width"), values.get("height")), values, fisheye)}


def stella_vslam(keys: Keys) -> dict[str, Keys]:
    """Camera of stella_vslam or OpenVSLAM."""
    known = {"perspective": False, "fisheye": True}
    fisheye = known[known_lens(keys["Camera.model"], known)]
    values = {key.removeprefix("Camera."): value for key, value in keys.items()}
    return {"": named((values.get("cols"), values.get("rows")), values, fisheye)}


def kalibr(keys: Keys, only: str | None) -> dict[str, Keys]:
    """Cameras of Kalibr's chain, or only the camera `only`."""
    chain = {name: keys[name] for name in keys if KALIBR_CAMERA.fullmatch(name)}
    return {name: camera_of_chain(f"{name}.", chain[name]) for name in ([only] if only in chain else chain)}
