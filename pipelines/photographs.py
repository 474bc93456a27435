"""Input of surveys and localisations: detections from photographs, a video, or a file; odometry."""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from .composing import editable
from .nodes import detector_of, keyed
from .sensed import in_batches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lmd.detection.detectors import Detector
    from lmd.formats.detections import DetectedTags
    from lmd.geometry.camera import Camera
    from lmd.geometry.trajectory import Trajectory
    from lmd.scene.tag import Tag


def detected(cfg: DictConfig, cameras: "Sequence[Camera]", detector: "Detector", tag: "Tag") -> "DetectedTags":
    """Detections of tags of the family of `tag`, without copies of images.

    Raises:
        InputError: photographs and detections are both given or both missing, or a file cannot be read or has another
            family.
    """
    from lmd.core.checks import InputError
    from lmd.detection.photographed import detected_in_photographs
    from lmd.formats.bags import is_bag
    from lmd.formats.detection_formats import read_detections, with_images
    from lmd.formats.detections import without_copies
    from lmd.formats.placed_tag import check_family

    if (cfg.photographs is None) == (cfg.detections is None):
        raise InputError(
            "photographs=DIR, a folder, a video or a bag, or detections=FILE.csv must be given, and not both."
        )
    if cfg.detections is not None:
        if cfg.topic is not None and not is_bag(cfg.detections):
            raise InputError(f"topic is for a bag of ROS 2, and detections is {str(cfg.detections)!r}.")
        found = read_detections(cfg.detections, _plain(cfg.topic))
        with keyed(family="tag.family"):
            check_family(cfg.detections, found.family, tag.family)
        return without_copies(found if cfg.images is None else with_images(found, cfg.images))
    if cfg.topic is not None and not is_bag(cfg.photographs):
        raise InputError(f"topic is for a bag of ROS 2, and photographs is {str(cfg.photographs)!r}.")
    if cfg.images is not None:
        raise InputError("images goes with detections=FILE.csv: with photographs it is known which there are.")
    each = partial(in_batches, cfg.workers)
    words = {"topic": _plain(cfg.topic), "rate": cfg.rate, "workers": cfg.workers}
    with keyed():
        found = detected_in_photographs(cfg.photographs, cameras, detector, tag.modules, each, **words)
    return without_copies(replace(found, family=tag.family))


def _plain(node: Any) -> Any:
    """Plain values of a node of the configuration."""
    return OmegaConf.to_container(node) if OmegaConf.is_config(node) else node


def with_camera_of_bag(cfg: DictConfig) -> DictConfig:
    """Configuration whose calibration is that of the bag in `photographs`, if no other one is given."""
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
    """Name of the detector, and the detector.

    Raises:
        InputError: there is no detector, there are several, or the corner errors of the detector are unknown.
    """
    from lmd.core.checks import InputError

    named = list(cfg.get("detectors") or {})
    if len(named) != 1:
        raise InputError(f"detectors must name one detector, got {named}.")
    detector = detector_of(cfg, named[0])
    if not hasattr(detector, "corner_errors"):
        raise InputError(f"detectors: {named[0]} does not say corner_errors, how far its corners are off.")
    return named[0], detector


def odometry_of(given: Any, key: str) -> "Trajectory | None":
    """Trajectory of the body, given a path or the keys of a trajectory file.

    Args:
        given: value at the key; None without odometry.
        key: key of the configuration.

    Raises:
        InputError: the file cannot be read, or is no trajectory.
    """
    from lmd.core.checks import InputError
    from lmd.formats.trajectories import TrajectoryFile

    if given is None:
        return None
    given = OmegaConf.to_container(given, resolve=True) if OmegaConf.is_config(given) else given
    keys = given if isinstance(given, dict) else {"path": given}
    known = ("path", "frame", "times", "rate", "mount")
    if unknown := [key for key in keys if key not in known]:
        raise InputError(f"{key} has the key {unknown[0]!r}, but takes {', '.join(known)}.")
    with keyed(key, **({} if isinstance(given, dict) else {"path": key})):
        file = TrajectoryFile(**{str(key): value for key, value in keys.items()})
        return file.trajectory
