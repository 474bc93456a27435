"""Concave relaxation F of an objective, and Lagrange multipliers that give an upper bound on F.

Another bound is on the largest gain of a landmark on the walls, that is, on its contribution to the first bound.

An interrupted search still gives a valid bound. `lmd.evaluation.bounds` defines the symbols and derives the bound.
"""

import heapq
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise
from math import inf
from time import monotonic
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import clock
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator, averaged
from lmd.sight.poses import Cells, covered_amounts, gains

BETWEEN = 10.0  # least time between two texts on the progress, seconds


class TimeLimit:
    """Time limit that starts when the object is made; the time of compilation does not count.

    Args:
        seconds: limit, seconds; infinite for no limit, with which results are reproducible.
        print_text: function that is called with texts on the progress, at most every `BETWEEN` seconds.
    """

    def __init__(self, seconds: float = inf, print_text: Callable[[str], None] = lambda _: None) -> None:
        self.seconds, self._print_text, self._until, self._told = seconds, print_text, clock() + seconds, monotonic()
        self.cut: list[str] = []
        """Descriptions of the searches that the time limit has cut short."""

    @property
    def left(self) -> float:
        """Time that remains before the limit, seconds; not negative."""
        return max(self._until - clock(), 0.0)

    def part(self, share: float) -> "TimeLimit":
        """Make a time limit for a part of the work: it ends after the fraction `share` of the time that remains."""
        return TimeLimit(share * self.left, self.report)

    def report(self, text: str) -> None:
        """Pass on a text on the progress unless another one was passed on shortly before."""
        if monotonic() - self._told >= BETWEEN:
            self._told = monotonic()
            self._print_text(text)

    def leaves(self, seconds: float, what: str) -> bool:
        """True if at least `seconds` remain; otherwise record that the search described by `what` was cut short."""
        if seconds <= self.left:
            return True
        self.cut.append(what)
        return False


# First and last half-width of the smoothing of min(v, 1), and number of steps after which the width is halved.
FIRST_WIDTH, LAST_WIDTH, STEPS_PER_WIDTH = 0.3, 0.01, 25
# Greatest number of cells that branch and bound scans, which takes a minute or two on two cores; the bound stays valid.
MOST_CELLS = 2_000_000
BATCH = 10_000  # greatest number of cells that are divided at a time
PROBES = 500  # number of new cells, with the highest bounds, at whose centres a landmark is evaluated
BATCH_SHARE = 0.05  # share of the remaining time for each batch


class Dual(NamedTuple):
    """Lagrange multipliers for an upper bound on the relaxation F; any choice of multipliers gives a valid bound."""

    constant: float
    """Part of the bound that does not depend on the number of free landmarks, constant(z, y) in
    `lmd.evaluation.bounds`.
    """
    prices: FloatArray
    """Multipliers y, `(P, D)` for P positions and D axes."""

    def bound(self, count: int, gain: float) -> float:
        """Upper bound on the fitness with `count` landmarks to be chosen besides fixed ones; at most 1.

        `gain` is an upper bound on the gain of a landmark, its contribution to the bound.
        """
        return min(self.constant + count * gain, 1.0)


@dataclass(frozen=True)
class Relaxation:
    """Concave relaxation F of one objective, an upper bound on its fitness that `lmd.evaluation.bounds` derives."""

    evaluator: Evaluator
    """Evaluator of the scene at P positions."""
    shares: FloatArray
    """Share r of each position in the fitness, `(P,)`, sum 1."""
    n: int
    """Number of landmarks that must be covered."""
    threshold: float
    """Threshold t of P_n, in (0, 1]; 1 for the average of P_n."""
    fixed: Deployment | None = None
    """Fixed landmarks."""

    @property
    def weights(self) -> FloatArray:
        """Probability w of each camera orientation (axis), `(1, D)`; `(P, D)` if it depends on the position."""
        return self.evaluator.probability

    @cached_property
    def fixed_coverage(self) -> FloatArray | float:
        """Number b of fixed landmarks that are covered at each position and camera orientation (axis), `(P, D)`."""
        return 0.0 if self.fixed is None else covered_amounts(self.evaluator, self.fixed, np.ones(len(self.fixed)))

    def value(self, added: FloatArray) -> float:
        """Value of F for given numbers of covered free landmarks.

        `added` = c - b is the number at each position and camera orientation (axis), `(P, D)`.
        """
        seen = averaged(np.minimum((added + self.fixed_coverage) / self.n, 1.0), self.weights)
        return float(self.shares @ np.minimum(seen / self.threshold, 1.0))

    def smoothed(self, added: FloatArray, width: float) -> tuple[float, Dual]:
        """Value of F with a smoothed min(v, 1), and Lagrange multipliers, which are the slopes of the smoothed min.

        The `prices` of the multipliers are the gradient of the smoothed F with respect to the numbers c of covered
        landmarks. `added` `(P, D)` has the numbers of free landmarks that are covered at each position and axis;
        `width` is the half-width of the smoothing, see `smoothed_min`.
        """
        by_axis, slope = smoothed_min((added + self.fixed_coverage) / self.n, width)
        by_position, z = smoothed_min(averaged(by_axis, self.weights) / self.threshold, width)
        prices = slope * self.weights * (z * self.shares / (self.n * self.threshold))[:, None]
        constant = self.shares @ (1.0 - z + z / self.threshold) - self.n * prices.sum()
        constant += (self.fixed_coverage * prices).sum()
        return float(self.shares @ by_position), Dual(float(constant), prices)


def smoothed_min(v: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Smoothed min(v, 1), and its slope, from 0 to 1. The smoothed value differs from min(v, 1) only if v is within
    `width` of 1. `v` has any shape.
    """
    slope = np.clip((1.0 + width - v) / (2.0 * width), 0.0, 1.0)
    # This is the integral of the slope: 1 to the right of the kink, v to the left.
    return np.where(slope < 1.0, 1.0 - width * slope**2, v), slope


def nearest_on_simplex(v: FloatArray, total: float) -> FloatArray:
    """Point nearest to `v` `(N,)` among all points whose entries are not negative and have the sum `total`."""
    descending = np.sort(v)[::-1]
    excess = (np.cumsum(descending) - total) / np.arange(1, len(v) + 1)
    return np.asarray(np.maximum(v - excess[np.flatnonzero(descending > excess)[-1]], 0.0))


def solve(
    relaxation: Relaxation, kinds: Sequence[tuple[Deployment, int]], iterations: int, tolerance: float, limit: TimeLimit
) -> tuple[Dual, float, float]:
    """Find the Lagrange multipliers of a low upper bound on F by accelerated projected ascent of F.

    Args:
        relaxation: relaxation F.
        kinds: for each size of landmarks, the poses that landmarks of this size may take, and the number of these
            landmarks.
        iterations: largest number of steps.
        tolerance: the search stops when the bound exceeds the largest value of F found by at most this number.
        limit: time limit.

    Returns:
        best multipliers found; the bound that they give for all choices of the poses; largest value of F found.
    """
    evaluator, poses = relaxation.evaluator, reduce(operator.add, (own for own, _ in kinds))
    ends = np.cumsum([0, *(len(own) for own, _ in kinds)]).tolist()
    parts = [(slice(*at), number) for at, (_, number) in zip(pairwise(ends), kinds, strict=True)]
    x = ahead = np.concatenate([np.full(len(own), number / len(own)) for own, number in kinds])
    began = clock()
    covered = covered_ahead = covered_amounts(evaluator, poses, x)
    scan = clock() - began  # time for all poses
    fractional, momentum, curvature = relaxation.value(covered), 1.0, 0.0
    best, grid = Dual(1.0, np.zeros_like(covered)), 1.0
    for step in range(iterations):
        so_far = f"after {step} of {iterations} steps"
        limit.report(
            f"{so_far}: <= {grid:.2%} on the grid of poses, where fractions of landmarks reach {fractional:.2%}"
        )
        if not limit.leaves(scan, f"the multipliers {so_far}"):
            break
        width = max(FIRST_WIDTH * 0.5 ** (step // STEPS_PER_WIDTH), LAST_WIDTH)
        value, dual = relaxation.smoothed(covered_ahead, width)
        gradient = gains(evaluator, poses, dual.prices)
        earned = sum(count * float(gradient[part].max()) for part, count in parts)
        if (bound := dual.bound(1, earned)) < grid:
            best, grid = dual, bound
        if grid - fractional <= tolerance:
            break
        curvature = 0.9 * curvature or 0.01 * gradient.max() / x.max()
        while limit.leaves(scan, f"the multipliers {so_far}"):
            up = ahead + gradient / curvature
            new = np.concatenate([nearest_on_simplex(up[part], count) for part, count in parts])
            covered_new, moved = covered_amounts(evaluator, poses, new), new - ahead
            model = value + gradient @ moved - curvature / 2.0 * moved @ moved
            if relaxation.smoothed(covered_new, width)[0] >= model - TOLERANCE:
                break
            curvature *= 2.0
        else:
            break
        fractional = max(fractional, relaxation.value(covered_new))
        # The momentum is reset if it leads downhill or belongs to another width.
        if gradient @ (new - x) < 0.0 or step % STEPS_PER_WIDTH == STEPS_PER_WIDTH - 1:
            momentum = 1.0
        before, momentum = momentum, (1.0 + math.sqrt(1.0 + 4.0 * momentum**2)) / 2.0
        carry = (before - 1.0) / momentum
        ahead, covered_ahead = new + carry * (new - x), covered_new + carry * (covered_new - covered)
        x, covered = new, covered_new
    return best, grid, fractional


def largest_gain(
    evaluator: Evaluator, cells: Cells, prices: FloatArray, tolerance: float, limit: TimeLimit | None = None
) -> float:
    """Upper bound on the gain of a flush landmark anywhere in the given cells of the walls, by branch and bound.

    The gain of a landmark is its contribution to an upper bound on the fitness. The contribution is the sum of the
    Lagrange multipliers y over the positions and axes at which the landmark is covered.

    Args:
        evaluator: scene with landmarks of one size.
        cells: pieces of wall.
        prices: multipliers y, `(P, D)`, not negative.
        tolerance: the search stops when its result exceeds the largest gain found by at most this number.
        limit: time limit; None for no limit.
    """
    limit, began = limit or TimeLimit(), clock()
    largest, looked_at = 0.0, 0
    # The heap is sorted by bound, so its first entry bounds all remaining cells whenever the search stops.
    heap: list[tuple[float, int, Cells]] = []
    while True:
        most = gains(evaluator, cells.poses, prices, cells.radius)
        looked_at += len(most)
        order = np.argsort(-most)
        largest = max(largest, float(gains(evaluator, cells.picked(order[:PROBES]).poses, prices).max()))
        order = order[most[order] > largest + tolerance]
        each = (clock() - began) / looked_at
        batch = BATCH if limit.left == math.inf else int(np.clip(BATCH_SHARE * limit.left / each / 4, 1, BATCH))
        for first in range(0, len(order), batch):
            part = order[first : first + batch]
            heapq.heappush(heap, (-float(most[part[0]]), looked_at + first, cells.picked(part)))
        if not heap or -heap[0][0] <= largest + tolerance:
            return largest + tolerance
        so_far = f"the walls after {looked_at} cells"
        if looked_at > MOST_CELLS:
            limit.cut.append(so_far)
            return -heap[0][0]
        limit.report(f"{looked_at} cells of the walls: a landmark earns {largest:.4g} to {-heap[0][0]:.4g}")
        if not limit.leaves(4 * each * len(heap[0][2].poses), so_far):
            return -heap[0][0]
        cells = heapq.heappop(heap)[2].quarters()
