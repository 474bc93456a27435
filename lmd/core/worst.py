"""The worst of several values: their number, as a share of all, and their mean."""

import math

import numpy as np

from lmd.core.checks import FloatArray

ROUNDING = 1e-9  # of a share times a number, which is rounded up


def worst_of(number: int, share: float) -> int:
    """Number of the worst of `number` values, a share of them, rounded up."""
    return max(1, math.ceil(share * number - ROUNDING))


def worst_mean(values: FloatArray, count: int) -> FloatArray:
    """Mean of the `count` least values along the last axis."""
    return np.asarray(np.sort(values, axis=-1)[..., :count].sum(axis=-1) / count)
