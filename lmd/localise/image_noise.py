"""Noise of the sightings of single images: errors of corners, and errors of the tags of the map.

The residuals e of a sighting, see `lmd.survey.residuals`, have the covariance (sigma^2 + f^2) I + J S J^T: the variance
of the detector's corners, the squared floor f for errors that the detector does not explain, and the covariance S of
the tag's pose in the map. With the eigenvectors U and eigenvalues l of J S J^T, U^T e has independent components of
variance sigma^2 + f^2 + l.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.survey.adjustment import FLOOR_BISECTIONS
from lmd.survey.map_estimate import OUTLIER_CHI_SQUARE, OUTLIER_PIXELS, OUTLIER_SHARE
from lmd.survey.residuals import DEGREES_OF_FREEDOM, Reprojection, student_weight
from lmd.survey.sightings import RESIDUALS, Sightings

POSE = 6  # degrees of freedom of the pose of a frame
ASSUMED_FREEDOM = 20.0  # excess of squared errors, in degrees of freedom, that is attributed to chance
# The efficiency is estimated from sightings in frames of `FEWEST_TAGS` tags. With fewer than `FEWEST_SIGHTINGS`,
# slope of the estimating equations and variance of their right side have the values of normal errors.
FEWEST_TAGS, FEWEST_SIGHTINGS, NORMAL_SLOPE, NORMAL_SPREAD = 3, 100, 0.9452, 0.9843
QUANTILES = 1000  # quantiles of chi^2 by which means are computed


@dataclass(frozen=True)
class ImageNoise:
    """Noise of N sightings."""

    variance: FloatArray
    """`(N,)` variance of a coordinate of a corner according to the detector, pixels^2."""
    values: FloatArray
    """`(N, 8)` eigenvalues l, pixels^2."""
    vectors: FloatArray
    """`(N, 8, 8)` eigenvectors U, in columns."""

    @classmethod
    def of(cls, sightings: Sightings, at: Reprojection, sigmas: FloatArray) -> "ImageNoise":
        """Noise of sightings whose tags have the standard deviations `sigmas` `(K, 6)`, see `FixedMap`."""
        half = at.by_tag * sigmas[sightings.tag, None, :]
        values, vectors = np.linalg.eigh(half @ np.swapaxes(half, 1, 2))
        return cls(sightings.noise**2, np.maximum(values, 0.0), vectors)

    def whitened(self, values: FloatArray, floor: float) -> FloatArray:
        """Residuals or Jacobians `(N, 8, m)` in units of standard deviations."""
        scale = np.sqrt(self.variance[:, None] + floor**2 + self.values)
        return np.asarray((np.swapaxes(self.vectors, 1, 2) @ values) / scale[..., None])

    def squares(self, error: FloatArray, floor: float) -> FloatArray:
        """chi^2 of residuals `(N, 8)`, `(N,)`."""
        return np.asarray((self.whitened(error[..., None], floor) ** 2).sum(axis=(1, 2)))

    def fits(self, sightings: Sightings, error: FloatArray, floor: float) -> BoolArray:
        """Mask of the sightings that are no outliers, see `lmd.survey.map_estimate.fitting`; False for NaN."""
        near = np.sqrt((error**2).mean(axis=1) * 2.0) <= np.maximum(OUTLIER_PIXELS, OUTLIER_SHARE * sightings.sizes)
        return np.asarray((self.squares(error, floor) <= OUTLIER_CHI_SQUARE) | near)

    def of_some(self, chosen: BoolArray) -> "ImageNoise":
        """Noise of the chosen sightings."""
        return ImageNoise(self.variance[chosen], self.values[chosen], self.vectors[chosen])

    def floor(self, error: FloatArray, frame: IntArray, most: float) -> float:
        """Floor, pixels, at most `most`, at which chi^2 of the frames has its expected robust mean, by bisection.

        Args:
            error: residuals after the fit of each frame, `(N, 8)`.
            frame: frame of each sighting, `(N,)`.
            most: greatest floor, pixels.
        """
        _, owner, counts = np.unique(frame, return_inverse=True, return_counts=True)
        freedom = RESIDUALS * counts - POSE
        turned = (np.swapaxes(self.vectors, 1, 2) @ error[..., None])[..., 0] ** 2
        known, low, high = self.variance[:, None] + self.values, 0.0, most
        expected = (1.0 + ASSUMED_FREEDOM / freedom.sum()) * _robust_mean(freedom).sum()
        for _ in range(FLOOR_BISECTIONS):
            middle = (low + high) / 2.0
            square = np.asarray(np.bincount(owner, (turned / (known + middle**2)).sum(axis=1)), dtype=np.float64)
            if (student_weight(square, freedom) * square).sum() > expected:
                low = middle
            else:
                high = middle
        return high

    def efficiency(self, error: FloatArray, frame: IntArray, floor: float) -> float:
        """Weight of all sightings, slope^2 / variance, with which least squares has the covariance of the robust fit.

        Args:
            error, frame: see `floor`.
            floor: floor, pixels.
        """
        counts = np.bincount(frame)[frame]
        slope, spread, sure = NORMAL_SLOPE, NORMAL_SPREAD, counts >= FEWEST_TAGS
        if sure.sum() >= FEWEST_SIGHTINGS:
            square = self.of_some(sure).squares(error[sure], floor) / (1.0 - POSE / (RESIDUALS * counts[sure]))
            weight = student_weight(square)
            slope = float((weight - 2.0 / RESIDUALS * square * weight / (DEGREES_OF_FREEDOM + square)).mean())
            spread = float((weight**2 * square).mean() / RESIDUALS)
        return slope**2 / spread


def _robust_mean(freedom: IntArray) -> FloatArray:
    """Mean of (nu + d) x / (nu + x) for x with the chi^2 distribution with d degrees of freedom, `(n,)`."""
    different, which = np.unique(freedom, return_inverse=True)
    return np.array([_robust_mean_of(number) for number in different.tolist()])[which]


@cache
def _robust_mean_of(freedom: int) -> float:
    from scipy.special import gammaincinv

    square = 2.0 * gammaincinv(freedom / 2.0, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    return float((student_weight(square, freedom) * square).mean())
