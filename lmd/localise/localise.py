"""Localisation: all steps from detections and a map to poses with covariances, in order.

Localisation is the bundle adjustment of a survey in which the map is the prior of the tags (`lmd.adjust`). Poses of the
cameras on the body (*mounts*), intrinsics, shapes of tags and poses of new tags are unknowns as well. There are two
results: poses from single images, and smoothed poses if motion links the frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.candidates import placed_tags
from lmd.adjust.corners import Poses, agreeing, squared_errors
from lmd.adjust.drive import Nodes, measured_motion, smoothest, spread_motion, with_motion, with_rough_clock
from lmd.adjust.estimate import FLOOR_PIXELS, ONE_THREAD, STEPS, Estimate
from lmd.adjust.faults import other_sizes, second_places, with_best_edges
from lmd.adjust.intrinsics import Optics
from lmd.adjust.motion import Motion, seconds_of
from lmd.adjust.prior import Mounts
from lmd.adjust.refinement import edge_doubts, minimised, synchronised, with_lenses
from lmd.adjust.sightings import Observations, outside_doubts
from lmd.core.checks import FloatArray, InputError
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import inverse, log
from lmd.geometry.trajectory import Trajectory
from lmd.localise.changes import Change, Comparison, compare
from lmd.localise.fixed_map import FixedMap
from lmd.localise.images import RoughPoses, State, rough_poses, states_of
from lmd.scene.tag import Tag

# Minimum number, and share, of sightings that must agree on the pose of a tag that the map lacks, as ids may be
# misread.
FEWEST_BELIEVED, LEAST_SHARE = 2, 0.3
TRIED_FRAMES = 40  # maximum number of frames with several tags by which the first corner of detections is found
FEWEST_FRAMES = 3  # minimum number of frames of a drive that is smoothed
SURPRISING = 3.0  # a mount or camera is named if its estimate is farther from its prior, in standard deviations
# Standard deviations of mounts that were measured with a tape measure: rotation, rad, and position, metres.
MOUNT_SIGMAS = (0.0175, 0.01)


@dataclass(frozen=True)
class Drive:
    """Prior knowledge of the body that carries the cameras: poses of the cameras on it (mounts), and its motion."""

    mounts: FloatArray | None = None
    """`(C, 4, 4)` poses of the cameras on the body, which is the first camera, as measured by hand; None for one
    camera.
    """
    odometry: Trajectory | None = None
    """Trajectory of the body in any frame; None if unknown."""
    steady: bool | None = None
    """False if the velocity may change suddenly: poses are then smoothed only with odometry."""

    def motion(self, detected: DetectedTags) -> Motion | None:
        """Motion between the frames; None if it is unknown."""
        seconds = seconds_of(detected.times)
        if self.odometry is not None:
            return Motion.by_odometry(seconds, self.odometry)
        return Motion(seconds) if self.steady is not False and np.isfinite(seconds).all() else None


@dataclass(frozen=True)
class Localisation:
    """Result of a localisation; frames in the order of `detected.times`."""

    detected: DetectedTags
    """Detections, with corners in the order of the tags' frames."""
    known: FixedMap
    """The map."""
    renumbered: int
    """Index that corner 0 of every detection got when the corners were put into the order of the tags' frames; 0 if
    their order was right.
    """
    found: Estimate
    """Estimate of the poses of single images; frames that are refused have no pose."""
    states: tuple[State, ...]
    """Outcome of each image."""
    smoothed: Estimate | None
    """Estimate of the smoothed poses; None if the motion between frames is unknown."""
    changes: tuple[Change, ...]
    """Tags that were moved, followed by new tags, each in the order of their ids."""
    comparison: Comparison
    """Comparison of the tags with the map."""
    sizes: dict[int, float]
    """Estimated edge lengths of the tags whose stated size is wrong, metres, keyed by id."""
    doubts: tuple[str, ...]
    """Sentences on values that the images contradict: calibrations, mounts, ids that two tags share."""


def localise(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: FixedMap,
    drive: Drive | None = None,
    calibrate: bool = True,
) -> Localisation:
    """Localise the frames of detections in a map.

    Args:
        detected: detections.
        cameras: cameras in the order of `detected.cameras`.
        tag: family of the tags.
        errors: errors of the detector's corners.
        known: map of the tags.
        drive: mounts of the cameras and motion of the body; None for one camera with an unknown motion.
        calibrate: False if the cameras are exact; True to refine them within the uncertainty of a calibration.

    Raises:
        InputError: no tag of the map was detected, the cameras are not those of the detections, or odometry contradicts
            the images.
    """
    drive = drive or Drive()
    mounts = Mounts(np.eye(4)[None] if drive.mounts is None else drive.mounts, MOUNT_SIGMAS)
    motion, here = drive.motion(detected), _map_of(detected, tag, known)
    seen = Observations(detected, tuple(map(Optics, cameras)), here.ids, here.edges, tag.modules, errors)
    if not here.has[seen.through().tag].any():
        raise InputError(
            "detections has no tag of the map wholly within an image; check the calibration.",
            "detections",
        )
    with threadpool_limits(limits=ONE_THREAD):
        seen, quarters = (seen, 0) if detected.in_order else _in_order(seen, here, mounts)
        (seen, rough), odd = with_best_edges(seen, partial(_begun, here=here, mounts=mounts), here.poses[:, :3, 3])
        group = np.where(rough.poses.known_tags, 0, -1)
        begun = Estimate(seen.through(), here.prior(rough.gross, mounts), rough.poses, group).adjusted()
        states, both = states_of(begun, rough.others)
        begun = _with_all_tags(begun, rough, both)
        begun = with_lenses(begun, seen) if calibrate else begun
        compared = compare(begun, here, mounts, rough.gross, odd)
        found = compared.found
        alone, states = _refused(found, states)
        linked = None if motion is None else smoothed(found, motion, both)
        doubts = outside_doubts(seen) or [*_surprises(found, mounts), *(edge_doubts(found) if calibrate else ())]
        stay = found.misfits & (here.has & ~compared.moved)[found.sightings.tag]
        doubts += [
            f"tag {here.ids[place.tag]} hangs at ({', '.join(f'{x:.2f}' for x in place.pose[:3, 3])}) as well, in "
            f"{place.sightings} images: another tag has the same id, or the tag was moved during the drive"
            for place in second_places(found, stay)
        ]
    return Localisation(
        detected=seen.detected,
        known=known,
        renumbered=quarters,
        found=alone,
        states=tuple(states.tolist()),
        smoothed=linked,
        changes=tuple(compared.changes(here)),
        comparison=compared,
        sizes=other_sizes(found, compared.odd),
        doubts=tuple(doubts),
    )


def _map_of(detected: DetectedTags, tag: Tag, known: FixedMap) -> FixedMap:
    """Map of the detected tags: those in the map `known`, and tags without a pose that were detected at least twice.

    Raises:
        InputError: no tag of the map was detected.
    """
    if not np.isin(detected.ids, known.ids).any():
        shown = ", ".join(map(str, np.unique(detected.ids)[:5].tolist()))
        raise InputError(f"detections has no tag of the map, only tags such as {shown}.", "detections")
    several, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(several[counts >= FEWEST_BELIEVED], np.intersect1d(known.ids, detected.ids))
    return known.among(ids, float(np.median(known.edges)) if tag.is_point else tag.size)


def _begun(seen: Observations, here: FixedMap, mounts: Mounts) -> tuple[tuple[Observations, RoughPoses], int]:
    """Find rough poses. Returns a pair of the detections and the rough poses, and the number of sightings that agree
    with the rough poses.
    """
    rough = rough_poses(seen.through(), Poses(here.poses, np.empty((0, 4, 4)), mounts.poses), here.sigmas)
    return (seen, rough), int(agreeing(seen.through(), squared_errors(seen.through(), rough.poses)).sum())


def _in_order(seen: Observations, here: FixedMap, mounts: Mounts) -> tuple[Observations, int]:
    """Detections whose corners begin at the top left, and the new index of corner 0 of the given detections. The index
    with which most sightings fit is chosen, the lowest in a tie. Only frames with several tags of the map are used;
    without such frames the index is 0.
    """
    detected = seen.detected
    of_map = np.flatnonzero(np.isin(detected.ids, here.ids[here.has]))
    several = np.flatnonzero(np.bincount(detected.frame[of_map]) > 1)
    tried = several[:: max(1, len(several) // TRIED_FRAMES)]
    if not len(tried):
        return seen, 0
    some = replace(seen, detected=detected.of(of_map[np.isin(detected.frame[of_map], tried)]))
    best = int(np.argmax([_begun(some.renumbered(quarters), here, mounts)[1] for quarters in range(4)]))
    return seen.renumbered(best), best


def _with_all_tags(begun: Estimate, rough: RoughPoses, both: FloatArray) -> Estimate:
    """Estimate in which tags without a rough pose get a pose from the frames, and ambiguous frames lose their pose.
    `both` `(F, 2, 4, 4)` has two poses of each ambiguous frame, NaN for other frames.
    """
    some, lost = begun.sightings, ~rough.poses.known_tags
    frames = np.where(np.isfinite(both[:, 0]), np.nan, begun.poses.frames)
    begun = replace(begun, poses=replace(begun.poses, tags=rough.poses.tags, frames=frames))
    begun = begun.with_tags(lost, placed_tags(some.of(lost[some.tag]), begun.poses, FEWEST_BELIEVED, LEAST_SHARE)[lost])
    return replace(begun, group=np.where(begun.poses.known_tags, 0, -1))


def _refused(found: Estimate, states: NDArray[np.object_]) -> tuple[Estimate, NDArray[np.object_]]:
    """Refuse the frames in which most sightings do not fit. Return the estimate without the poses of all refused
    frames, and the outcome of each frame, `(F,)`. `states` `(F,)` has the outcomes before this check.
    """
    some = found.sightings
    of_map = found.poses.known_tags[some.tag]
    seen, used = (np.bincount(some.frame[which], minlength=some.frames) for which in (of_map, found.used))
    wrong = (seen > 0) & (2 * used <= seen) & ~((used == 1) & (seen == 1))
    after = states.copy()
    after[wrong & (states == State.LOCALISED)] = State.RESIDUAL
    refused = np.asarray(after != State.LOCALISED)
    poses = replace(found.poses, frames=np.where(refused[:, None, None], np.nan, found.poses.frames))
    return replace(found, poses=poses, used=found.used & ~refused[some.frame]), after


def smoothed(found: Estimate, motion: Motion, both: FloatArray) -> Estimate | None:
    """Estimate in which motion links the frames.

    Args:
        found: estimate of single images.
        motion: motion between the frames.
        both: two poses of each frame that both fit almost equally well, `(F, 2, 4, 4)`, NaN for other frames; the
            smoothest sequence decides between the two.

    Returns:
        smoothed estimate; None if fewer than `FEWEST_FRAMES` frames have a pose, or motion links no two of these
        frames.

    Raises:
        InputError: odometry contradicts the images.
    """
    there = np.flatnonzero(found.poses.known_frames)
    motion = with_rough_clock(motion, there, 0 * there, found.poses.frames[there])
    poses, some = _decided(found, motion, both), found.sightings
    there = np.flatnonzero(poses.known_frames)
    if len(there) < FEWEST_FRAMES or not motion.follows(there).any():
        return None
    posed = poses.known_frames[some.frame] & (found.group[some.tag] == 0)
    used = posed & (found.used | np.isfinite(both[some.frame, 0, 0, 0]))
    rough = Adjustment(some.of(used), replace(found.prior, motion=motion), inflation=found.inflation)
    rough = with_motion(rough, spread_motion(rough, poses, FLOOR_PIXELS))
    poses, floor = rough.run(poses, FLOOR_PIXELS, STEPS)
    prior = replace(found.prior, motion=measured_motion(rough, poses, floor))

    def again(begun: Estimate) -> Estimate:
        """Adjust all poses of the estimate `begun`. Refine the cameras too if their intrinsics are unknowns."""
        now = begun.adjusted()
        return now if now.lenses is None else minimised(now)

    return synchronised(again(replace(found, prior=prior, poses=poses)), again)


def _decided(found: Estimate, motion: Motion, both: FloatArray) -> Poses:
    """Poses of an estimate, with a decision for each ambiguous frame, which two poses fit. The pose nearer to the
    smoothest sequence of poses is taken; none if no other frame is linked to the frame. `both` `(F, 2, 4, 4)` has the
    two poses of each ambiguous frame, NaN for other frames.
    """
    frames, opened = found.poses.frames.copy(), np.flatnonzero(np.isfinite(both[:, 0, 0, 0]))
    if opened.size:
        some = found.sightings.of(found.poses.known_tags[found.sightings.tag])
        nodes = Nodes.of(some, np.zeros(len(some.ids), dtype=np.int64), motion)
        views = np.full_like(frames, np.nan)
        views[nodes.frame] = smoothest(nodes, found.poses).frames
        away = np.linalg.norm(log(inverse(views[opened])[:, None] @ both[opened]), axis=2)
        frames[opened] = both[opened, np.argmin(away, axis=1)]
        # A frame that no other frame is linked to stays open.
        there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
        frames[np.setdiff1d(opened, there[motion.linked(there)])] = np.nan
    return replace(found.poses, frames=frames)


def _surprises(found: Estimate, mounts: Mounts) -> list[str]:
    """Sentences on mounts, focal lengths and principal points whose estimate is more than `SURPRISING` standard
    deviations from the prior.
    """
    said, off = [], -mounts.off(found.poses.mounts)
    for camera in np.flatnonzero((np.abs(off) > SURPRISING * mounts.information**-0.5).any(axis=1)).tolist():
        turn, way = np.linalg.norm(off[camera].reshape(2, 3), axis=1)
        where = f"camera {camera + 2} is {1e3 * way:.0f} mm and {np.degrees(turn):.3g} degrees from its mount"
        said.append(f"{where}, as estimated from the images; check the signs, units and order of the poses of the rig")
    for number, camera in enumerate(found.calibrated, 1):
        assert found.lenses is not None
        if (most := np.abs(found.lenses.off[number - 1, :4]).max()) >= SURPRISING:
            text = f"{most:.2g} standard deviations of a calibration from the given one"
            said.append(f"camera {number} is {text} ({camera.to_text().partition(';')[0]}); check the calibration")
    return said
