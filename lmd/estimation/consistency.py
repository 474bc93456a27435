"""Consistency of estimators: normalised estimation errors squared (NEES) and their chi-square intervals.

An estimate Xh with the covariance S of the body twist (w, v) of its error Xh^-1 X = exp(w, v) is consistent if
(w, v)^T S^-1 (w, v) follows the chi-square distribution of 6 degrees. The blocks of S give the squares of rotation and
of position, of 3 degrees each. See Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with applications to
tracking and navigation", 2001, section 5.4.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import inverse, log

# Degrees of freedom of the three squares of `squares`.
DEGREES = {"joint": 6, "rotation": 3, "position": 3}


def squares(estimates: Sequence[tuple[FloatArray, FloatArray]], true: FloatArray) -> FloatArray:
    """Normalised errors squared of a run: joint, of rotation and of position, `(T, 3)`; NaN without an estimate.

    Args:
        estimates: Xh `(4, 4)` of each frame, and the covariance of its error as a body twist, `(6, 6)`.
        true: X, `(T, 4, 4)`.
    """
    found = np.full((len(true), 3), np.nan)
    poses, covariances = (np.array(part) for part in zip(*estimates, strict=True))
    there = np.isfinite(poses).all(axis=(-2, -1)) & np.isfinite(covariances).all(axis=(-2, -1))
    back = inverse(poses[there]) @ true[there]
    twist, covariance = log(back), covariances[there]
    found[there, 0] = _square(twist, covariance)
    found[there, 1] = _square(twist[:, :3], covariance[:, :3, :3])
    found[there, 2] = _square(back[:, :3, 3], covariance[:, 3:, 3:])
    return found


def interval(degrees: int, count: float, probability: float = 0.99) -> tuple[float, float]:
    """Chi-square interval of the mean of `count` independent squares over their degrees of freedom."""
    tails = np.array([1.0 - probability, 1.0 + probability]) / 2.0
    low, high = chi2.ppf(tails, degrees * count) / (degrees * count)
    return float(low), float(high)


def _square(error: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1))
