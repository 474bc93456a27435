"""The fast exact path: views localised at each position, compiled with numba.

Landmarks covered are counted as in `lmd.sight.kernels`, by the same operations. Then, for the views that cover enough,
the landmarks' 15 numbers (`information`) are summed, and the sums decide. Threads share the positions.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, add_digit, at_least_so_far, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, inlined, kernel
from lmd.geometry.squares import VERTICAL_TOLERANCE, upright_axes
from lmd.objectives.localisation.information import WIDTH, meets, moments, share_of, variance
from lmd.scene.criteria import covering, covers, frame_of, from_position, pixel_density
from lmd.sight.bands import band_of
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import NOWHERE, cell_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import is_hidden, weights_row
from lmd.sight.obstacles import find_ends, is_blocked, no_ends
from lmd.sight.poses import shared


@inlined
def landmark_moments(x, y, z, nx, ny, nz, precision):
    """The `moments` of an upright landmark at offset (x, y, z) with the unit normal (nx, ny, nz)."""
    rx, ry, rz, ux, uy, uz = upright_axes(nx, ny, nz, VERTICAL_TOLERANCE)
    half = precision.half
    return moments(x, y, z, half * rx, half * ry, half * rz, half * ux, half * uy, half * uz, precision.share)


@inlined
def meets_row(precision, sums, v):
    """`meets` with the sums of view v in `sums` `(V, WIDTH)`."""
    return meets(
        precision, sums[v, 0], sums[v, 1], sums[v, 2], sums[v, 3], sums[v, 4], sums[v, 5], sums[v, 6], sums[v, 7],
        sums[v, 8], sums[v, 9], sums[v, 10], sums[v, 11], sums[v, 12], sums[v, 13], sums[v, 14],
    )  # fmt: skip


@inlined
def variance_of_row(sums, v):
    """`variance` with the sums of view v in `sums` `(V, WIDTH)`, infinite where something is open."""
    value, fixed = variance(
        sums[v, 0], sums[v, 1], sums[v, 2], sums[v, 3], sums[v, 4], sums[v, 5], sums[v, 6], sums[v, 7],
        sums[v, 8], sums[v, 9], sums[v, 10], sums[v, 11], sums[v, 12], sums[v, 13], sums[v, 14],
    )  # fmt: skip
    return value if fixed else np.inf


@kernel
def localise_range(
    first, last, positions, landmarks, normals, sight, obstacles, axes, bands, tables, weights, n, places, precision,
    asks, covered, localised, variances, keep,
):  # fmt: skip
    """Evaluate deployments at the positions `first` to `last`.

    Args:
        first, last, positions, landmarks, normals, sight, obstacles, axes, bands, tables, weights, n: see
            `kernels.evaluate_range`.
        places: binary digits of a number of landmarks.
        precision: what is asked of a view, see `information`.
        asks: whether it asks anything.
        covered, localised: `(B, P)` int64, receive P_n and L in integer units.
        variances: `(B, P, D)`, receives `variance`, infinite where fewer than n are covered, if `keep` is set.
    """
    count, words = landmarks.shape[2], np.uint64(axes.shape[1] // BITS)
    reach = sight.reach
    x, y, z, squared = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    low, high, deep = np.empty(count), np.empty(count), np.empty(count)
    bottom, top = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    reached = np.empty(count, dtype=np.bool_)
    padded = (count + BLOCK - 1) & -BLOCK
    u, v, w = np.zeros(padded, np.float32), np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    close = np.full(padded, 2.0, np.float32)
    caps, digits = np.empty((count, words), dtype=np.uint64), np.empty((words, np.uint64(places)), dtype=np.uint64)
    enough, listed = np.empty(words, dtype=np.uint64), np.empty(axes.shape[1], dtype=np.uint64)
    moment, sums = np.zeros(WIDTH), np.empty((axes.shape[1], WIDTH))
    # A number that the compiler does not know, or it would unroll loops over it and not vectorise them.
    terms = np.uint64(WIDTH + landmarks.shape[1] - 3)
    ends = no_ends(obstacles, count)
    for b in range(landmarks.shape[0]):
        for k in range(count):
            mx, my, mz = landmarks[b, 0, k], landmarks[b, 1, k], landmarks[b, 2, k]
            find_ends(obstacles, sight, mx, my, mz, normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], ends, k)
        for p in range(first, last):
            px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
            for k in range(count):
                xk, yk, zk = landmarks[b, 0, k] - px, landmarks[b, 1, k] - py, landmarks[b, 2, k] - pz
                nx, ny, nz = normals[b, 0, k], normals[b, 1, k], normals[b, 2, k]
                in_reach, least, most, sure = from_position(sight, xk, yk, zk, nx, ny, nz, 0.0)
                if tables is None:
                    bottom[k], top[k] = band_of(xk, yk, zk, least, 0.0)
                else:
                    bottom[k] = cell_of(xk, yk, zk)
                x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
                reached[k], low[k], high[k], deep[k] = in_reach, least, most, sure
            if reach >= 0.0:
                for k in range(count):
                    here = squared[k] == 0.0
                    scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
                    u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
                    close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - reach / squared[k]
            digits[:] = ZERO
            for k in range(count):
                if not reached[k]:
                    continue
                if is_blocked(obstacles, sight, p, ends, k):
                    reached[k] = False
                    continue
                if reach >= 0.0:
                    uk, vk, wk, suspects = u[k], v[k], w[k], np.int32(0)
                    for j in range(np.uint64(padded)):
                        cosine = u[j] * uk + v[j] * vk + w[j] * wk
                        suspects += np.int32(cosine * cosine >= close[j])
                    if suspects > 1 and is_hidden(k, count, x, y, z, squared, normals[b], sight):
                        reached[k] = False
                        continue
                xk, yk, zk, least = x[k], y[k], z[k], low[k]
                nx, ny, nz = normals[b, 0, k], normals[b, 1, k], normals[b, 2, k]
                if tables is None:
                    start, stop = bands[bottom[k]] // LANES, (bands[top[k]] + LANES - 1) // LANES
                    bottom[k], top[k] = start // 2, (stop + 1) // 2
                    for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                        caps[k, i] = ZERO
                    for i in range(np.uint64(start), np.uint64(stop)):
                        half = np.uint32(0)
                        for lane in range(np.uint64(LANES)):
                            a = i * np.uint64(LANES) + lane
                            inside = covers(sight, xk, yk, zk, nx, ny, nz, least, 0.0, axes, a)
                            half |= np.uint32(inside) << np.uint32(lane)
                        caps[k, i // np.uint64(2)] |= np.uint64(half) << (i % np.uint64(2) * np.uint64(LANES))
                else:
                    certain, possible = tables
                    cell, frame = np.uint64(bottom[k]), frame_of(sight, nx, ny, nz)
                    given = cell if deep[k] == np.inf else np.uint64(NOWHERE)
                    bottom[k], top[k] = 0, words
                    for i in range(words):
                        cap, left = certain[given, i], possible[cell, i] & ~certain[given, i]
                        if left:
                            well = certain[cell, i]
                            cap |= covering(sight, left, i, xk, yk, zk, frame, least, high[k], deep[k], well, axes)
                        caps[k, i] = cap
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    carry = caps[k, i]
                    for j in range(np.uint64(places)):
                        digits[i, j], carry = add_digit(digits[i, j], carry, ZERO)
            total, useful, row_of = np.int64(0), np.uint64(0), weights_row(weights, p)
            for i in range(words):
                has = ALL
                for j in range(np.uint64(places)):
                    has = at_least_so_far(has, digits[i, j], n, j)
                enough[i] = has
                while has:
                    a = i * np.uint64(BITS) + lowest(has)
                    has &= has - ONE
                    total += weights[row_of, a]
                    listed[useful] = a
                    useful += ONE
                    for j in range(terms):
                        sums[a, j] = 0.0
            covered[b, p] = localised[b, p] = total
            if not asks and not keep:
                continue
            for k in range(count):
                if not reached[k]:
                    continue
                xk, yk, zk = x[k], y[k], z[k]
                nx, ny, nz = normals[b, 0, k], normals[b, 1, k], normals[b, 2, k]
                (
                    moment[0], moment[1], moment[2], moment[3], moment[4], moment[5], moment[6], moment[7],
                    moment[8], moment[9], moment[10], moment[11], moment[12], moment[13], moment[14],
                ) = landmark_moments(xk, yk, zk, nx, ny, nz, precision)  # fmt: skip
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    left = caps[k, i] & enough[i]
                    while left:
                        a = i * np.uint64(BITS) + lowest(left)
                        left &= left - ONE
                        weight = pixel_density(sight, xk, yk, zk, axes, a)
                        for j in range(terms):
                            sums[a, j] += share_of(moment[j], weight)
            if asks:
                total = np.int64(0)
                for m in range(useful):
                    total += weights[row_of, listed[m]] if meets_row(precision, sums, listed[m]) else 0
                localised[b, p] = total
            if keep:
                for a in range(np.uint64(variances.shape[2])):
                    variances[b, p, a] = np.inf
                for m in range(useful):
                    variances[b, p, listed[m]] = variance_of_row(sums, listed[m])


class Views(NamedTuple):
    """What the views of B deployments are worth at P positions: see `localise_range`."""

    covered: np.ndarray
    localised: np.ndarray
    variances: np.ndarray


def localised_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Any, keep: bool = False
) -> Views:
    """Evaluate deployments; the same for any number of threads.

    Args:
        evaluator: the scene.
        positions, normals: `(B, K, 3)` landmarks of B deployments.
        n: landmarks that must be covered.
        precision: what is asked of a view besides.
        keep: whether to return the variances, `(B, P, D)`.
    """
    e, batch, size = evaluator, len(positions), len(evaluator.positions)
    if keep:
        e.check_memory(8 * batch)
    covered, localised = np.zeros((2, batch, size), dtype=np.int64)
    views = Views(covered, localised, np.empty((batch, size, e.axes.shape[1]) if keep else (0, 0, 0)))
    landmarks = tuple(for_kernels(v.transpose(0, 2, 1)) for v in (positions, normals))
    sight = e.sight.among(e.positions.min(axis=0), e.positions.max(axis=0), *landmarks)
    tables = e.tables if e.sight.tabulated else None
    places = max(positions.shape[1], n).bit_length()
    scene = (e.positions, *landmarks, sight, e.obstacles, e.axes, e.bands, tables, e.weights)
    fixed = (*scene, n, places, precision, precision.asks, *views, keep)
    shared(localise_range, size, e.threads, fixed)
    return views
