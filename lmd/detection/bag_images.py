"""Images of a topic of a bag of ROS 2: `sensor_msgs/Image` and `sensor_msgs/CompressedImage`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import Checked, Positive
from lmd.core.optional import optional
from lmd.detection.images import pixels_of, wrong_size
from lmd.formats.bags import COMPRESSED, IMAGE, Bag, Message
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size
from lmd.render.imaging import UInt8Array

# Encodings of `sensor_msgs/Image`: bytes of a pixel, and OpenCV's conversion to grey; None if the first byte is grey.
ENCODINGS: dict[str, tuple[int, str | None]] = {
    "mono8": (1, None), "8UC1": (1, None), "mono16": (2, None), "16UC1": (2, None),
    "rgb8": (3, "COLOR_RGB2GRAY"), "bgr8": (3, "COLOR_BGR2GRAY"), "8UC3": (3, "COLOR_BGR2GRAY"),
    "rgba8": (4, "COLOR_RGBA2GRAY"), "bgra8": (4, "COLOR_BGRA2GRAY"), "8UC4": (4, "COLOR_BGRA2GRAY"),
    # OpenCV names the second row and column of a Bayer pattern, ROS the first ones.
    "bayer_rggb8": (1, "COLOR_BayerBG2GRAY"), "bayer_bggr8": (1, "COLOR_BayerRG2GRAY"),
    "bayer_gbrg8": (1, "COLOR_BayerGR2GRAY"), "bayer_grbg8": (1, "COLOR_BayerGB2GRAY"),
    "yuv422": (2, "COLOR_YUV2GRAY_UYVY"), "uyvy": (2, "COLOR_YUV2GRAY_UYVY"),
    "yuv422_yuy2": (2, "COLOR_YUV2GRAY_YUY2"), "yuyv": (2, "COLOR_YUV2GRAY_YUY2"),
}  # fmt: skip
JITTER = 0.05  # shortening of a period between images that is taken for jitter, as a share
DEEP = ("mono16", "16UC1")  # encodings with two bytes for a grey level


@dataclass(frozen=True)
class BagImages(Checked):
    """Images of one topic, sampled at a rate; their names are the times in their headers, seconds.

    Raises:
        InputError: the rate is not positive, or the topic has no image.
    """

    bag: Bag
    """The bag."""
    topic: str
    """Topic of the images."""
    rate: Positive
    """Greatest number of images per second that are taken."""

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
        """Time, and time of recording, ns, of each image that is taken, by ascending time."""
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
        for stamp, _ in wanted:  # images are yielded by ascending time, and were recorded nearly so
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
            raise self.bag.refused(f"has images of the encoding {message.encoding!r}; read are {', '.join(ENCODINGS)}")
        bytes_each, conversion = ENCODINGS[message.encoding]
        data, row = np.asarray(message.data, dtype=np.uint8), message.width * bytes_each
        if message.step < row or len(data) != message.step * message.height or not len(data):
            raise self.bag.refused(f"has an image at {stamp} s with {len(data)} bytes, other than its size says")
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
    """Images of `count` topics of a bag, by topic; arguments as in `Bag.chosen`.

    Raises:
        InputError: the bag cannot be read, or has other topics.
    """
    bag = Bag(path, argument)
    return {name: BagImages(bag, name, rate) for name in bag.chosen(topic, IMAGE, COMPRESSED, count=count)}
