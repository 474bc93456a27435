"""The fast exact path: landmarks covered at each position and axis, compiled with numba.

Every decision is the reference's, by the same float64 operations in the same order (no fast-math, so nothing is
re-associated or fused), hence the same bits. Speed comes from skipped work and from loops that vectorise, never
from approximation:

1. For each block of positions, landmarks beyond the horizon of all of them are dropped, for many blocks at once first,
   and per position those that are too near, too far or face away: some 60 % in the paper's room.
2. Only those left are tested for being blocked by the room, where there is something in it, and then for being hidden
   by the others, without a branch in the inner loop.
3. Only axes in a band of heights around the landmark need the exact test (`bands`).
4. Where that test is long, sets of axes are bits, and tables of `directions` say which axes surely cover a landmark,
   and which may; the second need the test, but only where the first did not already make enough landmarks.
5. Probabilities are sums of integers (`PROBABILITY_ONE` per unit), exact in any order.

Kernels release the GIL and work on a range of positions, so threads can share a batch; the result does not depend
on how it is shared.
"""

import math

import numpy as np

from lmd.core.bits import ALL, BITS, ONE, ZERO, lowest
from lmd.core.compiled import inlined, inner, kernel
from lmd.scene.criteria import covering, covers, frame_of, from_position, hide
from lmd.sight.bands import band_of
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import NOWHERE, cell_of
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends

# A probability of 1 in the integer units of the kernels: quantisation is far below TOLERANCE, and a sum of
# at most one fits a double exactly.
PROBABILITY_ONE = 1 << 52
REGION = 16 * BLOCK  # positions: what is far from all of these is not looked at for each block


@inlined
def weights_row(weights, p):
    """The row of `weights` `(1, D)` or `(P, D)` that holds for position p."""
    return np.uint64(p) if len(weights) > 1 else np.uint64(0)


@inner
def box_around(positions, among):
    """The lowest and the highest corner of a box around those of the `positions` `(P, 3)`, three numbers each."""
    low = high = positions[among[0], 0], positions[among[0], 1], positions[among[0], 2]
    for p in among[1:]:
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        low = min(low[0], x), min(low[1], y), min(low[2], z)
        high = max(high[0], x), max(high[1], y), max(high[2], z)
    return low, high


@inner
def gather(low, high, horizon, count, poses, names, near, who):
    """Write position and normal of the landmarks at most `horizon` metres from a box into `near` `(6, K)`.

    Which they are goes into `who` `(K,)`.

    Args:
        low, high: corners of the box, three numbers each.
        horizon: see `criteria.horizon_of`.
        count: so many landmarks are looked at.
        poses: their positions and normals, `(6, K)`.
        names: which they are, `(K,)`.

    Returns:
        how many there are.
    """
    most, found = horizon * horizon, 0
    for k in range(count):
        x, y, z = poses[0, k], poses[1, k], poses[2, k]
        dx, dy = max(low[0] - x, x - high[0], 0.0), max(low[1] - y, y - high[1], 0.0)
        dz = max(low[2] - z, z - high[2], 0.0)
        near[0, found], near[1, found], near[2, found] = x, y, z
        near[3, found], near[4, found], near[5, found] = poses[3, k], poses[4, k], poses[5, k]
        who[found] = names[k]
        found += dx * dx + dy * dy + dz * dz <= most
    return found


@inner
def is_hidden(k, count, x, y, z, squared, normals, sight):
    """Whether one of the first `count` landmarks hides landmark k.

    Offsets `x, y, z` and their `squared` lengths `(K,)`, `normals` `(3, K)`.
    """
    xk, yk, zk, sk, hiding = x[k], y[k], z[k], squared[k], 0
    nx, ny, nz = normals[0, k], normals[1, k], normals[2, k]
    for j in range(count):
        ux, uy, uz = normals[0, j], normals[1, j], normals[2, j]
        hides, _ = hide(sight, x[j], y[j], z[j], squared[j], xk, yk, zk, sk, ux, uy, uz, nx, ny, nz)
        hiding += hides & (j != k)
    return hiding > 0


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
        sight: the compiled model of sight.
        horizon: its `criteria.horizon_of`.
        obstacles: what of the room stands in the way of the positions, see `obstacles`.
        axes: axis and right, `(6, D)`, sorted by height of the axis and filled up to D = 64 W.
        bands: their `bands.height_index`.
        tables: their `directions.tables` for models whose tests are long, None for others.
        weights: probability of each axis in integer units, `(1, D)` for all positions or `(P, D)` for each.
        n: landmarks that must be covered.
        units: `(B, P)` int64, receives P_n in integer units.
        counts: `(B, P, D)` int16 zeros, receives landmarks covered per axis if `keep` is set.
    """
    # One long body but for the rare `is_hidden`: handing arrays on to a function costs atomic reference counts, as
    # much as the work itself. Which half of it is compiled depends on the type of `tables`.
    count, size, reach = landmarks.shape[2], axes.shape[1], sight.reach
    poses, names = np.empty((6, count)), np.arange(count)
    clear, ends = is_clear(obstacles), no_ends(obstacles, count)
    # Landmarks near a region of blocks, and near a block in it.
    around, region = np.empty((6, count)), np.empty(count, dtype=np.int64)
    near, who = np.empty((6, count)), np.empty(count, dtype=np.int64)
    directions = near[3:]
    x, y, z, squared = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    low, high, deep = np.empty(count), np.empty(count), np.empty(count)
    bottom, top = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    reached, shown = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.uint64)
    # Directions in single precision, filled up to whole vectors with landmarks that no direction comes close to.
    padded = (count + BLOCK - 1) & -BLOCK
    u, v, w = np.zeros(padded, np.float32), np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    close = np.full(padded, 2.0, np.float32)
    row = np.empty(size, dtype=np.int16)
    words = np.uint64(size // BITS)
    some = np.empty((n, words), dtype=np.uint64)  # axes that cover at least 1, 2, ... n of the landmarks so far
    for b in range(landmarks.shape[0]):
        for k in range(landmarks.shape[2]):
            mx, my, mz = landmarks[b, 0, k], landmarks[b, 1, k], landmarks[b, 2, k]
            for i in range(3):
                poses[i, k], poses[3 + i, k] = landmarks[b, i, k], normals[b, i, k]
            if not clear:
                find_ends(obstacles, sight, mx, my, mz, normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], ends, k)
        for o in range(first, last):
            p = order[o]
            if o == first or o % REGION == 0:
                low_corner, high_corner = box_around(positions, order[o : min(o - o % REGION + REGION, last)])
                many = gather(low_corner, high_corner, horizon, len(names), poses, names, around, region)
            if o == first or o % BLOCK == 0:
                low_corner, high_corner = box_around(positions, order[o : min(o - o % BLOCK + BLOCK, last)])
                count = gather(low_corner, high_corner, horizon, many, around, region, near, who)
                padded = (count + BLOCK - 1) & -BLOCK
                close[count:padded] = 2.0
            px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
            for k in range(count):
                # Kept in variables: to read back what was just written would keep the loop from vectorising.
                xk, yk, zk = near[0, k] - px, near[1, k] - py, near[2, k] - pz
                nx, ny, nz = near[3, k], near[4, k], near[5, k]
                in_reach, least, most, sure = from_position(sight, xk, yk, zk, nx, ny, nz, 0.0)
                if tables is None:
                    bottom[k], top[k] = band_of(xk, yk, zk, least, 0.0)
                else:
                    cell = cell_of(xk, yk, zk)
                    bottom[k], top[k] = NOWHERE if sure < math.inf else cell, cell
                x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
                reached[k], low[k], high[k], deep[k] = in_reach, least, most, sure
            if reach >= 0.0:
                for k in range(count):
                    here = squared[k] == 0.0  # such a landmark hides all others
                    scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
                    u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
                    close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - reach / squared[k]
            found = ZERO
            for k in range(count):
                if not reached[k] or (not clear and is_blocked(obstacles, sight, p, ends, who[k])):
                    continue
                if reach >= 0.0:
                    uk, vk, wk, suspects = u[k], v[k], w[k], np.int32(0)
                    for j in range(np.uint64(padded)):
                        cosine = u[j] * uk + v[j] * vk + w[j] * wk
                        suspects += np.int32(cosine * cosine >= close[j])
                    # The landmark itself is always one of the suspects.
                    if suspects > 1 and is_hidden(k, count, x, y, z, squared, directions, sight):
                        continue
                shown[found] = k
                found += ONE
            total, row_of = np.int64(0), weights_row(weights, p)
            if tables is None:
                for a in range(size):
                    row[a] = 0
                for m in range(found):
                    k = shown[m]
                    xk, yk, zk, least = x[k], y[k], z[k], low[k]
                    nx, ny, nz = near[3, k], near[4, k], near[5, k]
                    start, stop = bands[bottom[k]] & -BLOCK, (bands[top[k]] + BLOCK - 1) & -BLOCK
                    # Unsigned, so that the compiler sees indices that cannot be negative and vectorises the loop.
                    for a in range(np.uint64(start), np.uint64(stop)):
                        row[a] += covers(sight, xk, yk, zk, nx, ny, nz, least, 0.0, axes, a)
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
                    frame = frame_of(sight, near[3, k], near[4, k], near[5, k])
                    given, cell = np.uint64(bottom[k]), np.uint64(top[k])
                    for i in range(words):
                        left, cap = possible[cell, i] & ~certain[given, i], ZERO
                        left &= ALL if keep else ~some[n - 1, i]
                        if left:
                            well = certain[cell, i]
                            cap = covering(sight, left, i, xk, yk, zk, frame, least, most, sure, well, axes)
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
