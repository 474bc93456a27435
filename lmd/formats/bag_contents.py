"""Cameras and detections in bags of ROS 2, see `lmd.formats.bags`."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.formats.bags import CAMERA_INFO, DETECTIONS, Bag
from lmd.formats.calibration_readers import Keys, message
from lmd.formats.detection_readers import SeenTag


def cameras_in(path: Any, argument: str) -> Mapping[str, Any]:
    """Cameras of a bag by topic, each by the first `CameraInfo`.

    Raises:
        InputError: the bag cannot be read, or has no camera.
    """
    bag = Bag(path, argument)
    topics = bag.topics_of(CAMERA_INFO)
    if not topics:
        bag.chosen(None, CAMERA_INFO)  # refuses
    return {topic: lambda topic=topic: _camera(bag, topic) for topic in topics}


def _camera(bag: Bag, topic: str) -> Keys:
    first = next(bag.messages(topic), None)
    if first is None:
        raise bag.refused(f"has no message on {topic!r}")
    found = bag.content(first.raw, CAMERA_INFO)
    if max(found.binning_x, found.binning_y) > 1 or found.roi.width or found.roi.height:
        raise bag.refused(f"has images on {topic!r} that are binned or cut; whole images are read")
    keys = {name: getattr(found, name.lower()).tolist() for name in "KD"}
    rest = {name: getattr(found, name) for name in ("width", "height", "distortion_model")}
    return message({**keys, **rest})[""]


def seen_in(path: Any, argument: str, topic: Any = None) -> tuple[list[SeenTag], list[tuple[str, str]]]:
    """Detections in a bag, and time and topic of each image, also of images without a tag.

    Args:
        path, argument: path of the bag, and the name of its argument.
        topic: topic of the detections, or a list of the topics of several cameras; None for all topics.

    Raises:
        InputError: the bag cannot be read, or has no detections.
    """
    bag = Bag(path, argument)
    topics = bag.chosen(topic, DETECTIONS, count=1 if isinstance(topic, str) else max(_count(bag, topic), 1))
    seen, images = [], []
    for name in topics:
        for stored in bag.messages(name):
            images.append((stored.stamp, name))
            seen += list(_tags(bag, stored.raw, name if len(topics) > 1 else "", stored.stamp))
    if not seen:
        raise bag.refused(f"has no tag on {', '.join(topics)}")
    return seen, images


def _count(bag: Bag, topic: Any) -> int:
    return len(bag.topics_of(DETECTIONS) if topic is None else list(topic))


def _tags(bag: Bag, raw: bytes, camera: str, stamp: str) -> Iterator[SeenTag]:
    """Tags of a message; AprilTag's corners count from the border of the image."""
    for tag in bag.content(raw, DETECTIONS).detections:
        corners = [(float(corner.x), float(corner.y)) for corner in tag.corners]
        if not np.isfinite(corners).all():
            raise InputError(f"{bag.argument}: {str(bag.path)!r} has a corner that is no number at {stamp} s.")
        yield SeenTag(camera, stamp, int(tag.id), list(corners), tag.family)
