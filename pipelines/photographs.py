"""Input of surveys and localisations: odometry, and tag detections from photographs, a video, or a file."""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .composing import editable
from .nodes import detectors_of, keyed, plain
from .sensed import in_batches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lmd.detection.detectors import Detector
    from lmd.formats.detections import DetectedTags
    from lmd.geometry.camera import Camera
    from lmd.geometry.trajectory import Trajectory
    from lmd.scene.tag import Tag


def detected(cfg: DictConfig, cameras: "Sequence[Camera]", detector: "Detector", tag: "Tag") -> "DetectedTags":
    """Read the detections of the tags from photographs, or from a file of detections.

    If an image occurs more than once, only one copy of it is used.

    Args:
        cfg: configuration.
        cameras: cameras that took the photographs.
        detector: detector that reads the photographs.
        tag: tag whose family the detections must have.

    Raises:
        InputError: photographs and detections are both given or both missing, or a file cannot be read or holds another
            tag family.
    """
    from lmd.core.checks import InputError
    from lmd.detection.photographed import detected_in_photographs
    from lmd.formats.bags import is_bag
    from lmd.formats.detection_formats import read_detections, with_images
    from lmd.formats.detections import without_copies
    from lmd.formats.placed_tag import check_family

    photographs, detections, topic = cfg.photographs, cfg.detections, plain(cfg.topic)
    if (photographs is None) == (detections is None):
        either = "either photographs (a folder, a video or a bag) or detections (a CSV file)"
        raise InputError(f"{either} must be given.")
    key, source = ("photographs", photographs) if detections is None else ("detections", detections)
    if topic is not None and not is_bag(source):
        raise InputError(f"topic is for a bag of ROS 2, but {key} is {str(source)!r}.")
    if detections is not None:
        found = read_detections(detections, topic)
        with keyed(family="tag.family"):
            check_family(detections, found.family, tag.family)
        return without_copies(found if cfg.images is None else with_images(found, cfg.images))
    if cfg.images is not None:
        raise InputError(f"images = {str(cfg.images)!r} goes with detections, not with photographs.")
    words = {"topic": topic, "rate": cfg.rate, "workers": cfg.workers}
    each = partial(in_batches, cfg.workers)
    with keyed():
        found = detected_in_photographs(photographs, cameras, detector, tag.modules, each, **words)
    return without_copies(replace(found, family=tag.family))


def with_camera_of_bag(cfg: DictConfig) -> DictConfig:
    """Take the camera calibration from the ROS bag `photographs`, if the configuration gives no other calibration.

    The result is a changed copy of `cfg`, or `cfg` itself if `photographs` is not a bag with a calibration.
    """
    from lmd.formats.bags import CAMERA_INFO, Bag, is_bag

    if cfg.photographs is None or "path" not in cfg.camera or cfg.camera.path is not None or cfg.camera.get("rig"):
        return cfg
    with keyed():
        if not is_bag(cfg.photographs) or not Bag(cfg.photographs, "photographs").topics_of(CAMERA_INFO):
            return cfg
    result = editable(cfg)
    result.camera.path = str(cfg.photographs)
    return result


def reader_of(cfg: DictConfig) -> "tuple[str, Detector]":
    """Build the single configured detector; return its name and the detector.

    Raises:
        InputError: no detector or several detectors are configured, or the detector's corner errors are unknown.
    """
    from lmd.core.checks import InputError

    if len(named := list(cfg.get("detectors") or {})) != 1:
        raise InputError(f"detectors must name one detector, got {named}.")
    ((name, detector),) = detectors_of(cfg).items()
    if not hasattr(detector, "corner_errors"):
        raise InputError(f"detectors: the class of {name} must have an attribute corner_errors.")
    return name, detector


def odometry_of(given: Any, key: str) -> "Trajectory | None":
    """Read the odometry, which is the trajectory of the robot or rig with the cameras; None if there is no odometry.

    Args:
        given: value at the config key `key`: the path of a file, or a mapping of the reader's arguments; None if there
            is no odometry.
        key: config key, for error messages.

    Raises:
        InputError: the file cannot be read, or is not a trajectory.
    """
    from lmd.formats.trajectories import TrajectoryFile
    from lmd.space.parts import made

    if (given := plain(given)) is None:
        return None
    keys = given if isinstance(given, dict) else {"path": given}
    with keyed(key, **({} if keys is given else {"path": key})):
        return made(key, keys, TrajectoryFile).trajectory
