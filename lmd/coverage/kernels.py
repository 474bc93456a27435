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
_PAPER = OCCLUSION_CODES["paper"]


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
def _band(height, cosine, index):
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
    return index[first] & -BLOCK, (index[last] + BLOCK - 1) & -BLOCK


@njit(nogil=True, cache=True)
def _offsets(position, landmarks, offset):
    """Write d = s - p, |d|^2 and |d| of every landmark into the rows of `offset` `(5, K)`."""
    px, py, pz = position
    for k in range(landmarks.shape[1]):
        x, y, z = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
        squared = x * x + y * y + z * z
        offset[0, k], offset[1, k], offset[2, k] = x, y, z
        offset[3, k], offset[4, k] = squared, math.sqrt(squared)


@njit(nogil=True, cache=True)
def _reachable(k, offset, normals, limits):
    """Whether landmark k faces the camera and some depth up to its distance is within the limits."""
    distance = offset[4, k]
    if distance * limits[0] > limits[2] or distance * (1.0 + TOLERANCE) < limits[1]:
        return False
    facing = normals[0, k] * offset[0, k] + normals[1, k] * offset[1, k] + normals[2, k] * offset[2, k]
    return -facing > TOLERANCE * distance


@njit(nogil=True, cache=True)
def _hidden(k, offset, reach, mode):
    """Whether another landmark lies within nu of the line of sight to landmark k (Eq. occlusion2)."""
    x, y, z, squared = offset[0, k], offset[1, k], offset[2, k], offset[3, k]
    bound = reach * squared
    hiding = 0
    for j in range(offset.shape[1]):
        cx = offset[1, j] * z - offset[2, j] * y
        cy = offset[2, j] * x - offset[0, j] * z
        cz = offset[0, j] * y - offset[1, j] * x
        hiding += cx * cx + cy * cy + cz * cz <= bound
    if hiding <= 1 or mode == _PAPER:  # the landmark itself is always one of them
        return hiding > 1
    further = squared * (1.0 + TOLERANCE)
    for j in range(offset.shape[1]):
        cx = offset[1, j] * z - offset[2, j] * y
        cy = offset[2, j] * x - offset[0, j] * z
        cz = offset[0, j] * y - offset[1, j] * x
        in_front = x * offset[0, j] + y * offset[1, j] + z * offset[2, j] > 0.0
        if j != k and in_front and cx * cx + cy * cy + cz * cz <= bound and offset[3, j] <= further:
            return True
    return False


@njit(nogil=True, cache=True)
def add_cap(k, offset, limits, axes, index, counts, step):
    """Add `step` to the count of every axis inside the cap of landmark k."""
    x, y, z, distance = offset[0, k], offset[1, k], offset[2, k], offset[4, k]
    low, high = max(distance * limits[0], limits[1]), limits[2]
    first, last = _band(z / distance, low / distance, index)
    # Unsigned, so that the compiler sees indices that cannot be negative and vectorises the loop.
    for a in range(np.uint64(first), np.uint64(last)):
        depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
        counts[a] += step * ((depth >= low) & (depth <= high))


@njit(nogil=True, cache=True)
def count_at(position, landmarks, normals, limits, reach, mode, axes, index, offset, counts):
    """Landmarks covered along every axis at one position, written into `counts` `(D,)`."""
    counts[:] = 0
    _offsets(position, landmarks, offset)
    for k in range(landmarks.shape[1]):
        if _reachable(k, offset, normals, limits) and not (mode and _hidden(k, offset, reach, mode)):
            add_cap(k, offset, limits, axes, index, counts, 1)


@njit(nogil=True, cache=True)
def counts_in_range(first, last, positions, landmarks, normals, limits, reach, mode, axes, index, out):
    """Fill `out[b, first:last]` `(B, P, D)` int32 with counts.

    Args:
        positions: `(P, 3)`.
        landmarks, normals: `(B, 3, K)`.
        limits: min_cosine, min_depth, max_depth.
        reach: squared virtual diameter with tolerance.
        mode: a value of `OCCLUSION_CODES`.
        axes: `(3, D)` sorted by height and filled up by `in_blocks`.
        index: their `height_index`.
    """
    offset = np.empty((5, landmarks.shape[2]))
    for b in range(landmarks.shape[0]):
        for p in range(first, last):
            count_at(positions[p], landmarks[b], normals[b], limits, reach, mode, axes, index, offset, out[b, p])


@njit(nogil=True, cache=True)
def units_of(counts, weights, n):
    """P_n in integer units: the sum of `weights` `(D,)` int64 where at least n landmarks are covered."""
    total = np.int64(0)
    for a in range(len(counts)):
        total += weights[a] * (counts[a] >= n)
    return total


@njit(nogil=True, cache=True)
def units_in_range(first, last, positions, landmarks, normals, limits, reach, mode, axes, index, weights, n, out):
    """Fill `out[b, first:last]` `(B, P)` int64 with P_n in integer units; arguments as in `counts_in_range`."""
    offset = np.empty((5, landmarks.shape[2]))
    counts = np.empty(axes.shape[1], dtype=np.int32)
    for b in range(landmarks.shape[0]):
        for p in range(first, last):
            count_at(positions[p], landmarks[b], normals[b], limits, reach, mode, axes, index, offset, counts)
            out[b, p] = units_of(counts, weights, n)
