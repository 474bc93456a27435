"""The fast exact path: landmarks covered at each position and axis, compiled with numba.

Every decision is the reference's, by the same float64 operations in the same order (no fast-math, so nothing is
re-associated or fused), hence the same bits. Speed comes from skipped work and from loops that vectorise, never
from approximation:

1. Per position, landmarks that are too near, too far or face away are dropped: some 60 % in the paper's room.
2. Only those left are tested for being hidden by the others, without a branch in the inner loop.
3. A cap lies in a cone around the direction of its landmark. Axes are sorted by height (their z coordinate), so
   the cone's lowest and highest point bound the axes that need the exact test to one contiguous band.
4. Probabilities are sums of integers (`PROBABILITY_ONE` per unit), exact in any order.

Kernels release the GIL and work on a range of positions, so threads can share a batch; the result does not depend
on how it is shared.
"""

import math

import numpy as np
from numba import njit

from lmd.checks import FloatArray
from lmd.visibility import TOLERANCE

# A probability of 1 in the integer units of the kernels: quantisation is far below TOLERANCE, and a sum of
# at most one fits a double exactly.
PROBABILITY_ONE = 1 << 52
# Axes come in blocks of this many, the last one filled up with zero vectors that nothing covers: loops over whole
# blocks vectorise without a remainder.
BLOCK = 16
# Number of equal intervals of [-1, 1] in which the start of a band of axes is tabulated.
HEIGHT_BINS = 512
# Heights this far beyond the cone's ends are still tested; rounding moves the end of a narrow cone by 2e-8.
HEIGHT_MARGIN = 1e-6

OCCLUSION_CODES = {"none": 0, "paper": 1, "line_of_sight": 2}
_LINE_OF_SIGHT = OCCLUSION_CODES["line_of_sight"]


def in_blocks(values: FloatArray) -> FloatArray:
    """Fill the last axis of `values` `(..., D)` up with zeros to whole blocks."""
    missing = -values.shape[-1] % BLOCK
    return np.ascontiguousarray(np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, missing)]))


def height_index(heights: FloatArray) -> np.ndarray:
    """`index[b]`: the first axis at or above the bottom of height bin b, less a margin, `(HEIGHT_BINS + 2,)`.

    Args:
        heights: z coordinates of the axes in ascending order, `(D,)`.
    """
    edges = np.linspace(-1.0, 1.0, HEIGHT_BINS + 1)
    return np.append(np.searchsorted(heights, edges - HEIGHT_MARGIN), len(heights)).astype(np.int64)


@njit(nogil=True, cache=True)
def band_of(height, cosine, bands):
    """First and last + 1 axis that can lie within arccos(cosine) of a direction at `height`, in whole blocks."""
    cosine = min(max(cosine, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    across = math.sqrt(max(0.0, 1.0 - height * height))
    low = -1.0 if -height >= cosine else height * cosine - across * sine
    high = 1.0 if height >= cosine else height * cosine + across * sine
    scale = HEIGHT_BINS / 2.0
    first = max(math.floor((low - HEIGHT_MARGIN + 1.0) * scale), 0)
    # Twice the margin: the table starts each bin one margin early.
    last = min(math.floor((high + 2.0 * HEIGHT_MARGIN + 1.0) * scale) + 1, HEIGHT_BINS + 1)
    return bands[first] & -BLOCK, (bands[last] + BLOCK - 1) & -BLOCK


@njit(nogil=True, cache=True)
def evaluate_range(
    first, last, positions, landmarks, normals, limits, reach, mode, axes, bands, weights, n, units, counts, keep
):  # fmt: skip
    """Evaluate deployments at the positions `first` to `last`.

    Args:
        positions: `(P, 3)`.
        landmarks, normals: `(B, 3, K)`.
        limits: min_cosine, min_depth, max_depth.
        reach: squared virtual diameter with tolerance.
        mode: a value of `OCCLUSION_CODES`.
        axes: `(3, D)` sorted by height and filled up by `in_blocks`.
        bands: their `height_index`.
        weights: probability of each axis in integer units, `(D,)`.
        n: landmarks that must be covered.
        units: `(B, P)` int64, receives P_n in integer units.
        counts: `(B, P, D)` int16, receives landmarks covered per axis if `keep` is set.
    """
    # One long body: handing arrays on to a function costs an atomic reference count, as much as the work itself.
    count, size = landmarks.shape[2], axes.shape[1]
    min_cosine, min_depth, max_depth = limits[0], limits[1], limits[2]
    x, y, z = np.empty(count), np.empty(count), np.empty(count)
    squared, distance = np.empty(count), np.empty(count)
    candidate = np.empty(count, dtype=np.bool_)
    row = np.empty(size, dtype=np.int16)
    for b in range(landmarks.shape[0]):
        for p in range(first, last):
            px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
            for k in range(count):
                x[k], y[k], z[k] = landmarks[b, 0, k] - px, landmarks[b, 1, k] - py, landmarks[b, 2, k] - pz
                squared[k] = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
                distance[k] = math.sqrt(squared[k])
                facing = normals[b, 0, k] * x[k] + normals[b, 1, k] * y[k] + normals[b, 2, k] * z[k]
                in_reach = (distance[k] * min_cosine <= max_depth) & (distance[k] * (1.0 + TOLERANCE) >= min_depth)
                candidate[k] = in_reach & (-facing > TOLERANCE * distance[k])
            for a in range(size):
                row[a] = 0
            for k in range(count):
                if not candidate[k]:
                    continue
                xk, yk, zk = x[k], y[k], z[k]
                if mode:
                    bound, further, hiding = reach * squared[k], squared[k] * (1.0 + TOLERANCE), 0
                    for j in range(count):
                        cx = y[j] * zk - z[j] * yk
                        cy = z[j] * xk - x[j] * zk
                        cz = x[j] * yk - y[j] * xk
                        hiding += cx * cx + cy * cy + cz * cz <= bound
                    if mode == _LINE_OF_SIGHT and hiding > 1:
                        hiding = 1
                        for j in range(count):
                            cx = y[j] * zk - z[j] * yk
                            cy = z[j] * xk - x[j] * zk
                            cz = x[j] * yk - y[j] * xk
                            in_front = xk * x[j] + yk * y[j] + zk * z[j] > 0.0
                            near = cx * cx + cy * cy + cz * cz <= bound and squared[j] <= further
                            hiding += j != k and in_front and near
                    if hiding > 1:  # the landmark itself is always one of them
                        continue
                low = max(distance[k] * min_cosine, min_depth)
                start, stop = band_of(zk / distance[k], low / distance[k], bands)
                # Unsigned, so that the compiler sees indices that cannot be negative and vectorises the loop.
                for a in range(np.uint64(start), np.uint64(stop)):
                    depth = axes[0, a] * xk + axes[1, a] * yk + axes[2, a] * zk
                    row[a] += (depth >= low) & (depth <= max_depth)
            total = np.int64(0)
            for a in range(size):
                total += weights[a] if row[a] >= n else 0
            units[b, p] = total
            if keep:
                for a in range(size):
                    counts[b, p, a] = row[a]
