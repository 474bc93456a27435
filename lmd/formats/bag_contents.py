"""Cameras in bags of ROS 2, see `lmd.formats.bags`."""

from collections.abc import Mapping
from typing import Any

from lmd.formats.bags import CAMERA_INFO, Bag


def cameras_in(path: Any, argument: str) -> Mapping[str, Any]:
    """Cameras of a bag by topic, each as a function that returns the keys of the first `CameraInfo`.

    Raises:
        InputError: the bag cannot be read, or has no camera.
    """
    bag = Bag(path, argument)
    topics = bag.topics_of(CAMERA_INFO)
    if not topics:
        bag.chosen(None, CAMERA_INFO)  # refuses
    return {topic: lambda topic=topic: _camera(bag, topic) for topic in topics}


def _camera(bag: Bag, topic: str) -> Mapping[str, Any]:
    first = next(bag.messages(topic), None)
    if first is None:
        raise bag.refused(f"has no message on {topic!r}")
    found = bag.content(first.raw, CAMERA_INFO)
    if max(found.binning_x, found.binning_y) > 1 or found.roi.width or found.roi.height:
        raise bag.refused(f"has images on {topic!r} that are binned or cut; whole images are read")
    keys = {name: getattr(found, name.lower()).tolist() for name in "KD"}
    rest = {name: getattr(found, name) for name in ("width", "height", "distortion_model")}
    return {**keys, **rest}
