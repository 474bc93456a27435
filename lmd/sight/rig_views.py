"""Results of `Evaluator` and of `poses` for a rig of cameras, from the sets of orientations of `rig_sets`.

Positions or poses are divided among the threads. The order of each sum does not depend on the number of threads.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, Integer, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.threads import in_parts
from lmd.sight.blocks import in_blocks
from lmd.sight.kernels import count_set, weights_row
from lmd.sight.mounts import MountGroup, with_sight
from lmd.sight.rig_sets import Blocking, covered_sets

# Greatest number of positions or poses that a thread evaluates at once; it limits the memory of the sets.
LARGEST_BATCH = 256


@kernel
def _sum_probability(seen: Any, weights: Any, n: Integer, units: Any, counts: Any) -> None:
    """Write P_n at P positions into `units` `(P,)`, and numbers of covered landmarks into `counts` `(P, 64 W)`.

    P_n is the quantised probability that at least n landmarks are covered. `counts` has the number for each position
    and orientation; if `counts` is empty, only `units` is written. `seen` `(P, K, W)` has bit sets, words of 64 bits,
    of the orientations at which each landmark is covered. `weights`, `(1, 64 W)` or `(P, 64 W)`, are the quantised
    probabilities of the orientations.
    """
    words, keep = np.uint64(seen.shape[2]), len(counts) > 0
    at_least = np.empty((n, words), dtype=np.uint64)  # [j]: orientations that cover more than j landmarks
    for p in range(len(seen)):
        at_least[:] = ZERO
        for k in range(seen.shape[1]):
            for w in range(words):
                visible = seen[p, k, w]
                if visible == ZERO:
                    continue
                count_set(at_least, w, visible)
                while keep and visible:
                    counts[p, w * np.uint64(BITS) + lowest(visible)] += 1
                    visible &= visible - ONE
        units[p], row = 0, weights_row(weights, p)
        for w in range(words):
            left = at_least[n - 1, w]
            while left:
                units[p] += weights[row, w * np.uint64(BITS) + lowest(left)]
                left &= left - ONE


@kernel
def _sum_gains(seen: Any, prices: FloatArray, out: Any) -> None:
    """For each of N poses, sum the prices of the positions and orientations from which a landmark there is covered.

    `seen` `(P, N, W)` has bit sets of these orientations for each position and pose. `prices` `(P, 64 W)` are the
    weights of positions and orientations. The sums are written into `out` `(N,)`.
    """
    row = np.empty(prices.shape[1])
    for j in range(len(out)):
        row[:] = 0.0
        for p in range(len(seen)):
            for w in range(np.uint64(seen.shape[2])):
                left = seen[p, j, w]
                while left:
                    a = w * np.uint64(BITS) + lowest(left)
                    row[a] += prices[p, a]
                    left &= left - ONE
        out[j] = 0.0
        for d in range(len(row)):
            out[j] += row[d]


@kernel
def _sum_amounts(seen: Any, amounts: FloatArray, out: Any) -> None:
    """For each position and orientation, add up the amounts of the poses at which a landmark would be covered.

    `amounts` `(N,)` are numbers of landmarks at the poses, possibly fractions. The sums are added to `out`
    `(P, 64 W)`. `seen` `(P, N, W)` has bit sets of the orientations from which each of the N poses is covered.
    """
    for p in range(len(seen)):
        for j in range(len(amounts)):
            for w in range(np.uint64(seen.shape[2])):
                left = seen[p, j, w]
                while left:
                    out[p, w * np.uint64(BITS) + lowest(left)] += amounts[j]
                    left &= left - ONE


class RigViews:
    """Coverage by a rig from P positions of its body.

    Args:
        groups: mounts of the rig, for D orientations.
        blockers: bodies of the room that block lines of sight; None without such bodies.
        positions: positions of the body, `(P, 3)`, metres.
        threads: number of threads.
    """

    def __init__(self, groups: tuple[MountGroup, ...], blockers: Blocking, positions: FloatArray, threads: int) -> None:
        self.groups, self.blockers, self.positions, self.threads = groups, blockers, positions, threads
        self._order = in_blocks(positions)[0][: len(positions)]

    @property
    def _single(self) -> tuple[MountGroup, ...]:
        """Mount groups whose models of sight ignore occlusion by other landmarks."""
        return tuple(with_sight(group, group.sight.unhidden()) for group in self.groups)

    def groups_among(self, landmarks: FloatArray, normals: FloatArray) -> tuple[MountGroup, ...]:
        """Mount groups that are prepared for the landmarks of one deployment.

        If no landmark can hide another, the models of sight of the groups ignore such occlusion, see
        `SightModel.among`. `landmarks` and `normals` `(K, 3)` are positions, metres, and unit normals.
        """
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        batch = landmarks.T[None], normals.T[None]
        return tuple(
            with_sight(
                group, group.sight.among(low + group.places.min(axis=0), high + group.places.max(axis=0), *batch)
            )
            for group in self.groups
        )

    def _shared(self, size: int, job: Callable[[slice], None]) -> None:
        in_parts(self.threads, lambda first, last: job(slice(first, last)), size, math.ceil(size / LARGEST_BATCH))

    def evaluate(
        self, landmarks: FloatArray, normals: FloatArray, weights: np.ndarray, n: int, counts: np.ndarray
    ) -> np.ndarray:
        """Probability P_n that at least n landmarks of a deployment are covered, for each of P positions, `(P,)`.

        P_n is quantised: integers in units of 1 / `PROBABILITY_ONE`.

        Args:
            landmarks, normals: positions, metres, and unit normals, `(K, 3)`.
            weights: quantised probability of each orientation, padded to 64 W columns, `(1, 64 W)` or `(P, 64 W)`.
            n: number of landmarks that must be covered.
            counts: receives the number of landmarks that each orientation covers, `(P, 64 W)` zeros; empty to skip the
                counts.
        """
        units, slack = np.empty(len(self.positions), dtype=np.int64), np.zeros(len(landmarks))
        groups = self.groups_among(landmarks, normals)
        ordered, enough = self.positions[self._order], 0 if len(counts) else n

        def job(part: slice) -> None:
            here = self._order[part]
            found_counts = np.zeros((len(here) if len(counts) else 0, counts.shape[1]), dtype=np.int16)
            seen = covered_sets(groups, self.blockers, ordered[part], (landmarks, normals, slack), enough)
            found = np.empty(len(here), dtype=np.int64)
            _sum_probability(seen, weights[here] if len(weights) > 1 else weights, n, found, found_counts)
            units[here] = found
            if len(counts):
                counts[here] = found_counts

        self._shared(len(units), job)
        return units

    def gains(self, landmarks: FloatArray, normals: FloatArray, prices: FloatArray, slack: FloatArray) -> FloatArray:
        """For each of N poses, sum of the prices (weights) of the views that cover a landmark there, see `poses.gains`.

        A view is a position of the rig and an orientation; `prices` is `(P, 64 W)`. The result is `(N,)`.

        `landmarks` and `normals` `(N, 3)` are positions and unit normals of the poses.
        """
        out, single = np.empty(len(landmarks)), self._single

        def job(part: slice) -> None:
            poses = landmarks[part], normals[part], slack[part]
            _sum_gains(covered_sets(single, self.blockers, self.positions, poses), prices, out[part])

        self._shared(len(landmarks), job)
        return out

    def covered_amounts(self, landmarks: FloatArray, normals: FloatArray, amounts: FloatArray) -> FloatArray:
        """See `poses.covered_amounts`."""
        used = amounts != 0.0
        landmarks, normals, amounts, single = landmarks[used], normals[used], amounts[used], self._single
        out = np.zeros((len(self.positions), self.groups[0].axes.shape[2]))

        def job(part: slice) -> None:
            poses = landmarks, normals, np.zeros(len(landmarks))
            _sum_amounts(covered_sets(single, self.blockers, self.positions[part], poses), amounts, out[part])

        self._shared(len(out), job)
        return out
