"""Evaluation of deployments: P_n and L at each position.

P_n is the probability that n landmarks are covered, and L the probability that a view (an orientation at this position)
is localised.

Compiled code counts landmarks by the operations of `lmd.sight.kernels`. For the views that cover n landmarks, the
information of the landmarks (`information`, `ambiguity`) is summed and compared with the required precision. Positions
are divided among the threads. The module `rig` evaluates rigs, whose cameras change their positions when the body
turns.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, Integer, add_digit, at_least, lowest
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import kernel
from lmd.geometry.vectors import pair3, row3
from lmd.objectives.localisation.ambiguity import has_one_pose
from lmd.objectives.localisation.information import WIDTH, Precision, meets, share_of, variance
from lmd.objectives.localisation.reference import reference_views
from lmd.objectives.localisation.rig import rig_views
from lmd.objectives.localisation.views import VIEW, landmark_moments
from lmd.scene.criteria import covering, covers, frame_of, pixel_density, sized
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import Batch, weights_row
from lmd.sight.obstacles import is_clear, new_ends
from lmd.sight.poses import CHUNKS_PER_THREAD
from lmd.sight.viewpoint import fill_viewpoint, gather_near, list_shown, load_deployment, viewpoint_for


class ViewValues(NamedTuple):
    """Probabilities of covered and of localised views, and variances, for B deployments at P positions."""

    covered: IntArray
    """`(B, P)` quantised P_n, the probability that n landmarks are covered, of each deployment at each position."""
    localised: IntArray
    """`(B, P)` quantised L, the probability of a localised view, of each deployment at each position."""
    variances: FloatArray
    """`(B, P, D)` variance of the camera's position in each view, divided by the square of `deviation_per_variance`;
    empty unless `keep` was set.

    The variance is infinite for views that cover fewer than n landmarks, leave the pose undetermined, or are ambiguous
    (if `Precision.residual` is not None).
    """


def localised_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Precision, keep: bool = False
) -> ViewValues:
    """Compute P_n, L and the variance of each view for B deployments, see `ViewValues`.

    A view of a rig has the images of all its cameras. The result does not depend on the number of threads.

    Args:
        evaluator: scene and P positions.
        positions, normals: landmarks of B deployments, metres and unit vectors, `(B, K, 3)`.
        n: number of landmarks that must be covered.
        precision: limits that a localised view must satisfy.
        keep: True to return the variances.
    """
    e, batch, size = evaluator, len(positions), len(evaluator.positions)
    if keep:
        e.check_memory(8 * batch)
    if e.by_reference:
        return ViewValues(*reference_views(e, positions, normals, n, precision, keep))
    if e.groups:
        return ViewValues(*rig_views(e, positions, normals, n, precision, keep))
    covered, localised = np.zeros((2, batch, size), dtype=np.int64)
    values = ViewValues(covered, localised, np.empty((batch, size, e.axes.shape[1]) if keep else (0, 0, 0)))
    digits = max(positions.shape[1], n, 2).bit_length()
    fixed = (*e.batch(positions, normals), n, digits, precision, precision.asks, values)
    e.run_over_blocks(_localise_range, fixed, CHUNKS_PER_THREAD)
    return values


@kernel
def _localise_range(
    first: Integer, last: Integer, batch: Batch, tables: Any, n: Integer, places: Integer, precision: Precision,
    asks: bool, values: ViewValues,
) -> None:  # fmt: skip
    """Write the `ViewValues` of B deployments at the positions `order[first:last]` into `values`.

    Args:
        first, last: range of indices of the array `order`, which is a part of `batch`.
        batch, tables, n: see `kernels.evaluate_range`.
        places: number of binary digits in which landmarks are counted.
        precision, asks: limits that a localised view must satisfy, and the value of `Precision.asks` for these limits.
        values: receives the results; its variances are empty if they are not computed.
    """
    order, positions, landmarks, normals, sight, horizon, obstacles, axes, bands, weights = batch
    (covered, localised, variances), words = values, np.uint64(axes.shape[1] // BITS)
    keep = len(variances) > 0
    poses, indices = np.empty((6, landmarks.shape[2])), np.arange(landmarks.shape[2])
    clear, ends, view = is_clear(obstacles), new_ends(obstacles, len(indices)), viewpoint_for(len(indices))
    near, index, x, y, z, bottom, top = view.near_poses, view.near_index, view.x, view.y, view.z, view.bottom, view.top
    low, high, sure_depth, shown, room = view.low, view.high, view.sure_depth, view.shown, (obstacles, clear, ends)
    visible_axes = np.empty((len(indices), words), dtype=np.uint64)
    digits = np.empty((words, np.uint64(places)), dtype=np.uint64)
    enough, listed = np.empty(words, dtype=np.uint64), np.empty(axes.shape[1], dtype=np.uint64)
    moment, sums, several = np.zeros(WIDTH), np.empty((axes.shape[1], WIDTH)), np.empty(words, dtype=np.uint64)
    flat = sums.reshape(-1)
    # The number of terms is no compile-time constant, as LLVM would then unroll the loops over them instead of
    # vectorising.
    terms = np.uint64(WIDTH + landmarks.shape[1] - 3)
    for b in range(landmarks.shape[0]):
        many = count = 0
        load_deployment(b, landmarks, normals, sight, room, poses)
        for o in range(first, last):
            p = order[o]
            part = first, last, order, positions
            many, count = gather_near(o, part, horizon, many, count, poses, indices, view)
            fill_viewpoint(view, count, row3(positions, p), sight, tables)
            found = list_shown(view, count, p, sight, room)
            digits[:] = ZERO
            for m in range(found):
                k = shown[m]
                offset, (_, normal), mine = (x[k], y[k], z[k]), pair3(near, k), sized(sight, index[k])
                if tables is None:
                    start, stop = bands[bottom[k]] // LANES, (bands[top[k]] + LANES - 1) // LANES
                    bottom[k], top[k] = start // 2, (stop + 1) // 2
                    for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                        visible_axes[k, i] = ZERO
                    for i in range(np.uint64(start), np.uint64(stop)):
                        half = np.uint32(0)
                        for lane in range(np.uint64(LANES)):
                            a = i * np.uint64(LANES) + lane
                            inside = covers(mine, offset, normal, low[k], 0.0, axes, a)
                            half |= np.uint32(inside) << np.uint32(lane)
                        visible_axes[k, i // np.uint64(2)] |= np.uint64(half) << (i % np.uint64(2) * np.uint64(LANES))
                else:
                    certain, possible = tables
                    given, cell, frame = np.uint64(bottom[k]), np.uint64(top[k]), frame_of(mine, normal)
                    depths = low[k], high[k], sure_depth[k]
                    bottom[k], top[k] = 0, words
                    for i in range(words):
                        visible, left = certain[given, i], possible[cell, i] & ~certain[given, i]
                        if left:
                            well = certain[cell, i]
                            visible |= covering(mine, left, i, offset, frame, depths, well, axes)
                        visible_axes[k, i] = visible
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    carry, j = visible_axes[k, i], ZERO
                    while carry:
                        digits[i, j], carry = add_digit(digits[i, j], carry, ZERO)
                        j += ONE
            total, useful, row_of = np.int64(0), np.uint64(0), weights_row(weights, p)
            for i in range(words):
                enough[i] = has = at_least(digits[i], n)
                several[i] = at_least(digits[i], 2)
                while has:
                    a = i * np.uint64(BITS) + lowest(has)
                    has &= has - ONE
                    total += weights[row_of, a]
                    listed[useful] = a
                    useful += ONE
                    for t in range(terms):
                        sums[a, t] = 0.0
            covered[b, p] = localised[b, p] = total
            if not asks and not keep:
                continue
            for m in range(found):
                k = shown[m]
                offset, (_, normal) = (x[k], y[k], z[k]), pair3(near, k)
                landmark_moments(offset, normal, precision, index[k], moment)
                for i in range(np.uint64(bottom[k]), np.uint64(top[k])):
                    left = visible_axes[k, i] & enough[i]
                    while left:
                        a = i * np.uint64(BITS) + lowest(left)
                        left &= left - ONE
                        weight = pixel_density(sight, offset, axes, a)
                        for t in range(terms):
                            sums[a, t] += share_of(moment[t], weight)
            for i in range(np.uint64(variances.shape[2]) if keep else ZERO):
                variances[b, p, i] = np.inf
            total = np.int64(0) if asks else total
            for m in range(useful):
                a, start = listed[m], listed[m] * np.uint64(WIDTH)
                one_pose = several[a // VIEW] >> a % VIEW & ONE != ZERO
                one_pose |= has_one_pose(precision.residual, flat, start, ONE)
                if asks:
                    total += weights[row_of, a] if meets(precision, flat, start, ONE) & one_pose else 0
                if keep:
                    value, fixed = variance(flat, start, ONE)
                    variances[b, p, a] = value if fixed & one_pose else np.inf
            localised[b, p] = total
