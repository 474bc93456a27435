"""What a rig covers from many positions, summed up: counts, probabilities, and what single poses earn.

The bits come from `rig_sets`; threads share positions, or poses. Every sum is over the same terms in the same
order whatever their number.
"""

import math
from collections.abc import Callable

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.threads import in_parts
from lmd.sight.blocks import in_blocks
from lmd.sight.kernels import weights_row
from lmd.sight.mounts import Part, with_sight
from lmd.sight.rig_sets import seen_by
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles

# Positions, or poses, that a thread works on at a time at most: what they see in all orientations is kept for so long.
AT_A_TIME = 256


@kernel
def _count(seen, weights, n, units, counts):
    """P_n in integer units `(P,)` from sets `(P, K, W)`, and in `counts` `(P, 64 W)`, unless empty, the landmarks."""
    words, keep = np.uint64(seen.shape[2]), len(counts) > 0
    some = np.empty((n, words), dtype=np.uint64)  # orientations that cover at least 1, 2, ... n of the landmarks so far
    for p in range(len(seen)):
        some[:] = ZERO
        for k in range(seen.shape[1]):
            for w in range(words):
                cap = seen[p, k, w]
                if cap == ZERO:
                    continue
                for j in range(n - 1, 0, -1):
                    some[j, w] |= some[j - 1, w] & cap
                some[0, w] |= cap
                while keep and cap:
                    counts[p, w * np.uint64(BITS) + lowest(cap)] += 1
                    cap &= cap - ONE
        units[p], row = 0, weights_row(weights, p)
        for w in range(words):
            left = some[n - 1, w]
            while left:
                units[p] += weights[row, w * np.uint64(BITS) + lowest(left)]
                left &= left - ONE


@kernel
def _earn(seen, prices, out):
    """The sum of the `prices` `(P, 64 W)` of what each of N poses covers, sets `(P, N, W)`, to `out` `(N,)`."""
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
        for a in range(len(row)):
            out[j] += row[a]


@kernel
def _add_up(seen, amounts, out):
    """Add to `out` `(P, 64 W)` the `amounts` `(N,)` of the poses that cover, sets `(P, N, W)`."""
    for p in range(len(seen)):
        for j in range(len(amounts)):
            for w in range(np.uint64(seen.shape[2])):
                left = seen[p, j, w]
                while left:
                    out[p, w * np.uint64(BITS) + lowest(left)] += amounts[j]
                    left &= left - ONE


class RigViews:
    """The views of a rig from P positions of its body.

    Args:
        parts: the rig, for D orientations.
        blockers: what in the room blocks lines of sight.
        positions: `(P, 3)`, metres.
        threads: that share the work.
    """

    def __init__(
        self, parts: tuple[Part, ...], blockers: Blockers | Triangles | None, positions: FloatArray, threads: int
    ) -> None:
        self.parts, self.blockers, self.positions, self.threads = parts, blockers, positions, threads
        self._order = in_blocks(positions)[0][: len(positions)]

    @property
    def _single(self) -> tuple[Part, ...]:
        """The rig where no landmark hides another."""
        return tuple(with_sight(part, part.sight.unhidden()) for part in self.parts)

    def parts_among(self, landmarks: FloatArray, normals: FloatArray) -> tuple[Part, ...]:
        """The rig with what its criteria make of the landmarks of a deployment, `(K, 3)`: see `Sight.among`."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        batch = landmarks.T[None], normals.T[None]
        return tuple(
            with_sight(part, part.sight.among(low + part.places.min(axis=0), high + part.places.max(axis=0), *batch))
            for part in self.parts
        )

    def _shared(self, size: int, job: Callable[[slice], None]) -> None:
        in_parts(self.threads, lambda first, last: job(slice(first, last)), size, math.ceil(size / AT_A_TIME))

    def evaluate(
        self, landmarks: FloatArray, normals: FloatArray, weights: np.ndarray, n: int, counts: np.ndarray
    ) -> np.ndarray:
        """P_n in integer units of one deployment, `(P,)`.

        Args:
            landmarks, normals: `(K, 3)`.
            weights: of the orientations in integer units, `(1, 64 W)` or `(P, 64 W)`.
            n: landmarks that must be covered.
            counts: `(P, 64 W)` zeros, receives the landmarks covered; empty if nobody asks.
        """
        units, slack = np.empty(len(self.positions), dtype=np.int64), np.zeros(len(landmarks))
        parts = self.parts_among(landmarks, normals)
        ordered, enough = self.positions[self._order], 0 if len(counts) else n

        def job(part: slice) -> None:
            here = self._order[part]
            some = np.zeros((len(here) if len(counts) else 0, counts.shape[1]), dtype=np.int16)
            seen = seen_by(parts, self.blockers, ordered[part], landmarks, normals, slack, enough)
            found = np.empty(len(here), dtype=np.int64)
            _count(seen, weights[here] if len(weights) > 1 else weights, n, found, some)
            units[here] = found
            if len(counts):
                counts[here] = some

        self._shared(len(units), job)
        return units

    def gains(self, landmarks: FloatArray, normals: FloatArray, prices: FloatArray, slack: FloatArray) -> FloatArray:
        """See `poses.gains`: of N poses with `landmarks` and `normals` `(N, 3)`."""
        out, single = np.empty(len(landmarks)), self._single

        def job(part: slice) -> None:
            poses = landmarks[part], normals[part], slack[part]
            _earn(seen_by(single, self.blockers, self.positions, *poses), prices, out[part])

        self._shared(len(landmarks), job)
        return out

    def covered_amounts(self, landmarks: FloatArray, normals: FloatArray, amounts: FloatArray) -> FloatArray:
        """See `poses.covered_amounts`."""
        used = amounts != 0.0
        landmarks, normals, amounts, single = landmarks[used], normals[used], amounts[used], self._single
        out = np.zeros((len(self.positions), self.parts[0].axes.shape[2]))

        def job(part: slice) -> None:
            poses = landmarks, normals, np.zeros(len(landmarks))
            _add_up(seen_by(single, self.blockers, self.positions[part], *poses), amounts, out[part])

        self._shared(len(out), job)
        return out
