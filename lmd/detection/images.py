"""Images of one camera from a folder of photographs, and the blur of an image with tags."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, file_path, printable
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.detection.detectors import Detections
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP")  # Pillow's names of these formats
# Suffixes of image formats that cannot be read.
UNREAD = (".heic", ".heif", ".avif", ".dng", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".gif")
# Minimum pitch of tags whose edges are measured, pixels per module; maximum distance of samples from an edge, pixels.
LEAST_PITCH, WIDEST_EDGE = 3.0, 12.0
# Number of samples along an edge and across it.
SAMPLES, STEPS = 12, 65
# Part of an edge that is sampled, as shares of its length; the blurred corners are excluded.
EDGE_PART = (0.2, 0.8)
# Two grey levels, as shares of the step from black to white; on a blurred edge they are two standard deviations apart.
LOW, HIGH = 0.16, 0.84
# A frame counts as blurred if its blur exceeds `TIMES` times the median blur, and also `LEAST` pixels.
TIMES, LEAST = 2.0, 1.0


class Images(Protocol):
    """Interface of a sequence of grey images, which are read on demand, possibly by several processes."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the images, in order."""

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks for the user, such as on files that are not read; each is a sentence without a full stop."""

    @property
    def is_random_access(self) -> bool:
        """True if an image can be read without reading the images before it."""

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """Read images `first` to `last` (excluded), `(h, w)` each; they must have the size of `camera`.

        Raises:
            InputError: an image cannot be read, or its size differs from the camera's.
        """


@dataclass(frozen=True)
class Photographs:
    """Images of a folder, ordered by name.

    Raises:
        InputError: the folder does not exist, or has no image.
    """

    folder: str | Path
    """Folder of the images."""
    argument: str = "folder"
    """Name of the argument that gave the folder, for messages."""

    def __post_init__(self) -> None:
        if not self.paths:
            raise InputError(
                f"{self.argument}: {str(self.folder)!r} has no images ({', '.join(IMAGES)}).", self.argument
            )

    @property
    def is_random_access(self) -> bool:
        """See `Images.is_random_access`."""
        return True

    @cached_property
    def paths(self) -> list[Path]:
        """Files of the images."""
        return self._with(IMAGES)

    @property
    def unread(self) -> list[str]:
        """Names of the image files whose format is not supported."""
        return [printable(path.name) for path in self._with(UNREAD)]

    @property
    def remarks(self) -> list[str]:
        """See `Images.remarks`."""
        left = self.unread
        return [f"{len(left)} images of {str(self.folder)!r} are unsupported, such as {left[0]}"] if left else []

    @property
    def names(self) -> list[str]:
        """See `Images.names`: names of the files; characters that cannot be encoded are replaced."""
        return [printable(path.name) for path in self.paths]

    def _with(self, suffixes: Sequence[str]) -> list[Path]:
        """Files of the folder whose names have one of the suffixes, ordered by name."""
        paths = [path for path in folder_entries(self.folder, self.argument) if path.suffix.lower() in suffixes]
        return sorted(paths, key=lambda path: printable(path.name))

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`."""
        for path in self.paths[first:last]:
            yield read_image(path, camera, self.argument)


def folder_entries(folder: str | Path, argument: str) -> list[Path]:
    """Entries of a folder, ordered by name.

    Args:
        folder: path of the folder.
        argument: name of the argument that gave the path, for messages.

    Raises:
        InputError: the folder does not exist or cannot be read.
    """
    try:
        return sorted(file_path(argument, folder).iterdir())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{argument}: there is no folder {str(folder)!r}.", argument) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{argument}: the folder {str(folder)!r} cannot be read ({reason}).", argument) from None


def read_image(path: Path, camera: Camera, argument: str) -> UInt8Array:
    """Read an image file as a grey image, `(h, w)`.

    Args:
        path: file of the image.
        camera: camera whose image size the file must have.
        argument: name of the argument that gave the path, for messages.

    Raises:
        InputError: the file cannot be read, or its size differs from the camera's.
    """
    cv2 = optional("cv2", "detection")
    content = read_bytes(path, argument)
    size = image_size(camera)
    written = pixels_of(content)
    if written in (size, size[::-1]):
        # The file may state a rotation for display. The rotation is ignored, as a calibration is in the sensor's
        # orientation, unless the calibrated size shows that the calibration used rotated images.
        turned = cv2.IMREAD_GRAYSCALE | (cv2.IMREAD_IGNORE_ORIENTATION if written == size else 0)
        image: UInt8Array | None = cv2.imdecode(np.frombuffer(content, np.uint8), turned)
        written = None if image is None else image.shape[::-1]
        if image is not None and written == size:
            return image
    if written is None:
        raise InputError(f"{argument}: {str(path)!r} cannot be read as an image.", argument)
    raise wrong_size(path, argument, written, size)


def wrong_size(path: Path, argument: str, written: tuple[int, ...], size: tuple[int, int]) -> InputError:
    """Error that an image or a video does not have the size of the camera.

    `written` is the size of the image or video, and `size` that of the camera, (width, height), pixels.
    """
    found, needed = (" x ".join(map(str, pair)) for pair in (written, size))
    return InputError(f"{argument}: {str(path)!r} has {found} pixels, but the camera has {needed}.", argument)


def pixels_of(content: bytes) -> tuple[int, ...] | None:
    """Width and height from the header of an image file; None if the file is not an image.

    Callers check this size before decoding, as a small file may decode to gigabytes.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as header:
            return header.size
    except Exception:  # readers may raise any error for a broken file
        return None


def blur_of(image: UInt8Array, found: Detections, modules: int) -> float:
    """Blur of an image, pixels: the median, over the tags in the image, of the blur of a tag.

    The blur of a tag is the standard deviation of the blur across the second most blurred edge of the tag. Across an
    edge, the grey level rises from black to white. The distance between 16 and 84 % of the rise is two standard
    deviations of the blur. Motion blurs only the two edges perpendicular to the motion, so the second most blurred edge
    shows motion blur, too.

    Args:
        image: grey image, `(h, w)`.
        found: detections in the image.
        modules: number of modules along an edge of a tag.

    Returns:
        blur, pixels; NaN if no tag is large enough.
    """
    from scipy.ndimage import map_coordinates

    starts, ends = found.corners, np.roll(found.corners, -1, axis=1)  # clockwise, so the outside is on the left
    along = ends - starts
    lengths = np.linalg.norm(along, axis=-1)
    pitch = lengths.min(axis=1) / modules
    own = pitch >= LEAST_PITCH
    if not own.any():
        return float("nan")
    starts, along, lengths, pitch = starts[own], along[own], lengths[own], pitch[own]
    outwards = np.stack([along[..., 1], -along[..., 0]], axis=-1) / lengths[..., None]
    reach = np.minimum(0.9 * pitch, WIDEST_EDGE)
    offsets = np.linspace(-1.0, 1.0, STEPS)
    middle = starts[:, :, None] + np.linspace(*EDGE_PART, SAMPLES)[:, None] * along[:, :, None]  # (M, 4, S, 2)
    places = (
        middle[:, :, :, None] + (reach[:, None, None] * offsets[:, None])[:, None, None] * outwards[:, :, None, None]
    )
    grey = map_coordinates(
        image.astype(np.float64), np.moveaxis(places[..., ::-1] - 0.5, -1, 0), order=1, mode="nearest"
    )
    across = grey.mean(axis=2)
    rises = across[..., -1:] >= across[..., :1]  # in some families the white side is inside
    profile = np.maximum.accumulate(np.where(rises, across, across[..., ::-1]), axis=-1)  # from black to white
    low, high = profile[..., :1], profile[..., -1:]
    step = (profile - low) / np.maximum(high - low, 1.0)
    width = ((step < HIGH) & (step >= LOW)).sum(axis=-1) * (2.0 * reach / (STEPS - 1))[:, None] / 2.0
    return float(np.median(np.sort(width, axis=1)[:, -2]))


def blurred(blurs: FloatArray) -> BoolArray:
    """Mask of the frames whose blur is far above the median blur of all frames, `(F,)`.

    `blurs` is the blur of each frame, pixels, `(F,)`; NaN counts as sharp.
    """
    known = blurs[np.isfinite(blurs)]
    usual = np.median(known) if known.size else np.inf
    return np.asarray(np.nan_to_num(blurs) > max(TIMES * usual, LEAST))
