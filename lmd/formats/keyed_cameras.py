"""Cameras from files of keys and values (YAML, JSON, XML), whose formats are described by rows of
`tables/calibration.yaml`.

Sources of the rows for ROS and calibration programs: `sensor_msgs/CameraInfo`, "YAML formats" of Kalibr and its
`CameraUtils.py`, the calibration samples of OpenCV, "lens models" of mrcal, `cameraIntrinsicsToOpenCV` of MATLAB. For
FIRST robots: `CameraCalibrationCoefficients` of PhotonVision, `cameracalibration.cpp` of WPIcal, `calibration.fbs` of
frc971, `teamwebcamcalibrations.xml` of FTC. For odometry: Basalt's `calibration.hpp`, ORB-SLAM3's
"Calibration_Tutorial", stella_vslam's examples, `CameraFactory` of camodocal (VINS), `sensor.yaml` of EuRoC. For depth
cameras: `CameraInfo.hpp` of depthai-core, `rs_types.h` and `rs-enumerate-devices.cpp` of librealsense. For
reconstruction: "Cameras" of COLMAP's output format, `PinholeCameraIntrinsic` of Open3D, `cameras.py` of nerfstudio,
`nerf_loader.cu` of instant-ngp, `CameraUtilities.cpp` of visual_marker_mapping.

The model "inverse Brown Conrady" has two meanings in librealsense: by `rs_types.h` the polynomial undistorts an image,
but in `rs2_project_point_to_pixel` it distorts (librealsense's issues 6382, 7335, 7734 leave the question open).
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, bounded
from lmd.formats.calibrations import LENS_MODELS, Calibration, ReadCamera, lens_model, no_size
from lmd.formats.placed_tag import transform_of
from lmd.formats.registry import Keyed
from lmd.formats.trees import MISSING, File, Keys, find, number_at, numbers_of, plain, vector_at
from lmd.geometry.central_models import (
    GOOD_PIXELS,
    MODELS,
    PINHOLE,
    Restated,
    inverse_brown_conrady,
    modified_brown_conrady,
    nearest_lens,
    restated,
)
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.se3 import inverse, poses_from_rows

BROWN_CONRADY = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
INVERSE, MODIFIED = "inverse_brown_conrady", "modified_brown_conrady"
# Coefficients of each lens model, in the order of lists in files. `none` has no distortion; the file does not tell the
# model `unsaid`.
COEFFICIENTS = {
    **dict.fromkeys(("plumb_bob", "rational_polynomial", "unsaid"), BROWN_CONRADY),
    **dict.fromkeys(("none", "ds", "eucm"), ()),
    **dict.fromkeys((MODIFIED, INVERSE), BROWN_CONRADY[:5]),
    EQUIDISTANT: ("k1", "k2", "k3", "k4"),
    "omni": BROWN_CONRADY[:4],
}
DISTORTION = (*BROWN_CONRADY, "radial_4")  # no model has `radial_4`
QUANTITIES = ("f", *PINHOLE, "skew", "xi", "alpha", "beta", *DISTORTION)  # `f` stands for both focal lengths
SIDES, POSES = ("width", "height"), ("body_inverse", "body", "step")
KNOWN = {*QUANTITIES, *SIDES, "size", "matrix", "columns", "lens", *POSES}
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
UNCLEAR = 4  # a pinhole and a fisheye may both have this number of coefficients
MOST_CAMERAS = 64  # maximum number of different cameras among the images of a file


@dataclass(frozen=True, kw_only=True)
class KeyedCameras(Keyed):
    """Description of a format: the keys under which a file holds its cameras.

    The field `at` has the paths (see `lmd.formats.trees`) of these quantities:

    - size of the image: `width` and `height`, or `size`.
    - intrinsics: `matrix` (nine numbers, row by row), `columns` (nine numbers, column by column), or single numbers
      named as in `QUANTITIES`, such as `fx`.
    - distortion: `lens`, a list of coefficients, or single coefficients named as in `QUANTITIES`.
    - poses: `body`, the pose of the camera's optical frame in the frame of the body that carries the camera;
      `body_inverse`, its inverse; `step`, the pose of the previous camera in this camera's optical frame.
    """

    called: str = ""
    """Template for the name of a camera, in which `{key}`, `{index}` (from 0), `{number}` (from 1) and keys of the
    entry are replaced by their values. If several cameras get one name, `/2` is appended to the name of the second.
    """
    named: str = ""
    """Names of quantities, separated by blanks, that have their own names as keys in the entry."""
    values: Sequence[str] = ()
    """Paths to lists with the quantities that `models` names, or to mappings with quantities keyed by name. A path that
    ends in a dot stands for all keys that begin with the path.
    """
    model: Sequence[str] = ()
    """Paths, in the entry, to the words that form the name of the lens model when joined by `_`."""
    models: Mapping[str, str] = field(default_factory=lambda: LENS_MODELS)
    """Lens model, a key of `COEFFICIENTS`, keyed by a pattern that the words at `model` match, in lower case; an empty
    value stands for an unknown model. After a colon follow the names of the quantities in the lists at the paths
    `values`, as `ours` or `ours=theirs`.
    """
    origin: float = 0.0
    """Coordinate of the centre of the first pixel in the pixel coordinates of the file, such as 0 or 0.5."""
    loose: bool = False
    """True if the outermost keys of an entry are compared in lower case and without `_`."""
    distinct: bool = False
    """True if equal cameras are returned only once, as in a file that repeats the camera of each image."""

    def __post_init__(self) -> None:
        models = {words.partition(":")[0] for words in self.models.values() if words}
        unknown = [*self.at.keys() - KNOWN, *set(self.named.split()) - KNOWN, *models - COEFFICIENTS.keys()]
        if unknown:
            raise InputError(f"a calibration format names {unknown[0]!r}, which is no quantity or lens model.")

    def read(self, file: File) -> dict[str, ReadCamera]:
        """Cameras in a file, keyed by name.

        Raises:
            InputError: the file does not have the described keys, or has more than `MOST_CAMERAS` different cameras.
        """
        found: dict[str, ReadCamera] = {}
        owns: dict[str, Any] = {}
        for key, entry in self.entries(file)[1]:
            camera = _Camera(self, self.compared(entry), key, file.asked)
            own = [camera.value(path) for path in (*self.at.values(), *self.named.split(), *self.values)]
            name = camera.name(len(found))
            twins = [other for other in owns if self.distinct or other == name or other.startswith(f"{name}/")]
            if any(owns[other] == own for other in twins):
                continue
            name = f"{name}/{len(twins) + 1}" if twins and not self.distinct else name
            owns[name], found[name] = own, ReadCamera(camera.calibration, camera.poses)
            bounded("different cameras", len(found), MOST_CAMERAS if self.distinct else math.inf, "it")
        return found

    def compared(self, entry: Keys) -> Keys:
        """Entry of a camera (a mapping); if the format is `loose`, a copy with keys in lower case and without `_`."""
        return {plain(name): value for name, value in entry.items()} if self.loose else entry


@dataclass(frozen=True)
class _Camera:
    """One camera of a file: the format, the camera's entry (a mapping), the entry's key, and the user's settings."""

    form: KeyedCameras
    entry: Keys
    key: str
    asked: Keys

    def path(self, path: str) -> str:
        """Path in the camera's entry, made from a `path` that the format states.

        A final `?`, which marks an optional value, is removed; `{key}` is replaced by the key of the entry. If the
        format is `loose`, the result is in lower case and without `_`.
        """
        path = path.rstrip("?").replace("{key}", self.key)
        return plain(path) if self.form.loose else path

    def value(self, path: str) -> Any:
        """Value to which a path of keys leads in the camera's entry; `MISSING` without such a value."""
        return find(self.entry, self.path(path))

    def numbers(self, path: str, size: int | None = 1) -> tuple[float, ...]:
        """Numbers to which a path of keys leads in the camera's entry.

        There must be `size` numbers; None allows any count.
        """
        called = path.split("|")[0].rstrip("?").replace("{key}", self.key)
        return vector_at(self.entry, self.path(path), size, called)

    def name(self, index: int) -> str:
        """Name of the camera; `index` is its index in the file, from 0."""
        sides = {name: f"{self._side(name, i) or 0.0:.0f}" for i, name in enumerate(SIDES) if name in self.form.called}
        return self.form.called.format_map(
            {**self.entry, "key": self.key, "index": index, "number": index + 1, **sides}
        )

    def calibration(self) -> Calibration:
        """Make the calibration of the camera from its entry.

        Raises:
            InputError: a key is missing or wrong, the lens model is unknown or ambiguous, or the size is missing.
        """
        if callable(message := self.entry.get("value")):  # a camera of a bag is read when it is chosen
            return replace(self, entry=self.form.compared(message())).calibration()
        word, model, names = self._model()
        given, values = self._lens(model), self._quantities(names)
        sides = [self._side(name, i) for i, name in enumerate(SIDES)]
        values |= self._pinhole(values)
        size = [side for side in sides if side is not None]
        if len(size) < len(sides):
            raise no_size()
        model = self._chosen(model, given, word)
        known = COEFFICIENTS[model]
        if more := [name for name in DISTORTION if values.get(name) and name not in known]:
            raise InputError(f"its lens has {more[0]} = {values[more[0]]:g}, which the model {model} lacks.")
        lens = given if "lens" in self.form.at else [values.get(name, 0.0) for name in known]
        if model == EQUIDISTANT and not any(lens[len(known) :]):
            lens = lens[: len(known)]
        found = _nearest(model, lens, values | dict(zip(known, lens, strict=False)), size)
        asked = self.asked.get("distortion_model")
        if asked is not None and model != INVERSE and lens_model(asked, LENS_MODELS) != found.model:
            raise InputError(
                f"distortion_model must be {found.model}: the file has this model, not {asked}.", "distortion_model"
            )
        off = f"its lens model {model} is approximated by {found.model}, which is up to {found.worst:.2f} pixels off"
        pinhole = (found.focal_pixels, found.principal_point)
        note = off if found.worst > GOOD_PIXELS else ""
        width, height = size
        return Calibration(width, height, *pinhole, found.coefficients, found.model, note=note)  # type: ignore[arg-type]

    def _lens(self, model: str) -> list[float]:
        """Coefficients of the lens; empty if the format or the lens model has none."""
        path = self.form.at.get("lens", "")
        value = self.value(path) if path else []
        optional = path.endswith("?") or model in ("none", *MODELS)
        return [] if value == [] or (value is MISSING and optional) else list(self.numbers(path, None))

    def _side(self, name: str, index: int) -> float | None:
        """Width (`index` 0) or height (1) of the image, pixels; None if neither the file nor the user gives it."""
        if name in self.form.at and self.value(self.form.at[name]) is not MISSING:
            return self.numbers(self.form.at[name])[0]
        if "size" in self.form.at and self.value(self.form.at["size"]) is not MISSING:
            return self.numbers(self.form.at["size"], 2)[index]
        size = self.asked.get("image_size")
        return None if size is None else float(size[index])

    def _model(self) -> tuple[str, str, list[str]]:
        """Lens model as the file names it; standard name of the model; and names of the quantities in the file's lists.

        The paths `values` of the format lead to these lists. Names are in the order of the lists; the form
        `ours=theirs` adds the file's own name.
        """
        said = [self.value(path) for path in self.form.model]
        needed = [path for path, word in zip(self.form.model, said, strict=True) if word is MISSING and path[-1] != "?"]
        if len(said) > 1 and needed:
            raise InputError(f"the key {needed[0]} is missing.")
        words = "_".join(str(word) for word in said if word is not MISSING)
        if not words and not any(re.fullmatch(pattern, "") for pattern in self.form.models):
            raise InputError(f"the key {self.form.model[0].split('|')[0]} is missing.")
        name, _, names = lens_model(words, self.form.models).partition(":")
        return words, name, names.split()

    def _chosen(self, model: str, lens: Sequence[float], word: str) -> str:
        """Lens model of the file or, if it is unclear, the model that the user names.

        Args:
            model: the file's lens model, which may be `unsaid` or `INVERSE`.
            lens: coefficients in the file.
            word: name of the model in the file.

        Raises:
            InputError: neither the file nor the user determines the model.
        """
        asked = self.asked.get("distortion_model")
        if model == INVERSE and any(lens) and asked is None:
            raise InputError(
                "distortion_model must be given: the file's coefficients are of "
                f"{'the inverse Brown-Conrady model' if word else 'an unnamed model'}, which librealsense "
                f"documents as undistorting ({INVERSE}) but computes as distorting (plumb_bob, as ROS does).",
                "distortion_model",
            )
        if model == INVERSE:
            return "none" if not any(lens) else INVERSE if asked == INVERSE else lens_model(asked, LENS_MODELS)
        if model == "unsaid" and asked is None and len(lens) == UNCLEAR and any(lens):
            raise InputError(
                "distortion_model must be given: the file names no lens model, and its 4 coefficients may be those of "
                "cv2.fisheye (fisheye) or k1, k2, p1, p2 (plumb_bob).",
                "distortion_model",
            )
        return model if model != "unsaid" else "plumb_bob" if asked is None else lens_model(asked, LENS_MODELS)

    def _quantities(self, names: Sequence[str]) -> dict[str, float]:
        """Intrinsics and lens coefficients of the camera, keyed by name.

        `names` are the names of the quantities in the file's lists, as `_model` returns them.
        """
        found: dict[str, float] = {}
        pairs = [(ours, theirs or ours) for ours, _, theirs in (name.partition("=") for name in names)]
        for path in map(self.path, self.form.values):
            ended = {name.removeprefix(path): value for name, value in self.entry.items() if name.startswith(path)}
            value = ended if path.endswith(".") else find(self.entry, path)
            if isinstance(value, Mapping):
                own = pairs or [(name, name) for name in QUANTITIES]
                found |= {ours: number_at(value, name) for ours, name in own if name in value}
            elif value is not MISSING and not pairs:
                raise InputError(f"{path} must have keys such as fx, got {value!r}.")
            elif value is not MISSING:
                found |= zip([ours for ours, _ in pairs], vector_at(self.entry, path, len(pairs)), strict=True)
        for name, path in {**{name: name for name in self.form.named.split()}, **self.form.at}.items():
            if name in QUANTITIES and self.value(path) is not MISSING:
                found[name] = self.numbers(path)[0]
        return found

    def _pinhole(self, values: Keys) -> dict[str, float]:
        """Focal lengths and principal point, pixels, keyed by the names fx, fy, cx and cy.

        The principal point counts from the centre of the image's first pixel. `values` are the results of
        `_quantities`.
        """
        found, skew = dict(values), values.get("skew", 0.0)
        for name in ("matrix", "columns"):
            path = self.form.at.get(name, "")
            if not path or (path.endswith("?") and self.value(path) is MISSING):
                continue
            matrix = self.numbers(path, 9)
            rows = matrix if name == "matrix" else tuple(np.reshape(matrix, (3, 3)).T.ravel().tolist())
            found["fx"], skew, found["cx"], below, found["fy"], found["cy"], *last = rows
            skew = skew or below or last != [0.0, 0.0, 1.0]
        if skew:
            raise InputError("its camera matrix must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], without skew, and row by row.")
        if "f" in found:
            found["fx"] = found["fy"] = found["f"]
        if missing := [name for name in PINHOLE if name not in found]:
            path = ".".join([*(path.rstrip(".") for path in self.form.values[:1]), missing[0]])
            raise InputError(f"the key {self.form.at.get(missing[0], path).split('|')[0]} is missing.")
        return {name: found[name] - (self.form.origin if name[0] == "c" else 0.0) for name in PINHOLE}

    def poses(self) -> dict[str, FloatArray]:
        """Poses `(4, 4)` with the keys `body` and `step`, if the file has them.

        `body` is the pose of the camera's optical frame in the frame of the body that carries the camera; `step` is the
        pose of the previous camera in this camera's optical frame.

        Raises:
            InputError: a pose is not a rigid motion.
        """
        found: dict[str, FloatArray] = {}
        for name in POSES:
            if name in self.form.at and (value := self.value(self.form.at[name])) is not MISSING:
                pose = _pose_of(value)
                found[name.removesuffix("_inverse")] = inverse(pose) if name == "body_inverse" else pose
        return found


def _nearest(model: str, lens: Sequence[float], values: Mapping[str, float], size: Sequence[Any]) -> Restated:
    """Lens and intrinsics of a camera, with a lens model that `lmd.geometry.lens` supports.

    If the file has another lens model, a supported lens and its intrinsics are fitted to the file's lens.

    Args:
        model: lens model of the file.
        lens: coefficients of the lens.
        values: intrinsics and coefficients, keyed by name.
        size: width and height of the image, pixels.
    """
    focal, centre = (values["fx"], values["fy"]), (values["cx"], values["cy"])
    if model in MODELS:
        return restated(model, values, size)
    plumb_bob = [values.get(name, 0.0) for name in COEFFICIENTS[MODIFIED]]
    if model == MODIFIED:
        return nearest_lens(modified_brown_conrady(*plumb_bob), focal, centre, size, plumb_bob)
    if model == INVERSE:
        return nearest_lens(inverse_brown_conrady(*plumb_bob), focal, centre, size, [-k for k in plumb_bob])
    return Restated(focal, centre, "plumb_bob" if model == "none" else model, tuple(lens), 0.0)


def _pose_of(value: Any) -> FloatArray:
    """Pose `(4, 4)` from the keys px, py, pz, qx, qy, qz, qw, or from the 16 numbers of its matrix, row by row."""
    if isinstance(value, Mapping) and "data" not in value:
        return np.asarray(poses_from_rows(np.array([[number_at(value, key) for key in POSE]]))[0])
    return transform_of(numbers_of(value), "matrix")
