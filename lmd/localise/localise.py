"""Localisation: all steps from detections and a map to poses with covariances, in order.

Localisation is the bundle adjustment of a survey in which the map is the prior of the tags (`lmd.adjust`). Mounts,
cameras, shapes of tags and new tags are unknowns as well. Frames alone have the poses of single images; frames that
motion links have smoothed poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.candidates import single_poses
from lmd.adjust.corners import Poses
from lmd.adjust.estimate import FLOOR_PIXELS, ONE_THREAD, STEPS, Estimate, adjust
from lmd.adjust.intrinsics import Calibrated, Optics
from lmd.adjust.motion import Motion, seconds_of, with_bridged_gaps
from lmd.adjust.mounts import Mounts, mount_doubt
from lmd.adjust.refinement import Refined, edge_doubts
from lmd.adjust.second_places import FEWEST_SIGHTINGS
from lmd.adjust.sequence import Nodes, smoothest
from lmd.adjust.sightings import Observations, outside_doubts
from lmd.adjust.sizes import odd_sizes
from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import inverse, log
from lmd.geometry.trajectory import Trajectory
from lmd.localise.changes import Changes, MapPrior, compare
from lmd.localise.fixed_map import FixedMap
from lmd.localise.images import RoughPoses, State, rough_poses, states_of
from lmd.localise.vanished import vanished_tags
from lmd.scene.tag import Tag
from lmd.space.space import Space

FEWEST_BELIEVED = 2  # minimum number of sightings of a tag that the map lacks, as ids may be misread
TRIED_FRAMES = 40  # frames of several tags by which the first corner of detections is found
FEWEST_FRAMES = 3  # minimum number of frames of a drive that is smoothed
SURPRISING = 3.0  # standard deviations of its prior beyond which an estimated mount or camera is named
# Standard deviations of mounts that were measured with a tape measure: rotation, rad, and position, metres.
MOUNT_SIGMAS = (0.0175, 0.01)


@dataclass(frozen=True)
class Drive:
    """Knowledge of the body that carries the cameras, and of its motion."""

    mounts: FloatArray | None = None
    """`(C, 4, 4)` poses of the cameras on the body, which is the first camera; None for one camera."""
    is_mounted: bool = False
    """True if the mounts are exact; else they were measured with a tape measure, and are estimated."""
    odometry: Trajectory | None = None
    """Trajectory of the body in any frame; None if unknown."""
    steady: bool | None = None
    """False if the velocity may change at once, so that poses are not smoothed without odometry."""

    def prior(self) -> Mounts | None:
        """Prior of the mounts."""
        return None if self.mounts is None else Mounts(self.mounts, None if self.is_mounted else MOUNT_SIGMAS)

    def motion(self, detected: DetectedTags) -> Motion | None:
        """Motion between the frames; None if it is unknown."""
        seconds = seconds_of(detected.times)
        if self.odometry is not None:
            return Motion.by_odometry(seconds, self.odometry)
        return Motion.steady(seconds) if self.steady is not False and np.isfinite(seconds).all() else None


@dataclass(frozen=True)
class FramePoses:
    """Poses of F frames."""

    estimate: Estimate
    """Estimate of all poses; frames without a pose are NaN."""
    covariances: FloatArray
    """`(F, 6, 6)` covariance of the right-hand twist of each pose, rad and metres; NaN without a pose."""
    states: tuple[State, ...]
    """Outcome of each frame by itself."""

    @classmethod
    def of(cls, found: Estimate, states: Sequence[State]) -> "FramePoses":
        """Poses of the frames of an estimate that are not refused."""
        count = found.sightings.frames
        covariances, keep = np.full((count, 6, 6), np.nan), np.isfinite(found.poses.frames[:, 0, 0])
        if found.used.any():
            with threadpool_limits(limits=ONE_THREAD):
                final = found.adjustment
                covariances[final.seen] = final.frame_covariances(found.poses, found.floor)
        covariances[~keep] = np.nan
        return cls(found, covariances, tuple(states))

    @property
    def frames(self) -> FloatArray:
        """Poses of the body, `(F, 4, 4)`; NaN if unknown."""
        return self.estimate.poses.frames

    @property
    def used(self) -> BoolArray:
        """Sightings that fit, `(N,)`."""
        return self.estimate.used

    @property
    def localised(self) -> BoolArray:
        """True for frames with a pose, `(F,)`."""
        return np.isfinite(self.frames[:, 0, 0])


@dataclass(frozen=True)
class Localisation:
    """Result of a localisation; frames in the order of `detected.times`."""

    detected: DetectedTags
    """Detections, with corners in the order of the tags' frames."""
    known: FixedMap
    """The map."""
    renumbered: int
    """Number of corners by which the first corner of all detections was moved back."""
    found: FramePoses
    """Poses of single images."""
    smoothed: FramePoses | None
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
    drive: Drive | None = None,
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
        drive: mounts of the cameras and motion of the body; None for one camera with an unknown motion.
        room: room of the map, whose surfaces hide tags; None if unknown, so that no tag is said to have vanished.
        calibrate: False if cameras are exact; else they are refined within the uncertainty of a calibration.

    Raises:
        InputError: no detection has a tag of the map, the cameras are others, or odometry contradicts the images.
    """
    drive = drive or Drive()
    motion, seen = drive.motion(detected), _observed(detected, cameras, tag, errors, known)
    prior = MapPrior.of(known, seen.ids, drive.prior())
    quarters = 0 if detected.in_order else _quarters(seen, prior)
    seen = replace(seen, detected=detected.renumbered(seen.ids, np.full(len(seen.ids), quarters)))
    sightings = seen.through()
    if not prior.in_map[sightings.tag].any():
        raise InputError("detections has no tag of the map wholly within an image; is it another camera?", "detections")
    with threadpool_limits(limits=ONE_THREAD):
        seen, rough, gross, odd = _begun(seen, prior)
        sightings = seen.through()
        group = np.where(np.isnan(rough.poses.tags[:, 0, 0]), -1, 0)
        begun = adjust(sightings, prior.prior(gross), rough.poses, group, FLOOR_PIXELS)
        states, both = states_of(begun, rough.others)
        frames = np.where(np.isfinite(both[:, 0]), np.nan, begun.poses.frames)
        begun = replace(begun, poses=replace(begun.poses, frames=frames))
        comparison = compare(seen, prior, begun, gross, odd, calibrate)
    now, changes = comparison.now, comparison.changes(prior)
    alone = FramePoses.of(*_refused(now.found, states))
    linked = None if motion is None else smoothed(now, motion, both)
    best = linked or now
    doubts = outside_doubts(seen) or [*_surprises(now, drive), *(edge_doubts(now) if calibrate else ())]
    doubts += [
        f"tag {seen.ids[place.tag]} hangs at ({', '.join(f'{x:.2f}' for x in place.pose[:3, 3])}) as well, by "
        f"{place.sightings} images: has another tag its id, or was it moved on the way?"
        for place in changes.twice
    ]
    vanished = None if room is None else vanished_tags(alone.estimate, known, now.optics, room)
    result = None if linked is None else FramePoses.of(linked.found, states)
    return Localisation(
        seen.detected, known, quarters, alone, result, changes, vanished, best.calibrated, tuple(doubts)
    )


def _begun(seen: Observations, prior: MapPrior) -> tuple[Observations, RoughPoses, BoolArray, BoolArray]:
    """Rough poses and the mask of the tags that contradict the others, `(K,)`, with the detections of tags of another
    edge than the map states, and the mask of these, `(K,)`: those by which more sightings agree.
    """
    sightings = seen.through()
    single = single_poses(sightings).poses
    rough, gross = rough_poses(sightings, single, prior.begin, prior.sigmas)
    factors, odd = odd_sizes(sightings, single[:, 0])
    if gross.any() and odd.any():
        other = replace(seen, edges=seen.edges * factors)
        resized = other.through()
        again, fewer = rough_poses(resized, single_poses(resized).poses, prior.begin, prior.sigmas)
        if again.agreed(resized) > rough.agreed(sightings) + FEWEST_SIGHTINGS:
            return other, again, fewer, odd
    return seen, rough, gross, np.zeros_like(odd)


def _observed(
    detected: DetectedTags, cameras: Sequence[Camera], tag: Tag, errors: CornerErrors, known: FixedMap
) -> Observations:
    """Detections of the tags of the map that are seen, and of other tags that are seen twice.

    Raises:
        InputError: no detection has a tag of the map.
    """
    if not np.isin(detected.ids, known.ids).any():
        shown = ", ".join(map(str, np.unique(detected.ids)[:5].tolist()))
        raise InputError(f"detections has no tag of the map, only others such as {shown}.", "detections")
    several, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(several[counts >= FEWEST_BELIEVED], np.intersect1d(known.ids, detected.ids))
    edges = np.full(len(ids), np.median(known.edges) if tag.is_point else tag.size)
    _, own, there = np.intersect1d(ids, known.ids, return_indices=True)
    edges[own] = known.edges[there]
    return Observations(detected, tuple(map(Optics, cameras)), ids, edges, tag.modules, errors)


def _quarters(seen: Observations, prior: MapPrior) -> int:
    """Quarter turns by which the corners of detections are numbered from another corner: those with which most
    sightings of frames with several tags of the map fit; 0 in a tie.
    """
    detected = seen.detected
    of_map = np.flatnonzero(np.isin(detected.ids, seen.ids[prior.in_map]))
    counts = np.bincount(detected.frame[of_map], minlength=len(detected.times))
    several = np.flatnonzero(counts > 1)
    tried = several[:: max(1, len(several) // TRIED_FRAMES)]
    if not len(tried):
        return 0
    some, agreed = detected.of(of_map[np.isin(detected.frame[of_map], tried)]), []
    for quarters in range(4):
        turned = some.renumbered(seen.ids, np.full(len(seen.ids), quarters))
        sightings = replace(seen, detected=turned).through()
        rough, _ = rough_poses(sightings, single_poses(sightings).poses, prior.begin, prior.sigmas)
        agreed.append(rough.agreed(sightings))
    return int(np.argmax(agreed))


def _refused(found: Estimate, states: Sequence[State]) -> tuple[Estimate, list[State]]:
    """Estimate without the frames of which most sightings do not fit, and the outcomes of all frames."""
    of_map = np.isfinite(found.poses.tags[found.sightings.tag, 0, 0])
    seen, used = (
        np.bincount(found.sightings.frame[which], minlength=found.sightings.frames) for which in (of_map, found.used)
    )
    wrong = (seen > 0) & (2 * used <= seen) & ~((used == 1) & (seen == 1))
    after = [
        State.RESIDUAL if state is State.LOCALISED and is_wrong else state
        for state, is_wrong in zip(states, wrong, strict=True)
    ]
    refused = np.array([state is not State.LOCALISED for state in after])
    frames = np.where(refused[:, None, None], np.nan, found.poses.frames)
    used_frames = found.used & ~refused[found.sightings.frame]
    return replace(found, poses=replace(found.poses, frames=frames), used=used_frames), after


def smoothed(now: Refined, motion: Motion, both: FloatArray) -> Refined | None:
    """Estimate in which motion links the frames.

    Args:
        now: estimate of single images.
        motion: motion between the frames.
        both: `(F, 2, 4, 4)` poses of frames that two poses fit, NaN for others; the smoothest sequence decides.

    Returns:
        None if motion links no two frames with poses.

    Raises:
        InputError: odometry contradicts the images.
    """
    with threadpool_limits(limits=ONE_THREAD):
        poses = _decided(now.found, motion, both)
        there = np.flatnonzero(np.isfinite(poses.frames[:, 0, 0]))
        if len(there) < FEWEST_FRAMES or not motion.follows(there).any():
            return None
        found, prior = now.found, replace(now.found.prior, motion=motion)
        posed = np.isfinite(poses.frames[found.sightings.frame, 0, 0]) & (found.group[found.sightings.tag] == 0)
        used = posed & (found.used | np.isfinite(both[found.sightings.frame, 0, 0, 0]))
        rough = Adjustment(found.sightings.of(used), prior, inflation=found.inflation)
        rough = rough.with_motion(rough.estimate_motion(poses, FLOOR_PIXELS))
        poses, floor = rough.run(poses, FLOOR_PIXELS, STEPS)
        assert rough.links is not None
        rough.links.check(poses.frames[rough.seen])
        motion = rough.estimate_motion(poses, floor)
        if not motion.is_odometry:
            part = motion.of(rough.seen, np.zeros(len(rough.seen), dtype=np.int64))
            tested = with_bridged_gaps(part, poses.frames[rough.seen])
            motion = replace(motion, gaps=tested.gaps, bridged=tested.bridged)
        prior = replace(prior, motion=motion)
        found = adjust(found.sightings, prior, poses, found.group, FLOOR_PIXELS, found.inflation)
        linked = replace(now, found=found)
    return linked.minimised() if now.sigmas else linked


def _decided(found: Estimate, motion: Motion, both: FloatArray) -> Poses:
    """Poses of the frames; of two poses of an open frame, the one nearer to the smoothest sequence."""
    frames, opened = found.poses.frames.copy(), np.flatnonzero(np.isfinite(both[:, 0, 0, 0]))
    if opened.size:
        some = found.sightings.of(np.isfinite(found.poses.tags[found.sightings.tag, 0, 0]))
        nodes = Nodes.of(some, np.zeros(len(some.ids), dtype=np.int64), motion)
        views = np.full_like(frames, np.nan)
        views[nodes.frame] = smoothest(nodes, found.poses).frames
        away = np.linalg.norm(log(inverse(views[opened])[:, None] @ both[opened]), axis=2)
        frames[opened] = both[opened, np.argmin(away, axis=1)]
        # A frame that no other frame is linked to stays open.
        there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
        frames[np.setdiff1d(opened, there[motion.linked(there)])] = np.nan
    return replace(found.poses, frames=frames)


def _surprises(now: Refined, drive: Drive) -> list[str]:
    """Sentences on mounts and cameras that are estimated beyond `SURPRISING` standard deviations of their priors."""
    said, prior = [], drive.prior()
    if prior is not None and prior.sigmas is not None:
        off = log(inverse(now.found.poses.mounts[1:]) @ prior.poses[1:])
        for camera, twist in enumerate(off, 1):
            if (np.abs(twist) > SURPRISING * np.repeat(prior.sigmas, 3)).any():
                said.append(mount_doubt(camera, twist, "by the images"))
    return said + now.surprises(SURPRISING)
