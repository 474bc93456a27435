"""Localisation: all steps from detections and a fixed map to poses with covariances, in order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.trajectory import Trajectory
from lmd.localise.changes import Changes, find_changes
from lmd.localise.fixed_map import FixedMap
from lmd.localise.image_poses import ImagePoses, image_poses
from lmd.localise.refined_optics import RefinedOptics, refined_optics
from lmd.localise.smoothing import SmoothedPoses, smoothed_poses
from lmd.localise.vanished import vanished_tags
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.survey.intrinsics import Calibrated
from lmd.survey.map_estimate import mount_doubts
from lmd.survey.motion import Motion, seconds_of
from lmd.survey.nuisances import Optics
from lmd.survey.sightings import Sightings, outside_doubts
from lmd.survey.survey import FEWEST_BELIEVED

MOUNT_FRAMES = 200  # frames by which the mounts of cameras are tested
TRIED_FRAMES = 40  # frames of several tags by which the first corner of detections is found


@dataclass(frozen=True)
class Localisation:
    """Result of a localisation; frames in the order of `detected.times`."""

    detected: DetectedTags
    """Detections, with corners in the order of the tags' frames."""
    known: FixedMap
    """The map."""
    renumbered: int
    """Number of corners by which the first corner of all detections was moved back."""
    found: ImagePoses
    """Poses of single images."""
    smoothed: SmoothedPoses | None
    """Smoothed poses; None if the motion between frames is unknown."""
    changes: Changes
    """Tags that were moved since the map was made, and new tags."""
    vanished: dict[int, int] | None
    """Number of views in which each tag that vanished should have been detected, by id; None in an unknown room."""
    calibrated: tuple[Calibrated, ...]
    """Cameras as refined by the drive; empty if cameras are exact."""
    doubts: tuple[str, ...] = ()
    """Sentences on what contradicts the images: calibrations, mounts, tags of one id."""


def localise(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: FixedMap,
    mounts: FloatArray | None = None,
    odometry: Trajectory | None = None,
    steady: bool | None = None,
    room: Space | None = None,
    calibrate: bool = True,
) -> Localisation:
    """Localise the frames of detections in a map.

    Args:
        detected: detections.
        cameras: cameras in the order of `detected.cameras`.
        tag: family of the tags.
        errors: errors of the detector's corners.
        known: map.
        mounts: poses of the cameras on the body, which is the first camera; None for one camera.
        odometry: trajectory of the body in any frame; None if unknown.
        steady: False if the velocity may change at once, so that poses are not smoothed without odometry.
        room: room of the map, whose surfaces hide tags; None if unknown, so that no tag is said to have vanished.
        calibrate: False if cameras are exact; else they are refined within the uncertainty of a calibration.

    Raises:
        InputError: no detection has a tag of the map, the cameras are others, or odometry contradicts the images.
    """
    if not np.isin(detected.ids, known.ids).any():
        shown = ", ".join(map(str, np.unique(detected.ids)[:5].tolist()))
        raise InputError(f"detections has no tag of the map, only others such as {shown}.", "detections")
    poses = np.tile(np.eye(4), (len(cameras), 1, 1)) if mounts is None else mounts
    optics = RefinedOptics(tuple(Optics(camera) for camera in cameras))

    def sighted(some: DetectedTags) -> Sightings:
        return optics.sightings(some, known, tag, errors)

    quarters = 0 if detected.in_order else _quarters(detected, known, sighted, poses)
    if quarters:
        detected = detected.renumbered(known.ids, np.full(len(known.ids), quarters))
    sightings = sighted(detected)
    if not len(sightings):
        raise InputError("detections has no tag of the map wholly within an image; is it another camera?", "detections")
    found = image_poses(sightings, known.poses, poses, known.sigmas)
    if calibrate:
        optics = refined_optics(detected, cameras, tag, errors, known, found)
    several, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    others = optics.sightings(detected, known, tag, errors, several[counts >= FEWEST_BELIEVED].tolist())

    def localised(present: FixedMap) -> ImagePoses:
        some = optics.with_errors(sighted(detected), present, found)
        return image_poses(some, present.poses, poses, present.sigmas, present.joint, optics.covariances)

    found = localised(known)
    changes = find_changes(optics.with_errors(others, known, found), known, poses, found)
    present = changes.updated(known)
    if changes.moved:
        found = localised(present)
    seconds = seconds_of(detected.times)
    motion = None
    if odometry is not None:
        motion = Motion.by_odometry(seconds, odometry)
    elif steady is not False and np.isfinite(seconds).all():
        motion = Motion.steady(seconds)
    smoothed = None if motion is None else smoothed_poses(found, motion, present, changes.inflation)
    through = [one.camera for one in optics.cameras]
    vanished = None if room is None else vanished_tags(found, present, through, room)
    doubts = outside_doubts(detected, cameras) or _mount_doubts(sightings, known, poses) or [*optics.doubts]
    doubts += [
        f"tag {others.ids[place.tag]} hangs at ({', '.join(f'{x:.2f}' for x in place.pose[:3, 3])}) as well, by "
        f"{place.sightings} images: has another tag its id, or was it moved on the way?"
        for place in changes.twice
    ]
    calibrated = optics.calibrated(cameras)
    return Localisation(detected, known, quarters, found, smoothed, changes, vanished, calibrated, tuple(doubts))


def _mount_doubts(sightings: Sightings, known: FixedMap, mounts: FloatArray) -> list[str]:
    """Sentences on cameras that are mounted elsewhere, see `mount_doubts`, by some frames with tags in each camera."""
    count = len(mounts)
    shows = np.zeros((count, sightings.frames), dtype=bool)
    shows[sightings.camera, sightings.frame] = True
    both = np.flatnonzero(shows.sum(axis=0) > 1)
    if not len(both):
        return []
    some = sightings.of(np.isin(sightings.frame, both[:: max(1, len(both) // MOUNT_FRAMES)])).with_separate_cameras()
    views = image_poses(some, known.poses, np.eye(4)[None], known.sigmas).poses.frames
    return mount_doubts(views.reshape(count, sightings.frames, 4, 4), mounts)


def _quarters(
    detected: DetectedTags, known: FixedMap, sighted: Callable[[DetectedTags], Sightings], mounts: FloatArray
) -> int:
    """Quarter turns by which the corners of detections are numbered from another corner: those with which most
    sightings of frames with several tags of the map fit; 0 in a tie.
    """
    of_map = np.flatnonzero(np.isin(detected.ids, known.ids))
    counts = np.bincount(detected.frame[of_map], minlength=len(detected.times))
    several = np.flatnonzero(counts > 1)
    tried = several[:: max(1, len(several) // TRIED_FRAMES)]
    some = detected.of(of_map[np.isin(detected.frame[of_map], tried)]) if len(tried) else None
    if some is None:
        return 0
    fits = []
    for quarters in range(4):
        turned = sighted(some.renumbered(known.ids, np.full(len(known.ids), quarters)))
        fits.append(int(image_poses(turned, known.poses, mounts, known.sigmas).used.sum()))
    return int(np.argmax(fits))
