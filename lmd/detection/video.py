"""Frames of a video.

Frames are told apart by their times, which a video may keep at any distances. Some kinds of videos have no times, and
in some no frame can be found but from the first one on.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import InputError, check_fields, real
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.detection.containers import FIRST, Container, container_of, refusal
from lmd.detection.images import wrong_size
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

LEAD = 500.0  # milliseconds before a frame to which is sought: OpenCV seeks as if frames were equally far apart
SAME_TIME = 1e-3  # milliseconds
MOST_FRAMES = 1e9  # of which a header can tell
ROUNDED = 1  # frames that a header is off by which tells the length only


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
        """The frames that are taken."""
        return list(range(0, len(self._index.times), max(1, round(self._index.rate / self.rate))))

    @property
    def remarks(self) -> list[str]:
        """See `Images.remarks`."""
        index, remarks = self._index, []
        if index.stated > len(index.times) + ROUNDED:
            remarks.append(f"ends after {len(index.times)} of the {index.stated} frames that it says it has")
        if not index.is_timed:
            remarks.append(f"has no times: {index.rate:g} frames a second are taken, as OpenCV says")
        return [f"{str(self.path)!r} {remark}" for remark in remarks]

    @property
    def is_random_access(self) -> bool:
        """See `Images.is_random_access`."""
        return self._index.seeks

    @cached_property
    def _index(self) -> "_Index":
        """The times of all frames, from reading all: what a header says of their number may be wrong or missing."""
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
            raise self._unread("it has neither times nor a number of frames a second")
        seconds = [time / 1e3 for time in times] if is_timed else [number / rate for number in range(len(times))]
        return _Index(seconds, rate, int(stated) if 0.0 < stated < MOST_FRAMES else 0, is_timed, seeks)

    def _unread(self, why: str) -> InputError:
        return InputError(f"{self.argument}: {str(self.path)!r} cannot be read as a video: {why}.", self.argument)

    def _opened(self, size: tuple[int, int] | None = None) -> Any:
        """The video before its first frame.

        Args:
            size: of the frames. As of photographs, these are as the sensor has them, however the camera was held,
                unless only the turned ones have this size. None for those of the sensor.

        Raises:
            InputError: it cannot be opened, or has frames of another size.
        """
        cv2 = optional("cv2", "detection")
        container = container_of(read_bytes(self.path, self.argument, first=FIRST))
        with _for(container, cv2):
            # A name may mean more to FFmpeg than to the system, but for one that begins with a slash.
            video = cv2.VideoCapture(str(Path(self.path).absolute()), cv2.CAP_FFMPEG)
        if not video.isOpened():
            raise self._unread("OpenCV cannot open it")
        found = []
        for is_turned in (0, 1):
            video.set(cv2.CAP_PROP_ORIENTATION_AUTO, is_turned)
            width, height = (int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            found.append((width, height))
            if size in (None, found[-1]):
                return video
        video.release()
        assert size is not None, "any size will do"
        raise wrong_size(Path(self.path), self.argument, found[0], size)

    def _at(self, number: int, size: tuple[int, int]) -> Any:
        """The video at a frame, which is grabbed."""
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
        self._opened(size).release()  # a wrong size is said before all frames are counted
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
    """All frames of a video.

    Args:
        times: seconds.
        rate: frames a second.
        stated: frames that the header says there are; 0 if it does not.
        is_timed: whether the video has the times, and not its rate alone.
        seeks: whether a frame is found by its time.
    """

    times: list[float]
    rate: float
    stated: int
    is_timed: bool
    seeks: bool


@contextmanager
def _for(container: Container | None, cv2: Any) -> Iterator[None]:
    """While entered, OpenCV opens files of one kind alone, and says nothing of what is wrong with them.

    It takes the options of FFmpeg from the environment.
    """
    assert container is not None, "Video refuses what is none"
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
