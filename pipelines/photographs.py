"""Input of surveys and localisations: detections from photographs, a video, or a file; odometry."""

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from omegaconf import DictConfig, OmegaConf, open_dict

from .nodes import detector_of, keyed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lmd.detection.detectors import Detections, Detector
    from lmd.detection.images import Images
    from lmd.formats.detections import DetectedTags
    from lmd.geometry.camera import Camera
    from lmd.geometry.trajectory import Trajectory
    from lmd.scene.tag import Tag

CHUNK = 8  # number of images that a worker reads at once


def detected(cfg: DictConfig, cameras: "Sequence[Camera]", detector: "Detector", tag: "Tag") -> "DetectedTags":
    """Detections of tags of the family of `tag`, without copies of images.

    Raises:
        InputError: photographs and detections are both given or both missing, or a file cannot be read or has another
            family.
    """
    from lmd.core.checks import InputError
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
    return without_copies(replace(_in_images(cfg, cameras, detector, tag.modules), family=tag.family))


def _in_images(cfg: DictConfig, cameras: "Sequence[Camera]", detector: "Detector", modules: int) -> "DetectedTags":
    """Detections in the photographs of all cameras.

    Raises:
        InputError: there are no photographs, or a photograph cannot be read.
    """
    from lmd.core.checks import InputError, printable
    from lmd.detection.bag_images import images_in
    from lmd.detection.images import Photographs, folder_entries
    from lmd.detection.video import Video
    from lmd.formats.bags import is_bag
    from lmd.formats.detections import DetectedTags

    given = Path(str(cfg.photographs))
    if not os.path.lexists(given):
        raise InputError(f"photographs: there is no folder, video or bag {str(given)!r}.")
    views: Mapping[str, Images]
    with keyed():
        if is_bag(given):
            views = images_in(given, _plain(cfg.topic), cfg.rate, "photographs", len(cameras))
        elif len(cameras) == 1:
            is_folder = os.path.isdir(given)
            views = {"": Photographs(given, "photographs") if is_folder else Video(given, cfg.rate, "photographs")}
        else:
            folders = [entry for entry in folder_entries(given, "photographs") if os.path.isdir(entry)]
            if len(folders) != len(cameras):
                text = f"photographs must be a folder with one folder for each of {len(cameras)} cameras"
                raise InputError(f"{text}, {str(given)!r} has {len(folders)}.")
            views = {printable(folder.name): Photographs(folder, "photographs") for folder in folders}
        parts = {
            name: detected_in(images, camera, detector, modules, cfg.workers)
            for (name, images), camera in zip(views.items(), cameras, strict=True)
        }
    return DetectedTags.together(parts) if len(parts) > 1 else next(iter(parts.values()))


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
    result: DictConfig = cfg.copy()
    with open_dict(result):
        result.camera.path = str(cfg.photographs)
    return result


class Chunk(NamedTuple):
    """Consecutive images, for a worker."""

    images: "Images"
    camera: "Camera"
    detector: "Detector"
    modules: int
    first: int
    last: int


def detected_in(
    images: "Images", camera: "Camera", detector: "Detector", modules: int, workers: int | None
) -> "DetectedTags":
    """Detections in images, without images that are much more blurred than the others.

    Args:
        images: images of one camera.
        camera: camera with the size of the images.
        detector: detector of the tags.
        modules: number of modules on an edge in the tags' family.
        workers: number of processes, None for every processor; the result does not depend on the number.

    Raises:
        InputError: an image cannot be read, or no image shows a tag.
    """
    import numpy as np

    from lmd.core.checks import InputError
    from lmd.detection.images import blurred
    from lmd.formats.detections import DetectedTags

    from .progress import bar
    from .workers import in_processes, processes

    next(images.read(0, 1, camera), None)  # an error that is common to all images is raised before the progress bar
    count = len(images.names)
    for remark in images.remarks:
        print(f"warning: photographs: {remark}", file=sys.stderr)
    # Some videos can only be read from the start, so each worker gets one long chunk.
    chunk = CHUNK if images.is_random_access else -(-count // processes(workers))
    jobs = [
        Chunk(images, camera, detector, modules, first, min(first + chunk, count)) for first in range(0, count, chunk)
    ]
    found: list[Detections] = []
    blurs: list[float] = []
    with bar(count, "images") as progress:
        for part in in_processes(_read, jobs, workers, lambda job: job.images.names[job.first], ordered=True):
            found += [detections for detections, _ in part]
            blurs += [blur for _, blur in part]
            progress.update(len(part))
    if not any(len(one) for one in found):
        raise InputError(f"photographs: no tag is found in any of {count} images; tag.family says which to look for.")
    smeared = np.flatnonzero(blurred(np.array(blurs)))
    return DetectedTags.in_frames(images.names, [one.ids for one in found], [one.corners for one in found]).without(
        {images.names[k]: blurs[k] for k in smeared}
    )


def _read(job: Chunk) -> "list[tuple[Detections, float]]":
    """Detections in each image, and the blur of the image, on one thread."""
    from lmd.core.optional import optional
    from lmd.detection.images import blur_of

    optional("cv2", "detection").setNumThreads(1)
    found = []
    for image in job.images.read(job.first, job.last, job.camera):
        detections = job.detector.detect(image)
        found.append((detections, blur_of(image, detections, job.modules)))
    return found


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
