"""Estimate of a map: bundle adjustment from the initial poses, outliers, and marginal covariances."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, log, median_pose, skew
from lmd.survey.adjustment import Adjustment
from lmd.survey.gauge import diagonal_blocks, gauge_free, into_world
from lmd.survey.groups import join_groups
from lmd.survey.initialisation import FLOOR_PIXELS, place
from lmd.survey.linked_adjustment import LinkedAdjustment, adjustment_of, constraining
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses, squared_errors
from lmd.survey.sightings import Sightings
from lmd.survey.turns import turned_as_seen

# A sighting is an outlier if its chi^2, with eight degrees of freedom, exceeds `OUTLIER_CHI_SQUARE`, and its RMS error
# exceeds `OUTLIER_PIXELS` and the share `OUTLIER_SHARE` of its shortest side. Blur and lenses cause smaller errors.
OUTLIER_CHI_SQUARE, OUTLIER_PIXELS, OUTLIER_SHARE = 60.0, 1.0, 0.02
STEPS, FINAL_STEPS = 40, 15  # steps of bundle adjustment with all sightings, and without outliers
# Threads of linear algebra: with matrices of some hundred rows, more threads wait longer than they work.
ONE_THREAD = 1
# A mount is doubted if at least `FEWEST_FRAMES` frames put the camera farther from it than `OFF_M`, metres, or than
# `OFF_RAD`, rad, which calibrations explain, and than `OFF_SIGMAS` standard deviations.
FEWEST_FRAMES, OFF_M, OFF_RAD, OFF_SIGMAS = 5, 0.05, 0.012, 5.0
OF_MEDIAN = 1.86  # standard deviation of a median of n values, times sqrt(n), over their median absolute deviation
NEAREST = 6  # number of tags of other groups relative to which the covariance of a tag is computed


def in_world(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances of position and rotation about the axes of the world, m^2 and rad^2, `(n, 6, 6)`.

    Args:
        poses: poses, `(n, 4, 4)`.
        covariances: covariances of their right-hand twists, `(n, 6, 6)`.
    """
    turned = poses[:, :3, :3]
    whole = np.zeros((len(poses), 6, 6))
    whole[:, :3, 3:] = whole[:, 3:, :3] = turned
    return np.asarray(whole @ covariances @ np.swapaxes(whole, 1, 2))


@dataclass(frozen=True)
class Estimate:
    """Estimated poses of the tags of some sightings."""

    sightings: Sightings
    """All sightings."""
    prior: Prior
    """Prior of the tags."""
    poses: Poses
    """Poses of tags, frames and mounts; NaN if not placed."""
    group: IntArray
    """`(K,)` group of each tag: 0 for tags of the map, larger for tags that no frame connects with the map, -1 for tags
    that are not placed.
    """
    used: BoolArray
    """`(N,)` inliers: sightings from which the map is made."""
    misfits: BoolArray
    """`(N,)` outliers: sightings, of tags and in frames of the map, that do not fit the pose of their tag."""
    floor: float
    """Standard deviation of corners beyond the detector's own, pixels."""
    inflation: float = 1.0
    """Factor of the standard deviations of sightings, see `lmd.survey.resampling`."""

    @property
    def _adjustment(self) -> Adjustment:
        return adjustment_of(self.sightings.of(self.used), self.prior, True, self.inflation)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the twists of all tags, each in the frame of its tag, then of other unknowns, see
        `SchurSystem`.
        """
        with threadpool_limits(limits=ONE_THREAD):
            return self._adjustment.covariance(self.poses, self.floor)

    @property
    def known(self) -> BoolArray:
        """True for tags of the map that have a covariance, `(K,)`."""
        of_tags = np.diag(self.covariance)[: 6 * len(self.group)].reshape(-1, 6)
        return np.asarray((self.group == 0) & np.isfinite(of_tags).all(axis=1))

    @property
    def covariances(self) -> FloatArray:
        """Marginal covariance of the twist of each tag, `(K, 6, 6)`; NaN for tags not in the map."""
        size = 6 * len(self.group)
        blocks = diagonal_blocks(self.covariance[:size, :size], len(self.group))
        return np.where(self.known[:, None, None], blocks, np.nan)

    @cached_property
    def gauge_free_covariance(self) -> FloatArray:
        """Covariance of the twists of all `known` tags relative to the other tags, see `gauge_free`, `(6 n, 6 n)`."""
        rows = np.flatnonzero(np.repeat(self.known, 6))
        left = gauge_free(self.poses.tags[self.known])
        return np.asarray(left @ self.covariance[np.ix_(rows, rows)] @ left.T)

    @cached_property
    def gauge_free_covariances(self) -> FloatArray:
        """Covariance of the twist of each tag relative to the other tags, see `gauge_free`, `(K, 6, 6)`."""
        known, found = self.known, np.full((len(self.group), 6, 6), np.nan)
        found[known] = diagonal_blocks(self.gauge_free_covariance, int(known.sum()))
        return found

    @property
    def lens_covariances(self) -> FloatArray:
        """Covariance of each camera's nuisance parameters, in the units of `Sightings.lens`, `(C, 6 L, 6 L)`."""
        system = self._adjustment
        own = slice(6 * system.posed, 6 * system.first_shape)
        return diagonal_blocks(self.covariance[own, own], self.sightings.cameras)

    @property
    def mapped(self) -> IntArray:
        """Indices of the tags of the map."""
        return np.flatnonzero(self.group == 0)

    @property
    def frames(self) -> IntArray:
        """Indices of the frames from which the map is made."""
        return np.unique(self.sightings.frame[self.used])

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviation of each tag's place relative to the other tags, in the worst direction, metres, `(K,)`."""
        known = np.asarray(np.isfinite(self.gauge_free_covariances).all(axis=(1, 2)))
        result = np.full(len(known), np.nan)
        largest = np.linalg.eigvalsh(self.gauge_free_covariances[known][:, 3:, 3:])[:, -1]
        result[known] = np.sqrt(np.maximum(largest, 0.0))
        return result

    def in_world(self, covariances: FloatArray) -> FloatArray:
        """Covariances of position and rotation in the world frame, m^2 and rad^2, `(K, 6, 6)`.

        Args:
            covariances: covariances of the twists of tags in their own frames, `(K, 6, 6)`.
        """
        return in_world(self.poses.tags, covariances)

    def moved(self, motion: FloatArray) -> "Estimate":
        """Estimate after a motion `(4, 4)` of the world."""
        poses = replace(self.poses, tags=motion @ self.poses.tags, frames=motion @ self.poses.frames)
        return replace(self, poses=poses, prior=replace(self.prior, tags=motion @ self.prior.tags))

    def errors(self) -> FloatArray:
        """RMS reprojection errors of the inliers, pixels, `(n,)`."""
        return np.asarray(np.sqrt(squared_errors(self.sightings.of(self.used), self.poses) / 4.0))


@dataclass(frozen=True)
class Start:
    """Initial poses."""

    poses: Poses
    """Rough poses, with each camera as a body of its own, see `Sightings.with_separate_cameras`."""
    group: IntArray
    """`(K,)` group of each tag, -1 for tags that are not placed. Each group has a world of its own."""


def initialise(sightings: Sightings, prior: Prior) -> Start:
    """Find initial poses.

    Raises:
        InputError: no two tags were seen together.
    """
    with threadpool_limits(limits=ONE_THREAD):
        apart = sightings.with_separate_cameras()
        # To find unknown mounts, frames of two cameras must be placed, even by single sightings.
        is_linked = prior.motion is not None and (sightings.cameras == 1 or prior.mounts is not None)
        rough, group = place(apart, np.where(prior.is_posed[:, None, None], prior.tags, np.nan), is_linked)
        if prior.motion is None:
            _check_groups(group)
        return Start(turned_as_seen(apart, rough), group)


def estimate_map(sightings: Sightings, prior: Prior, origin: int | None = None, start: Start | None = None) -> Estimate:
    """Estimate the poses of all tags, frames and mounts together.

    Args:
        sightings: sightings; at least one frame must show two tags.
        prior: prior of the tags.
        origin: id of the tag whose frame is the world if no tag has a prior; None for the tag seen most often.
        start: initial poses; None for the poses of `initialise`.

    Raises:
        InputError: no two tags were seen together, `origin` is not placed, or known centres are too few for a world.
    """
    start = initialise(sightings, prior) if start is None else start
    with threadpool_limits(limits=ONE_THREAD):
        poses, group, prior = into_world(sightings, *of_body(sightings, start, prior), origin)
        return adjust(sightings, prior, poses, group, FLOOR_PIXELS)


def of_body(sightings: Sightings, start: Start, prior: Prior) -> tuple[Poses, IntArray, Prior]:
    """Initial poses of the body, groups joined by motion, and the prior with the estimated spread of the motion.

    Raises:
        InputError: a camera was never placed together with the first camera.
    """
    rough = _mounted(sightings, start.poses, prior.mounts)
    if prior.motion is None:
        return rough, start.group, prior
    poses, group, prior = join_groups(sightings, rough, start.group, prior)
    _check_groups(group)
    return poses, group, prior


def _check_groups(group: IntArray) -> None:
    """Raise `InputError` if there is no group."""
    if group.max(initial=-1) < 0:
        raise InputError("detections never show two tags at once, of which one leaves no doubt.", "detections")


def adjust(
    sightings: Sightings, prior: Prior, poses: Poses, group: IntArray, floor: float, inflation: float = 1.0
) -> Estimate:
    """Adjust the map, which is group 0, from initial `poses`; arguments as in `Estimate`.

    Raises:
        InputError: no sightings agree.
    """
    of_map = (group[sightings.tag] == 0) & np.isfinite(poses.frames[sightings.frame, 0, 0])
    of_map = used = constraining(sightings, of_map, prior.motion)
    misfits = np.zeros(len(sightings), dtype=bool)
    sheets = None if prior.sheets is None else prior.sheets.of((group == 0) & (sightings.counts(of_map) > 0))
    information = np.where((group == 0)[:, None], prior.information, 0.0)
    prior = replace(prior, information=information, sheets=sheets if sheets is not None and len(sheets.tag) else None)
    for steps in (STEPS, FINAL_STEPS):
        used = constraining(sightings, used, prior.motion)
        if not used.any():
            raise InputError(
                "detections: no two tags of a frame agree with one pose of the camera; are the corners in another "
                "order, or the calibration another one?",
                "detections",
            )
        adjustment = adjustment_of(sightings.of(used), prior, inflation=inflation)
        poses, floor = adjustment.run(poses, floor, steps)
        if isinstance(adjustment, LinkedAdjustment) and steps == STEPS:
            prior = replace(prior, motion=adjustment.estimate_motion(poses, floor))
        misfits = of_map & ~fitting(sightings, squared_errors(sightings, poses), floor)
        used = of_map & ~misfits
    used = constraining(sightings, used, prior.motion)
    frames = np.full_like(poses.frames, np.nan)
    frames[np.unique(sightings.frame[used])] = poses.frames[np.unique(sightings.frame[used])]
    poses = replace(poses, frames=frames)
    return Estimate(sightings, prior, poses, group, used, misfits, floor, inflation)


def fitting(sightings: Sightings, error: FloatArray, floor: float) -> BoolArray:
    """Mask of the sightings that are no outliers, from their squared errors `(N,)`; False for NaN."""
    near = np.sqrt(error / 4.0) <= np.maximum(OUTLIER_PIXELS, OUTLIER_SHARE * sightings.sizes)
    return np.asarray((error / sightings.variance(floor) <= OUTLIER_CHI_SQUARE) | near)


def _mounted(sightings: Sightings, apart: Poses, mounts: FloatArray | None) -> Poses:
    """Poses of the body from the poses of its cameras.

    Args:
        sightings: sightings of the body.
        apart: poses for `sightings.with_separate_cameras()`.
        mounts: poses of the cameras on the body, `(C, 4, 4)`; None to estimate them.

    Raises:
        InputError: a camera was never placed together with the first camera.
    """
    views = apart.frames.reshape(sightings.cameras, sightings.frames, 4, 4)
    found, frames = np.tile(np.eye(4), (sightings.cameras, 1, 1)), views[0].copy()
    for camera in range(1, sightings.cameras):
        there = np.isfinite(views[camera, :, 0, 0])
        both = there & np.isfinite(frames[:, 0, 0])
        if mounts is not None:
            found[camera] = mounts[camera]
        elif both.any():
            found[camera] = median_pose(inverse(frames[both]) @ views[camera, both])
        else:
            raise InputError(f"detections have no frame that shows where camera {camera + 1} is mounted.", "detections")
        fresh = there & ~both
        frames[fresh] = views[camera, fresh] @ inverse(found[camera])
    return Poses(apart.tags, frames, found)


def mount_doubts(views: FloatArray, mounts: FloatArray) -> list[str]:
    """Sentences on cameras that are mounted elsewhere than their mounts say.

    Args:
        views: poses of each camera in each frame by its own images, `(C, F, 4, 4)`; NaN if not known.
        mounts: poses of the cameras on the body, which is the first camera, `(C, 4, 4)`.
    """
    doubts = []
    for camera in range(1, len(mounts)):
        between = inverse(views[0]) @ views[camera]
        between = between[np.isfinite(between[:, 0, 0])]
        if len(between) < FEWEST_FRAMES:
            continue
        middle = median_pose(between)
        spread = np.median(np.abs(log(inverse(middle) @ between)), axis=0) * OF_MEDIAN / np.sqrt(len(between))
        turn, way = np.linalg.norm(log(inverse(middle) @ mounts[camera]).reshape(2, 3), axis=1)
        sure_turn, sure_way = OFF_SIGMAS * np.linalg.norm(spread.reshape(2, 3), axis=1)
        if turn > max(OFF_RAD, sure_turn) or way > max(OFF_M, sure_way):
            doubts.append(
                f"camera {camera + 1} is {1e3 * way:.0f} mm and {np.degrees(turn):.3g} degrees from its mount, by "
                f"{len(between)} frames in which camera 1 sees tags, too: is the rig right in sign, unit and order?"
            )
    return doubts


@dataclass(frozen=True)
class JoinedGroups:
    """Groups of a map that only motion joins."""

    group: IntArray
    """`(K,)` group of each tag, as images alone connect them; -1 for tags that are not in the map."""
    sigma: FloatArray
    """`(G,)` standard deviation of each group's place relative to the nearest other tags, in the worst direction, m."""


def joined_groups(found: Estimate, group: IntArray) -> JoinedGroups:
    """Groups that motion has joined, and the standard deviations of their places relative to each other.

    Args:
        found: estimate with a motion.
        group: group of each tag, `(K,)`, as images alone connect them; -1 for tags that no image connects with others.
    """
    alone = group < 0
    own = np.where(alone, group.max(initial=-1) + 1 + np.cumsum(alone), group)
    own = np.where(found.known, own, -1)
    own[found.known] = np.unique(own[found.known], return_inverse=True)[1]
    best = np.full(int(own.max(initial=-1)) + 1, np.inf)
    tags, covariance = found.poses.tags, found.covariance
    for k in np.flatnonzero(found.known).tolist():
        others = np.flatnonzero(found.known & (own != own[k]))
        near = others[np.argsort(np.linalg.norm(tags[others, :3, 3] - tags[k, :3, 3], axis=1))[:NEAREST]]
        for other in near.tolist():
            between = inverse(tags[k]) @ tags[other]
            slope = np.hstack([skew(between[:3, 3]), -np.eye(3), np.zeros((3, 3)), between[:3, :3]])
            rows = np.r_[6 * k : 6 * k + 6, 6 * other : 6 * other + 6]
            square = slope @ covariance[np.ix_(rows, rows)] @ slope.T
            best[own[k]] = min(best[own[k]], float(np.sqrt(np.linalg.eigvalsh(square)[-1])))
    return JoinedGroups(own, best)
