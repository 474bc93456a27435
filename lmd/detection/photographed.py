"""Detection of tags in photographs by one or several cameras. Photographs come from folders of images, a video, or a
bag.
"""

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lmd.core.checks import Checked, InputError, Positive, printable
from lmd.core.optional import optional
from lmd.core.workers import processes
from lmd.detection.images import Images, Photographs, blur_of, blurred, folder_entries, pixels_of, wrong_size
from lmd.detection.video import Video
from lmd.formats.bags import COMPRESSED, IMAGE, Bag, Message, is_bag
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

if TYPE_CHECKING:
    from lmd.detection.detectors import Detections, Detector
    from lmd.geometry.camera import Camera

# Encodings of `sensor_msgs/Image`: bytes per pixel, and OpenCV's conversion to grey; None if the first byte is grey.
ENCODINGS: dict[str, tuple[int, str | None]] = {
    "mono8": (1, None), "8UC1": (1, None), "mono16": (2, None), "16UC1": (2, None),
    "rgb8": (3, "COLOR_RGB2GRAY"), "bgr8": (3, "COLOR_BGR2GRAY"), "8UC3": (3, "COLOR_BGR2GRAY"),
    "rgba8": (4, "COLOR_RGBA2GRAY"), "bgra8": (4, "COLOR_BGRA2GRAY"), "8UC4": (4, "COLOR_BGRA2GRAY"),
    # OpenCV names Bayer patterns by the second row and column, ROS by the first ones.
    "bayer_rggb8": (1, "COLOR_BayerBG2GRAY"), "bayer_bggr8": (1, "COLOR_BayerRG2GRAY"),
    "bayer_gbrg8": (1, "COLOR_BayerGR2GRAY"), "bayer_grbg8": (1, "COLOR_BayerGB2GRAY"),
    "yuv422": (2, "COLOR_YUV2GRAY_UYVY"), "uyvy": (2, "COLOR_YUV2GRAY_UYVY"),
    "yuv422_yuy2": (2, "COLOR_YUV2GRAY_YUY2"), "yuyv": (2, "COLOR_YUV2GRAY_YUY2"),
}  # fmt: skip
JITTER = 0.05  # a period between images that is shorter by this share is taken for jitter
DEEP = ("mono16", "16UC1")  # encodings with two bytes per grey level


@dataclass(frozen=True)
class BagImages(Checked):
    """Images of one topic of a bag, sampled at a rate; the name of an image is the time in its header, seconds.

    Raises:
        InputError: the rate is not positive, or the topic has no image.
    """

    bag: Bag
    """Bag with the topic."""
    topic: str
    """Topic of the images."""
    rate: Positive
    """Maximum number of images per second; other images are skipped."""

    def _validate(self) -> None:
        if not self._taken:
            raise self.bag.refused(f"has no message on {self.topic!r}")

    @property
    def names(self) -> Sequence[str]:
        """See `Images.names`."""
        return [stamp for stamp, _ in self._taken]

    @property
    def remarks(self) -> Sequence[str]:
        """See `Images.remarks`."""
        return []

    @property
    def is_random_access(self) -> bool:
        """See `Images.is_random_access`."""
        return True

    @cached_property
    def _taken(self) -> list[tuple[str, int]]:
        """Time in the header (as a text) and time of recording (ns) of each image, in the order of the header times.

        Images that follow the previous one too soon for the sampling rate are left out.
        """
        found: dict[str, int] = {}
        for message in self.bag.messages(self.topic):
            found.setdefault(message.stamp, message.logged)
        taken: list[tuple[str, int]] = []
        for stamp in sorted(found, key=float):
            if not taken or float(stamp) - float(taken[-1][0]) > (1.0 - JITTER) / self.rate:
                taken.append((stamp, found[stamp]))
        return taken

    def read(self, first: int, last: int, camera: Camera) -> Iterator[UInt8Array]:
        """See `Images.read`."""
        wanted = self._taken[first:last]
        logged = [at for _, at in wanted]
        kind, size = self.bag.topics[self.topic], image_size(camera)
        waiting: dict[str, Message] = {}
        messages = self.bag.messages(self.topic, min(logged), max(logged))
        for stamp, _ in wanted:  # images are yielded by ascending time, and were recorded in nearly this order
            while stamp not in waiting:
                message = next(messages, None)
                if message is None:
                    raise self.bag.refused(f"lacks the image at {stamp} s, which it had before")
                waiting.setdefault(message.stamp, message)
            yield self._grey(self.bag.content(waiting[stamp].raw, kind), kind, stamp, size)
            waiting = {time: one for time, one in waiting.items() if float(time) > float(stamp)}
        messages.close()  # type: ignore[attr-defined]

    def _grey(self, message: Any, kind: str, stamp: str, size: tuple[int, int]) -> UInt8Array:
        image = self._decoded(message, stamp, size) if kind == COMPRESSED else self._converted(message, stamp)
        if image.shape[::-1] != size:
            raise wrong_size(Path(self.bag.path), self.bag.argument, image.shape[::-1], size)
        return image

    def _decoded(self, message: Any, stamp: str, size: tuple[int, int]) -> UInt8Array:
        cv2, content = optional("cv2", "detection"), np.asarray(message.data, dtype=np.uint8)
        written = pixels_of(content.tobytes())
        if written is not None and written != size:
            raise wrong_size(Path(self.bag.path), self.bag.argument, written, size)
        found = None if written is None else cv2.imdecode(content, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if found is None:
            raise self.bag.refused(f"has an image at {stamp} s of {message.format!r} that cannot be decoded")
        image: UInt8Array = found
        return image

    def _converted(self, message: Any, stamp: str) -> UInt8Array:
        if message.encoding not in ENCODINGS:
            raise self.bag.refused(f"has images encoded as {message.encoding!r}, not as one of {', '.join(ENCODINGS)}")
        bytes_each, conversion = ENCODINGS[message.encoding]
        data, row = np.asarray(message.data, dtype=np.uint8), message.width * bytes_each
        if message.step < row or len(data) != message.step * message.height or not len(data):
            raise self.bag.refused(f"has an image at {stamp} s with {len(data)} bytes that do not match its pixels")
        rows = data.reshape(message.height, message.step)[:, :row]
        if message.encoding in DEEP:
            return np.ascontiguousarray(rows[:, (0 if message.is_bigendian else 1) :: 2])
        if conversion is None:
            return np.ascontiguousarray(rows)
        cv2 = optional("cv2", "detection")
        pixels = np.ascontiguousarray(rows).reshape(message.height, message.width, *[bytes_each] * (bytes_each > 1))
        image: UInt8Array = cv2.cvtColor(pixels, getattr(cv2, conversion))
        return image


def images_in(path: Any, topic: Any, rate: float, argument: str, count: int) -> dict[str, BagImages]:
    """Images of `count` topics of a bag, keyed by topic.

    Args:
        path: path of the bag.
        topic: topic or list of topics of images; None for all topics of images.
        rate: maximum number of images per second that are taken from a topic.
        argument: name of the argument that gave the path, for messages.
        count: number of topics that must be found.

    Raises:
        InputError: the bag cannot be read or lacks a topic, or the number of topics is not `count`.
    """
    bag = Bag(path, argument)
    return {name: BagImages(bag, name, rate) for name in bag.chosen(topic, IMAGE, COMPRESSED, count=count)}


CHUNK = 8  # number of images that are read together
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


def detected_in_photographs(
    given: str | Path, cameras: "Sequence[Camera]", detector: "Detector", modules: int, each: Each, *,
    topic: Any = None, rate: float = 5.0, workers: int | None = None,
) -> DetectedTags:  # fmt: skip
    """Detect tags in the photographs of all cameras; return the detected tags of each photograph.

    Args:
        given: folder of images, a video or a bag; for several cameras, a folder with a folder for each camera, or a
            bag.
        cameras: the cameras; photographs must have the image sizes of the cameras.
        detector: detector of the tags.
        modules: number of modules along an edge of a tag.
        each: function like the built-in `map`, with which ranges of images are read; may use several processes.
        topic: topic of the images in a bag; for several cameras, a list with the topic of each camera.
        rate: maximum number of frames per second taken from a video or a bag.
        workers: number of processes that `each` uses; None for one per processor. The result does not depend on this
            number.

    Raises:
        InputError: there are no photographs, or a photograph cannot be read.
    """
    given = Path(str(given))
    if not os.path.lexists(given):
        raise InputError(f"photographs: there is no folder, video or bag {str(given)!r}.")
    views: dict[str, Images]
    if is_bag(given):
        views = dict(images_in(given, topic, rate, "photographs", len(cameras)))
    elif len(cameras) == 1:
        is_folder = os.path.isdir(given)
        views = {"": Photographs(given, "photographs") if is_folder else Video(given, rate, "photographs")}
    else:
        folders = [entry for entry in folder_entries(given, "photographs") if os.path.isdir(entry)]
        if len(folders) != len(cameras):
            text = f"photographs must be a folder with one folder for each of {len(cameras)} cameras"
            raise InputError(f"{text}, but {str(given)!r} has {len(folders)}.")
        views = {printable(folder.name): Photographs(folder, "photographs") for folder in folders}
    parts = {
        name: detected_in(images, camera, detector, modules, each, workers)
        for (name, images), camera in zip(views.items(), cameras, strict=True)
    }
    return DetectedTags.together(parts) if len(parts) > 1 else next(iter(parts.values()))


class Chunk(NamedTuple):
    """Range of consecutive images, from `first` to `last` (excluded), which one worker process reads."""

    images: Images
    camera: "Camera"
    detector: "Detector"
    modules: int
    first: int
    last: int


def detected_in(
    images: Images, camera: "Camera", detector: "Detector", modules: int, each: Each, workers: int | None
) -> DetectedTags:
    """Detect tags in the images of one camera; images that are much more blurred than the others are left out.

    Remarks of `images`, such as on files that are not read, are printed as warnings.

    Args:
        images: the images.
        camera: camera that took the images.
        detector: detector of the tags.
        modules: number of modules along an edge of a tag.
        each: function like the built-in `map`, with which ranges of images are read; may use several processes.
        workers: number of processes that `each` uses; None for one per processor.

    Raises:
        InputError: an image cannot be read, or no image shows a tag.
    """
    next(images.read(0, 1, camera), None)  # raise an error common to all images before the work begins
    count = len(images.names)
    for remark in images.remarks:
        print(f"warning: photographs: {remark}", file=sys.stderr)
    # Some videos can only be read from the start, so each worker gets one long chunk.
    chunk = CHUNK if images.is_random_access else -(-count // processes(workers))
    jobs = [
        Chunk(images, camera, detector, modules, first, min(first + chunk, count)) for first in range(0, count, chunk)
    ]
    found = [one for part in each(read, jobs) for one in part]
    if not any(len(detections) for detections, _ in found):
        raise InputError(f"photographs: no tag of this family is found in any of {count} images.")
    blurs = np.array([blur for _, blur in found])
    detections = [one for one, _ in found]
    tags = DetectedTags.in_frames(images.names, [one.ids for one in detections], [one.corners for one in detections])
    return tags.without({images.names[k]: float(blurs[k]) for k in np.flatnonzero(blurred(blurs))})


def read(job: Chunk) -> "list[tuple[Detections, float]]":
    """Read the images of a chunk; return, for each image, the detections and the blur of the image, pixels."""
    found = []
    for image in job.images.read(job.first, job.last, job.camera):
        detections = job.detector.detect(image)
        found.append((detections, blur_of(image, detections, job.modules)))
    return found
