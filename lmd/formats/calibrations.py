"""Cameras from calibration files; `tables/calibration.yaml` lists the formats.

In the results of all readers, the origin of pixel coordinates is the centre of the image's first (top left) pixel.
`lmd` itself has the origin at the outer corner of this pixel: its principal point is larger by 0.5, all other values
are equal.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

from lmd.core.checks import Checked, Count, FloatArray, InputError, Pair, real, said_of, vector
from lmd.formats.registry import read
from lmd.formats.trees import File, Keys, arrays_of, tree_of
from lmd.geometry.camera import PIXEL_CENTRE, Camera
from lmd.geometry.lens import EQUIDISTANT, lens_of

ASKED = ("image_size", "distortion_model")  # settings that a file may lack
# Models of `lmd.geometry.lens`, by their names in files of ROS, Kalibr, EuRoC and OpenCV.
LENS_MODELS = {
    **dict.fromkeys(("plumb_bob", "radtan", "none", "radial_tangential", "brown_conrady"), "plumb_bob"),
    **dict.fromkeys((EQUIDISTANT, "fisheye", "kannala_brandt"), EQUIDISTANT),
    "rational_polynomial": "rational_polynomial",
}
# Separator of the messages that tools of ROS print.
FIRST_MESSAGE = re.compile(r"(?<=\n)---[ \t]*\n(?=header:)")
SHORTEST = 0.05  # minimum focal length, as a share of the image's size; shorter lengths are refused
LARGEST = 1 << 25  # maximum size of a file, bytes: some files contain every detected point, or the images
UNDISTORTED = (0.0,) * 5  # coefficients of a lens without distortion, of the model plumb_bob
OPTICS = ("focal_length", "aperture", "focus_distance", "image_circle")  # settings that no calibration file contains


@dataclass(frozen=True)
class Calibration(Checked):
    """Intrinsic calibration of a camera, in pixels.

    Args:
        image_width, image_height: width w and height h of the image.
        focal_pixels: focal lengths (f / s_u, f / s_v), for the focal length f and pixels of the sides s_u and s_v.
        principal_point: principal point (c_x, c_y), counted from the centre of the first pixel as in OpenCV.
        distortion, distortion_model: coefficients and model of the lens, see `lmd.geometry.lens.Lens`.
        image_circle: diameter of the image circle, pixels; infinite if the file has none.
        note: remark for the user on how the values were obtained.

    Raises:
        InputError: a value is out of range, or the lens model is unknown.
    """

    image_width: Count
    image_height: Count
    focal_pixels: Annotated[tuple[float, ...], partial(vector, size=2, above=0.0)]
    principal_point: Pair
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    image_circle: float = math.inf
    note: str = field(default="", compare=False)

    def _validate(self) -> None:
        size = (self.image_width, self.image_height)
        if any(focal < SHORTEST * side for focal, side in zip(self.focal_pixels, size, strict=True)):
            told = " x ".join(f"{focal:.4g}" for focal in self.focal_pixels)
            raise InputError(
                f"the focal lengths, {told}, must be in pixels of an image of {size[0]} x {size[1]}; check that they "
                "are not divided by its size"
            )
        lens = lens_of(self.distortion_model, self.distortion)
        object.__setattr__(self, "distortion", () if lens is None else lens.coefficients)
        if lens is None:
            object.__setattr__(self, "image_circle", math.inf)  # a pinhole has no image circle

    def camera(self, focal_length: float | None = None, aperture: float | None = None, **lens: float) -> Camera:
        """Make a camera with this calibration.

        Without an aperture it is a pinhole camera, whose images are sharp at any depth.

        Args:
            focal_length: f, mm; determines the size of a pixel, which matters only for the focus.
            aperture: effective diameter d_a, mm.
            lens: further arguments of `Camera`, `focus_distance` and `image_circle`.

        Raises:
            InputError: an aperture or a focus distance lacks a setting that it needs, or `Camera` refuses a value.
        """
        if aperture is not None and focal_length is None:
            raise InputError("focal_length must be given, in mm, if aperture is given.", "focal_length")
        if aperture is None and lens.get("focus_distance", math.inf) != math.inf:
            raise InputError("aperture must be given, in mm, if focus_distance is given.", "aperture")
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
    """Make a camera from a calibration file.

    Args:
        path, name: the file, and the camera in a file with several cameras.
        image_size, distortion_model: size (pixels) and lens model for a file that lacks them, see `read_calibration`.
        focal_length, aperture: lengths in mm that no calibration states, see `Calibration.camera`.
        focus_distance, image_circle: see `Camera`.

    Raises:
        InputError: see `read_calibration` and `Calibration.camera`.
    """
    calibration = read_calibration(path, name, image_size, distortion_model)
    with said_of(path, known=OPTICS):
        return calibration.camera(focal_length, aperture, focus_distance=focus_distance, image_circle=image_circle)


class CalibrationFile(File):
    """File of a calibration: a text, XML, or an archive of arrays (`.npz`)."""

    @cached_property
    def arrays(self) -> Keys | None:
        """Arrays of an archive, keyed by name; None for a text file."""
        arrays = arrays_of(self.path, self.argument, self.largest)
        return None if arrays is None else {name: array.tolist() for name, array in arrays.items()}

    @cached_property
    def text(self) -> str:
        """Text of the file; of a file with several messages of ROS, only the first message. Empty for an archive of
        arrays.
        """
        return FIRST_MESSAGE.split(super().text)[0] if self.arrays is None else ""

    @cached_property
    def data(self) -> Keys:
        """Content of the file as keys and values: from YAML, JSON or XML, or the arrays of an archive, keyed by name.

        Raises:
            InputError: the text has another format.
        """
        if self.arrays is not None:
            return self.arrays
        if self.root is None:
            return super().data
        tree = tree_of(self.root)
        return tree if isinstance(tree, dict) else {}


class ReadCamera(NamedTuple):
    """Camera in a file, as two functions: one returns its `Calibration`, the other returns its poses.

    The file's values are interpreted only when a function is called.
    """

    calibration: Callable[[], Calibration]
    """Function that returns the calibration."""
    poses: Callable[[], Mapping[str, FloatArray]] = dict
    """Function that returns poses of the camera's optical frame, `(4, 4)`, keyed by frame of reference: `body` or
    `step`. See `lmd.formats.keyed_cameras.KeyedCameras`.
    """


def lens_model(word: Any, models: Mapping[str, str]) -> str:
    """Standard name of the lens model that a file or a user calls `word`.

    Args:
        word: name of the lens model in the file or from the user.
        models: standard names of lens models, keyed by a pattern (regular expression in lower case) of the names that
            files use, see `lmd.formats.keyed_cameras.KeyedCameras.models`.

    Raises:
        InputError: no pattern matches.
    """
    spelled = re.sub(r"[ -]+", "_", str(word).strip().lower())
    if found := next((model for pattern, model in models.items() if re.fullmatch(pattern, spelled)), ""):
        return found
    known = dict.fromkeys(model.partition(":")[0] for model in models.values() if model not in ("", "unsaid"))
    raise InputError(
        f"the lens model {word!r} is not supported, only {', '.join(known)}: calibrate with Kalibr's pinhole-radtan or "
        "pinhole-equi (Kannala-Brandt), or convert the model, for example with mrcal-convert-lensmodel."
    )


def no_size() -> InputError:
    """Make the error for a calibration file that does not state the size of the images."""
    return InputError(
        "image_size must be given, [width, height] in pixels: image_width or image_height is missing.", "image_size"
    )


def read_calibration(
    path: str | None,
    name: str | None = None,
    image_size: Iterable[int] | None = None,
    distortion_model: str | None = None,
) -> Calibration:
    """Read the calibration of one camera from a file in a format of `tables/calibration.yaml`.

    Args:
        path: path of the file.
        name: name of the camera in a file with several cameras, such as Kalibr's `cam1`; not needed for a single
            camera. With `image_size`, the part before `/` suffices for names such as `color/1280x720`.
        image_size: width and height, pixels; needed if the file lacks the size.
        distortion_model: lens model, by OpenCV's names such as `fisheye`, if the file names none; needed for four
            coefficients, and for RealSense's "inverse Brown Conrady".

    Raises:
        InputError: the file cannot be read, a key is missing or wrong, the size or the model contradicts the file, or
            the lens model is unknown.
    """
    if path is None:
        raise InputError("path is missing: a calibration file is needed.", "path")
    size = None if image_size is None else vector("image_size", image_size, 2, above=0.0)
    cameras = read_cameras(path, size, distortion_model)
    with _damaged(path):
        found = cameras[_chosen(path, list(cameras), name, size)].calibration()
    if size not in (None, known := (found.image_width, found.image_height)):
        raise InputError(f"image_size must be {list(known)}, as {path} states, got {list(size)}.", "image_size")
    return replace(found, note=f"{path}: {found.note}") if found.note else found


def _chosen(path: str, names: list[str], name: str | None, size: tuple[float, ...] | None) -> str:
    """Choose one of the cameras `names`: the camera `name`, or the camera whose name begins with `name` and `/`.

    If several names begin in this way, the camera with the image size `size` in its name is chosen. A camera without a
    name is the empty text.
    """
    if not names:
        raise InputError(f"path: {path} has no camera in its list.", "path")
    cameras = [key for key in names if key]
    if name in cameras:
        return str(name)
    left = cameras if name is None else [key for key in cameras if key.startswith(f"{name}/")]
    if name is not None and not left:
        raise InputError(f"name = {name!r} is not a camera of {path}, which has {', '.join(cameras) or 'one'}.", "name")
    if size is not None and (sized := [key for key in left if f"/{size[0]:.0f}x{size[1]:.0f}" in key]):
        left = sized
    if len(left) > 1:
        raise InputError(f"name must be given: {path} has the cameras {', '.join(left)}.", "name")
    return left[0] if left else ""


def read_cameras(
    path: Any, image_size: Any = None, distortion_model: str | None = None, argument: str = "path"
) -> dict[str, ReadCamera]:
    """Read the cameras of a file, keyed by name; a camera without a name has the name "".

    Args:
        path: path of the file, at most `LARGEST` bytes.
        image_size, distortion_model: size (pixels) and lens model for a file that lacks them, see `read_calibration`.
        argument: name of the argument that gave the path, for messages.

    Raises:
        InputError: the file cannot be read, or has another format.
    """
    asked = {"image_size": image_size, "distortion_model": distortion_model}
    with _damaged(path):
        cameras: dict[str, ReadCamera] = read("calibration", CalibrationFile(path, argument, asked, LARGEST))
    return cameras


def camera_info(camera: Camera) -> dict[str, Any]:
    """Keys and values of a calibration file in ROS's format for a camera. In this format, pixel coordinates count from
    the centre of the first pixel.
    """
    (focal_u, focal_v), (u, v) = camera.focal_pixels.tolist(), camera.principal_point
    lens = list(camera.distortion or UNDISTORTED)
    matrix = [focal_u, 0.0, u - PIXEL_CENTRE, 0.0, focal_v, v - PIXEL_CENTRE, 0.0, 0.0, 1.0]
    return {
        "image_width": round(camera.image_width),
        "image_height": round(camera.image_height),
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": lens},
    }


@contextmanager
def _damaged(path: Any) -> Iterator[None]:
    """Context manager that turns errors of readers into an `InputError` with a sentence that names the file."""
    try:
        yield
    except InputError as error:
        if error.argument in ("path", "name", "mount"):
            raise
        if error.argument in ASKED:  # such a message begins with the name of its argument
            what, _, why = str(error).partition(": ")
            raise InputError(f"{what}: {path}: {why}", error.argument) from None
        raise InputError(f"{path}: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
        raise InputError(f"{path}: the key or value {error} is missing or wrong.") from None
