"""Bundle adjustment: the poses of tags, frames and cameras that minimise the robust reprojection error.

A sighting has eight residuals e, pixels, and chi^2 = |e|^2 / sigma^2. The variance sigma^2 is the sum of the detector's
variance and of the squared *floor*, which stands for errors of lenses and bodies. Levenberg-Marquardt steps, with the
weights of reweighted least squares, minimise the sum of the Student losses (`lmd.survey.residuals`) of sightings and of
priors that are not exact. The floor is estimated so that the weighted mean of chi^2 has the value expected for normal
errors.
"""

from collections.abc import Sequence

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import nearest_rotations, pose_of
from lmd.survey.prior import Prior
from lmd.survey.residuals import DEGREES_OF_FREEDOM, Poses, squared_errors, student_loss, student_weight
from lmd.survey.schur import LEAST_DAMPING, SchurSystem
from lmd.survey.sightings import RESIDUALS, Sightings

# Mean of (nu + 8) x / (nu + x) for x with the chi^2 distribution with 8 degrees of freedom.
NORMAL_MEAN = 7.5625
LEAST_SHARE = 0.1  # least share of the squared errors that is assumed to remain after a fit
FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e6
LEAST_GAIN = 1e-7  # the iteration ends when a step decreases the loss per sighting by less
FLOOR_BISECTIONS = 40


class Adjustment(SchurSystem):
    """Bundle adjustment of some sightings, see `SchurSystem`."""

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        super().__init__(sightings, prior, nuisances, inflation)
        poses = len(np.unique(sightings.frame)) + len(np.unique(sightings.tag)) + self.mounts
        unknowns = 6 * poses + sightings.taken
        self.share = max(1.0 - unknowns / (RESIDUALS * len(sightings)), LEAST_SHARE)  # of the squares, after a fit

    def prior_losses(self, poses: Poses) -> list[float]:
        """Robust losses of the priors at some poses."""
        losses = [self.prior.loss(self.prior.off(poses.tags))]
        if self.prior.sheets is not None:
            losses.append(student_loss(self.prior.sheets.fitted(poses.tags).squares, 6))
        return losses

    def loss(self, error: FloatArray, prior_losses: Sequence[float], floor: float) -> float:
        """Total loss, from the squared errors of sightings `(N,)` and the losses of the priors."""
        square = error / self.sightings.variance(floor)
        return sum(prior_losses, student_loss(square) / self.inflation**2)

    def floor(self, error: FloatArray, most: float) -> float:
        """Floor, pixels, at most `most`, at which the squared errors of sightings have their expected mean, by
        bisection.
        """
        shared, low, high = error / self.share, 0.0, most
        for _ in range(FLOOR_BISECTIONS):
            middle = (low + high) / 2.0
            square = shared / self.sightings.variance(middle)
            if (student_weight(square) * square).mean() > NORMAL_MEAN:
                low = middle
            else:
                high = middle
        return high

    def efficiency(self, poses: Poses, floor: float) -> tuple[float, float]:
        """Mean slope of the estimating equations and variance of their right side (sandwich formula).

        With weights w(chi^2), the slope is the mean of w + 2 w' chi^2 / 8, and the variance is the mean of w^2 chi^2 /
        8.
        """
        square = squared_errors(self.sightings, poses) / self.sightings.variance(floor) / self.share
        weight = student_weight(square)
        slope = (weight - 2.0 / RESIDUALS * square * weight / (DEGREES_OF_FREEDOM + square)).mean()
        return float(slope), float((weight**2 * square).mean() / RESIDUALS)

    def covariance(self, poses: Poses, floor: float) -> FloatArray:
        """Marginal covariance of the kept unknowns, `(6 kept, 6 kept)`; NaN for tags without sightings.

        Computed as for least squares with the weight slope^2 / variance (`efficiency`) for all sightings.
        """
        slope, spread = self.efficiency(poses, floor)
        matrix, *_ = self.schur_system(poses, floor, 0.0, slope**2 / spread)
        informed = np.flatnonzero(np.diag(matrix) > 0.0)
        whole = np.full_like(matrix, np.nan)
        whole[np.ix_(informed, informed)] = np.linalg.inv(matrix[np.ix_(informed, informed)])
        return whole

    def run(self, poses: Poses, floor: float, steps: int, most: float | None = None) -> tuple[Poses, float]:
        """Minimise the loss by Levenberg-Marquardt.

        Args:
            poses: initial poses.
            floor: initial floor, pixels.
            steps: maximum number of steps.
            most: maximum of the floor; None for its initial value.

        Returns:
            poses; floor, pixels: the standard deviation of corners beyond the detector's own.
        """
        damping, most = FIRST_DAMPING, floor if most is None else most
        error, priors = squared_errors(self.sightings, poses), self.prior_losses(poses)
        loss = self.loss(error, priors, floor)
        for _ in range(steps):
            tried = self.step(poses, floor, damping)
            error, priors = squared_errors(self.sightings, tried), self.prior_losses(tried)
            found = self.loss(error, priors, floor)
            if found > loss or not np.isfinite(found):
                damping *= 10.0
                if damping > MOST_DAMPING:
                    break
                continue
            gained, poses, damping = loss - found, tried, max(damping / 10.0, LEAST_DAMPING)
            before, floor = floor, self.floor(error, most)
            loss = self.loss(error, priors, floor)
            if gained < LEAST_GAIN * len(self.sightings) and abs(floor - before) < 1e-3 * before + 1e-6:
                break
        return Poses(*map(_orthonormal, (poses.tags, poses.frames, poses.mounts))), floor


def _orthonormal(poses: FloatArray) -> FloatArray:
    """Poses with their rotations made orthonormal again, as products accumulate rounding errors; NaN stays NaN."""
    result = poses.copy()
    known = np.isfinite(poses).all(axis=(1, 2))
    result[known] = pose_of(nearest_rotations(poses[known, :3, :3]), poses[known, :3, 3])
    return result
