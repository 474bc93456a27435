"""Smoothed poses: all poses of a drive together, by its images, the map, and the motion between its frames.

This is the bundle adjustment of a survey in which the map is the prior of the tags. Images that two poses fit count as
well: the smoothest sequence decides between their poses.
"""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import inverse, log
from lmd.localise.fixed_map import FixedMap, information_of, rows_of
from lmd.localise.image_noise import ImageNoise
from lmd.localise.image_poses import ImagePoses
from lmd.survey.groups import Nodes, check_odometry, smoothest
from lmd.survey.initialisation import FLOOR_PIXELS
from lmd.survey.linked_adjustment import LinkedAdjustment
from lmd.survey.map_estimate import FINAL_STEPS, ONE_THREAD, STEPS
from lmd.survey.motion import Motion, with_bridged_gaps
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses, Reprojection
from lmd.survey.sightings import Sightings

FEWEST_FRAMES = 3  # minimum number of frames of a drive that is smoothed


@dataclass(frozen=True)
class SmoothedPoses:
    """Smoothed poses of F images."""

    frames: FloatArray
    """`(F, 4, 4)` poses of the body; NaN for images without a sighting that fits."""
    covariances: FloatArray
    """`(F, 6, 6)` covariance of the right-hand twist of each pose, rad and metres; NaN without a pose."""
    motion: Motion
    """Motion between the frames, with its estimated spread."""
    used: BoolArray
    """`(N,)` sightings of the images' poses that fit."""
    floor: float
    """Standard deviation of corners beyond the detector's own, pixels."""


def smoothed_poses(found: ImagePoses, motion: Motion, known: FixedMap, inflation: float = 1.0) -> SmoothedPoses | None:
    """Smooth the poses of images.

    Args:
        found: poses of single images.
        motion: motion between the frames.
        known: map, with the tags of the sightings.
        inflation: factor on the standard deviations of sightings, see `lmd.survey.resampling`.

    Returns:
        smoothed poses; None if motion links no two frames with poses.

    Raises:
        InputError: odometry contradicts the images.
    """
    with threadpool_limits(limits=ONE_THREAD):
        frames = _decided(found, motion)
        poses, some = replace(found.poses, frames=frames), found.sightings
        posed = np.isfinite(frames[some.frame, 0, 0])
        used = found.used | (posed & ~found.localised[some.frame])
        for steps in (STEPS, FINAL_STEPS):
            used = posed & used
            there = np.unique(some.frame[used])
            if len(there) < FEWEST_FRAMES or not motion.follows(there).any():
                return None
            seen, own = _of_seen_tags(some.of(used), poses)
            rows = rows_of(seen)
            joint = information_of(known.joint[np.ix_(rows, rows)])
            prior = Prior(known.poses[seen], known.sigmas[seen] ** -2.0, None, own.mounts, motion, joint)
            adjustment = LinkedAdjustment(_renumbered(some.of(used), seen), prior, inflation=inflation)
            own, floor = adjustment.run(own, FLOOR_PIXELS, steps)
            if steps == STEPS:
                check_odometry(adjustment, own)
                motion = adjustment.estimate_motion(own, floor)
                if not motion.is_odometry:
                    part = motion.of(adjustment.seen, np.zeros(len(adjustment.seen), dtype=np.int64))
                    tested = with_bridged_gaps(part, own.frames[adjustment.seen])
                    motion = replace(motion, gaps=tested.gaps, bridged=tested.bridged)
                tags = poses.tags.copy()
                tags[seen] = own.tags
                shown = some.of(posed)
                at = Reprojection(shown, *replace(poses, frames=own.frames).of(shown))
                used[posed] = ImageNoise.of(shown, at, known.sigmas).fits(shown, at.error, floor)
            poses = replace(poses, frames=own.frames)
        covariances = np.full((len(frames), 6, 6), np.nan)
        final = LinkedAdjustment(adjustment.sightings, prior, True, inflation)
        covariances[adjustment.seen] = final.frame_covariances(own, floor)
        result = np.full_like(frames, np.nan)
        result[adjustment.seen] = own.frames[adjustment.seen]
    return SmoothedPoses(result, covariances, motion, used, floor)


def _decided(found: ImagePoses, motion: Motion) -> FloatArray:
    """Poses of the frames, `(F, 4, 4)`; of two poses that fit, the one nearer to the smoothest sequence."""
    frames, some = found.poses.frames.copy(), found.sightings
    open_frames = np.flatnonzero(np.isfinite(found.others[:, 0, 0, 0]))
    if not open_frames.size:
        return frames
    nodes = Nodes.of(some, np.zeros(len(some.ids), dtype=np.int64), motion)
    views = np.full_like(frames, np.nan)
    views[nodes.frame] = smoothest(nodes, found.poses).frames
    both = found.others[open_frames]
    away = np.linalg.norm(log(inverse(views[open_frames])[:, None] @ both), axis=2)
    frames[open_frames] = both[np.arange(len(both)), np.argmin(away, axis=1)]
    # A frame that no other frame is linked to stays open.
    there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
    alone = np.setdiff1d(open_frames, there[motion.linked(there)])
    frames[alone] = np.nan
    return frames


def _of_seen_tags(some: Sightings, poses: Poses) -> tuple[IntArray, Poses]:
    """Indices of the tags of some sightings, and the poses of these tags."""
    seen = np.unique(some.tag)
    return seen, replace(poses, tags=poses.tags[seen])


def _renumbered(some: Sightings, seen: IntArray) -> Sightings:
    """Sightings of the tags `seen` alone, `(k,)`, so that matrices have no rows of other tags."""
    tag = np.searchsorted(seen, some.tag)
    return replace(some, ids=some.ids[seen], edges=some.edges[seen], shapes=some.shapes[seen], tag=tag)
