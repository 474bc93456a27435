"""What a position sees, whoever asks: the landmarks that are near, in reach, unblocked and not hidden.

Every decision is the reference's, by the same float64 operations in the same order. `lmd.sight.kernels` counts what is
seen, `lmd.objectives.localisation` sums up what it tells, `lmd.sight.views` picks single orientations, and
`lmd.sight.poses` looks at each landmark on its own.

Landmarks are dropped in stages, from cheap to dear: those beyond the horizon of a region of blocks of positions, then
of a block; per position those that are too near, too far or face away; what the room blocks; what others hide. These
have directions close to that of the landmark, which is found in single precision first.
"""

import math
from typing import NamedTuple

import numpy as np

from lmd.core.bits import LANES
from lmd.core.compiled import allocating, inlined, inner
from lmd.scene.criteria import from_position, hide_between, sized
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import NOWHERE, band_of, cell_of
from lmd.sight.obstacles import find_ends, is_blocked

REGION = 16 * BLOCK  # positions: what is far from all of these is not looked at for each block


class Viewpoint(NamedTuple):
    """Working memory for the view of K landmarks from one position after the other."""

    around: np.ndarray
    """Positions and normals of the landmarks near a region of blocks, `(6, K)`, metres."""
    region: np.ndarray
    """Which they are, `(K,)`."""
    near: np.ndarray
    """The same near a block, `(6, K)`; all that follows goes by their order."""
    who: np.ndarray
    """Which they are, `(K,)`."""
    x: np.ndarray
    """Offset from the position, `(K,)`, world frame, metres; so are y and z."""
    y: np.ndarray
    z: np.ndarray
    squared: np.ndarray
    """The square of its length, `(K,)`."""
    low: np.ndarray
    """The least depth with which an orientation may cover it, `(K,)`, see `criteria.from_position`."""
    high: np.ndarray
    """The greatest."""
    deep: np.ndarray
    """Up to which depth all do that have it well in view: `sure` of `criteria.from_position`."""
    bottom: np.ndarray
    """The first height of `bands`, or with tables the row of orientations that surely cover it, `(K,)`."""
    top: np.ndarray
    """The last height, or the row of those that may."""
    reached: np.ndarray
    """Whether any orientation may cover it, `(K,)`."""
    u: np.ndarray
    """Direction in single precision, filled up to whole `LANES`, as are v, w and `close`."""
    v: np.ndarray
    w: np.ndarray
    close: np.ndarray
    """The square of the cosine from which on the landmark may hide another in a direction."""
    shown: np.ndarray
    """The landmarks that are seen with some orientation, a list `(K,)`."""


@allocating
def viewpoint_for(count):
    """A `Viewpoint` of so many landmarks."""
    whole = (count + LANES - 1) & -LANES
    return Viewpoint(
        np.empty((6, count)), np.empty(count, np.int64), np.empty((6, count)), np.empty(count, np.int64),
        np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count),
        np.empty(count), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.bool_),
        np.zeros(whole, np.float32), np.zeros(whole, np.float32), np.zeros(whole, np.float32),
        np.full(whole, 2.0, np.float32), np.empty(count, np.uint64),
    )  # fmt: skip


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
def take(b, landmarks, normals, sight, obstacles, clear, poses, ends):
    """Write deployment b of `landmarks`, `normals` `(B, 3, K)` into `poses` `(6, K)`, and its `obstacles.find_ends`."""
    for k in range(landmarks.shape[2]):
        x, y, z = landmarks[b, 0, k], landmarks[b, 1, k], landmarks[b, 2, k]
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[b, i, k], normals[b, i, k]
        if not clear:
            find_ends(
                obstacles, sized(sight, k), x, y, z, normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], ends, k
            )


@inlined
def gather_near(o, first, last, order, positions, horizon, many, count, poses, names, view):
    """Gather the landmarks near position `order[o]` where a region, or a block, of `order[first:last]` begins.

    Args:
        many, count: how many landmarks were near the last region and block.
        poses, names: all landmarks, `(6, K)` and `(K,)`.

    Returns:
        how many are now.
    """
    if o == first or o % REGION == 0:
        low, high = box_around(positions, order[o : min(o - o % REGION + REGION, last)])
        many = gather(low, high, horizon, len(names), poses, names, view.around, view.region)
    if o == first or o % BLOCK == 0:
        low, high = box_around(positions, order[o : min(o - o % BLOCK + BLOCK, last)])
        count = gather(low, high, horizon, many, view.around, view.region, view.near, view.who)
        view.close[count : (count + BLOCK - 1) & -BLOCK] = 2.0  # no direction comes close to those that fill up
    return many, count


@inlined
def look(view, count, px, py, pz, sight, tables):
    """Find what the first `count` landmarks are like from (px, py, pz), whatever the orientation."""
    near, who, x, y, z, squared, low, high, deep = (
        view.near, view.who, view.x, view.y, view.z, view.squared, view.low, view.high, view.deep
    )  # fmt: skip
    bottom, top, reached, u, v, w, close = view.bottom, view.top, view.reached, view.u, view.v, view.w, view.close
    for k in range(count):
        # Kept in variables: to read back what was just written would keep the loop from vectorising.
        xk, yk, zk = near[0, k] - px, near[1, k] - py, near[2, k] - pz
        nx, ny, nz = near[3, k], near[4, k], near[5, k]
        in_reach, least, most, sure = from_position(sized(sight, who[k]), xk, yk, zk, nx, ny, nz, 0.0)
        if tables is None:
            bottom[k], top[k] = band_of(xk, yk, zk, least, 0.0)
        else:
            cell = cell_of(xk, yk, zk)
            bottom[k], top[k] = NOWHERE if sure < math.inf else cell, cell
        x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
        reached[k], low[k], high[k], deep[k] = in_reach, least, most, sure
    if sight.reach >= 0.0:
        for k in range(count):
            here = squared[k] == 0.0  # such a landmark hides all others
            scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - sight.reach / squared[k]


@inner
def is_hidden(k, count, who, x, y, z, squared, normals, sight):
    """Whether one of the first `count` landmarks hides landmark k.

    Which they are in the deployment, `who`, offsets `x, y, z` and their `squared` lengths `(K,)`, `normals` `(3, K)`.
    """
    xk, yk, zk, sk, hiding = x[k], y[k], z[k], squared[k], 0
    nx, ny, nz, mine = normals[0, k], normals[1, k], normals[2, k], sized(sight, who[k])
    for j in range(count):
        ux, uy, uz = normals[0, j], normals[1, j], normals[2, j]
        hides, _ = hide_between(
            sized(sight, who[j]), mine, x[j], y[j], z[j], squared[j], xk, yk, zk, sk, ux, uy, uz, nx, ny, nz
        )  # fmt: skip
        hiding += hides & (j != k)
    return hiding > 0


@inlined
def is_shown(k, view, directions, count, p, sight, obstacles, clear, ends):
    """Whether landmark k is in reach of position p, nothing blocks it, and none of the first `count` hides it.

    `directions` are the normals among `near`.
    """
    if not view.reached[k] or (not clear and is_blocked(obstacles, sized(sight, view.who[k]), p, ends, view.who[k])):
        return False
    if sight.reach < 0.0:
        return True
    u, v, w, close = view.u, view.v, view.w, view.close
    uk, vk, wk, suspects = u[k], v[k], w[k], np.int32(0)
    for j in range(np.uint64((count + BLOCK - 1) & -BLOCK)):
        cosine = u[j] * uk + v[j] * vk + w[j] * wk
        suspects += np.int32(cosine * cosine >= close[j])
    # The landmark itself is always one of the suspects.
    return suspects <= 1 or not is_hidden(
        k, count, view.who, view.x, view.y, view.z, view.squared, directions, sight
    )  # fmt: skip


@inlined
def list_shown(view, directions, count, p, sight, obstacles, clear, ends):
    """List the landmarks that `is_shown` in `shown`; returns how many."""
    shown, found = view.shown, np.uint64(0)
    for k in range(count):
        if is_shown(k, view, directions, count, p, sight, obstacles, clear, ends):
            shown[found] = k
            found += np.uint64(1)
    return found


@inlined
def see_alone(pose, positions, p, sight, obstacles, ends, bands):
    """What position p of `positions` `(P, 3)` sees of a landmark that none hides.

    Args:
        pose: its position and normal, six numbers.
        ends: of `obstacles.find_ends`, the landmark being the first.

    Returns:
        its offset, three numbers; the least depth of `criteria.from_position`; the first axis that may cover it, and
        the one behind the last, equal if none does.
    """
    lx, ly, lz, nx, ny, nz = pose
    x, y, z = lx - positions[p, 0], ly - positions[p, 1], lz - positions[p, 2]
    reached, low, _, _ = from_position(sight, x, y, z, nx, ny, nz, 0.0)
    if not reached or is_blocked(obstacles, sight, p, ends, 0):
        return x, y, z, low, np.int64(0), np.int64(0)
    bottom, top = band_of(x, y, z, low, 0.0)
    return x, y, z, low, bands[bottom], bands[top]
