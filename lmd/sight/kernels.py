"""The fast exact path: landmarks covered at each position and axis, compiled with numba.

Every decision is the reference's, by the same float64 operations in the same order (no fast-math, so nothing is
re-associated or fused), hence the same bits. Speed comes from skipped work and from loops that vectorise, never
from approximation:

1. `viewpoint` drops landmarks that no axis covers: some 60 % in the paper's room.
2. Only axes in a band of heights around the landmark need the exact test (`directions.height_index`).
3. Where that test is long, sets of axes are bits, and tables of `directions` say which axes surely cover a landmark,
   and which may; the second need the test, but only where the first did not already make enough landmarks.
4. Probabilities are sums of integers (`PROBABILITY_ONE` per unit), exact in any order.

Kernels release the GIL and work on a range of positions, so threads can share a batch; the result does not depend
on how it is shared.
"""

import numpy as np

from lmd.core.bits import ALL, BITS, ONE, ZERO, lowest
from lmd.core.compiled import inlined, inner, kernel
from lmd.scene.criteria import covering, covers, frame_of, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.obstacles import is_clear, no_ends
from lmd.sight.viewpoint import gather_near, list_shown, look, take, viewpoint_for

# A probability of 1 in the integer units of the kernels: quantisation is far below TOLERANCE, and a sum of
# at most one fits a double exactly.
PROBABILITY_ONE = 1 << 52


@inlined
def weights_row(weights, p):
    """The row of `weights` `(1, D)` or `(P, D)` that holds for position p."""
    return np.uint64(p) if len(weights) > 1 else np.uint64(0)


@inner
def sum_weights(before, after, weights, p, w):
    """What the axes of word w weigh at position p that are in the set `after`, less those in `before`."""
    change, left, row = np.int64(0), before ^ after, weights_row(weights, p)
    while left:
        bit = lowest(left)
        weight = weights[row, w * np.uint64(BITS) + bit]
        change += weight if after >> bit & ONE else -weight
        left &= left - ONE
    return change


@kernel
def evaluate_range(
    first, last, order, positions, landmarks, normals, sight, horizon, obstacles, axes, bands, tables, weights, n,
    units, counts, keep,
):  # fmt: skip
    """Evaluate deployments at the positions `order[first:last]`.

    Args:
        order: `(P,)`, positions by blocks of neighbours.
        positions: `(P, 3)`.
        landmarks, normals: `(B, 3, K)`.
        horizon: its `criteria.horizon_of`.
        obstacles: what of the room stands in the way of the positions, see `obstacles`.
        axes: axis and right, `(6, D)`, sorted by height of the axis and filled up to D = 64 W.
        bands: their `directions.height_index`.
        tables: their `directions.tables` for models whose tests are long, None for others.
        weights: probability of each axis in integer units, `(1, D)` for all positions or `(P, D)` for each.
        n: landmarks that must be covered.
        units: `(B, P)` int64, receives P_n in integer units.
        counts: `(B, P, D)` int16 zeros, receives landmarks covered per axis if `keep` is set.
    """
    # Which half of this is compiled depends on the type of `tables`.
    size, poses, names = axes.shape[1], np.empty((6, landmarks.shape[2])), np.arange(landmarks.shape[2])
    clear, ends, view = is_clear(obstacles), no_ends(obstacles, len(names)), viewpoint_for(len(names))
    near, who, x, y, z, low, high, deep = (
        view.near, view.who, view.x, view.y, view.z, view.low, view.high, view.deep
    )  # fmt: skip
    bottom, top, shown, directions = view.bottom, view.top, view.shown, view.near[3:]
    row = np.empty(size, dtype=np.int16)
    words = np.uint64(size // BITS)
    some = np.empty((n, words), dtype=np.uint64)  # axes that cover at least 1, 2, ... n of the landmarks so far
    for b in range(landmarks.shape[0]):
        many = count = 0
        take(b, landmarks, normals, sight, obstacles, clear, poses, ends)
        for o in range(first, last):
            p = order[o]
            many, count = gather_near(o, first, last, order, positions, horizon, many, count, poses, names, view)
            look(view, count, positions[p, 0], positions[p, 1], positions[p, 2], sight, tables)
            found = list_shown(view, directions, count, p, sight, obstacles, clear, ends)
            total, row_of = np.int64(0), weights_row(weights, p)
            if tables is None:
                for a in range(size):
                    row[a] = 0
                for m in range(found):
                    k = shown[m]
                    xk, yk, zk, least = x[k], y[k], z[k], low[k]
                    nx, ny, nz, mine = near[3, k], near[4, k], near[5, k], sized(sight, who[k])
                    start, stop = bands[bottom[k]] & -BLOCK, (bands[top[k]] + BLOCK - 1) & -BLOCK
                    # Unsigned, so that the compiler sees indices that cannot be negative and vectorises the loop.
                    for a in range(np.uint64(start), np.uint64(stop)):
                        row[a] += covers(mine, xk, yk, zk, nx, ny, nz, least, 0.0, axes, a)
                for a in range(size):
                    total += weights[row_of, a] if row[a] >= n else 0
                if keep:
                    for a in range(size):
                        counts[b, p, a] = row[a]
            else:
                certain, possible = tables
                some[:] = ZERO
                for m in range(found):
                    given = np.uint64(bottom[shown[m]])
                    for i in range(words):
                        cap = certain[given, i]
                        for j in range(n - 1, 0, -1):
                            some[j, i] |= some[j - 1, i] & cap
                        some[0, i] |= cap
                for m in range(found):
                    k = shown[m]
                    xk, yk, zk, least, most, sure = x[k], y[k], z[k], low[k], high[k], deep[k]
                    mine = sized(sight, who[k])
                    frame = frame_of(mine, near[3, k], near[4, k], near[5, k])
                    given, cell = np.uint64(bottom[k]), np.uint64(top[k])
                    for i in range(words):
                        left, cap = possible[cell, i] & ~certain[given, i], ZERO
                        left &= ALL if keep else ~some[n - 1, i]
                        if left:
                            well = certain[cell, i]
                            cap = covering(mine, left, i, xk, yk, zk, frame, least, most, sure, well, axes)
                            for j in range(n - 1, 0, -1):
                                some[j, i] |= some[j - 1, i] & cap
                            some[0, i] |= cap
                        cap |= certain[given, i]
                        while keep and cap:
                            counts[b, p, i * np.uint64(BITS) + lowest(cap)] += 1
                            cap &= cap - ONE
                for i in range(words):
                    left = some[n - 1, i]
                    while left:
                        total += weights[row_of, i * np.uint64(BITS) + lowest(left)]
                        left &= left - ONE
            units[b, p] = total
