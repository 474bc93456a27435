"""What deployments are worth at most: a concave function F of how many landmarks cover an axis, and its multipliers.

The symbols and the derivation are those of `lmd.evaluation.bounds`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator, averaged
from lmd.sight.poses import covered_amounts


class Dual(NamedTuple):
    """A choice of multipliers: its constant, and the prices y, `(P, D)`."""

    constant: float
    prices: FloatArray

    def bound(self, count: int, gain: float) -> float:
        """The bound for `count` free landmarks if none earns more than `gain`; 1 is always one."""
        return min(self.constant + count * gain, 1.0)


@dataclass(frozen=True)
class Relaxation:
    """F for one objective.

    Args:
        evaluator: the scene.
        shares: r, `(P,)`.
        n: landmarks that must be seen.
        threshold: t, in (0, 1].
        fixed: landmarks that hang already.
    """

    evaluator: Evaluator
    shares: FloatArray
    n: int
    threshold: float
    fixed: Deployment | None = None

    @property
    def weights(self) -> FloatArray:
        """w, `(1, D)` or `(P, D)`."""
        return self.evaluator.probability

    @cached_property
    def already(self) -> FloatArray | float:
        """b, `(P, D)`; 0 where nothing is fixed."""
        return 0.0 if self.fixed is None else covered_amounts(self.evaluator, self.fixed, np.ones(len(self.fixed)))

    def value(self, added: FloatArray) -> float:
        """F at c - b `(P, D)`."""
        seen = averaged(np.minimum((added + self.already) / self.n, 1.0), self.weights)
        return float(self.shares @ np.minimum(seen / self.threshold, 1.0))

    def smoothed(self, added: FloatArray, width: float) -> tuple[float, Dual]:
        """Smoothed F at c - b `(P, D)`, and its slopes as multipliers; the prices are its gradient in c."""
        by_axis, slope = smoothed_min((added + self.already) / self.n, width)
        by_position, z = smoothed_min(averaged(by_axis, self.weights) / self.threshold, width)
        prices = slope * self.weights * (z * self.shares / (self.n * self.threshold))[:, None]
        constant = self.shares @ (1.0 - z + z / self.threshold) - self.n * prices.sum()
        constant += (self.already * prices).sum()
        return float(self.shares @ by_position), Dual(float(constant), prices)


def smoothed_min(v: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """min(v, 1) with its kink rounded off within `width`, and its slope in [0, 1]; `v` has any shape."""
    slope = np.clip((1.0 + width - v) / (2.0 * width), 0.0, 1.0)
    # The integral of the slope: 1 on the right of the kink, v on the left.
    return np.where(slope < 1.0, 1.0 - width * slope**2, v), slope


def nearest_on_simplex(v: FloatArray, total: float) -> FloatArray:
    """The point nearest to `v` `(N,)` among those that are not negative and sum to `total`."""
    descending = np.sort(v)[::-1]
    excess = (np.cumsum(descending) - total) / np.arange(1, len(v) + 1)
    return np.asarray(np.maximum(v - excess[np.flatnonzero(descending > excess)[-1]], 0.0))
