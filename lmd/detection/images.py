"""Images of one camera, such as a folder of photographs."""

import hashlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from lmd.core.checks import InputError, file_path, printable
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
UNREAD = (".heic", ".heif", ".avif", ".dng", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".gif")  # which cameras write


class Images(Protocol):
    """Grey images that are read when they are needed, if need be by several processes."""

    @property
    def names(self) -> Sequence[str]:
        """What each is called, in order."""

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks on those that are not read, a sentence each without its end."""

    @property
    def is_random_access(self) -> bool:
        """True if an image is read without those before it."""

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
        """The files."""
        return self._with(IMAGES)

    @property
    def unread(self) -> list[str]:
        """The names of images of formats that are not read."""
        return [printable(path.name) for path in self._with(UNREAD)]

    @property
    def remarks(self) -> list[str]:
        """See `Images.remarks`."""
        left = self.unread
        return [f"{len(left)} images of {str(self.folder)!r} are not read, such as {left[0]}"] if left else []

    @property
    def names(self) -> list[str]:
        """See `Images.names`: those of the files, as they can be written and printed."""
        return [printable(path.name) for path in self.paths]

    @cached_property
    def repeated(self) -> dict[str, str]:
        """The names of files with the contents of an earlier one, and the name of that."""
        first: dict[bytes, str] = {}
        digests = [hashlib.sha256(read_bytes(path, self.argument)).digest() for path in self.paths]
        earlier = [first.setdefault(digest, name) for digest, name in zip(digests, self.names, strict=True)]
        return {name: one for name, one in zip(self.names, earlier, strict=True) if one != name}

    def _with(self, suffixes: Sequence[str]) -> list[Path]:
        """The files whose names end so, by their names."""
        paths = [path for path in folder_entries(self.folder, self.argument) if path.suffix.lower() in suffixes]
        return sorted(paths, key=lambda path: printable(path.name))

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`."""
        for path in self.paths[first:last]:
            yield read_image(path, camera, self.argument)


def folder_entries(folder: str | Path, argument: str) -> list[Path]:
    """The entries of a folder, by name.

    Args:
        argument: the argument the path came from, for messages.

    Raises:
        InputError: there is no such folder, or it cannot be read.
    """
    try:
        return sorted(file_path(argument, folder).iterdir())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{argument}: there is no folder {str(folder)!r}.", argument) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{argument}: the folder {str(folder)!r} cannot be read ({reason}).", argument) from None


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
    raise wrong_size(path, argument, written, size)


def wrong_size(path: Path, argument: str, written: tuple[int, ...], size: tuple[int, int]) -> InputError:
    """The error that an image or a video has not the size of the camera."""
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
