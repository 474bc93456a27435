"""Poses of single images in a fixed map, with covariances, and the reasons why images are refused.

Each sighting of a tag proposes two poses of the body, as two poses of a tag look alike (IPPE). For each image the
likeliest proposals are refined with all tags in view, with the robust loss of `lmd.survey.residuals`. If another pose
is nearly as likely as the best pose, the image is refused.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between, exp, inverse
from lmd.localise.image_noise import ImageNoise
from lmd.localise.pose_errors import pose_covariances
from lmd.survey.initialisation import FLOOR_PIXELS, JUDGING, NARROW, PROPOSING, REFINED, REFINING_STEPS, WIDE
from lmd.survey.map_estimate import ONE_THREAD
from lmd.survey.residuals import (
    DEGREES_OF_FREEDOM,
    Poses,
    Reprojection,
    normal_equations,
    solved,
    student_weight,
    sums_by,
)
from lmd.survey.schur import LEAST_DAMPING
from lmd.survey.sightings import RESIDUALS, Sightings
from lmd.survey.single_poses import single_poses

FRAME_CHUNK = 256  # frames whose proposals are refined at once
ROUNDS, STEPS = 3, 8  # rounds of estimates of the floor, and Gauss-Newton steps in each round
ANOTHER_RAD, ANOTHER_SHARE = 0.05, 0.02  # least rotation, rad, or shift, in distances to the tags, of another pose
TOLD_APART = float(np.log(100.0))  # least log-likelihood ratio of the best pose to another pose
FIRST_DAMPING = 1e-6  # damping of the refinement of proposals, as in `lmd.survey.initialisation`


class State(Enum):
    """Outcome of an image."""

    LOCALISED = "localised"
    NO_TAG = "no tag of the map"
    TWO_POSES = "one tag, whose two poses cannot be told apart"
    ALIKE = "tags whose two poses cannot be told apart"
    RESIDUAL = "residual too large"


@dataclass(frozen=True)
class ImagePoses:
    """Poses of F images."""

    sightings: Sightings
    """N sightings of tags of the map."""
    poses: Poses
    """Poses of tags, frames and mounts; frames are NaN if refused."""
    others: FloatArray
    """`(F, 2, 4, 4)` the best pose and the other pose of images that are refused since both fit; NaN for others."""
    covariances: FloatArray
    """`(F, 6, 6)` covariance of the right-hand twist of each pose, rad and metres; NaN if refused."""
    states: tuple[State, ...]
    """State of each image."""
    used: BoolArray
    """`(N,)` sightings that fit the pose of their image."""
    floor: float
    """Standard deviation of corners beyond the detector's own, pixels."""

    @property
    def localised(self) -> BoolArray:
        """True for images with a pose, `(F,)`."""
        return np.isfinite(self.poses.frames[:, 0, 0])


def image_poses(
    sightings: Sightings,
    tags: FloatArray,
    mounts: FloatArray,
    sigmas: FloatArray,
    joint: FloatArray | None = None,
    lens: FloatArray | None = None,
) -> ImagePoses:
    """Find the pose of each image by itself.

    Args:
        sightings: sightings; those of tags without a pose are ignored.
        tags: poses of the tags in the map, `(K, 4, 4)`, NaN if not in the map.
        mounts: poses of the cameras on the body, `(C, 4, 4)`.
        sigmas: standard deviations of the tags, `(K, 6)`, see `FixedMap`.
        joint: covariance of all tags together, `(6 K, 6 K)`; None if they are independent.
        lens: covariance of each camera's values, see `pose_covariances`; None if cameras are exact.
    """
    some = sightings.of(np.flatnonzero(np.isfinite(tags[sightings.tag, 0, 0])))
    nowhere = np.full((sightings.frames, 4, 4), np.nan)
    states = np.full(sightings.frames, State.NO_TAG, dtype=object)
    if not len(some):
        empty = np.full((sightings.frames, 6, 6), np.nan)
        both = np.full((sightings.frames, 2, 4, 4), np.nan)
        return ImagePoses(some, Poses(tags, nowhere, mounts), both, empty, tuple(states), np.zeros(0, bool), 0.0)
    with threadpool_limits(limits=ONE_THREAD):
        best, other = _proposed(some, tags, mounts)
        fit = _Fit(some, tags, mounts, sigmas, best)
        ratio = fit.ratio(other)
        frames, used = fit.frames.copy(), fit.used
        count = np.bincount(some.frame[used], minlength=some.frames)
        seen = np.bincount(some.frame, minlength=some.frames)
        states[seen > 0] = State.LOCALISED
        wrong = (seen > 0) & (2 * count <= seen) & ~((count == 1) & (seen == 1))
        states[wrong] = State.RESIDUAL
        alike = (seen > 0) & ~wrong & (ratio < TOLD_APART)
        states[alike & (count == 1)], states[alike & (count > 1)] = State.TWO_POSES, State.ALIKE
        both = np.where(alike[:, None, None, None], np.stack([fit.frames, fit.other], axis=1), np.nan)
        frames[wrong | alike] = np.nan
        independent = np.diag(np.where(np.isfinite(sigmas), sigmas, 0.0).ravel() ** 2) if joint is None else joint
        covariances = fit.covariances(independent, lens)
        covariances[wrong | alike] = np.nan
    used = used & np.isfinite(frames[some.frame, 0, 0])
    return ImagePoses(some, Poses(tags, frames, mounts), both, covariances, tuple(states), used, fit.floor)


class _Fit:
    """Robust fit of the poses of all images, with the noise of the detector and of the map."""

    def __init__(
        self,
        some: Sightings,
        tags: FloatArray,
        mounts: FloatArray,
        sigmas: FloatArray,
        frames: FloatArray,
    ) -> None:
        self.some, self.tags, self.mounts = some, tags, mounts
        self.seen, self.owner = np.unique(some.frame, return_inverse=True)
        self.summed = sums_by(self.owner, len(self.seen))
        self.frames = self.other = frames
        self.floor = FLOOR_PIXELS
        self.used = np.ones(len(some), dtype=bool)
        for _ in range(ROUNDS):
            self.noise = ImageNoise.of(some, self._at(self.frames), sigmas)
            self.frames = self.refined(self.frames, self.used)
            error = self._at(self.frames).error
            self.used = self.noise.fits(some, error, self.floor)
            if self.used.any():
                own = self.noise.of_some(self.used)
                self.floor = own.floor(error[self.used], some.frame[self.used], FLOOR_PIXELS)

    def _at(self, frames: FloatArray) -> Reprojection:
        return Reprojection(self.some, *Poses(self.tags, frames, self.mounts).of(self.some))

    def refined(self, frames: FloatArray, used: BoolArray) -> FloatArray:
        """Poses of the frames after Gauss-Newton steps."""
        result = frames.copy()
        for _ in range(STEPS):
            at = self._at(result)
            slope = self.noise.whitened(at.by_frame, self.floor)
            error = self.noise.whitened(at.error[..., None], self.floor)[..., 0]
            weight = student_weight((error**2).sum(axis=1)) * used
            matrix, right = normal_equations(slope, error, weight, self.summed)
            step = solved(matrix + LEAST_DAMPING * np.eye(6), right)
            result[self.seen] = result[self.seen] @ exp(-step)
        return result

    def losses(self, frames: FloatArray) -> FloatArray:
        """Negative log-likelihood of each image, `(F,)`."""
        square = self.noise.squares(self._at(frames).error, self.floor)
        each = (DEGREES_OF_FREEDOM + RESIDUALS) / 2.0 * np.log1p(square / DEGREES_OF_FREEDOM)
        return np.asarray(np.bincount(self.some.frame, each, minlength=len(frames)))

    def ratio(self, other: FloatArray) -> FloatArray:
        """Log-likelihood ratio of each pose to the other pose of its image, `(F,)`; infinite without another pose.

        A better other pose is exchanged with the best pose.
        """
        there = np.isfinite(other[:, 0, 0])
        tried = np.where(there[:, None, None], other, self.frames)
        self.other = self.refined(tried, np.ones(len(self.some), dtype=bool))
        gap = self.losses(self.other) - self.losses(self.frames)
        apart = there & self._are_apart(self.frames, self.other)
        swapped = (apart & (gap < 0.0))[:, None, None]
        self.frames, self.other = np.where(swapped, self.other, self.frames), np.where(swapped, self.frames, self.other)
        if swapped.any():
            self.used = self.noise.fits(self.some, self._at(self.frames).error, self.floor)
        return np.where(apart, np.abs(gap), np.inf)

    def _are_apart(self, one: FloatArray, two: FloatArray) -> BoolArray:
        tags = self.tags[self.some.tag, :3, 3]
        far = np.linalg.norm(tags - one[self.some.frame, :3, 3], axis=1)
        far = np.bincount(self.some.frame, far, len(one)) / np.maximum(
            np.bincount(self.some.frame, minlength=len(one)), 1
        )
        shift = np.linalg.norm(one[:, :3, 3] - two[:, :3, 3], axis=1)
        return np.asarray((angle_between(one, two) > ANOTHER_RAD) | (shift > ANOTHER_SHARE * far))

    def covariances(self, joint: FloatArray, lens: FloatArray | None) -> FloatArray:
        """Covariance of each pose, see `pose_covariances`, `(F, 6, 6)`; NaN for images without sightings that fit."""
        at, own = self._at(self.frames), self.noise.of_some(self.used)
        weight = own.efficiency(at.error[self.used], self.some.frame[self.used], self.floor)
        return pose_covariances(self.some, at, self.noise, self.used, self.floor, weight, joint, lens)


def _proposed(some: Sightings, tags: FloatArray, mounts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rough poses of each frame, `(F, 4, 4)`: the best pose, and the best pose that differs from it; NaN if none."""
    single = single_poses(some).poses
    bodies = tags[some.tag, None] @ inverse(single) @ inverse(mounts[some.camera])[:, None]
    rank = np.empty(len(some), dtype=np.int64)
    order = np.lexsort((-some.sizes, some.frame))
    rank[order] = np.arange(len(some)) - np.searchsorted(some.frame, some.frame[order])
    best, other = np.full((2, some.frames, 4, 4), np.nan)
    seen = np.unique(some.frame)
    for first in range(0, len(seen), FRAME_CHUNK):
        low, high = seen[first], seen[min(first + FRAME_CHUNK, len(seen)) - 1]
        own = np.flatnonzero((some.frame >= low) & (some.frame <= high) & (rank < JUDGING))
        judges = some.of(own)
        proposing = np.flatnonzero(rank[own] < PROPOSING)
        proposals = _Proposals(judges, tags, mounts)
        poses, owner = bodies[own[proposing]].reshape(-1, 4, 4), np.repeat(judges.frame[proposing], 2)
        kept = _least(owner, proposals.losses(poses, owner), REFINED)
        poses, owner = proposals.refined(poses[kept], owner[kept]), owner[kept]
        losses = proposals.losses(poses, owner)
        kept = _least(owner, losses, REFINED)
        poses, owner = poses[kept], owner[kept]
        at = np.searchsorted(owner, owner)  # index of the best proposal of the frame of each proposal
        best[owner[at]] = poses[at]
        far = np.linalg.norm(poses[:, :3, 3] - poses[at, :3, 3], axis=1) > ANOTHER_SHARE
        differ = np.flatnonzero((angle_between(poses, poses[at]) > ANOTHER_RAD) | far)[::-1]
        other[owner[differ]] = poses[differ]  # the last assignment of each frame is its best one
    return best, other


def _least(owner: IntArray, losses: FloatArray, count: int) -> IntArray:
    """Indices of the `count` entries of each owner with the least losses, sorted by owner, then by loss."""
    order = np.lexsort((losses, owner))
    return np.asarray(order[np.arange(len(order)) - np.searchsorted(owner[order], owner[order]) < count])


class _Proposals:
    """Proposed poses of frames, judged by all sightings of the frames."""

    def __init__(self, judges: Sightings, tags: FloatArray, mounts: FloatArray) -> None:
        self.judges, self.tags, self.mounts = judges, tags, mounts

    def _pairs(self, owner: IntArray) -> tuple[IntArray, IntArray]:
        """Indices of all pairs of a proposal and a sighting of its frame; `owner` has the frame of each proposal."""
        first = np.searchsorted(self.judges.frame, owner)
        counts = np.searchsorted(self.judges.frame, owner, side="right") - first
        pose = np.repeat(np.arange(len(owner)), counts)
        return np.arange(len(pose)) - np.repeat(np.cumsum(counts) - counts, counts) + first[pose], pose

    def _at(self, poses: FloatArray, pairs: IntArray, pose: IntArray) -> Reprojection:
        some = self.judges.of(pairs)
        return Reprojection(some, self.tags[some.tag], poses[pose], self.mounts[some.camera])

    def losses(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Robust losses of proposals `(P, 4, 4)`, `(P,)`."""
        pairs, pose = self._pairs(owner)
        error = self._at(poses, pairs, pose).squared
        return np.asarray(np.bincount(pose, np.log1p(error / (4.0 * NARROW**2)), minlength=len(poses)))

    def refined(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Proposals after Gauss-Newton steps with robust losses of decreasing scale."""
        pairs, pose = self._pairs(owner)
        summed = sums_by(pose, len(poses))
        for scale in np.geomspace(WIDE, NARROW, REFINING_STEPS):
            at = self._at(poses, pairs, pose)
            weight = 1.0 / (1.0 + (at.error**2).mean(axis=1) / scale**2)
            matrix, right = normal_equations(at.by_frame, at.error, weight, summed)
            poses = np.asarray(poses @ exp(-solved(matrix + FIRST_DAMPING * np.eye(6), right)))
        return poses
