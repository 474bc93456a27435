"""Number of landmarks covered at each position and axis, compiled with numba; equal to the reference bit for bit.

Every decision repeats the float64 operations of the reference in their order. Without fast-math the compiler neither
reorders nor fuses operations. The speed comes from skipped work and from loops that vectorise; nothing is approximated:

1. `viewpoint` drops landmarks that no axis covers: about 60 % in the paper's room.
2. Only axes whose z component is close to the z component of the landmark's direction need the exact test
   (`directions.height_index`).
3. For a model with an expensive test, sets of axes are bit sets. The tables of `directions` list the axes that
   certainly cover a landmark and the axes that possibly cover it. Possible axes are tested only where the certain axes
   cover fewer than n landmarks.
4. Probabilities are sums of integers (`PROBABILITY_ONE`), exact in any order.

Kernels release the GIL and work on a range of positions, so threads can share a batch. The result does not depend on
the number of threads.
"""

from typing import Any, TypeAlias

import numpy as np

from lmd.core.bits import ALL, BITS, ONE, ZERO, Integer, WordArray, lowest
from lmd.core.compiled import inlined, inner, kernel
from lmd.geometry.vectors import pair3, row3
from lmd.scene.criteria import covering, covers, frame_of, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.obstacles import is_clear, new_ends
from lmd.sight.viewpoint import fill_viewpoint, gather_near, list_shown, load_deployment, viewpoint_for

Batch: TypeAlias = tuple[Any, ...]  # see `evaluator.Evaluator.batch`
# Quantised probability 1. The quantisation step is far below TOLERANCE, and a float64 represents every sum up to 1
# exactly.
PROBABILITY_ONE = 1 << 52


@inlined
def weights_row(weights: Any, p: Integer) -> Any:
    """Index of the row of `weights`, the probabilities of D axes, that holds for position p.

    All positions share the row 0 of `(1, D)` weights; position p has the row p of `(P, D)` weights.
    """
    return np.uint64(p) if len(weights) > 1 else np.uint64(0)


@inner
def sum_weights(before: Any, after: Any, weights: Any, p: Integer, w: Integer) -> Any:
    """Change of the quantised probability of a set of axes when word w (64 bits) of the bit set changes.

    `before` and `after` are the old and the new word. `weights` are the quantised probabilities of D axes, `(1, D)` for
    all positions or `(P, D)` for each of P positions; p is the index of the position.
    """
    change, left, row = np.int64(0), before ^ after, weights_row(weights, p)
    while left:
        bit = lowest(left)
        weight = weights[row, w * np.uint64(BITS) + bit]
        change += weight if after >> bit & ONE else -weight
        left &= left - ONE
    return change


@inlined
def count_set(at_least: WordArray, w: Integer, visible: Any) -> None:
    """Add one to the count of each orientation whose bit is set in `visible`, word w (64 bits) of a bit set.

    The counts are stored as bit sets, `at_least` `(n, W)`: set j has the orientations that were counted more than j
    times.
    """
    for j in range(len(at_least) - 1, 0, -1):
        at_least[j, w] |= at_least[j - 1, w] & visible
    at_least[0, w] |= visible


@kernel
def evaluate_range(
    first: Integer, last: Integer, batch: Batch, tables: Any, n: Integer, units: np.ndarray, counts: np.ndarray
) -> None:
    """Compute P_n and numbers of covered landmarks of B deployments at the positions `order[first:last]`.

    Args:
        first, last: range of indices of `order`.
        batch: tuple of the arguments listed next (`order` to `weights`, without `tables`), in this order.
        order: indices of the positions, sorted into blocks of neighbours, `(P,)`.
        positions: positions of the camera, `(P, 3)`, metres.
        landmarks, normals: positions, metres, and unit normals of B deployments, `(B, 3, K)`.
        sight: compiled model of sight.
        horizon: distance beyond which a landmark has no effect, metres.
        obstacles: obstacles of the room, prepared for the positions, see `crowd.obstacles_of`.
        axes: optical axis and direction to the right in the image, `(6, D)`, sorted by the z component of the optical
            axis and padded to D = 64 W.
        bands: result of `directions.height_index` for these axes.
        tables: result of `directions.tables` for a model with an expensive test, else None.
        weights: quantised probability of each axis, `(1, D)` for all positions or `(P, D)` for each.
        n: number of landmarks that must be covered.
        units: receives P_n, the quantised probability that at least n landmarks are covered, `(B, P)` int64.
        counts: receives the number of landmarks that each axis covers, `(B, P, D)` int16 zeros; empty to skip the
            counts.
    """
    order, positions, landmarks, normals, sight, horizon, obstacles, axes, bands, weights = batch
    # numba compiles one branch of `tables is None`, by the type of `tables`.
    size, poses, indices = axes.shape[1], np.empty((6, landmarks.shape[2])), np.arange(landmarks.shape[2])
    keep = len(counts) > 0
    clear, ends, view = is_clear(obstacles), new_ends(obstacles, len(indices)), viewpoint_for(len(indices))
    near, index, x, y, z, bottom, top = view.near_poses, view.near_index, view.x, view.y, view.z, view.bottom, view.top
    low, high, sure_depth, shown, room = view.low, view.high, view.sure_depth, view.shown, (obstacles, clear, ends)
    row = np.empty(size, dtype=np.int16)
    words = np.uint64(size // BITS)
    at_least = np.empty((n, words), dtype=np.uint64)  # [j]: axes that cover more than j landmarks
    for b in range(landmarks.shape[0]):
        many = count = 0
        load_deployment(b, landmarks, normals, sight, room, poses)
        for o in range(first, last):
            p = order[o]
            part = first, last, order, positions
            many, count = gather_near(o, part, horizon, many, count, poses, indices, view)
            fill_viewpoint(view, count, row3(positions, p), sight, tables)
            found = list_shown(view, count, p, sight, room)
            total, row_of = np.int64(0), weights_row(weights, p)
            if tables is None:
                for a in range(size):
                    row[a] = 0
                for m in range(found):
                    k = shown[m]
                    offset, (_, normal), mine = (x[k], y[k], z[k]), pair3(near, k), sized(sight, index[k])
                    least = low[k]
                    start, stop = bands[bottom[k]] & -BLOCK, (bands[top[k]] + BLOCK - 1) & -BLOCK
                    # Unsigned indices cannot be negative, so the compiler vectorises the loop.
                    for a in range(np.uint64(start), np.uint64(stop)):
                        row[a] += covers(mine, offset, normal, least, 0.0, axes, a)
                for a in range(size):
                    total += weights[row_of, a] if row[a] >= n else 0
                if keep:
                    for a in range(size):
                        counts[b, p, a] = row[a]
            else:
                certain, possible = tables
                at_least[:] = ZERO
                for m in range(found):
                    sure_row = np.uint64(bottom[shown[m]])
                    for i in range(words):
                        count_set(at_least, i, certain[sure_row, i])
                for m in range(found):
                    k = shown[m]
                    mine, offset, (_, normal) = sized(sight, index[k]), (x[k], y[k], z[k]), pair3(near, k)
                    frame, depths = frame_of(mine, normal), (low[k], high[k], sure_depth[k])
                    sure_row, cell = np.uint64(bottom[k]), np.uint64(top[k])
                    for i in range(words):
                        left, visible = possible[cell, i] & ~certain[sure_row, i], ZERO
                        left &= ALL if keep else ~at_least[n - 1, i]
                        if left:
                            well = certain[cell, i]
                            visible = covering(mine, left, i, offset, frame, depths, well, axes)
                            count_set(at_least, i, visible)
                        visible |= certain[sure_row, i]
                        while keep and visible:
                            counts[b, p, i * np.uint64(BITS) + lowest(visible)] += 1
                            visible &= visible - ONE
                for i in range(words):
                    left = at_least[n - 1, i]
                    while left:
                        total += weights[row_of, i * np.uint64(BITS) + lowest(left)]
                        left &= left - ONE
            units[b, p] = total
