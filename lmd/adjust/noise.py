"""Noise of corners beyond the detector's own: floor, efficiency of the robust fit, and outliers.

The variance of a coordinate of a corner is the sum of the detector's variance and of the squared *floor*, which stands
for errors of lenses and bodies. The floor is estimated so that the weighted mean of chi^2 has the value expected for
normal errors.
"""

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, student_weight
from lmd.adjust.sightings import RESIDUALS, Sightings
from lmd.core.checks import BoolArray, FloatArray

# Mean of (nu + 8) x / (nu + x) for x with the chi^2 distribution with 8 degrees of freedom.
NORMAL_MEAN = 7.5625
FLOOR_BISECTIONS = 40
# A sighting is an outlier if its chi^2, with eight degrees of freedom, exceeds `OUTLIER_CHI_SQUARE`, and its RMS error
# exceeds `OUTLIER_PIXELS` and the share `OUTLIER_SHARE` of its shortest side. Blur and lenses cause smaller errors.
OUTLIER_CHI_SQUARE, OUTLIER_PIXELS, OUTLIER_SHARE = 60.0, 1.0, 0.02


def floor_of(error: FloatArray, noise: FloatArray, most: float) -> float:
    """Floor, pixels, at most `most`, at which the squared errors have their expected mean, by bisection.

    Args:
        error: squared errors |e|^2 of sightings before a fit takes a part of them, pixels^2, `(N,)`.
        noise: standard deviation of a coordinate of a corner according to the detector, pixels, `(N,)`.
        most: greatest floor, pixels.
    """
    low, high = 0.0, most
    for _ in range(FLOOR_BISECTIONS):
        middle = (low + high) / 2.0
        square = error / (noise**2 + middle**2)
        if (student_weight(square) * square).mean() > NORMAL_MEAN:
            low = middle
        else:
            high = middle
    return high


def efficiency(square: FloatArray) -> tuple[float, float]:
    """Mean slope of the estimating equations and variance of their right side (sandwich formula), by chi^2 `(N,)`.

    With weights w(chi^2), the slope is the mean of w + 2 w' chi^2 / 8, and the variance is the mean of w^2 chi^2 / 8.
    Least squares with the weight slope^2 / variance of all sightings has the covariance of the robust fit.
    """
    weight = student_weight(square)
    slope = (weight - 2.0 / RESIDUALS * square * weight / (DEGREES_OF_FREEDOM + square)).mean()
    return float(slope), float((weight**2 * square).mean() / RESIDUALS)


def fitting(sightings: Sightings, error: FloatArray, floor: float) -> BoolArray:
    """Mask of the sightings that are no outliers, from their squared errors `(N,)`; False for NaN."""
    near = np.sqrt(error / 4.0) <= np.maximum(OUTLIER_PIXELS, OUTLIER_SHARE * sightings.sizes)
    return np.asarray((error / sightings.variance(floor) <= OUTLIER_CHI_SQUARE) | near)
