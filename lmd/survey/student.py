"""What residuals count for whose noise has Student's distribution: the further off, the less.

With d residuals of a sighting, in standard deviations, and chi^2 the sum of their squares.
"""

import numpy as np

from lmd.core.checks import FloatArray

DEGREES_OF_FREEDOM = 4.0  # nu
RESIDUALS = 8  # of a tag: two for each corner


def solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """The solutions `(n, m)` of n systems `(n, m, m)`."""
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0], dtype=np.float64)


def weight_of(square: FloatArray, residuals: int = RESIDUALS) -> FloatArray:
    """(nu + d) / (nu + chi^2) for d residuals."""
    return np.asarray((DEGREES_OF_FREEDOM + residuals) / (DEGREES_OF_FREEDOM + square))


def cost_of(square: FloatArray, residuals: int = RESIDUALS) -> float:
    """The sum of (nu + d) / 2 log(1 + chi^2 / nu) for d residuals."""
    return float((DEGREES_OF_FREEDOM + residuals) / 2.0 * np.log1p(square / DEGREES_OF_FREEDOM).sum())
