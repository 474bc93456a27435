"""Detections in the photographs of one or several cameras: folders of images, a video, or a bag."""

import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lmd.core.checks import InputError, printable
from lmd.core.workers import processes
from lmd.detection.bag_images import images_in
from lmd.detection.images import Images, Photographs, blur_of, blurred, folder_entries
from lmd.detection.video import Video
from lmd.formats.bags import is_bag
from lmd.formats.detections import DetectedTags

if TYPE_CHECKING:
    from lmd.detection.detectors import Detections, Detector
    from lmd.geometry.camera import Camera

CHUNK = 8  # number of images that are read at once
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


def detected_in_photographs(
    given: str | Path, cameras: "Sequence[Camera]", detector: "Detector", modules: int, each: Each, *,
    topic: Any = None, rate: float = 5.0, workers: int | None = None,
) -> DetectedTags:  # fmt: skip
    """Detections in the photographs of all cameras.

    Args:
        given: folder of images, a video or a bag; of several cameras a folder with one folder for each, or a bag.
        cameras: cameras with the sizes of their images.
        detector: detector of the tags.
        modules: number of modules on an edge in the tags' family.
        each: function that applies a function to each of some jobs, in their order.
        topic: topic of a bag, or of each camera.
        rate: greatest number of frames a second taken from a video.
        workers: number of processes of `each`, None for every processor; the result does not depend on the number.

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
            raise InputError(f"{text}, {str(given)!r} has {len(folders)}.")
        views = {printable(folder.name): Photographs(folder, "photographs") for folder in folders}
    parts = {
        name: detected_in(images, camera, detector, modules, each, workers)
        for (name, images), camera in zip(views.items(), cameras, strict=True)
    }
    return DetectedTags.together(parts) if len(parts) > 1 else next(iter(parts.values()))


class Chunk(NamedTuple):
    """Consecutive images, for a worker."""

    images: Images
    camera: "Camera"
    detector: "Detector"
    modules: int
    first: int
    last: int


def detected_in(
    images: Images, camera: "Camera", detector: "Detector", modules: int, each: Each, workers: int | None
) -> DetectedTags:
    """Detections in images of one camera, without images that are much more blurred than the others.

    Raises:
        InputError: an image cannot be read, or no image shows a tag.
    """
    next(images.read(0, 1, camera), None)  # an error that is common to all images is raised before the work begins
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
    """Detections in each image, and the blur of the image."""
    found = []
    for image in job.images.read(job.first, job.last, job.camera):
        detections = job.detector.detect(image)
        found.append((detections, blur_of(image, detections, job.modules)))
    return found
