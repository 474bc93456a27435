"""Bags of ROS 2, read without ROS: a folder with `metadata.yaml`, an MCAP file, or a database (`.db3`).

Messages are read with the message definitions of `lmd`, because the library `rosbags` would generate code from the
definitions in a bag. A bag is refused if the hash of its definition of a message type differs from that of `lmd`'s
definition.
"""

import math
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from lmd.core.checks import InputError, bounded, printable
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.core.words import few

EXTRA, SUFFIXES = "bags", (".mcap", ".db3")
METADATA = "metadata.yaml"  # file that marks a folder as a bag
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, DETECTIONS = "sensor_msgs/msg/CameraInfo", "apriltag_msgs/msg/AprilTagDetectionArray"
# Definitions of apriltag_msgs, which are not part of ROS.
APRILTAG_MSGS = {
    DETECTIONS: "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\napriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n",
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
}
# Maximum size of `metadata.yaml`, bytes (500 topics have 300 kB); and maximum size of an expanded message, or chunk of
# messages, bytes (an image of 8K has 100 MB).
LARGEST_METADATA, LARGEST_CHUNK = 1 << 19, 1 << 28
# Maximum size of an expanded file: bytes, and ratio to the size of the compressed file.
LARGEST_FILE, LARGEST_RATIO = 1 << 30, 100
ZSTD = b"\x28\xb5\x2f\xfd"  # first bytes of content that zstd has compressed
CHUNK, CHUNK_HEAD = 0x06, 37  # operation of a chunk in MCAP, and bytes before the name of its compression
MOST_TOPICS = 8  # maximum number of topics that a message names
SHOWN = 120  # maximum number of characters of a library's reason that a message shows


class Message(NamedTuple):
    """Message in a bag (a file of recorded messages of ROS): its time, time of recording, and serialised content."""

    stamp: str
    """Time in the header, seconds with nine decimals; time of recording if the header has no time."""
    logged: int
    """Time at which the message was recorded, ns."""
    raw: bytes
    """Message in the serialised form in which it is stored."""


@cache
def types() -> Any:
    """Type store of the library `rosbags`, with the types of the messages that are read and written."""
    optional("rosbags", EXTRA)
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_JAZZY)
    for name, text in APRILTAG_MSGS.items():
        found.register(get_types_from_msg(text, name))
    return found


@cache
def _reader() -> Any:
    """Make a class that reads bags: a subclass of the reader of `rosbags` that limits the size of expanded content."""
    optional("rosbags", EXTRA)
    library, mcap = (optional(f"rosbags.rosbag2.{name}", EXTRA) for name in ("reader", "storage_mcap"))
    zstd, lz4 = library.zstd, optional("lz4.frame", EXTRA)
    kinds = {"zstd": zstd.ZstdDecompressor, "lz4": lz4.LZ4FrameDecompressor}

    def expanded(kind: str, content: bytes) -> bytes:
        found: bytes = kinds[kind]().decompress(content, LARGEST_CHUNK + 1)
        bounded("bytes in a compressed message or chunk", len(found), LARGEST_CHUNK, "it")
        return found

    def check_length(file: Any, most: int) -> None:
        count = 0
        while part := file.read(1 << 20):
            count += len(part)
            bounded("bytes in a compressed file", count, most, "it")

    class Mcap(mcap.McapReader):  # type: ignore[misc, name-defined]
        def messages(self, *asked: Any, **limits: Any) -> Iterator[Any]:
            for start in [chunk.chunk_start_offset for chunk in self.chunks] or self._records(CHUNK):
                self.bio.seek(start + CHUNK_HEAD)
                kind = mcap.read_string(self.bio)
                if kind in kinds:
                    expanded(kind, self.bio.read(*struct.unpack("<Q", self.bio.read(8))))
            yield from super().messages(*asked, **limits)

        def _records(self, kind: int) -> Iterator[int]:
            start = self.data_start
            while start < self.data_end:
                self.bio.seek(start)
                operation, size = struct.unpack("<BQ", self.bio.read(9))
                if operation == kind:
                    yield start
                start += 9 + size

    class Folder(library.DirectoryReader):  # type: ignore[misc, name-defined]
        STORAGE_PLUGINS: ClassVar = {**library.DirectoryReader.STORAGE_PLUGINS, "mcap": Mcap}

        def open(self) -> None:
            for path in filter(Path.is_file, self.path.iterdir()):
                with path.open("rb") as content:
                    if content.read(len(ZSTD)) == ZSTD:
                        content.seek(0)
                        check_length(zstd.open(content), LARGEST_FILE + LARGEST_RATIO * path.stat().st_size)
            super().open()
            self.is_by_message = self.metadata.compression_mode == "message"  # type: ignore[has-type]
            # The library would expand messages without a limit.
            self.metadata = self.metadata._replace(compression_mode=None)  # type: ignore[has-type]

        def messages(self, *asked: Any, **limits: Any) -> Iterator[Any]:
            for connection, time, raw in super().messages(*asked, **limits):
                yield connection, time, expanded("zstd", raw) if self.is_by_message else raw

    class Reader(library.Reader):  # type: ignore[misc, name-defined]
        STORAGE_PLUGINS: ClassVar = {**library.Reader.STORAGE_PLUGINS, "dir": Folder, ".mcap": Mcap}

    return Reader


def is_bag(path: Any) -> bool:
    """True if `path` is a bag: a file with the suffix of a bag, such as `.mcap`, or a folder with `metadata.yaml`."""
    with suppress(OSError, TypeError, ValueError):
        return Path(path).suffix.lower() in SUFFIXES or (Path(path) / METADATA).is_file()
    return False


@dataclass(frozen=True)
class Bag:
    """Bag of ROS 2.

    Raises:
        InputError: the bag cannot be read.
    """

    path: str | Path
    """File or folder."""
    argument: str = "path"
    """Name of the argument that gave the path, for messages."""

    def __post_init__(self) -> None:
        _ = self.topics

    @cached_property
    def topics(self) -> dict[str, str]:
        """Type of the messages of each topic, keyed by topic."""
        with self._opened() as reader:
            return {topic: str(info.msgtype) for topic, info in sorted(reader.topics.items())}

    def topics_of(self, *kinds: str) -> list[str]:
        """Names of the topics whose messages have one of the given types, ascending."""
        return [topic for topic, kind in self.topics.items() if kind in kinds]

    def chosen(self, topic: Any, *kinds: str, count: int = 1) -> list[str]:
        """Names of the topics to read.

        Args:
            topic: topic or list of topics that the user wants; None for all topics with messages of `kinds`.
            kinds: types of the topics' messages.
            count: required number of topics.

        Raises:
            InputError: the bag lacks a topic, or the number of topics is not `count`.
        """
        found, what = self.topics_of(*kinds), " or ".join(kind.rpartition("/")[2] for kind in kinds)
        asked = [topic] if isinstance(topic, str) else found if topic is None else list(topic)
        told = few([printable(name) for name in found], most=MOST_TOPICS) if found else "none"
        if unknown := [name for name in asked if name not in found]:
            raise self.refused(f"has no topic {unknown[0]!r} of {what}; it has {told}", "topic")
        if len(asked) != count and not found:
            every = few([f"{name} ({kind})" for name, kind in self.topics.items()], most=MOST_TOPICS) or "nothing"
            raise self.refused(f"has no topic of {what}; it has {every}")
        if len(asked) != count:
            number = f"{count} topics" if count > 1 else "one topic"
            raise self.refused(f"has {len(found)} topics of {what}, {told}: set topic to {number} of these")
        return asked

    def messages(self, topic: str, first: int | None = None, last: int | None = None) -> Iterator[Message]:
        """Messages of a topic, in the order in which they were recorded.

        Args:
            topic: topic; messages must have a header.
            first, last: times of recording of the first and the last message to read, ns; None for all messages.

        Raises:
            InputError: the bag is damaged, or its definition of the message type differs from the one known here.
        """
        with self._opened() as reader:
            own = [connection for connection in reader.connections if connection.topic == topic]
            for connection in own:
                self._check_type(connection)
            stop = None if last is None else last + 1
            for _, logged, raw in reader.messages(connections=own, start=first, stop=stop):
                yield Message(_stamp(raw, logged), logged, bytes(raw))

    def content(self, raw: bytes, kind: str) -> Any:
        """Deserialise the message `raw`, which has the type `kind`.

        Raises:
            InputError: the message is damaged.
        """
        try:
            return types().deserialize_cdr(raw, kind)
        except Exception as error:  # a damaged message may raise any error
            raise self.refused(f"has a damaged message of {kind} ({_reason(error)})") from None

    def refused(self, why: str, argument: str | None = None) -> InputError:
        """Make an error about this bag, with the reason `why`: a predicate, such as `has no camera`."""
        return InputError(f"{self.argument}: the bag {str(self.path)!r} {why}.", argument or self.argument)

    def _check_type(self, connection: Any) -> None:
        expected = types().hash_rihs01(connection.msgtype) if connection.msgtype in types().fielddefs else ""
        if connection.digest and expected and connection.digest != expected:
            raise self.refused(f"defines {connection.msgtype} differently from the definition known here")

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        path = Path(self.path)
        if not os.path.exists(path):
            raise InputError(f"{self.argument}: there is no bag {str(path)!r}.", self.argument)
        for file in path.iterdir() if path.is_dir() else [path]:
            if not file.is_dir():
                # A pipe is refused here, as the library would wait for its content; other files are not read yet.
                largest = LARGEST_METADATA if file.name == METADATA else math.inf
                read_bytes(file, self.argument, largest, None if file.name == METADATA else 0)
        try:
            with _reader()(path) as reader:
                yield reader
        except InputError as error:
            if str(path) in str(error):
                raise
            raise self.refused(str(error).removeprefix("it ").rstrip(".")) from None
        except GeneratorExit:
            raise
        except Exception as error:  # a broken file may raise any error
            cut = "; `mcap recover` repairs a truncated file" * (Path(self.path).suffix == ".mcap")
            raise self.refused(f"cannot be read ({_reason(error)}){cut}") from None


def _reason(error: Exception) -> str:
    """Reason that an error of a library states, on one line."""
    return (" ".join(str(error).split()) or type(error).__name__).rstrip(".")[:SHOWN]


def _stamp(raw: bytes, logged: int) -> str:
    """Time in the header of a message, seconds, as a text; the time of recording if the header has no time."""
    if len(raw) < 12:
        return _seconds(logged)
    seconds, rest = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    return _seconds(logged if not (seconds or rest) else 1_000_000_000 * seconds + rest)


def _seconds(nanoseconds: int) -> str:
    return f"{nanoseconds // 1_000_000_000}.{nanoseconds % 1_000_000_000:09d}"


def cameras_in(path: Any, argument: str) -> Mapping[str, Any]:
    """Cameras of a bag, keyed by topic; `argument` is the argument that gave the path, for messages.

    Each value is a function that reads the first `CameraInfo` of the topic, and returns its content as keys and values.

    Raises:
        InputError: the bag cannot be read, or has no camera.
    """
    bag = Bag(path, argument)
    topics = bag.topics_of(CAMERA_INFO)
    if not topics:
        bag.chosen(None, CAMERA_INFO)  # raises the error about the missing topic
    return {topic: lambda topic=topic: _camera(bag, topic) for topic in topics}


def _camera(bag: Bag, topic: str) -> Mapping[str, Any]:
    first = next(bag.messages(topic), None)
    if first is None:
        raise bag.refused(f"has no message on {topic!r}")
    found = bag.content(first.raw, CAMERA_INFO)
    if max(found.binning_x, found.binning_y) > 1 or found.roi.width or found.roi.height:
        raise bag.refused(f"has images on {topic!r} that are binned or cropped; record whole images")
    keys = {name: getattr(found, name.lower()).tolist() for name in "KD"}
    rest = {name: getattr(found, name) for name in ("width", "height", "distortion_model")}
    return {**keys, **rest}
