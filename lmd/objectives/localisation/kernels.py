"""The fast exact path: views localised at each position, compiled with numba.

Landmarks covered are counted as in `lmd.sight.kernels`, by the same operations. Then, for the views that cover enough,
the landmarks' numbers (`information`, `ambiguity`) are summed, and the sums decide. Threads share the positions.
"""

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, add_digit, at_least, lowest
from lmd.core.compiled import inlined, kernel
from lmd.geometry.squares import upright_sides
from lmd.objectives.localisation.ambiguity import count_tag, tells, told_apart
from lmd.objectives.localisation.information import WIDTH, half_of, meets, moments, share_of, variance
from lmd.scene.criteria import covering, covers, frame_of, pixel_density, sized
from lmd.sight.kernels import weights_row
from lmd.sight.obstacles import is_clear, no_ends
from lmd.sight.viewpoint import gather_near, list_shown, look, take, viewpoint_for


@inlined
def landmark_moments(x, y, z, nx, ny, nz, precision, k):
    """The `moments` of landmark k, upright at offset (x, y, z) with the unit normal (nx, ny, nz)."""
    rx, ry, rz, ux, uy, uz = upright_sides(half_of(precision, k), nx, ny, nz)
    return moments(x, y, z, rx, ry, rz, ux, uy, uz, precision.share)


@inlined
def meets_row(precision, sums, v):
    """`meets` and `tells` with the sums of view v in `sums` `(V, WIDTH)`."""
    within = meets(
        precision, sums[v, 0], sums[v, 1], sums[v, 2], sums[v, 3], sums[v, 4], sums[v, 5], sums[v, 6], sums[v, 7],
        sums[v, 8], sums[v, 9], sums[v, 10], sums[v, 11], sums[v, 12], sums[v, 13], sums[v, 14],
    )  # fmt: skip
    return within & tells(precision, sums[v, 15])


@inlined
def variance_of_row(precision, sums, v):
    """`variance` with the sums of view v in `sums` `(V, WIDTH)`, infinite where something is open."""
    value, fixed = variance(
        sums[v, 0], sums[v, 1], sums[v, 2], sums[v, 3], sums[v, 4], sums[v, 5], sums[v, 6], sums[v, 7],
        sums[v, 8], sums[v, 9], sums[v, 10], sums[v, 11], sums[v, 12], sums[v, 13], sums[v, 14],
    )  # fmt: skip
    return value if fixed & tells(precision, sums[v, 15]) else np.inf


@kernel
def localise_range(
    first, last, order, positions, landmarks, normals, sight, horizon, obstacles, axes, bands, tables, weights, n,
    places, precision, asks, covered, localised, variances, keep,
):  # fmt: skip
    """Evaluate deployments at the positions `order[first:last]`.

    Args:
        first, last, order, positions, landmarks, normals, sight, horizon, obstacles, axes, bands, tables, weights, n:
            see `kernels.evaluate_range`.
        places: binary digits of a number of landmarks.
        precision: what is asked of a view, see `information`.
        asks: whether it asks anything.
        covered, localised: `(B, P)` int64, receive P_n and L in integer units.
        variances: `(B, P, D)`, receives `variance`, infinite where fewer than n are covered or two poses look alike, if
            `keep` is set.
    """
    words, poses, names = (
        np.uint64(axes.shape[1] // BITS),
        np.empty((6, landmarks.shape[2])),
        np.arange(landmarks.shape[2]),
    )
    clear, ends, view = is_clear(obstacles), no_ends(obstacles, len(names)), viewpoint_for(len(names))
    near, who, x, y, z, low, high, deep = (
        view.near, view.who, view.x, view.y, view.z, view.low, view.high, view.deep
    )  # fmt: skip
    bottom, top, shown, directions = view.bottom, view.top, view.shown, view.near[3:]
    caps, digits = np.empty((len(names), words), dtype=np.uint64), np.empty((words, np.uint64(places)), dtype=np.uint64)
    enough, listed = np.empty(words, dtype=np.uint64), np.empty(axes.shape[1], dtype=np.uint64)
    moment, sums = np.zeros(WIDTH), np.empty((axes.shape[1], WIDTH))
    # A number that the compiler does not know, or it would unroll loops over it and not vectorise them.
    terms = np.uint64(WIDTH + landmarks.shape[1] - 3)
    for b in range(landmarks.shape[0]):
        many = count = 0
        take(b, landmarks, normals, sight, obstacles, clear, poses, ends)
        for o in range(first, last):
            p = order[o]
            many, count = gather_near(o, first, last, order, positions, horizon, many, count, poses, names, view)
            look(view, count, positions[p, 0], positions[p, 1], positions[p, 2], sight, tables)
            found = list_shown(view, directions, count, p, sight, obstacles, clear, ends)
            digits[:] = ZERO
            for m in range(found):
                k = shown[m]
                xk, yk, zk, least = x[k], y[k], z[k], low[k]
                nx, ny, nz, mine = near[3, k], near[4, k], near[5, k], sized(sight, who[k])
                if tables is None:
                    start, stop = bands[bottom[k]] // LANES, (bands[top[k]] + LANES - 1) // LANES
                    bottom[k], top[k] = start // 2, (stop + 1) // 2
                    for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                        caps[k, i] = ZERO
                    for i in range(np.uint64(start), np.uint64(stop)):
                        half = np.uint32(0)
                        for lane in range(np.uint64(LANES)):
                            a = i * np.uint64(LANES) + lane
                            inside = covers(mine, xk, yk, zk, nx, ny, nz, least, 0.0, axes, a)
                            half |= np.uint32(inside) << np.uint32(lane)
                        caps[k, i // np.uint64(2)] |= np.uint64(half) << (i % np.uint64(2) * np.uint64(LANES))
                else:
                    certain, possible = tables
                    given, cell, frame = np.uint64(bottom[k]), np.uint64(top[k]), frame_of(mine, nx, ny, nz)
                    bottom[k], top[k] = 0, words
                    for i in range(words):
                        cap, left = certain[given, i], possible[cell, i] & ~certain[given, i]
                        if left:
                            well = certain[cell, i]
                            cap |= covering(mine, left, i, xk, yk, zk, frame, least, high[k], deep[k], well, axes)
                        caps[k, i] = cap
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    carry, j = caps[k, i], ZERO
                    while carry:
                        digits[i, j], carry = add_digit(digits[i, j], carry, ZERO)
                        j += ONE
            total, useful, row_of = np.int64(0), np.uint64(0), weights_row(weights, p)
            for i in range(words):
                enough[i] = has = at_least(digits[i], n)
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
            for m in range(found):
                k = shown[m]
                xk, yk, zk = x[k], y[k], z[k]
                nx, ny, nz = near[3, k], near[4, k], near[5, k]
                (
                    moment[0], moment[1], moment[2], moment[3], moment[4], moment[5], moment[6], moment[7],
                    moment[8], moment[9], moment[10], moment[11], moment[12], moment[13], moment[14],
                ) = landmark_moments(xk, yk, zk, nx, ny, nz, precision, who[k])  # fmt: skip
                moment[15] = told_apart(precision, half_of(precision, who[k]), xk, yk, zk, nx, ny, nz)
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    left = caps[k, i] & enough[i]
                    while left:
                        a = i * np.uint64(BITS) + lowest(left)
                        left &= left - ONE
                        weight = pixel_density(sight, xk, yk, zk, axes, a)
                        for j in range(terms):
                            sums[a, j] += share_of(moment[j], weight)
                        count_tag(precision, sums, a, 1.0)
            if asks:
                total = np.int64(0)
                for m in range(useful):
                    total += weights[row_of, listed[m]] if meets_row(precision, sums, listed[m]) else 0
                localised[b, p] = total
            if keep:
                for a in range(np.uint64(variances.shape[2])):
                    variances[b, p, a] = np.inf
                for m in range(useful):
                    variances[b, p, listed[m]] = variance_of_row(precision, sums, listed[m])
