"""Where the cameras of a rig are, and what they cover from there: the compiled side of `lmd.scene.rig`.

A camera with a translation is elsewhere for every orientation of the body, but never far from a *centre*, around which
the body turns it. So the landmarks are looked at from the centre once, with bounds that hold for all places within the
radius of the cameras there (`criteria.from_around`), and with tables of directions that are shifted for each
orientation (`lmd.sight.directions.fill_tables`), one for each range of distances, `LEVELS` of them. These settle most
orientations of most landmarks. The others are tested one by one, from where the camera then is, by the reference's
operations: nothing is approximated. Whether one landmark may hide another is likewise asked from the centre first.

What several cameras cover are sets of orientations of the *body*, joined by OR.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, in_words, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, inlined, inner, kernel
from lmd.scene.criteria import (
    covers,
    covers_one,
    frame_of,
    from_around,
    from_position,
    hide,
    horizon_of,
    sized,
)
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import SIDE, cell_of, fill_tables
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends, obstacles_at
from lmd.sight.viewpoint import gather_near, viewpoint_for
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles

LEVELS = 6  # from 2 radii on, 4, 8, ...
CELLS = SIDE * SIDE
ANY, FIRST = 0, 1  # rows of the tables: with all orientations possible; the first of the first level
WIDER = 1.01  # radii, so that rounding and normals of a length not quite 1 do not matter
MARGIN = 1e-6  # metres, far more than rounding moves a depth


class Part(NamedTuple):
    """The cameras of a rig that are alike: M mounts around C centres, and D orientations of the body."""

    sight: Any
    """The model compiled for these cameras."""
    horizon: float
    """How far from the body's origin a landmark may matter, metres."""
    centres: np.ndarray
    """`(C, 3)` from the body's origin, world frame, metres."""
    radius: np.ndarray
    """`(C,)` of the cameras around each, metres."""
    mounts: np.ndarray
    """`(C + 1,)` the first mount of each centre, and the number of mounts."""
    offsets: np.ndarray
    """`(M, 3, 64 W)` of the cameras from the body's origin with each orientation, world frame, metres."""
    axes: np.ndarray
    """`(M, 6, 64 W)` their optical axes and right."""
    depths: np.ndarray
    """`(M, 64 W)` how far along its axis each camera is from its centre, metres."""
    places: np.ndarray
    """`(G, 3)` all distinct offsets."""
    place: np.ndarray
    """`(M, 64 W)` which of them each is."""
    tables: np.ndarray
    """`(1 + levels * cells, 2 M W)` orientations that have a direction from the centre in view for certain, for each
    mount, then those that may, see `fill_tables`: side by side, as they are looked up together."""


def parts_of(scene: Scene) -> tuple[Part, ...]:
    """The rig of a scene in parts, one for each kind of camera; none for a scene with a single camera."""
    if not isinstance(scene.camera, Rig):
        return ()
    cameras, (offsets, axes) = scene.camera.cameras, scene.camera.views(scene.orientations.axes)
    kinds = dict.fromkeys(cameras)
    return tuple(
        _part(scene.visibility.sight(kind), offsets[mounts], axes[mounts])
        for kind in kinds
        for mounts in [[m for m, camera in enumerate(cameras) if camera == kind]]
    )


def _part(sight: Any, offsets: FloatArray, axes: FloatArray) -> Part:
    """Mounts with the `offsets` `(M, D, 3)` and the `axes` `(M, D, 6)`."""
    middle = np.round((offsets.min(axis=1) + offsets.max(axis=1)) / 2.0, 9)
    centres, centre = np.unique(middle, axis=0, return_inverse=True)
    order = np.argsort(centre.reshape(-1), kind="stable")
    centre, offsets, axes = centre.reshape(-1)[order], offsets[order], axes[order]
    around = offsets - centres[centre][:, None]
    radius = np.zeros(len(centres))
    np.maximum.at(radius, centre, np.linalg.norm(around, axis=2).max(axis=1))
    radius = np.where(radius > 0.0, WIDER * radius + MARGIN, 0.0)
    places, place = np.unique(offsets.reshape(-1, 3), axis=0, return_inverse=True)
    turned, levels = in_words(np.swapaxes(axes, 1, 2)), LEVELS if radius.any() else 1
    words = turned.shape[2] // BITS
    found = np.zeros((FIRST + levels * CELLS, 2, len(axes), words), dtype=np.uint64)
    for m, shift in enumerate(in_words(np.swapaxes(around, 1, 2))):
        found[ANY, 1, m] = _all_of(offsets.shape[1], words)
        for level in range(levels):
            rows = slice(FIRST + level * CELLS, FIRST + (level + 1) * CELLS)
            certain, possible = np.zeros((2, CELLS, words), dtype=np.uint64)
            _fill_level(sight, turned[m], shift, radius[centre[m]], level, certain=certain, possible=possible)
            found[rows, 0, m], found[rows, 1, m] = certain, possible
    return Part(
        sight=sight,
        horizon=_horizon(sight, offsets.reshape(-1, 3)),
        centres=centres,
        radius=radius,
        mounts=np.searchsorted(centre, np.arange(len(centres) + 1)),
        offsets=in_words(np.swapaxes(offsets, 1, 2)),
        axes=turned,
        depths=in_words((axes[:, :, :3] * around).sum(axis=2)),
        places=places,
        place=in_words(place.reshape(offsets.shape[:2])),
        tables=found.reshape(len(found), -1),
    )


def _horizon(sight: Any, offsets: FloatArray) -> float:
    return horizon_of(sight) + float(np.linalg.norm(offsets, axis=1).max()) + MARGIN


def with_sight(part: Part, sight: Any) -> Part:
    """The same cameras with a variant of the model of sight, such as `Sight.unhidden`."""
    return part._replace(sight=sight, horizon=_horizon(sight, part.places))


def _all_of(size: int, words: int) -> np.ndarray:
    """The set `(W,)` of the first so many orientations."""
    return np.array([(1 << min(max(size - BITS * w, 0), BITS)) - 1 for w in range(words)], dtype=np.uint64)


def _fill_level(
    sight: Any, axes: FloatArray, shift: FloatArray, radius: float, level: int, **tables: np.ndarray
) -> None:
    """Fill the tables for distances from 2^(level + 1) radii on, twice as far at most but at the last level."""
    if radius == 0.0:
        fill_tables(sight, axes, 0.0 * shift, 0.0, 0.0, **tables)
        return
    nearest, farthest = 0.5 ** (level + 1), 0.5 ** (level + 2) if level < LEVELS - 1 else 0.0  # radii per distance
    middle = (nearest + farthest) / 2.0
    fill_tables(sight, axes, middle / radius * shift, nearest, nearest - middle, **tables)


@inlined
def bounds_from(part, c, k, x, y, z, nx, ny, nz):
    """What landmark k at the offset (x, y, z) from centre c is like for the cameras there.

    Returns:
        reached, most, start, sure: see `criteria.from_around`.
    """
    if part.radius[c] > 0.0:
        reached, most, start, sure = from_around(sized(part.sight, k), x, y, z, nx, ny, nz, part.radius[c])
    else:
        reached, low, most, sure = from_position(sized(part.sight, k), x, y, z, nx, ny, nz, 0.0)
        start = -math.inf if sure == math.inf else low
    return reached, most, start, sure


@inlined
def row_from(part, c, x, y, z):
    """The row of the tables for an offset from centre c; asks for it."""
    levels, level, squared = (len(part.tables) - FIRST) // CELLS, -1, x * x + y * y + z * z
    for i in range(LEVELS):
        level += squared >= part.radius[c] * part.radius[c] * 4.0 ** (i + 1)
    row = ANY if level < 0 else FIRST + min(level, levels - 1) * CELLS + cell_of(x, y, z)
    prefetch(part.tables, row * part.tables.shape[1])
    return np.uint64(row)


@inlined
def split(part, m, w, asked, words, x, y, z, most, start, sure, row):
    """Split the `asked` orientations of word w into those with which mount m surely covers a landmark, and undecided.

    `words` is how many there are; the rest is what `bounds_from` and `row_from` say.
    """
    at, half = np.uint64(m) * words + w, np.uint64(part.tables.shape[1] // 2)
    certain = part.tables[row, at] & asked if sure > -math.inf else ZERO
    left = part.tables[row, half + at] & asked
    if sure == math.inf and start == -math.inf:
        return certain, left & ~certain
    within, well = ZERO, ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            one, two = np.uint32(0), np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                depth = part.axes[m, 0, a] * x + part.axes[m, 1, a] * y + part.axes[m, 2, a] * z - part.depths[m, a]
                one |= np.uint32(depth <= most + MARGIN) << np.uint32(lane)
                two |= np.uint32((depth >= start + MARGIN) & (depth <= sure - MARGIN)) << np.uint32(lane)
            within, well = within | np.uint64(one) << first, well | np.uint64(two) << first
    certain &= well & within
    return certain, left & within & ~certain


@inlined
def covers_from(part, m, a, k, px, py, pz, lx, ly, lz, nx, ny, nz, frame):
    """Whether mount m covers landmark k at (lx, ly, lz) with orientation a of the body at (px, py, pz)."""
    offsets = part.offsets
    x = lx - (px + offsets[m, 0, a])
    y = ly - (py + offsets[m, 1, a])
    z = lz - (pz + offsets[m, 2, a])
    sight = sized(part.sight, k)
    reached, low, high, sure = from_position(sight, x, y, z, nx, ny, nz, 0.0)
    return reached and covers_one(sight, x, y, z, frame, low, high, sure, False, part.axes[m], a)


@inlined
def hides_from(part, m, a, i, k, px, py, pz, one, other):
    """Whether landmark i, `one`, hides k, the `other`, six numbers each, from mount m, the body turned as in a."""
    offsets = part.offsets
    sx, sy, sz = px + offsets[m, 0, a], py + offsets[m, 1, a], pz + offsets[m, 2, a]
    ax, ay, az, ux, uy, uz = one
    bx, by, bz, vx, vy, vz = other
    ax, ay, az, bx, by, bz = ax - sx, ay - sy, az - sz, bx - sx, by - sy, bz - sz
    first, second = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    mine, theirs = sized(part.sight, i), sized(part.sight, k)
    hides, _ = hide(mine, theirs, ax, ay, az, first, bx, by, bz, second, ux, uy, uz, vx, vy, vz)
    return hides


@inlined
def may_hide_around(ax, ay, az, bx, by, bz, radius, width):
    """Whether a landmark at the offset a hides one at b, or b hides a, from some camera within the radius.

    From a camera delta away the offsets a' = a - delta, b' = b - delta have the cross product a x b - delta x (b - a).
    One hides the other only within `width` = sqrt(reach) of the line of sight, if |a' x b'| <= width max(|a'|, |b'|).
    """
    ex, ey, ez = bx - ax, by - ay, bz - az
    cx, cy, cz = ay * ez - az * ey, az * ex - ax * ez, ax * ey - ay * ex
    longest = math.sqrt(max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz))
    apart = math.sqrt(ex * ex + ey * ey + ez * ez)
    return cx * cx + cy * cy + cz * cz <= line_room(longest, apart, radius, width)


@inlined
def line_room(longest, apart, radius, width):
    """The square of |a x b| up to which `may_hide_around`, for the longer of the two offsets and |b - a|."""
    room = (width * (longest + radius) + radius * apart) * (1.0 + SINGLE_ERROR) + SINGLE_ERROR
    return room * room


@inlined
def _look_around(part, c, view, count, px, py, pz, start):
    """Find what the first `count` landmarks of `view` are like from centre c of a body at (px, py, pz)."""
    near, x, y, z, squared, high, deep, reached = (
        view.near, view.x, view.y, view.z, view.squared, view.high, view.deep, view.reached
    )  # fmt: skip
    u, v, w, close = view.u, view.v, view.w, view.close
    cx, cy, cz, radius = px + part.centres[c, 0], py + part.centres[c, 1], pz + part.centres[c, 2], part.radius[c]
    for k in range(count):
        xk, yk, zk = near[0, k] - cx, near[1, k] - cy, near[2, k] - cz
        in_reach, most, begin, sure = bounds_from(
            part, c, view.who[k], xk, yk, zk, near[3, k], near[4, k], near[5, k]
        )  # fmt: skip
        x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
        reached[k], high[k], start[k], deep[k] = in_reach, most, begin, sure
    if part.sight.reach >= 0.0:
        width = math.sqrt(part.sight.reach)
        for k in range(count):
            distance = math.sqrt(squared[k])
            scale = 0.0 if distance == 0.0 else 1.0 / distance
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            # The sine of the angle to a landmark that it may hide, see `_is_suspect`.
            close[k] = width / (distance - radius) + radius * scale if distance > radius + width else 2.0


@inlined
def _is_suspect(j, k, mine, view):
    """Whether landmark j may hide landmark k from some camera, in single precision; so k itself.

    Seen from elsewhere within the radius, the direction of a landmark at the distance d turns by at most
    asin(radius / d), and it hides within asin(width / (d - radius)): the `sine` of the angle is at most the sum of both
    for the landmark that hides, and of the first, `mine`, for the other.
    """
    u, v, w = view.u, view.v, view.w
    cosine, sine = u[j] * u[k] + v[j] * v[k] + w[j] * w[k], view.close[j] + mine
    return cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR)


@inlined
def _turn(k, view, radius):
    """The sine of the angle by which the direction of landmark k may turn, single precision."""
    return np.float32(min(radius / math.sqrt(view.squared[k]), 1.0) if view.squared[k] > 0.0 else 1.0)


@inlined
def _find_suspects(k, view, count, radius, close):
    """Find the landmarks that may hide landmark k, as bits of `close` `(blocks, )`; returns whether there are any."""
    mine, some = _turn(k, view, radius), np.uint32(0)
    for b in range((count + BLOCK - 1) // BLOCK):
        found = np.uint32(0)
        for lane in range(np.uint64(BLOCK)):
            j = np.uint64(b * BLOCK) + lane
            found |= np.uint32(_is_suspect(j, k, mine, view)) << np.uint32(lane)
        if b == k // BLOCK:
            found &= ~(np.uint32(1) << np.uint32(k % BLOCK))
        if b == count // BLOCK:  # what fills up is close to all
            found &= (np.uint32(1) << np.uint32(count % BLOCK)) - np.uint32(1)
        close[b] = found
        some |= found
    return some != 0


@inlined
def _list_rivals(k, view, radius, width, close, blocks, rivals):
    """List those of so many blocks of suspects that may indeed hide landmark k; returns how many."""
    x, y, z, kept = view.x, view.y, view.z, 0
    for b in range(blocks):
        left = np.uint64(close[b])
        while left:
            j = b * BLOCK + np.int64(lowest(left))
            left &= left - ONE
            rivals[kept] = j
            kept += may_hide_around(x[j], y[j], z[j], x[k], y[k], z[k], radius, width)
    return kept


@inlined
def _pose(poses, k):
    """Position and normal of landmark k of `poses` `(6, K)`."""
    return poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]


@kernel
def _see(positions, part, obstacles, landmarks, normals, slack, n, keep, seen):
    """Add to `seen` what the cameras of a part cover.

    Args:
        positions: of the body, neighbours in blocks, `(P, 3)`, metres.
        part: where its sight says that none hides another, each landmark is seen on its own.
        obstacles: what of the room stands in the way of the places around each position, see `obstacles`, `(P G)`.
        landmarks, normals: `(1, 3, K)`.
        slack: see `criteria.from_position`, `(K,)` metres; what blocks a landmark with slack is not asked.
        n, keep: where n landmarks are covered, others are left out unless `keep` is set.
        seen: sets of orientations, `(P, K, W)`.
    """
    sight, words, total = part.sight, np.uint64(seen.shape[2]), landmarks.shape[2]
    poses, names, order = np.empty((6, total)), np.arange(total), np.arange(len(positions))
    clear, ends, view = is_clear(obstacles), no_ends(obstacles, total), viewpoint_for(total)
    for k in range(total):
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[0, i, k], normals[0, i, k]
        if not clear:
            lx, ly, lz, nx, ny, nz = _pose(poses, k)
            find_ends(obstacles, sized(sight, k), lx, ly, lz, nx, ny, nz, ends, k)
    near, x, y, z, reached, who, shown = view.near, view.x, view.y, view.z, view.reached, view.who, view.shown
    high, deep, size = view.high, view.deep, len(part.places)
    start, row, suspects = np.empty(total), np.empty(total, np.uint64), np.empty(total + 1, np.int64)
    close = np.zeros((total, total // BLOCK + 1), np.uint32)
    some, doubtful = np.empty((n, words), dtype=np.uint64), np.empty(total, dtype=np.bool_)
    mounts = len(part.axes)
    undecided, sure = np.empty((total, mounts, words), np.uint64), np.empty((total, mounts, words), np.uint64)
    loose, width = slack.max() > 0.0, math.sqrt(max(sight.reach, 0.0))
    many = count = 0
    for p in range(len(positions)):
        many, count = gather_near(p, 0, len(order), order, positions, part.horizon, many, count, poses, names, view)
        px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
        some[:] = ZERO
        if loose:
            for k in range(count):
                _see_loosely(part, px, py, pz, near, k, who[k], slack[who[k]], seen[p, who[k]])
        for c in range(len(part.centres)):
            _look_around(part, c, view, count, px, py, pz, start)
            radius = part.radius[c]
            begin, end, listed, blocks = part.mounts[c], part.mounts[c + 1], 0, (count + BLOCK - 1) // BLOCK
            for k in range(count):
                if reached[k] and not (loose and slack[who[k]] > 0.0):
                    shown[listed], row[k] = k, row_from(part, c, x[k], y[k], z[k])
                    listed += 1
            found, listed = listed, 0
            for e in range(found):
                k = shown[e]
                some_left, name = ZERO, who[k]
                for m in range(begin, end):
                    for w in range(words):
                        sure[k, m, w], undecided[k, m, w] = split(
                            part, m, w, ALL, words, x[k], y[k], z[k], high[k], start[k], deep[k], row[k]
                        )
                        some_left |= sure[k, m, w] | undecided[k, m, w]
                if some_left == ZERO:
                    continue
                doubtful[k] = sight.reach >= 0.0 and _find_suspects(k, view, count, radius, close[k])
                doubtful[k] |= not clear
                shown[listed] = k
                listed += 1
                for w in range(words):
                    cap = seen[p, name, w]
                    for m in range(begin, end if not doubtful[k] else begin):
                        cap |= sure[k, m, w]
                    seen[p, name, w] = cap
                    if not keep:
                        _add_to(some, w, cap)
            for e in range(listed):
                k = shown[e]
                name, rivals = who[k], -1
                lx, ly, lz, nx, ny, nz = _pose(near, k)
                frame = frame_of(sized(sight, name), nx, ny, nz)
                for m in range(begin, end):
                    for w in range(words):
                        mine, left, cap = seen[p, name, w], undecided[k, m, w], ZERO
                        if doubtful[k]:
                            left |= sure[k, m, w]
                        left &= ~mine if keep else ~(mine | some[n - 1, w])
                        if left and rivals < 0:
                            rivals = 0
                            if doubtful[k] and sight.reach >= 0.0:
                                rivals = _list_rivals(k, view, radius, width, close[k], blocks, suspects)
                        if clear and rivals == 0:
                            cap = left & sure[k, m, w]
                            left &= ~cap
                        while left:
                            bit = lowest(left)
                            a = w * np.uint64(BITS) + bit
                            left &= left - ONE
                            if (undecided[k, m, w] >> bit & ONE) != ZERO and not covers_from(
                                part, m, a, name, px, py, pz, lx, ly, lz, nx, ny, nz, frame
                            ):
                                continue
                            if not clear and is_blocked(obstacles, sight, p * size + part.place[m, a], ends, name):
                                continue
                            hidden = False
                            for i in range(rivals):
                                one, other = _pose(near, suspects[i]), (lx, ly, lz, nx, ny, nz)
                                if hides_from(part, m, a, who[suspects[i]], name, px, py, pz, one, other):
                                    hidden = True
                                    break
                            if not hidden:
                                cap |= ONE << bit
                        if cap:
                            seen[p, name, w] = mine | cap
                            if not keep:
                                _add_to(some, w, cap)
            if not keep:
                some[:] = ZERO


@inlined
def _add_to(some, w, cap):
    """Count the orientations of a set of word w in `some` `(n, W)`, of those that cover at least 1, 2, ... n."""
    for j in range(len(some) - 1, 0, -1):
        some[j, w] |= some[j - 1, w] & cap
    some[0, w] |= cap


@inner
def _see_loosely(part, px, py, pz, near, k, name, slack, seen):
    """Add to `seen` `(W,)` the orientations that cover some landmark within `slack` metres of landmark k of `near`.

    `name` is which that is in the deployment.
    """
    sight = sized(part.sight, name)
    lx, ly, lz, nx, ny, nz = near[0, k], near[1, k], near[2, k], near[3, k], near[4, k], near[5, k]
    if slack == 0.0:
        return
    for m in range(len(part.axes)):
        axes = part.axes[m]
        for w in range(np.uint64(len(seen))):
            left = part.tables[ANY, (len(part.axes) + m) * len(seen) + np.int64(w)]
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                left &= left - ONE
                x = lx - (px + part.offsets[m, 0, a])
                y = ly - (py + part.offsets[m, 1, a])
                z = lz - (pz + part.offsets[m, 2, a])
                reached, low, _, _ = from_position(sight, x, y, z, nx, ny, nz, slack)
                if reached and covers(sight, x, y, z, nx, ny, nz, low, slack, axes, a):
                    seen[w] |= ONE << bit


def seen_by(
    parts: tuple[Part, ...],
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
    n: int = 0,
) -> np.ndarray:
    """Sets of the orientations with which some camera covers each landmark, `(P, K, W)`.

    Args:
        parts: the rig.
        blockers: of the room.
        positions: of the body, `(P, 3)`, metres.
        landmarks, normals, slack: `(K, 3)` and `(K,)`, see `_see`.
        n: if it is not 0, where n landmarks are in view, others are left out.
    """
    points, directions = (for_kernels(v.T[None]) for v in (landmarks, normals))
    seen = np.zeros((len(positions), len(landmarks), parts[0].axes.shape[2] // BITS), dtype=np.uint64)
    for part in parts:
        obstacles = obstacles_at(blockers, places_around(positions, part) if blockers is not None else positions)
        part = part._replace(horizon=part.horizon + float(slack.max(initial=0.0)))
        _see(positions, part, obstacles, points, directions, slack, max(n, 1), n == 0, seen)
    return seen


def places_around(positions: FloatArray, part: Part) -> FloatArray:
    """Where cameras are: the places of a position one after the other, `(P G, 3)`, metres."""
    return np.asarray((positions[:, None] + part.places).reshape(-1, 3))
