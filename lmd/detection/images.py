"""Images of one camera: a folder of photographs, or a video."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lmd.core.checks import InputError, check_fields, file_path, real
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.render.imaging import UInt8Array
from lmd.render.optics import image_size
from lmd.scene.camera import Camera

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
UNREAD = (".heic", ".heif", ".avif", ".dng", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".gif")  # which cameras write


class Images(Protocol):
    """Grey images that are read when they are needed, if need be by several processes."""

    @property
    def names(self) -> Sequence[str]:
        """What each is called, in order."""

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """The images from `first` up to but not including `last`, `(h, w)` each.

        Raises:
            InputError: one cannot be read, or is not of the camera's size.
        """


@dataclass(frozen=True)
class Photographs:
    """The images of a folder, by name.

    Args:
        folder: where they are.
        argument: the argument it came from, for messages.

    Raises:
        InputError: there is no such folder, or no image in it.
    """

    folder: str | Path
    argument: str = "folder"

    def __post_init__(self) -> None:
        if not file_path(self.argument, self.folder).is_dir():
            raise InputError(f"{self.argument}: there is no folder {str(self.folder)!r}.", self.argument)
        if not self.paths:
            raise InputError(
                f"{self.argument}: {str(self.folder)!r} has no images ({', '.join(IMAGES)}).", self.argument
            )

    @cached_property
    def paths(self) -> list[Path]:
        """The files."""
        return sorted(path for path in Path(self.folder).iterdir() if path.suffix.lower() in IMAGES)

    @property
    def unread(self) -> list[str]:
        """The names of images of formats that are not read."""
        return sorted(path.name for path in Path(self.folder).iterdir() if path.suffix.lower() in UNREAD)

    @property
    def names(self) -> list[str]:
        """See `Images.names`: those of the files."""
        return [path.name for path in self.paths]

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`."""
        for path in self.paths[first:last]:
            yield read_image(path, camera, self.argument)


@dataclass(frozen=True)
class Video:
    """Some frames of a video; their names are their times, seconds.

    Args:
        path: the file.
        rate: frames a second that are taken; at most all are.
        argument: the argument the path came from, for messages.

    Raises:
        InputError: the file is no video that OpenCV can read, or the rate is not positive.
    """

    path: str | Path
    rate: float
    argument: str = "path"

    def __post_init__(self) -> None:
        check_fields(self, real, "rate", above=0.0)
        if not file_path(self.argument, self.path).is_file():
            raise InputError(f"{self.argument}: there is no file {str(self.path)!r}.", self.argument)
        frames, own = self._extent
        if not (frames >= 1.0 and own > 0.0):
            raise InputError(f"{self.argument}: {str(self.path)!r} cannot be read as a video.", self.argument)

    @cached_property
    def _extent(self) -> tuple[float, float]:
        """The number of frames, and how many there are a second."""
        cv2, video = optional("cv2", "detection"), self._opened()
        try:
            return float(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
        finally:
            video.release()

    @cached_property
    def numbers(self) -> list[int]:
        """The frames that are taken."""
        frames, own = self._extent
        return list(range(0, int(frames), max(1, round(own / self.rate))))

    @property
    def names(self) -> list[str]:
        """See `Images.names`."""
        return [f"{number / self._extent[1]:.6f}" for number in self.numbers]

    def _opened(self) -> Any:
        return optional("cv2", "detection").VideoCapture(str(self.path))

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`; a video that ends before it said so has fewer."""
        cv2, video = optional("cv2", "detection"), self._opened()
        at, wanted = self.numbers[first], self.numbers[first:last]
        try:
            video.set(cv2.CAP_PROP_POS_FRAMES, at)
            for number in range(at, wanted[-1] + 1):
                if not video.grab():
                    return
                if number not in wanted:
                    continue
                image: UInt8Array = cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2GRAY)
                if image.shape[::-1] != image_size(camera):
                    raise _wrong_size(Path(self.path), self.argument, image.shape[::-1], image_size(camera))
                yield image
        finally:
            video.release()


def read_image(path: Path, camera: Camera, argument: str) -> UInt8Array:
    """A grey image, `(h, w)`.

    Args:
        camera: has the size that it must have.
        argument: the argument the path came from, for messages.

    Raises:
        InputError: it cannot be read, or is not of the camera's size.
    """
    cv2 = optional("cv2", "detection")
    content = read_bytes(path, argument)
    size = image_size(camera)
    written = _pixels(content)
    if written in (size, size[::-1]):
        # How the camera was held stands in the image. A calibration is of the pixels as the sensor has them, however
        # that was held, unless its size says that they were turned before.
        turned = cv2.IMREAD_GRAYSCALE | (cv2.IMREAD_IGNORE_ORIENTATION if written == size else 0)
        image: UInt8Array | None = cv2.imdecode(np.frombuffer(content, np.uint8), turned)
        written = None if image is None else image.shape[::-1]
        if image is not None and written == size:
            return image
    if written is None:
        raise InputError(f"{argument}: {str(path)!r} cannot be read as an image.", argument)
    raise _wrong_size(path, argument, written, size)


def _wrong_size(path: Path, argument: str, written: tuple[int, ...], size: tuple[int, int]) -> InputError:
    found, needed = (" x ".join(map(str, pair)) for pair in (written, size))
    return InputError(f"{argument}: {str(path)!r} has {found} pixels, the camera {needed}.", argument)


def _pixels(content: bytes) -> tuple[int, ...] | None:
    """Width and height that an image says it has: a small file may stand for gigabytes. None if it is no image."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as header:
            return header.size
    except Exception:  # whatever a reader of a broken file runs into
        return None
