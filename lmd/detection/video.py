"""Frames of a video.

Frames are identified by their times, which need not be equally spaced. Some container formats store no times, and some
do not support seeking.

The decoder would also open playlists, scripts and descriptions of streams, which refer to other files and addresses. So
a file is passed to the decoder only if it begins like a video, and only the demuxer of its container is allowed.
"""

import codecs
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import Checked, InputError, Positive, bounded
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.detection.images import wrong_size
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

# Number of bytes that identify a container.
FIRST = 4096
# Number of packets that must begin with the sync byte for a file to be a transport stream.
LEAST_PACKETS = 4


class Container(NamedTuple):
    """Container format of a video file."""

    name: str
    """Name of the format, for messages."""
    demuxers: str
    """FFmpeg's names of the container's demuxers, separated by commas."""
    begins: re.Pattern[bytes]
    """Pattern that the first bytes of a file in this format match."""


def _kind(name: str, demuxers: str, begins: bytes) -> Container:
    return Container(name, demuxers, re.compile(begins, re.DOTALL))


CONTAINERS = (
    _kind("MP4 and MOV", "mov", rb".{4}(ftyp|styp|moov|mdat|wide|free|skip|pnot)"),
    _kind("Matroska and WebM", "matroska,webm", rb"\x1a\x45\xdf\xa3"),
    _kind("AVI", "avi", rb"RIFF.{4}AVI[ \x19]"),
    _kind("Ogg", "ogg", rb"OggS\0"),
    # Packets of 188 bytes, possibly preceded by a time of 4 bytes (camcorders) or followed by a checksum.
    *(
        _kind("MPEG-TS", "mpegts", rb".{%d}\x47(.{%d}\x47){%d}" % (before, size - 1, LEAST_PACKETS - 1))
        for before, size in ((0, 188), (4, 192), (0, 204))
    ),
    _kind("MPEG-PS", "mpeg", rb"\0\0\x01\xba"),
    # Start code, followed by the type of the first unit: parameters, a delimiter or information.
    _kind("raw H.264", "h264", rb"\0{2,8}\x01[\x07\x27\x47\x67\x06\x09\x29\x49\x69]"),
    _kind("raw H.265", "hevc", rb"\0{2,8}\x01[\x40\x42\x46\x4e]\x01"),
)
IMAGE = re.compile(rb"\x89PNG|\xff\xd8\xff|BM|II\*\0|MM\0\*|RIFF.{4}WEBP|GIF8", re.DOTALL)

# A seek aims at a time before the frame by this, ms, as OpenCV assumes equidistant frames.
LEAD = 500.0
# Maximum difference between times that count as equal, ms.
SAME_TIME = 1e-3
# Maximum plausible number of frames in a header, and rounding error of a number computed from the duration.
MOST_FRAMES, ROUNDED = 1e9, 1
# Maximum number of pixels of a frame; 8K has 3.3e7.
MOST_PIXELS = 10**8


@dataclass(frozen=True)
class Video(Checked):
    """Frames of a video, sampled at a rate; the names of frames are their times, seconds.

    Raises:
        InputError: OpenCV cannot read the file, or the rate is not positive.
    """

    path: str | Path
    """File of the video."""
    rate: Positive
    """Number of frames per second that are read, at most the rate of the video."""
    argument: str = "path"
    """Name of the argument that gave the path, for messages."""

    def _validate(self) -> None:
        head = read_bytes(self.path, self.argument, first=FIRST)
        if container_of(head) is None:
            raise InputError(f"{self.argument}: {str(self.path)!r} {refusal(head)}", self.argument)
        self._opened().release()

    @property
    def names(self) -> list[str]:
        """See `Images.names`."""
        return [f"{self._index.times[number]:.6f}" for number in self.numbers]

    @cached_property
    def numbers(self) -> list[int]:
        """Indices of the sampled frames among all frames of the video."""
        return list(range(0, len(self._index.times), max(1, round(self._index.rate / self.rate))))

    @property
    def remarks(self) -> list[str]:
        """Remarks for the user, see `Images.remarks`."""
        index, remarks = self._index, []
        if index.stated > len(index.times) + ROUNDED:
            remarks.append(f"ends after {len(index.times)} of the {index.stated} frames that its header states")
        if not index.is_timed:
            remarks.append(f"has no times: OpenCV's rate of {index.rate:g} frames a second is assumed")
        return [f"{str(self.path)!r} {remark}" for remark in remarks]

    @property
    def is_random_access(self) -> bool:
        """See `Images.is_random_access`."""
        return self._index.seeks

    @cached_property
    def _index(self) -> "_Index":
        """Times of all frames, and properties of the video that decide how frames are read.

        The whole video is read for this purpose, as the number of frames in the header may be missing or wrong.
        """
        cv2, video = optional("cv2", "detection"), self._opened()
        try:
            stated, rate = video.get(cv2.CAP_PROP_FRAME_COUNT), float(video.get(cv2.CAP_PROP_FPS))
            times = []
            while video.grab():
                times.append(float(video.get(cv2.CAP_PROP_POS_MSEC)))
            if not times:
                raise self._unread("no frame of it can be decoded")
            is_timed, seeks = all(a < b for a, b in pairwise(times)), False
            if is_timed and len(times) > 1:
                rate = 1e3 * (len(times) - 1) / (times[-1] - times[0])
                video.set(cv2.CAP_PROP_POS_MSEC, times[-1] - LEAD)
                now = video.get(cv2.CAP_PROP_POS_MSEC) if video.grab() else 0.0
                seeks = now > times[0] and bool((np.abs(np.array(times) - now) < SAME_TIME).any())
        finally:
            video.release()
        if not 0.0 < rate < np.inf:
            raise self._unread("it has neither times nor a frame rate")
        seconds = [time / 1e3 for time in times] if is_timed else [number / rate for number in range(len(times))]
        return _Index(seconds, rate, int(stated) if 0.0 < stated < MOST_FRAMES else 0, is_timed, seeks)

    def _unread(self, why: str) -> InputError:
        return InputError(f"{self.argument}: {str(self.path)!r} cannot be read as a video: {why}.", self.argument)

    def _opened(self, size: tuple[int, int] | None = None) -> Any:
        """Open the video, and return the OpenCV object that reads it from the first frame on.

        Args:
            size: required width and height. Frames keep the sensor's orientation if they then have this size; otherwise
                they are rotated as the file states. None to accept any size; frames then keep the sensor's orientation.

        Raises:
            InputError: the video cannot be opened, or has frames of another size.
        """
        cv2 = optional("cv2", "detection")
        container = container_of(read_bytes(self.path, self.argument, first=FIRST))
        with _for(container, cv2):
            # FFmpeg interprets names unless they are absolute paths.
            video = cv2.VideoCapture(str(Path(self.path).absolute()), cv2.CAP_FFMPEG)
        if not video.isOpened():
            raise self._unread("OpenCV cannot open it")
        found = []
        for is_turned in (0, 1):
            video.set(cv2.CAP_PROP_ORIENTATION_AUTO, is_turned)
            width, height = (int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            bounded(
                "pixels in a frame", width * height, MOST_PIXELS, f"{self.argument}: {str(self.path)!r}", self.argument
            )
            found.append((width, height))
            if size in (None, found[-1]):
                return video
        video.release()
        assert size is not None, "any size will do"
        raise wrong_size(Path(self.path), self.argument, found[0], size)

    def _at(self, number: int, size: tuple[int, int]) -> Any:
        """Open the video at frame `number`; return the OpenCV object, whose method `retrieve` then decodes this frame.

        `size` is the required width and height.
        """
        cv2, video = optional("cv2", "detection"), self._opened(size)
        if number and self._index.seeks:
            wanted = 1e3 * self._index.times[number]
            video.set(cv2.CAP_PROP_POS_MSEC, max(wanted - LEAD, 0.0))
            while video.grab() and (now := video.get(cv2.CAP_PROP_POS_MSEC)) < wanted + SAME_TIME:
                if now > wanted - SAME_TIME:
                    return video
            video.release()
            video = self._opened(size)
        for _ in range(number + 1):
            video.grab()
        return video

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`."""
        cv2, size = optional("cv2", "detection"), image_size(camera)
        self._opened(size).release()  # report a wrong size before all frames are counted
        wanted = self.numbers[first:last]
        video = self._at(wanted[0], size)
        try:
            for number in range(wanted[0], wanted[-1] + 1):
                is_there = number == wanted[0] or video.grab()
                if is_there and number not in wanted:
                    continue
                is_there, frame = video.retrieve() if is_there else (False, None)
                if not is_there:
                    raise self._unread(f"frame {number} of {len(self._index.times)} cannot be decoded again")
                image: UInt8Array = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
                if image.shape[::-1] != size:
                    raise wrong_size(Path(self.path), self.argument, image.shape[::-1], size)
                yield image
        finally:
            video.release()


@dataclass(frozen=True)
class _Index:
    """Times of all frames of a video, its frame rate, and whether the decoder can jump to a frame by its time."""

    times: list[float]
    """Times of the frames, seconds."""
    rate: float
    """Frames per second."""
    stated: int
    """Number of frames that the header states; 0 if it states none."""
    is_timed: bool
    """True if the video stores the times of its frames."""
    seeks: bool
    """True if the decoder can jump to a frame by its time, without reading the frames before it."""


@contextmanager
def _for(container: Container | None, cv2: Any) -> Iterator[None]:
    """Context manager that sets environment variables of FFmpeg, so that OpenCV reads only one container format and
    prints nothing.
    """
    assert container is not None, "Video checks its container"
    options = {
        "OPENCV_FFMPEG_CAPTURE_OPTIONS": f"format_whitelist;{container.demuxers}|protocol_whitelist;file",
        "OPENCV_FFMPEG_LOGLEVEL": "-8",
    }
    before = {name: os.environ.get(name) for name in options}
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.update(options)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def container_of(head: bytes) -> Container | None:
    """Container format of a file that begins with `head`; None if the format is not accepted."""
    return next((kind for kind in CONTAINERS if kind.begins.match(head)), None)


def refusal(head: bytes) -> str:
    """Reason for refusing a file that begins with `head`, as the end of a sentence whose subject is the file."""
    read = ", ".join(dict.fromkeys(kind.name for kind in CONTAINERS))
    if IMAGE.match(head):
        return "is a single image: give a folder of photographs, or a video."
    what = "does not begin like a video" if head else "is empty"
    if head and b"\0" not in head:
        with suppress(UnicodeDecodeError):
            codecs.getincrementaldecoder("utf-8")().decode(head)  # the last character may be cut
            what = "is a text, such as a playlist, which names other files"
    return f"cannot be read as a video: it {what}; give {read}."
