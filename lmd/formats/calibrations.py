"""Cameras from calibration files, see `lmd.formats.calibration_formats`.

All readers give pixels that count from the centre of the first pixel. `lmd` counts from the image's border, which adds
0.5 to the principal point; no other value changes.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from lmd.core.checks import InputError, check_fields, integer, real, said_of, vector
from lmd.formats.calibration_formats import CalibrationFile
from lmd.formats.calibration_readers import ANSWERED, CIRCLE, LENS_MODELS, NOTE, Cameras, known_lens, no_size
from lmd.formats.registry import read
from lmd.geometry.camera import PIXEL_CENTRE, Camera
from lmd.geometry.lens import lens_of

SIZE = ("image_width", "image_height")
ASKED = ("image_size", "distortion_model")  # settings that a file may lack
UNCLEAR = 4  # number of coefficients that both a pinhole and a fisheye may have
SHORTEST = 0.05  # least focal length, as a share of the image's size; shorter lengths are refused
LARGEST = 1 << 25  # greatest size of a file, bytes: some files hold every detected point, or the images
OPTICS = ("focal_length", "aperture", "focus_distance", "image_circle")  # settings that are in no calibration file


@dataclass(frozen=True)
class Calibration:
    """Intrinsic calibration of a camera, in pixels.

    Args:
        image_width, image_height: w and h.
        focal_pixels: (f / s_u, f / s_v).
        principal_point: (c_x, c_y), from the centre of the first pixel, as OpenCV counts.
        distortion, distortion_model: coefficients and model of the lens, see `lmd.geometry.lens.Lens`.
        image_circle: diameter of the image circle, pixels; infinite if the file has none.
        note: remark for the user on the origin of the values.

    Raises:
        InputError: a value is out of range, or the lens model is unknown.
    """

    image_width: int
    image_height: int
    focal_pixels: tuple[float, ...]
    principal_point: tuple[float, ...]
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    image_circle: float = math.inf
    note: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        check_fields(self, integer, "image_width", "image_height", low=1)
        check_fields(self, vector, "focal_pixels", size=2, above=0.0)
        check_fields(self, vector, "principal_point", size=2)
        size = (self.image_width, self.image_height)
        if any(focal < SHORTEST * side for focal, side in zip(self.focal_pixels, size, strict=True)):
            told = " x ".join(f"{focal:.4g}" for focal in self.focal_pixels)
            raise InputError(
                f"the focal lengths, {told}, must be in pixels of an image of {size[0]} x {size[1]}: are they divided "
                "by its size?"
            )
        lens = lens_of(self.distortion_model, self.distortion)
        object.__setattr__(self, "distortion", () if lens is None else lens.coefficients)
        if lens is None:
            object.__setattr__(self, "image_circle", math.inf)  # a pinhole has no image circle

    def camera(self, focal_length: float | None = None, aperture: float | None = None, **lens: float) -> Camera:
        """Camera with this calibration; without an aperture a pinhole, whose images are sharp at any depth.

        Args:
            focal_length: f, mm; determines the size of a pixel, which matters only for the focus.
            aperture: effective diameter d_a, mm.
            lens: `focus_distance` and `image_circle`, see `Camera`.

        Raises:
            InputError: an aperture or a focus distance lacks a setting that it needs, or `Camera` refuses a value.
        """
        if aperture is not None and focal_length is None:
            raise InputError("focal_length must be given, in mm, where an aperture is.", "focal_length")
        if aperture is None and lens.get("focus_distance", math.inf) != math.inf:
            raise InputError("aperture must be given, in mm, where a focus distance is.", "aperture")
        length = 1.0 if focal_length is None else real("focal_length", focal_length, above=0.0)
        width, height = (length / pixels for pixels in self.focal_pixels)
        u, v = (centre + PIXEL_CENTRE for centre in self.principal_point)
        if lens.get("image_circle", math.inf) == math.inf:
            lens["image_circle"] = self.image_circle
        return Camera(
            focal_length=length,
            pixel_width=width,
            pixel_height=height,
            principal_point=(u, v),
            image_width=self.image_width,
            image_height=self.image_height,
            aperture=0.0 if aperture is None else aperture,
            distortion=self.distortion,
            distortion_model=self.distortion_model,
            note=self.note,
            **lens,
        )


def calibrated_camera(
    path: str | None,
    name: str | None = None,
    image_size: Iterable[int] | None = None,
    distortion_model: str | None = None,
    focal_length: float | None = None,
    aperture: float | None = None,
    focus_distance: float = Camera.focus_distance,
    image_circle: float = Camera.image_circle,
) -> Camera:
    """Camera of a calibration file.

    Args:
        path, name, image_size, distortion_model: see `read_calibration`.
        focal_length, aperture, focus_distance, image_circle: see `Calibration.camera`.

    Raises:
        InputError: see `read_calibration` and `Calibration.camera`.
    """
    calibration = read_calibration(path, name, image_size, distortion_model)
    with said_of(path, known=OPTICS):
        return calibration.camera(focal_length, aperture, focus_distance=focus_distance, image_circle=image_circle)


def read_calibration(
    path: str | None,
    name: str | None = None,
    image_size: Iterable[int] | None = None,
    distortion_model: str | None = None,
) -> Calibration:
    """Read a file of one of the formats of `lmd.formats.calibration_formats`.

    Args:
        name: name of the camera in a file with several cameras, such as `cam1` of Kalibr; not needed if there is only
            one. For names such as `color/1280x720` the part before `/` suffices with `image_size`.
        image_size: width and height, pixels; needed if the file has none.
        distortion_model: model of the lens if the file names none, by OpenCV's names: `fisheye` for its fisheye; needed
            for four coefficients, and for RealSense's "inverse Brown Conrady".

    Raises:
        InputError: the file cannot be read, a key is missing or wrong, the size or the model contradicts the file, or
            the lens model is unknown.
    """
    if path is None:
        raise InputError("path is missing: a calibration file is needed.", "path")
    size = None if image_size is None else vector("image_size", image_size, 2, above=0.0)
    restated = read_cameras(path, name, size, distortion_model)
    chosen = _chosen(path, list(restated), name, size)
    keys = keys_of(path, restated[chosen])
    with said_of(path, known=ASKED):
        found = _calibration(path, keys, size, distortion_model)
    if size not in (None, known := (found.image_width, found.image_height)):
        raise InputError(f"image_size must be {list(known)}, as {path} has it, got {list(size)}.", "image_size")
    return replace(found, note=f"{path}: {found.note}") if found.note else found


def _chosen(path: str, names: list[str], name: str | None, size: tuple[float, ...] | None) -> str:
    """Choose the camera with a name, or with the part of the name before `/` and the size at its end."""
    if not names:
        raise InputError(f"path: {path} has no camera in its list.", "path")
    cameras = [key for key in names if key]
    if name in cameras:
        return str(name)
    left = cameras if name is None else [key for key in cameras if key.startswith(f"{name}/")]
    if name is not None and not left:
        raise InputError(f"name = {name!r} is no camera of {path}, which has {', '.join(cameras) or 'one'}.", "name")
    if size is not None and (sized := [key for key in left if f"/{size[0]:.0f}x{size[1]:.0f}" in key]):
        left = sized
    if len(left) > 1:
        raise InputError(f"name must be given: {path} has the cameras {', '.join(left)}.", "name")
    return left[0] if left else ""


def read_cameras(
    path: Any, only: str | None = None, image_size: Any = None, distortion_model: str | None = None
) -> Cameras:
    """Read the cameras of a file by name, each as keys of ROS; a camera without a name has the name "".

    Args:
        path: path of the file, at most `LARGEST` bytes.
        only: name of the only camera of a chain that is read; other cameras may have unknown lens models.
        image_size, distortion_model: see `read_calibration`.

    Raises:
        InputError: the file cannot be read, a key is missing, or the lens model is unknown.
    """
    asked = {"name": only, "image_size": image_size, "distortion_model": distortion_model}
    with _damaged(path):
        cameras: Cameras = read("calibration", CalibrationFile(path, asked=asked, largest=LARGEST))
    return cameras


def keys_of(path: Any, camera: Mapping[str, Any] | Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
    """Keys of ROS of a camera from `read_cameras`; `path` is for messages."""
    if isinstance(camera, Mapping):
        return camera
    with _damaged(path):
        return camera()


@contextmanager
def _damaged(path: Any) -> Iterator[None]:
    """Context in which errors of readers become sentences that name the file."""
    try:
        yield
    except InputError as error:
        if error.argument == "path":
            raise
        if error.argument in ASKED:  # a message begins with its argument
            what, _, why = str(error).partition(": ")
            raise InputError(f"{what}: {path}: {why}", error.argument) from None
        raise InputError(f"{path}: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{path}: the key or value {error} is missing or wrong.") from None


def _calibration(path: str, keys: Mapping[str, Any], size: tuple[float, ...] | None, asked: str | None) -> Calibration:
    """Calibration from keys of ROS; `asked` is the lens model that the user named, `path` is for messages."""
    matrix = vector("camera_matrix.data", _entry(keys, "camera_matrix", "data"), 9)
    focal_u, skew, centre_u, below, focal_v, centre_v, *last = matrix
    if (skew, below, *last) != (0.0, 0.0, 0.0, 0.0, 1.0):
        raise InputError(f"camera_matrix.data must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], got {list(matrix)}.")
    lens = _numbers("distortion_coefficients.data", _entry(keys, "distortion_coefficients", "data"))
    width, height = (keys.get(name, None if size is None else size[i]) for i, name in enumerate(SIZE))
    if width is None or height is None:
        with _damaged(path):
            raise no_size()
    asked = None if keys.get(ANSWERED) else asked
    name = keys.get("distortion_model") or asked  # drivers leave the model empty
    if name is None and len(lens) == UNCLEAR and any(lens):
        raise InputError(
            f"distortion_model must be given: {path} names no model, and its 4 coefficients may be those of "
            "cv2.fisheye (fisheye) or k1, k2, p1, p2 (plumb_bob).",
            "distortion_model",
        )
    name = name or "plumb_bob"
    model = LENS_MODELS[known_lens(name, LENS_MODELS)]
    if asked is not None and LENS_MODELS[known_lens(asked, LENS_MODELS)] != model:
        raise InputError(f"distortion_model must be {name}, as the file has it, got {asked}.", "distortion_model")
    ends = (keys.get(CIRCLE, math.inf), keys.get(NOTE, ""))
    return Calibration(width, height, (focal_u, focal_v), (centre_u, centre_v), lens, model, *ends)


def _entry(keys: Any, *path: str) -> Any:
    """Value at a path of nested keys.

    Raises:
        InputError: there is no such key.
    """
    for depth, key in enumerate(path):
        if not isinstance(keys, Mapping) or key not in keys:
            raise InputError(f"the key {'.'.join(path[: depth + 1])} is missing.")
        keys = keys[key]
    return keys


def _numbers(name: str, value: Any) -> tuple[float, ...]:
    """List of numbers of any length."""
    return vector(name, value, len(value) if isinstance(value, list) else 5)
