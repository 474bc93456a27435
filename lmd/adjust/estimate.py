"""Estimated poses and their covariances, from a bundle adjustment that leaves out outliers.

*Errors correlated in time*: the covariance C of an adjustment assumes that errors of sightings are independent. The
errors in a drive are correlated, as exposure, blur and errors of the lens model change slowly. So the frames are
divided into blocks of time with equal numbers of sightings. Block b adds S_b to the normal matrix S = C^-1, and g_b to
the right side; at the solution the sum of all g_b is 0. Block b contributes x_b = C (1 - S_b C)^-1/2 g_b to the error
of the map. The covariance of the map is the sum of x_b x_b' over all blocks, and equals C if errors are uncorrelated.

With the inverse in place of the inverse root, the method would be the jackknife. The jackknife leaves out one block at
a time, and overestimates the effect of a block that alone determines a part of the map.

Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples" (CR2).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.corners import Poses, fitting, squared_errors
from lmd.adjust.drive import spread_motion
from lmd.adjust.gauge import diagonal_blocks, gauge_free, rows_of, worst_sigmas
from lmd.adjust.intrinsics import Calibrated, Optics
from lmd.adjust.motion import Clock
from lmd.adjust.prior import EXACT_SIGMA, Prior
from lmd.adjust.sightings import Observations, Sightings
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray

FLOOR_PIXELS = 3.0  # maximum of the floor, pixels
STEPS, FINAL_STEPS = 40, 15  # steps of bundle adjustment with all sightings, and without outliers
# Threads of linear algebra: for matrices of a few hundred rows, more threads are slower.
ONE_THREAD = 1
FEWEST_MISFITS = 3  # minimum number of outliers of a tag that was moved or has another size
FEWEST_FRAMES = 10  # minimum number of frames for blocks of time
FEWEST_BLOCKS, MOST_BLOCKS = 5, 8
FEWEST_IN_BLOCK = 3  # minimum number of frames of a block, unless there would be too few blocks
ALONE = 0.98  # a block with a larger share of the information in a direction alone determines the direction
LEAST_RATIO = 1e-2  # minimum ratio of squared errors of a tag to its variance
LEAST_PART = 1e-9  # minimum eigenvalue of a block's information, relative to the largest


@dataclass(frozen=True)
class Lenses:
    """Nuisance parameters of the cameras: intrinsics, and the shifts by which blur and exposure move corners. See
    `lmd.adjust.refinement`.
    """

    seen: Observations
    """Detections, with the cameras as given before the refinement."""
    optics: tuple[Optics, ...]
    """Refined optics of the cameras."""
    sigmas: tuple[FloatArray, ...]
    """Prior standard deviations of each camera's P intrinsics and two shifts, see `Optics.values`, `(P + 2,)` each."""
    off: FloatArray
    """Differences between the refined and the given values of each camera, in prior standard deviations, `(C, 6 L)`;
    zeros are appended to the values to fill L blocks of six.
    """


@dataclass(frozen=True)
class Estimate:
    """Estimated poses of tags, of the body at each frame, and of the cameras on the body (mounts), from sightings."""

    sightings: Sightings
    """All sightings, with the shapes of tags."""
    prior: Prior
    """Prior of the unknowns."""
    poses: Poses
    """Poses of tags, frames and mounts; NaN if not placed."""
    group: IntArray
    """`(K,)` group of each tag: 0 for tags of the map, larger for tags that no frame connects with the map, -1 for tags
    that are not placed.
    """
    used: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Mask of the inliers, `(N,)`: the sightings from which the map is made. The mask is empty, as is `misfits`, while
    the poses are rough.
    """
    misfits: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Mask of the outliers, `(N,)`: sightings that do not fit the pose of their tag, although their tag and frame
    belong to the map.
    """
    floor: float = FLOOR_PIXELS
    """Standard deviation of corners in addition to the detector's own, pixels."""
    inflation: float = 1.0
    """Factor on the standard deviations of sightings that accounts for errors correlated in time, see the function
    `inflation`.
    """
    lenses: Lenses | None = None
    """Nuisance parameters of the cameras; None if cameras are exact."""
    clock: Clock | None = None
    """Offset of the odometry's clock; None without odometry."""

    def adjusted(self, most: float = FLOOR_PIXELS) -> "Estimate":
        """Estimate after a bundle adjustment of the map: first with all sightings, then without the outliers. The map
        consists of the tags whose `group` is 0, and of the frames that show these tags.

        Args:
            most: upper limit of the floor, pixels. The floor is the standard deviation of corners in addition to the
                detector's own.

        Raises:
            InputError: no two sightings agree on a pose of the camera.
        """
        sightings, prior, poses, group, floor = self.sightings, self.prior, self.poses, self.group, most
        of_map = (group[sightings.tag] == 0) & poses.known_frames[sightings.frame]
        used = of_map = constraining(sightings, of_map, prior)
        misfits = np.zeros_like(used)
        sheets = None if prior.sheets is None else prior.sheets.of((group == 0) & (sightings.counts(of_map) > 0))
        prior = replace(prior, information=np.where((group == 0)[:, None], prior.information, 0.0), sheets=sheets)
        for steps in (STEPS, FINAL_STEPS):
            used = constraining(sightings, used, prior)
            if not used.any() and prior.joint is not None:
                break
            if not used.any():
                raise InputError(
                    "detections: no two tags of a frame agree with one pose of the camera; check the order of the "
                    "corners and the calibration.",
                    "detections",
                )
            joint = Adjustment(sightings.of(used), prior, inflation=self.inflation)
            poses, floor = joint.run(poses, floor, steps)
            if joint.links is not None and steps == STEPS:
                prior = replace(prior, motion=spread_motion(joint, poses, floor))
            misfits = of_map & ~fitting(sightings, squared_errors(sightings, poses), floor)
            used = of_map & ~misfits
        used = constraining(sightings, used, prior)
        shown = np.isin(np.arange(sightings.frames), sightings.frame[used])
        poses = replace(poses, frames=np.where(shown[:, None, None], poses.frames, np.nan))
        return replace(self, prior=prior, poses=poses, used=used, misfits=misfits, floor=floor)

    @property
    def adjustment(self) -> Adjustment:
        """Bundle adjustment of the inliers. The unknowns include intrinsics, shifts of corners and shapes of tags."""
        return Adjustment(self.sightings.of(self.used), self.prior, True, self.inflation)

    @cached_property
    def covariance(self) -> FloatArray:
        """Joint covariance of the unknowns of `adjustment`, without the poses of the frames. Rows and columns are in
        the order that `Adjustment` states, tags first. A pose X has six rows: its error is a twist, X -> X exp(twist).
        """
        with threadpool_limits(limits=ONE_THREAD):
            return self.adjustment.fixed_system(self.poses, self.floor).covariance

    @property
    def known(self) -> BoolArray:
        """True for tags of the map that have a covariance, `(K,)`."""
        of_tags = np.diag(self.covariance)[: 6 * len(self.group)].reshape(-1, 6)
        return np.asarray((self.group == 0) & np.isfinite(of_tags).all(axis=1))

    def _blocks(self, first: int, last: int, size: int = 6) -> FloatArray:
        """Square blocks on the diagonal of `covariance`, `(n, size, size)`, for a range of its rows and columns.

        The range begins at row and column `6 * first`, and ends before row and column `6 * last`. `first` and `last`
        are therefore indices of groups of six unknowns, such as the twist of a tag.
        """
        return diagonal_blocks(self.covariance[6 * first : 6 * last, 6 * first : 6 * last], size)

    @property
    def covariances(self) -> FloatArray:
        """Marginal covariance of the twist of each tag, `(K, 6, 6)`; NaN for tags not in the map."""
        return np.where(self.known[:, None, None], self._blocks(0, len(self.group)), np.nan)

    @cached_property
    def frame_covariances(self) -> FloatArray:
        """Marginal covariance of the twist of each frame's pose, `(F, 6, 6)`; NaN for frames without a pose."""
        found = np.full((self.sightings.frames, 6, 6), np.nan)
        if self.used.any():
            with threadpool_limits(limits=ONE_THREAD):
                joint = self.adjustment
                found[joint.seen] = joint.frame_covariances(self.poses, self.floor)
        return np.where(self.poses.known_frames[:, None, None], found, np.nan)

    @cached_property
    def gauge_free_covariance(self) -> FloatArray:
        """Covariance of the twists of n tags relative to each other, `(6 n, 6 n)`: the tags of the map that have a
        covariance (`known`). A common motion of all tags is removed, see `gauge_free`.
        """
        rows = rows_of(np.flatnonzero(self.known))
        left = gauge_free(self.poses.tags[self.known])
        return np.asarray(left @ self.covariance[np.ix_(rows, rows)] @ left.T)

    @cached_property
    def gauge_free_covariances(self) -> FloatArray:
        """Covariance of the twist of each tag relative to the other tags, `(K, 6, 6)`. A common motion of all tags is
        removed, see `gauge_free`. NaN for tags that are not in the mask `known`.
        """
        known, found = self.known, np.full((len(self.group), 6, 6), np.nan)
        found[known] = diagonal_blocks(self.gauge_free_covariance)
        return found

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviation of each tag's position relative to the other tags, in the worst direction, metres,
        `(K,)`.
        """
        return worst_sigmas(self.gauge_free_covariances)[:, 0]

    @property
    def calibrated(self) -> tuple[Calibrated, ...]:
        """Refined cameras with their covariances; empty if cameras are not refined, or if there are no inliers."""
        if self.lenses is None or not self.used.any():
            return ()
        lenses, joint = self.lenses, self.adjustment
        blocks = self._blocks(joint.first_lens, joint.first_shape, 6 * joint.lens_blocks)
        each = zip(lenses.seen.optics, lenses.optics, blocks, lenses.sigmas, strict=True)
        return tuple(
            Calibrated(given.camera, one.camera, one.shifts[0], own[: len(s), : len(s)] * np.outer(s, s))
            for given, one, own, s in each
        )

    @property
    def frames(self) -> IntArray:
        """Indices of the frames from which the map is made."""
        return np.unique(self.sightings.frame[self.used])

    @property
    def squares(self) -> FloatArray:
        """Squared error of each sighting, pixels^2, `(N,)`; NaN if its tag or frame has no pose."""
        return squared_errors(self.sightings, self.poses)

    @property
    def are_astray(self) -> BoolArray:
        """Mask of the tags with more outliers than inliers, and with at least `FEWEST_MISFITS` outliers, `(K,)`."""
        counts = self.sightings.counts(self.misfits)
        return np.asarray((counts >= FEWEST_MISFITS) & (counts > self.sightings.counts(self.used)))

    def with_tags(self, chosen: IntArray | BoolArray, tags: FloatArray) -> "Estimate":
        """Copy of the estimate in which the `chosen` tags have the poses `tags` `(n, 4, 4)`."""
        every = self.poses.tags.copy()
        every[chosen] = tags
        return replace(self, poses=replace(self.poses, tags=every))

    def moved(self, motion: FloatArray) -> "Estimate":
        """Copy of the estimate with all poses moved by a rigid motion `(4, 4)` of the world frame."""
        poses = replace(self.poses, tags=motion @ self.poses.tags, frames=motion @ self.poses.frames)
        return replace(self, poses=poses, prior=replace(self.prior, tags=motion @ self.prior.tags))


def constraining(sightings: Sightings, used: BoolArray, prior: Prior) -> BoolArray:
    """Mask of those sightings in the mask `used` `(N,)` that constrain the map, `(N,)`.

    A sighting that is alone in its frame constrains the map only if motion links the frame to another frame. With a
    known map (`Prior.joint`) all sightings in `used` count, because a single sighting then determines the pose of its
    frame.
    """
    if prior.joint is not None:
        return used
    counts = np.bincount(sightings.frame[used], minlength=sightings.frames)
    enough, frames = counts >= 2, np.flatnonzero(counts)
    if prior.motion is not None:
        enough[frames[prior.motion.linked(frames)]] = True
    return np.asarray(used & enough[sightings.frame])


def inflation(found: Estimate) -> float:
    """Factor, at least 1, by which errors that are correlated in time enlarge the standard deviations of the tags'
    positions. The factor is the geometric mean of the factors of single tags, which follow from the errors of blocks of
    successive frames (blocks of time).

    With too few frames for blocks, the factor is 1. If motion links frames, only frames with two or more tags are used.
    Such frames may connect the map only in parts; the largest part is then used.

    Args:
        found: estimate whose attribute `inflation` is 1.
    """
    if found.prior.motion is not None:
        found = _without_links(found)
    if len(found.frames) < FEWEST_FRAMES:
        return 1.0
    slope, spread = Adjustment(found.sightings.of(found.used), found.prior).efficiency(found.poses, found.floor)
    off = [_off(found, frames, slope, spread) for frames in _blocks_of_time(found)]
    square = (np.stack(off) ** 2).sum(axis=(0, 2))
    stated = np.trace(found.gauge_free_covariances[found.known][:, 3:, 3:], axis1=1, axis2=2)
    known = stated > 0.0
    ratio = np.maximum(square[known] / stated[known], LEAST_RATIO)
    return float(max(np.exp(np.log(ratio).mean() / 2.0), 1.0)) if known.any() else 1.0


def _blocks_of_time(found: Estimate) -> list[IntArray]:
    """Divide the frames of the map into blocks of successive frames, with about equal numbers of inliers. Each array
    has the ascending indices of the frames in one block.
    """
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)[found.frames]
    middle = np.cumsum(counts) - counts / 2.0
    blocks = int(np.clip(len(counts) // FEWEST_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
    block = (blocks * middle / counts.sum()).astype(int)
    return [found.frames[block == b] for b in range(blocks) if (block == b).any()]


def _without_links(found: Estimate) -> Estimate:
    """Estimate of the largest part of the map that images alone connect, without the links of motion. The other tags
    get the group -1, as if they had no pose.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    some, count = found.sightings, len(found.group)
    used = constraining(some, found.used, replace(found.prior, motion=None, joint=None))
    ends = (some.tag[used], count + some.frame[used])
    whole = coo_array((np.ones(used.sum()), ends), shape=(count + some.frames,) * 2)
    _, part = connected_components(whole, directed=False)
    of_part = np.bincount(part[some.tag[used]], minlength=1)
    used = used & (part[some.tag] == of_part.argmax())
    information = found.prior.information.copy()
    if used.any() and not information[some.tag[used]].any():
        information[some.tag[used][0]] = EXACT_SIGMA**-2.0
    prior = replace(found.prior, motion=None, information=information)
    return replace(found, prior=prior, used=used, group=np.where(some.counts(used) > 0, found.group, -1))


def _off(found: Estimate, frames: IntArray, slope: float, spread: float) -> FloatArray:
    """Contribution of a block of frames to the error of each tag's position relative to the other tags, metres,
    `(n, 3)`. The contribution is x_b in the formulas of this module, for the n tags with a covariance.

    Args:
        found: estimate.
        frames: indices of the frames in the block.
        slope, spread: slope and variance that `Adjustment.efficiency` returns for all sightings.
    """
    used = found.sightings.of(found.used)
    some = used.of(np.isin(used.frame, frames))
    nothing = Prior(found.prior.tags, np.zeros_like(found.prior.information))
    part = Adjustment(some, nothing, nuisances=True)
    own = part.system(found.poses, found.floor, 0.0, slope**2 / spread).matrix
    right = part.system(found.poses, found.floor).right
    first = 6 * part.first_lens
    own[first:, first:] -= np.eye(len(own) - first)  # without the prior of nuisance parameters
    covariance = found.covariance
    rows = np.flatnonzero((np.diag(own) > 0.0) & np.isfinite(np.diag(covariance)))
    values, vectors = np.linalg.eigh(own[np.ix_(rows, rows)])
    there = values > LEAST_PART * values[-1]
    root = vectors[:, there] * np.sqrt(values[there])
    whitened = vectors[:, there].T @ right.ravel()[rows] * (slope / spread) / np.sqrt(values[there])
    share, turn = np.linalg.eigh(root.T @ covariance[np.ix_(rows, rows)] @ root)
    grown = np.where(share < ALONE, 1.0 / np.sqrt(np.clip(1.0 - share, 1.0 - ALONE, 1.0)), 0.0)
    tags = rows_of(np.flatnonzero(found.known))
    moved = covariance[np.ix_(tags, rows)] @ (root @ (turn @ (grown * (turn.T @ whitened))))
    return np.asarray((gauge_free(found.poses.tags[found.known]) @ moved).reshape(-1, 6)[:, 3:])
