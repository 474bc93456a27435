"""Rough poses of single images in a map, and reasons for the refusal of images.

Each sighting of a tag proposes two poses of the body, as two poses of a tag look alike (IPPE). For each image the
likeliest proposals are refined with all tags in view. The image is refused if another pose is nearly as likely as the
best pose.
"""

from dataclasses import replace
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmd.adjust.candidates import Candidates, measured_mounts, single_poses
from lmd.adjust.corners import Poses, Reprojection, agreeing, resected, squared_errors, student_losses
from lmd.adjust.estimate import Estimate
from lmd.adjust.faults import FEWEST_SIGHTINGS
from lmd.adjust.sightings import Sightings
from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.se3 import angle_between

FRAME_CHUNK = 256  # frames whose proposals are refined at once
ANOTHER_RAD, ANOTHER_SHARE = 0.05, 0.02  # minimum rotation, rad, or shift, in distances to the tags, of another pose
TOLD_APART = float(np.log(100.0))  # minimum log-likelihood ratio of the best pose to another pose
SIGMAS = 3.0  # standard deviations of the map by which a sighting of an unmoved tag may be off
# A tag contradicts the map if the share `CONTRADICTS` of its sightings together with other tags does. All tags with at
# least the share `SURELY` are ignored at once, in at most `MOST_ROUNDS` rounds.
CONTRADICTS, SURELY, MOST_ROUNDS = 0.5, 0.75, 12


class State(Enum):
    """Outcome of the localisation of an image: localised, or the reason to refuse the image."""

    LOCALISED = "localised"
    NO_TAG = "no tag of the map"
    TWO_POSES = "two poses that cannot be told apart"
    RESIDUAL = "residual too large"


class RoughPoses(NamedTuple):
    """Rough poses of F frames."""

    poses: Poses
    """Poses of tags, frames and mounts. The pose of a tag is NaN if the map lacks the tag, or if the tag contradicts
    the map. The pose of a frame is NaN if the frame shows no tag with a pose.
    """
    others: FloatArray
    """For each frame, the best pose that clearly differs from its pose in `poses`, `(F, 4, 4)`; NaN without such a
    pose.
    """
    gross: BoolArray
    """Mask of the tags that contradict the other tags, `(K,)`."""


def rough_poses(sightings: Sightings, poses: Poses, sigmas: FloatArray) -> RoughPoses:
    """Find rough poses of the frames, and tags that contradict the other tags.

    Each sighting that does not fit the pose of its image counts as one vote against its tag. In an image in which at
    most half of the sightings fit, each sighting counts as half a vote. The tags with the largest fraction of votes
    against them are ignored, and the images are localised again.

    Args:
        sightings: all sightings.
        poses: poses of tags in the map, NaN if not in the map, and expected poses of the cameras on the body (mounts).
            If frames contradict an expected mount, it is replaced by a measured mount.
        sigmas: standard deviations of the tags in the map, `(K, 6)`.
    """
    gross, single = np.zeros(len(poses.tags), dtype=bool), single_poses(sightings).poses
    if sightings.cameras > 1:
        order = np.argsort(sightings.frame + sightings.camera * sightings.frames, kind="stable")
        apart = sightings.with_separate_cameras()
        best, _ = _proposed(apart, replace(poses, mounts=np.eye(4)[None]), single[order])
        views = best.frames.reshape(sightings.cameras, -1, 4, 4)
        poses = replace(poses, mounts=measured_mounts(views, poses.mounts))
    for _ in range(MOST_ROUNDS):
        best, others = _proposed(sightings, poses, single)
        share = _blame(sightings, best, sigmas)
        if share.max(initial=0.0) < CONTRADICTS:
            break
        gross |= (share >= SURELY) | (share == share.max())
        poses = replace(poses, tags=np.where(gross[:, None, None], np.nan, poses.tags))
    return RoughPoses(best, others, gross)


def _blame(sightings: Sightings, poses: Poses, sigmas: FloatArray) -> FloatArray:
    """Fraction of votes against each tag, see `rough_poses`, `(K,)`; 0 for tags with few votes. Only images with
    several tags count. `sigmas` `(K, 6)` are the standard deviations of the tags in the map.
    """
    some = sightings.of(poses.known_tags[sightings.tag])
    at = Reprojection(some, *poses.of(some))
    expected = ((at.by_tag * sigmas[some.tag, None]) ** 2).sum(axis=(1, 2))
    fits = agreeing(some, np.maximum(at.squared - SIGMAS**2 * expected, 0.0))
    counts, agreed = (np.bincount(some.frame, which, minlength=some.frames) for which in (None, fits))
    refused = (2 * agreed <= counts)[some.frame]
    beside = counts[some.frame] > 1
    total = np.bincount(some.tag, np.where(refused, 0.5, ~fits) * beside, minlength=len(poses.tags))
    share = total / np.maximum(np.bincount(some.tag, beside, minlength=len(poses.tags)), 1)
    return np.where(total < FEWEST_SIGHTINGS / 2.0, 0.0, share)


def _proposed(sightings: Sightings, poses: Poses, single: FloatArray) -> tuple[Poses, FloatArray]:
    """Find the best pose of each frame, and the best of the poses that clearly differ from it.

    Args:
        sightings: sightings in F frames.
        poses: poses of tags, NaN if unknown, and of the cameras on the body.
        single: two poses of each sighting's tag in the frame of the camera, `(N, 2, 4, 4)`.

    Returns:
        copy of `poses` with the best poses of the frames; the differing poses, `(F, 4, 4)`, NaN without such a pose.
    """
    known = np.flatnonzero(poses.known_tags[sightings.tag])
    best, other = np.full((2, sightings.frames, 4, 4), np.nan)
    poses = replace(poses, frames=best)
    _, first = np.unique(sightings.frame[known], return_index=True)
    ends = np.append(first[::FRAME_CHUNK], len(known))
    for begin, end in pairwise(ends):
        own = known[begin:end]
        trial = Candidates(sightings.of(own), poses, by_frame=True)
        found, owner = trial.proposals(single[own])
        order = trial.best(found, owner, len(found))
        found, owner = found[order], owner[order]
        at = np.searchsorted(owner, owner)  # for each proposal, index of the best proposal of its frame
        best[trial.owners[owner[at]]] = found[at]
        away = _mean_distances(sightings.of(own), replace(poses, frames=best))[trial.owners[owner]]
        differ = np.flatnonzero(_are_apart(found[at], found, away))[::-1]
        other[trial.owners[owner[differ]]] = found[differ]  # the last assignment to a frame wins, and is the best pose
    return replace(poses, frames=best), other


def _are_apart(one: FloatArray, two: FloatArray, away: FloatArray) -> BoolArray:
    """Mask of the pairs of poses `one` and `two`, `(n, 4, 4)` each, that differ clearly, `(n,)`; `away` is the mean
    distance of the camera from the tags, metres, `(n,)`.
    """
    shift = np.linalg.norm(one[:, :3, 3] - two[:, :3, 3], axis=1)
    return np.asarray((angle_between(one, two) > ANOTHER_RAD) | (shift > ANOTHER_SHARE * away))


def states_of(found: Estimate, others: FloatArray) -> tuple[NDArray[np.object_], FloatArray]:
    """Decide for each frame: localised, no tag of the map, or two poses that cannot be distinguished.

    Args:
        found: estimate with a pose of each frame that shows a tag of the map.
        others: other poses of the frames, `(F, 4, 4)`; NaN for a frame without another pose.

    Returns:
        outcome (`State`) of each frame, `(F,)`; two poses of each frame that both fit almost equally well, the better
        pose first, `(F, 2, 4, 4)`, NaN for the other frames.
    """
    some = found.sightings.of(found.poses.known_tags[found.sightings.tag])
    seen = np.bincount(some.frame, minlength=some.frames)
    tried = some.of(np.isfinite(others[some.frame, 0, 0]))
    poses = resected(tried, replace(found.poses, frames=others), found.floor)
    losses = (student_losses(squared_errors(tried, one) / tried.variance(found.floor)) for one in (poses, found.poses))
    gap = np.subtract(*(np.bincount(tried.frame, loss, minlength=tried.frames) for loss in losses))
    here, there = found.poses.frames, poses.frames
    away = _mean_distances(tried, found.poses)
    alike = (seen > 0) & found.poses.known_frames & (gap < TOLD_APART) & _are_apart(here, there, away)
    states = np.array([State.LOCALISED if shown else State.NO_TAG for shown in seen])
    states[alike] = State.TWO_POSES
    both = np.where((gap < 0.0)[:, None, None, None], np.stack([there, here], 1), np.stack([here, there], 1))
    return states, np.where(alike[:, None, None, None], both, np.nan)


def _mean_distances(some: Sightings, poses: Poses) -> FloatArray:
    """Mean distance of the body at each frame from the tags in the frame, metres, `(F,)`; 0 without sightings."""
    away = np.linalg.norm(poses.tags[some.tag, :3, 3] - poses.frames[some.frame, :3, 3], axis=1)
    counts = np.bincount(some.frame, minlength=some.frames)
    return np.asarray(np.bincount(some.frame, away, minlength=some.frames) / np.maximum(counts, 1))
