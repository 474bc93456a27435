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
from lmd.compiled import kernel
from lmd.sight.criteria import covers, from_position, hide

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

# The square of a cosine in single precision is off by less than this: a dozen roundings of 6e-8.
SINGLE_ERROR = 2e-6


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


@njit(inline="always")
def band_of(x, y, z, low, slack):
    """The heights of the axes whose depth of a landmark at offset (x, y, z) may reach `low`.

    They lie in a cone around the direction of the landmark. With a `slack`, in that of any landmark so far away.
    Scalars only and no branch: a loop over landmarks or positions vectorises with it.

    Returns:
        the first and last height bin, to be looked up in `height_index`.
    """
    distance = math.sqrt(x * x + y * y + z * z)
    height, cosine = z / distance, min(max(low / distance, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    across = math.sqrt(max(0.0, 1.0 - height * height))
    wide = distance - slack <= 0.0  # the slack reaches the camera: any axis
    bottom = -1.0 if wide | (-height >= cosine) else height * cosine - across * sine
    top = 1.0 if wide | (height >= cosine) else height * cosine + across * sine
    scale = HEIGHT_BINS / 2.0
    first = math.floor((bottom - HEIGHT_MARGIN + 1.0) * scale)
    # Twice the margin: the table starts each bin one margin early.
    last = math.floor((top + 2.0 * HEIGHT_MARGIN + 1.0) * scale) + 1
    return max(first, 0), min(last, HEIGHT_BINS + 1)


@kernel
def is_hidden(k, x, y, z, squared, normals, sight):
    """Whether another hides landmark k; offsets `x, y, z` and their `squared` lengths `(K,)`, `normals` `(3, K)`."""
    xk, yk, zk, sk, hiding = x[k], y[k], z[k], squared[k], 0
    nx, ny, nz = normals[0, k], normals[1, k], normals[2, k]
    for j in range(len(x)):
        ux, uy, uz = normals[0, j], normals[1, j], normals[2, j]
        hides, _ = hide(sight, x[j], y[j], z[j], squared[j], xk, yk, zk, sk, ux, uy, uz, nx, ny, nz)
        hiding += hides & (j != k)
    return hiding > 0


@kernel
def evaluate_range(
    first, last, positions, landmarks, normals, sight, axes, bands, weights, n, units, counts, keep
):  # fmt: skip
    """Evaluate deployments at the positions `first` to `last`.

    Args:
        positions: `(P, 3)`.
        landmarks, normals: `(B, 3, K)`.
        sight: the compiled model of sight.
        axes: axis and right, `(6, D)`, sorted by height of the axis and filled up by `in_blocks`.
        bands: their `height_index`.
        weights: probability of each axis in integer units, `(D,)`.
        n: landmarks that must be covered.
        units: `(B, P)` int64, receives P_n in integer units.
        counts: `(B, P, D)` int16, receives landmarks covered per axis if `keep` is set.
    """
    # One long body but for the rare `is_hidden`: handing arrays on to a function costs atomic reference counts, as
    # much as the work itself.
    count, size = landmarks.shape[2], axes.shape[1]
    reach = sight.reach
    x, y, z, squared, low = np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    bottom, top = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    reached = np.empty(count, dtype=np.bool_)
    # Directions in single precision, filled up to whole vectors with landmarks that no direction comes close to.
    padded = (count + BLOCK - 1) & -BLOCK
    u, v, w = np.zeros(padded, np.float32), np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    close = np.full(padded, 2.0, np.float32)
    row = np.empty(size, dtype=np.int16)
    for b in range(landmarks.shape[0]):
        for p in range(first, last):
            px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
            for k in range(count):
                # Kept in variables: to read back what was just written would keep the loop from vectorising.
                xk, yk, zk = landmarks[b, 0, k] - px, landmarks[b, 1, k] - py, landmarks[b, 2, k] - pz
                nx, ny, nz = normals[b, 0, k], normals[b, 1, k], normals[b, 2, k]
                in_reach, least, _ = from_position(sight, xk, yk, zk, nx, ny, nz, 0.0)
                bottom[k], top[k] = band_of(xk, yk, zk, least, 0.0)
                x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
                reached[k], low[k] = in_reach, least
            if reach >= 0.0:
                for k in range(count):
                    here = squared[k] == 0.0  # such a landmark hides all others
                    scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
                    u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
                    close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - reach / squared[k]
            for a in range(size):
                row[a] = 0
            for k in range(count):
                if not reached[k]:
                    continue
                xk, yk, zk = x[k], y[k], z[k]
                nx, ny, nz = normals[b, 0, k], normals[b, 1, k], normals[b, 2, k]
                if reach >= 0.0:
                    uk, vk, wk, suspects = u[k], v[k], w[k], np.int32(0)
                    for j in range(np.uint64(padded)):
                        cosine = u[j] * uk + v[j] * vk + w[j] * wk
                        suspects += np.int32(cosine * cosine >= close[j])
                    # The landmark itself is always one of the suspects.
                    if suspects > 1 and is_hidden(k, x, y, z, squared, normals[b], sight):
                        continue
                least = low[k]
                start, stop = bands[bottom[k]] & -BLOCK, (bands[top[k]] + BLOCK - 1) & -BLOCK
                # Unsigned, so that the compiler sees indices that cannot be negative and vectorises the loop.
                for a in range(np.uint64(start), np.uint64(stop)):
                    row[a] += covers(sight, xk, yk, zk, nx, ny, nz, least, 0.0, axes, a)
            total = np.int64(0)
            for a in range(size):
                total += weights[a] if row[a] >= n else 0
            units[b, p] = total
            if keep:
                for a in range(size):
                    counts[b, p, a] = row[a]
