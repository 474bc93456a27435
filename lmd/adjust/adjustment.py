"""Bundle adjustment: the poses of tags, frames and cameras that minimise the robust reprojection error.

A sighting (one tag detected in one image) has eight residuals e, pixels, and chi^2 = |e|^2 / sigma^2. Here sigma is
the standard deviation of a corner's coordinate. Levenberg-Marquardt steps with iteratively reweighted least squares
minimise a sum of losses. The losses are those of sightings (Student's loss, see `lmd.adjust.corners`), of priors, and
of the motion between frames (`lmd.adjust.links`).

The *kept* unknowns remain when the poses of the frames are eliminated (`lmd.adjust.frames`). Kept are the poses of
tags, the poses of all cameras on the body but the first (*mounts*), the bias of odometry, and nuisance parameters.
Nuisance parameters are intrinsics, shifts of corners and shapes of tags. Let H_ff, H_kk, H_kf and H_fk = H_kf^T be the
blocks of the normal matrix, and g_f and g_k those of the right side, for frames (f) and kept unknowns (k). The step d_k
of the kept unknowns solves

    (H_kk - H_kf H_ff^-1 H_fk) d_k = g_k - H_kf H_ff^-1 g_f.

Source: Triggs et al., "Bundle Adjustment - A Modern Synthesis".
"""

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.adjust.corners import (
    LEAST_DAMPING,
    Poses,
    Reprojection,
    add_at,
    efficiency,
    floor_of,
    squared_errors,
    student_loss,
    student_weight,
    sums_by,
    weighted_product,
)
from lmd.adjust.frames import LinkedFrames, Part, SeparateFrames
from lmd.adjust.links import Links
from lmd.adjust.prior import Kept, Prior
from lmd.adjust.sightings import RESIDUALS, Sightings
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import exp, nearest_rotations, pose_of

FRAME_CHUNK = 128  # number of frames whose equations are built together
LEAST_SHARE = 0.1  # assumed minimum share of the squared errors that remains after a fit
FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e6
LEAST_GAIN = 1e-7  # the iteration ends when a step reduces the loss per sighting by less than this
CHANGE = 1e-3  # relative change for derivatives of determinants


class System(NamedTuple):
    """Normal equations of the kept unknowns, linearised at given poses. The kept unknowns are all unknowns but the
    poses of the frames, which are eliminated from the equations.
    """

    matrix: FloatArray
    """Matrix on the left side, `(6 kept, 6 kept)`; `kept` is the number of blocks of six kept unknowns."""
    right: FloatArray
    """Right side of the equations, `(kept, 6)`."""
    frames: SeparateFrames | LinkedFrames
    """The eliminated frames."""

    @property
    def informed(self) -> tuple[IntArray, FloatArray]:
        """Unknowns about which there is information. The first array has their indices, `(n,)`; the second has their
        rows and columns of `matrix`, `(n, n)`.
        """
        rows = np.flatnonzero(np.diag(self.matrix) > 0.0)
        return rows, self.matrix[np.ix_(rows, rows)]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the kept unknowns (all but the frames' poses), as large as `matrix`. Rows and columns of
        unknowns about which there is no information are NaN.
        """
        (rows, matrix), whole = self.informed, np.full_like(self.matrix, np.nan)
        whole[np.ix_(rows, rows)] = np.linalg.inv(matrix)
        return whole

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the normal matrix of all unknowns, frames included. Unknowns about which
        there is no information are left out.
        """
        return float(np.linalg.slogdet(self.informed[1])[1]) + self.frames.log_determinant

    def reached(self, kept: FloatArray) -> FloatArray:
        """Product H_fk x, `(F, 6, ...)`, by which the kept unknowns x enter the equations of the F frames. H_fk is the
        block of the normal matrix with the rows of the frames and the columns of the kept unknowns. The argument
        `kept` `(n, 6, ...)` is x, for n blocks of six unknowns.
        """
        return np.concatenate([part.reached(kept) for part in self.frames.parts])


class Adjustment:
    """Bundle adjustment of sightings; every sighting's tag and frame must have an initial pose.

    The kept unknowns (all but the frames' poses) are in blocks of six. The order of the blocks is: tags, mounts, bias
    of odometry, nuisance parameters of each camera, shapes of tags. The unknowns of tags and mounts are twists of their
    poses. Mounts are poses of cameras on the body, except the first camera's. The nuisance parameters of a camera are
    its intrinsics and its shifts of corners.

    Args:
        sightings: the sightings.
        prior: prior of the unknowns.
        nuisances: True if nuisance parameters of cameras and shapes of tags are unknowns, see `Sightings`.
        inflation: factor on the standard deviations of all sightings and of the shapes of tags; the other priors do
            not change.
    """

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        self.sightings, self.prior, self.inflation = sightings, prior, inflation
        self.seen, first = np.unique(sightings.frame, return_index=True)
        self.links: Links | None = None if prior.motion is None else prior.motion.links(self.seen)
        tags, mounts = len(sightings.ids), sightings.cameras - 1
        self.mounts = slice(tags, tags + mounts)  # blocks of the unknown mounts
        self.first_lens = tags + mounts + (self.links is not None and self.links.by_bias is not None)
        self.lens_blocks = sightings.lens.shape[2] // 6 if nuisances else 0  # number of blocks of each camera
        self.first_shape = self.first_lens + sightings.cameras * self.lens_blocks
        self.kept = self.first_shape + (tags if nuisances and sightings.shape_sigma else 0)
        # Prior information of nuisance parameters in units of their standard deviations. Shapes also absorb errors that
        # are common to all sightings of a tag, so the inflation must not weaken sightings relative to the priors of
        # shapes.
        lenses = np.arange(self.first_lens, self.kept) < self.first_shape
        self.nuisance_information = np.where(lenses, 1.0, inflation**-2.0)
        ends = np.append(first[::FRAME_CHUNK], len(sightings))
        self._chunks = [sightings.of(slice(*between)) for between in pairwise(ends)]
        unknowns = 6 * (len(self.seen) + len(np.unique(sightings.tag)) + mounts) + sightings.taken
        self.share = max(1.0 - unknowns / (RESIDUALS * len(sightings)), LEAST_SHARE)  # of the squares, after a fit

    def _jacobians(self, some: Sightings, at: Reprojection) -> list[tuple[IntArray, FloatArray]]:
        """Jacobians of n sightings `some`, whose reprojection is `at`, with respect to the kept unknowns.

        The list has one pair of arrays for each block of six unknowns on which a sighting depends: its tag, its
        camera's mount, nuisance parameters of the camera, the tag's shape. The first array has the index of this block
        for each sighting, `(n,)`. The second has the Jacobian of the sighting's residuals with respect to this block,
        `(n, 8, 6)`.
        """
        found = [(some.tag, at.by_tag)]
        if self.mounts.stop > self.mounts.start:
            others = some.camera > 0
            index = self.mounts.start + np.where(others, some.camera - 1, 0)
            found.append((index, at.by_mount * others[:, None, None]))
        for block in range(self.lens_blocks):
            index = self.first_lens + self.lens_blocks * some.camera + block
            found.append((index, some.lens[:, :, 6 * block : 6 * block + 6]))
        if self.kept > self.first_shape:
            found.append((self.first_shape + some.tag, some.shape_sigmas[some.tag, None] * at.by_shape))
        return found

    def system(self, poses: Poses, floor: float, damping: float = 0.0, weight: float | None = None) -> System:
        """Linearise at `poses`, eliminate the frames, and return the normal equations of the other unknowns.

        Args:
            poses: poses of tags, frames and mounts.
            floor: standard deviation of corners in addition to the detector's own, pixels.
            damping: relative increase of the diagonal of the normal matrix (Levenberg-Marquardt).
            weight: weight of every sighting; priors and links of motion then have the weight 1. None for robust weights
                of sightings, priors and links.
        """
        kept, is_robust = Kept(self.kept), weight is None
        parts = [self._part(some, poses, floor, damping, weight, kept) for some in self._chunks]
        kept.matrix += kept.matrix.T.copy()  # each part adds one of two symmetric blocks
        frames: SeparateFrames | LinkedFrames = SeparateFrames(parts)
        if self.links is not None:
            frames = LinkedFrames(parts, self.links, poses.frames[self.seen], is_robust, kept, self.first_lens - 1)
        frames.eliminate(kept.matrix, kept.right)
        self.prior.add_to(kept, poses, is_robust)
        kept.add(slice(self.first_lens, self.kept), self.nuisance_information[:, None] * np.ones(6), np.zeros(6))
        each = np.arange(self.kept)
        kept.cells[each, each] += kept.diagonal * (1.0 + damping * np.eye(6))
        return System(kept.matrix, kept.right, frames)

    def _part(
        self, some: Sightings, poses: Poses, floor: float, damping: float, weight: float | None, kept: Kept
    ) -> Part:
        """Add the contributions of the sightings `some` to `kept`, the normal equations of the kept unknowns. Return
        the normal equations of the frames that have these sightings.
        """
        at, variance = Reprojection(some, *poses.of(some)), some.variance(floor)
        trust = student_weight(at.squared / variance) if weight is None else weight
        product = partial(weighted_product, weight=trust / variance / self.inflation**2)
        frames, owner = np.unique(some.frame, return_inverse=True)
        summed, error = sums_by(owner, len(frames)), -at.error[..., None]
        block = summed(product(at.by_frame, at.by_frame))
        block += damping * block * np.eye(6)
        jacobians = self._jacobians(some, at)
        rows = np.unique(np.concatenate([index for index, _ in jacobians]))
        panel = np.zeros((len(block), 6, len(rows), 6))
        turned = panel.transpose(2, 0, 3, 1)
        for k, (index, slope) in enumerate(jacobians):
            add_at(turned, np.searchsorted(rows, index), owner, product(slope, at.by_frame))
            by_index = sums_by(index, self.kept)
            kept.diagonal += by_index(product(slope, slope))
            kept.right += by_index(product(slope, error)[..., 0])
            for other, beside in jacobians[:k]:
                add_at(kept.cells, index, other, product(slope, beside))
        return Part(block, summed(product(at.by_frame, error)[..., 0]), panel, rows)

    def _moved(self, poses: Poses, kept: FloatArray, system: System) -> Poses:
        """Poses after a step `kept` `(kept, 6)` of the kept unknowns. The steps of the frames follow from `system` by
        back-substitution.
        """
        frames, mounts, twists = poses.frames.copy(), poses.mounts.copy(), kept[self.mounts]
        frames[self.seen] = frames[self.seen] @ exp(system.frames.steps(system.reached(kept)))
        mounts[1 : 1 + len(twists)] = mounts[1 : 1 + len(twists)] @ exp(twists)
        return Poses(poses.tags @ exp(kept[: len(poses.tags)]), frames, mounts)

    def step(self, poses: Poses, floor: float, damping: float) -> Poses:
        """Poses after one Levenberg-Marquardt step. Unknowns about which there is no information do not change.

        Args:
            poses: poses before the step.
            floor: standard deviation of corners in addition to the detector's own, pixels.
            damping: relative increase of the diagonal of the normal matrix.
        """
        system, kept = self.system(poses, floor, damping), np.zeros(6 * self.kept)
        rows, matrix = system.informed
        matrix[np.diag_indices_from(matrix)] *= 1.0 + LEAST_DAMPING
        kept[rows] = np.linalg.solve(matrix, system.right.ravel()[rows])
        return self._moved(poses, kept.reshape(-1, 6), system)

    def joint_step(
        self, poses: Poses, floor: float, damping: float, off: FloatArray
    ) -> tuple[Poses, FloatArray, FloatArray]:
        """Take one Levenberg-Marquardt step of all unknowns, including n blocks of six nuisance parameters. The unit
        of a nuisance parameter is its prior standard deviation.

        Args:
            poses: poses before the step.
            floor: standard deviation of corners in addition to the detector's own, pixels.
            damping: relative increase of the diagonal of the normal matrix (Levenberg-Marquardt).
            off: nuisance parameters before the step, minus their prior means, `(n, 6)`.

        Returns:
            poses after the step; step of the nuisance parameters, `(n, 6)`; covariance of the nuisance parameters,
            `(6 n, 6 n)`.
        """
        system = self.system(poses, floor, damping)
        system.right[self.first_lens :] -= self.nuisance_information[:, None] * off
        covariance = np.nan_to_num(system.covariance)
        step = (covariance @ system.right.ravel()).reshape(-1, 6)
        first = 6 * self.first_lens
        return self._moved(poses, step, system), step[self.first_lens :], covariance[first:, first:]

    def loss(self, poses: Poses, floor: float, sightings: Sightings | None = None) -> float:
        """Total loss of sightings, priors and links of motion.

        Args:
            poses: all poses.
            floor: standard deviation of corners in addition to the detector's own, pixels.
            sightings: the adjustment's sightings, as converted with other parameters of the cameras. None for the
                sightings as given to the class.
        """
        some = self.sightings if sightings is None else sightings
        return self._loss(squared_errors(some, poses), self._prior_loss(poses), floor)

    def _prior_loss(self, poses: Poses) -> float:
        return self.prior.loss(poses) + (0.0 if self.links is None else self.links.loss(poses.frames[self.seen]))

    def _loss(self, error: FloatArray, prior_loss: float, floor: float) -> float:
        return prior_loss + student_loss(error / self.sightings.variance(floor)) / self.inflation**2

    def run(self, poses: Poses, floor: float, steps: int, most: float | None = None) -> tuple[Poses, float]:
        """Minimise the loss by Levenberg-Marquardt steps, and estimate the floor. The floor is the standard deviation
        of corners in addition to the detector's own.

        Args:
            poses: initial poses.
            floor: initial floor, pixels.
            steps: maximum number of steps.
            most: upper limit of the estimated floor, pixels; None for a limit equal to the initial floor.

        Returns:
            poses; estimated floor, pixels.
        """
        self._update_share(poses, floor)
        damping, most, some = FIRST_DAMPING, floor if most is None else most, self.sightings
        loss = self.loss(poses, floor)
        for _ in range(steps):
            tried = self.step(poses, floor, damping)
            error, priors = squared_errors(some, tried), self._prior_loss(tried)
            found = self._loss(error, priors, floor)
            if found > loss or not np.isfinite(found):
                damping *= 10.0
                if damping > MOST_DAMPING:
                    break
                continue
            gained, poses, damping = loss - found, tried, max(damping / 10.0, LEAST_DAMPING)
            before, floor = floor, floor_of(error / self.share, some.noise, most)
            loss = self._loss(error, priors, floor)
            if gained < LEAST_GAIN * len(some) and abs(floor - before) < 1e-3 * before + 1e-6:
                break
        return Poses(*map(_orthonormal, (poses.tags, poses.frames, poses.mounts))), floor

    def fixed_system(self, poses: Poses, floor: float) -> System:
        """Normal equations in which all sightings have an equal weight, as in ordinary least squares. The weight is
        chosen such that the covariance equals that of the fit with robust weights, see `efficiency`.
        """
        slope, spread = self.efficiency(poses, floor)
        return self.system(poses, floor, 0.0, slope**2 / spread)

    def efficiency(self, poses: Poses, floor: float) -> tuple[float, float]:
        """Slope and variance of the weighted residuals at `poses`, see `lmd.adjust.corners.efficiency`. Least squares
        in which all sightings have the weight slope^2 / variance have the covariance of the fit with robust weights.
        """
        self._update_share(poses, floor)
        return efficiency(squared_errors(self.sightings, poses) / self.sightings.variance(floor) / self.share)

    def frame_covariances(self, poses: Poses, floor: float) -> FloatArray:
        """Marginal covariance of the body-frame twist (X -> X exp(twist)) of each frame with sightings, `(F, 6, 6)`.

        With the covariance C of the kept unknowns, the frames have the covariance H_ff^-1 + H_ff^-1 H_fk C H_kf
        H_ff^-1. H_ff and H_fk are the blocks of the normal matrix for frames (f) and kept unknowns (k). The factor
        `inflation` on the standard deviations of sightings enlarges C. The factor enlarges H_ff^-1 only if frames are
        linked: without links, errors in one frame are independent of errors in other frames.
        """
        system = self.fixed_system(poses, floor)
        values, vectors = np.linalg.eigh(np.nan_to_num(system.covariance))
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).reshape(self.kept, 6, -1)
        return system.frames.covariances(system.reached(root), self.inflation**-2.0 if self.links is None else 1.0)

    def _update_share(self, poses: Poses, floor: float) -> None:
        """Update `share`, the fraction of the sightings' squared errors that is expected to remain after the fit.
        Without links of motion and without a map as the prior (`Prior.joint`), the fraction keeps its first value.
        """
        if self.links is not None or self.prior.joint is not None:
            here, there = (self.system(poses, floor, 0.0, weight).log_determinant for weight in (1.0, 1.0 + CHANGE))
            taken = (there - here) / np.log1p(CHANGE)
            self.share = max(1.0 - taken / (RESIDUALS * len(self.sightings)), LEAST_SHARE)


def _orthonormal(poses: FloatArray) -> FloatArray:
    """Copy of `poses` with orthonormal rotations, because products of poses accumulate rounding errors. Poses of NaN
    stay NaN.
    """
    result, known = poses.copy(), np.isfinite(poses).all(axis=(1, 2))
    result[known] = pose_of(nearest_rotations(poses[known, :3, :3]), poses[known, :3, 3])
    return result
