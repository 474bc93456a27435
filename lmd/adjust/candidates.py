"""Candidate poses of frames by known tags, or of tags by known frames, from single sightings.

Two poses of a tag in front of a camera look alike (IPPE), so each sighting proposes two poses.

Source: Collins and Bartoli, "Infinitesimal Plane-Based Pose Estimation".
"""

from dataclasses import dataclass

import numpy as np

from lmd.adjust.corners import Poses, Reprojection, normal_equations, sums_by
from lmd.adjust.frames import solved
from lmd.adjust.sightings import Sightings
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.optional import optional
from lmd.geometry.se3 import exp, inverse, pose_of

ASSUMED_PIXELS = 0.3  # pixels, added in quadrature to the detector's standard deviation for the odds of the two poses
# A sighting agrees with a pose if the RMS error is at most `AGREES` times its size plus `AGREES_PIXELS`, pixels.
AGREES, AGREES_PIXELS = 0.15, 2.0
# Maximum numbers, for a frame or tag, of sightings that propose poses, of sightings that judge poses (the largest
# sightings are used), and of poses that are refined.
PROPOSING, JUDGING, REFINED = 8, 60, 3
REFINING_STEPS, WIDE, NARROW = 12, 40.0, 3.0  # Gauss-Newton steps; first and last scale of the loss, pixels
DAMPING = 1e-6


@dataclass(frozen=True)
class SinglePoses:
    """Two poses of the tag of each sighting, in the frame of the camera."""

    poses: FloatArray
    """`(N, 2, 4, 4)` poses, the better pose first."""
    odds: FloatArray
    """`(N,)` log-likelihood ratio of the better to the worse pose."""


def single_poses(sightings: Sightings) -> SinglePoses:
    """Poses of the tag of each sighting, by IPPE in a pinhole camera that is turned towards the tag.

    Raises:
        InputError: corners are not in order.
    """
    cv2 = optional("cv2", "estimators")
    axis = sightings.directions.mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    side = np.cross(np.where(np.abs(axis[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turned = np.stack([side, np.cross(axis, side), axis], axis=1)  # rotation from the camera to the turned camera
    rays = sightings.directions @ np.swapaxes(turned, 1, 2)
    flat = rays[..., :2] / rays[..., 2:]
    found = np.empty((len(sightings), 2, 4, 4))
    for index, (corners, image) in enumerate(zip(sightings.corners, flat, strict=True)):
        _, turns, ways, _ = cv2.solvePnPGeneric(corners, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        if not turns:
            seen = f"tag {sightings.ids[sightings.tag[index]]}"
            text = f"detections: the corners of {seen} form no square in a frame; list them around the tag."
            raise InputError(text, "detections")
        for which in range(2):
            turn = cv2.Rodrigues(turns[which % len(turns)])[0]
            found[index, which] = pose_of(turn, np.ravel(ways[which % len(ways)]))
    poses = pose_of(np.swapaxes(turned, 1, 2), np.zeros(3))[:, None] @ found
    still = np.broadcast_to(np.eye(4), (len(sightings), 4, 4))
    error = np.stack([Reprojection(sightings, poses[:, which], still, still).squared for which in range(2)], axis=1)
    order = np.argsort(error, axis=1)
    poses = np.take_along_axis(poses, order[..., None, None], axis=1)
    gap = np.diff(np.sort(error, axis=1), axis=1)[:, 0]
    return SinglePoses(poses, gap / (2.0 * sightings.variance(ASSUMED_PIXELS)))


def agreeing(sightings: Sightings, error: FloatArray) -> BoolArray:
    """True for sightings with squared errors `(N,)` that agree with a rough pose; False for NaN."""
    return np.asarray(np.sqrt(error / 4.0) < AGREES * sightings.sizes + AGREES_PIXELS)


class Candidates:
    """Candidate poses for the owners of some sightings: frames whose tags are placed, or tags whose frames are placed.

    Args:
        some: the sightings that judge candidates.
        poses: poses of the placed tags and frames, and of the mounts.
        by_frame: True if owners are frames, False if they are tags.
    """

    def __init__(self, some: Sightings, poses: Poses, by_frame: bool) -> None:
        self.some, self.by_frame = some, by_frame
        self._tags, self._frames, self._mounts = poses.of(some)
        owner = some.frame if by_frame else some.tag
        self.owners, self.owner, self.counts = np.unique(owner, return_inverse=True, return_counts=True)
        self._order = np.argsort(self.owner, kind="stable")

    def proposed(self, index: IntArray, single: FloatArray) -> FloatArray:
        """Poses of the owners of the sightings `index`, `(2 n, 4, 4)`, from the two poses of each tag in its camera,
        `(n, 2, 4, 4)`.
        """
        mounts = self._mounts[index, None]
        if self.by_frame:
            return np.asarray(self._tags[index, None] @ inverse(single) @ inverse(mounts)).reshape(-1, 4, 4)
        return np.asarray(self._frames[index, None] @ mounts @ single).reshape(-1, 4, 4)

    def _pairs(self, owner: IntArray) -> tuple[IntArray, IntArray]:
        """Indices of all pairs of a pose and a sighting of its owner; `owner` `(P,)` has the owner of each pose."""
        counts = self.counts[owner]
        pose = np.repeat(np.arange(len(owner)), counts)
        within = np.arange(len(pose)) - np.repeat(np.cumsum(counts) - counts, counts)
        return self._order[(np.cumsum(self.counts) - self.counts)[owner][pose] + within], pose

    def _at(self, poses: FloatArray, pairs: IntArray, pose: IntArray) -> Reprojection:
        """Reprojection of each pair of a sighting and a pose."""
        own, mounts = poses[pose], self._mounts[pairs]
        tags, frames = (self._tags[pairs], own) if self.by_frame else (own, self._frames[pairs])
        return Reprojection(self.some.of(pairs), tags, frames, mounts)

    def losses(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Robust losses `(P,)` of poses `(P, 4, 4)` of the owners `(P,)`."""
        pairs, pose = self._pairs(owner)
        error = self._at(poses, pairs, pose).squared
        return np.asarray(np.bincount(pose, np.log1p(error / (4.0 * NARROW**2)), minlength=len(poses)))

    def agreed(self, poses: FloatArray) -> FloatArray:
        """Number of sightings of each of M owners that agree with the owner's pose `(M, 4, 4)`, `(M,)`."""
        pairs, pose = self._pairs(np.arange(len(self.owners)))
        agree = agreeing(self.some.of(pairs), self._at(poses, pairs, pose).squared)
        return np.asarray(np.bincount(pose, agree, minlength=len(self.owners)))

    def best(self, poses: FloatArray, owner: IntArray, count: int) -> IntArray:
        """Indices of the `count` poses of each owner with the least losses, sorted by owner, then by loss."""
        order = np.lexsort((self.losses(poses, owner), owner))
        return np.asarray(order[rank_within(owner[order]) < count])

    def refined(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Poses after Gauss-Newton steps with robust losses of decreasing scale."""
        pairs, pose = self._pairs(owner)
        summed = sums_by(pose, len(poses))
        for scale in np.geomspace(WIDE, NARROW, REFINING_STEPS):
            at = self._at(poses, pairs, pose)
            weight = 1.0 / (1.0 + (at.error**2).mean(axis=1) / scale**2)
            matrix, right = normal_equations(at.by_frame if self.by_frame else at.by_tag, at.error, weight, summed)
            poses = np.asarray(poses @ exp(-solved(matrix + DAMPING * np.eye(6), right)))
        return poses

    def proposals(self, single: FloatArray) -> tuple[FloatArray, IntArray]:
        """Refined poses of the owners by their largest sightings, `(P, 4, 4)`, and their owners, `(P,)`.

        Args:
            single: two poses of the tag of each sighting in its camera, `(N, 2, 4, 4)`.
        """
        proposing = np.flatnonzero(rank(self.some, self.owner) < PROPOSING)
        poses, owner = self.proposed(proposing, single[proposing]), np.repeat(self.owner[proposing], 2)
        best = self.best(poses, owner, REFINED)
        return self.refined(poses[best], owner[best]), owner[best]


def place(
    some: Sightings, single: FloatArray, poses: Poses, by_frame: bool, fewest: int, share: float
) -> tuple[IntArray, FloatArray]:
    """Place frames by placed tags, or tags by placed frames; a pose that they already have is a candidate as well.

    Args:
        some: sightings.
        single: two poses of the tag of each sighting in its camera, `(N, 2, 4, 4)`.
        poses: present poses.
        by_frame: True to place frames, False to place tags.
        fewest: minimum number of sightings that must agree.
        share: minimum share of the sightings that must agree.

    Returns:
        indices `(m,)` and poses `(m, 4, 4)` of the frames or tags that are placed.
    """
    judging = np.flatnonzero(rank(some, some.frame if by_frame else some.tag) < JUDGING)
    if not judging.size:
        return np.empty(0, dtype=np.int64), np.empty((0, 4, 4))
    trial = Candidates(some.of(judging), poses, by_frame)
    found, owner = trial.proposals(single[judging])
    present = (poses.frames if by_frame else poses.tags)[trial.owners]
    own = np.flatnonzero(np.isfinite(present[:, 0, 0]))
    found, owner = np.concatenate([found, present[own]]), np.concatenate([owner, own])
    found = found[trial.best(found, owner, 1)]
    agreed = trial.agreed(found)
    enough = (agreed >= fewest) & (agreed >= share * trial.counts)
    return trial.owners[enough], found[enough]


def placed_tags(some: Sightings, poses: Poses, fewest: int, share: float) -> FloatArray:
    """Poses of the tags of some sightings with all frames fixed, `(K, 4, 4)`; NaN if not placed, see `place`."""
    nowhere = np.full((len(some.ids), 4, 4), np.nan)
    some = some.of(np.isfinite(poses.frames[some.frame, 0, 0]))
    if len(some):
        around = Poses(nowhere, poses.frames, poses.mounts)
        tags, found = place(some, single_poses(some).poses, around, False, fewest, share)
        nowhere[tags] = found
    return nowhere


def rank(sightings: Sightings, owner: IntArray) -> IntArray:
    """Rank of sightings by size, from the largest, among the sightings of their owner, `(N,)`."""
    order = np.lexsort((-sightings.sizes, owner))
    result = np.empty(len(sightings), dtype=np.int64)
    result[order] = rank_within(owner[order])
    return result


def rank_within(owner: IntArray) -> IntArray:
    """Position of each entry among the entries with an equal owner; `owner` is sorted."""
    return np.asarray(np.arange(len(owner)) - np.searchsorted(owner, owner))


def best_sequence(costs: FloatArray, between: FloatArray) -> IntArray:
    """Choose one of the two poses of each of n sightings in a sequence, at the least total cost (Viterbi).

    Args:
        costs: cost of each pose, `(n, 2)`.
        between: cost of pose a after pose b of the previous sighting, `(n, 2, 2)`.

    Returns:
        index of the chosen pose of each sighting, 0 or 1, `(n,)`.
    """
    chosen = np.zeros(costs.shape, dtype=np.int64)
    total = costs[0]
    for k in range(1, len(costs)):
        ways = between[k] + total
        chosen[k] = np.argmin(ways, axis=1)
        total = costs[k] + ways.min(axis=1)
        total = total - total.min()
    which = np.zeros(len(costs), dtype=np.int64)
    which[-1] = np.argmin(total)
    for k in range(len(costs) - 1, 0, -1):
        which[k - 1] = chosen[k, which[k]]
    return which
