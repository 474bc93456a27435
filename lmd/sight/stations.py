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

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, in_words, lowest
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
NONE, ANY, FIRST = 0, 1, 2  # rows of the tables: no orientation, all; the first of the first level
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
    certain: np.ndarray
    """`(M, 2 + levels * cells, W)` orientations that have a direction from the centre in view, see `fill_tables`."""
    possible: np.ndarray
    """The same of those that may."""


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
    certain, possible = np.zeros((2, len(axes), FIRST + levels * CELLS, words), dtype=np.uint64)
    for m, shift in enumerate(in_words(np.swapaxes(around, 1, 2))):
        possible[m, ANY] = _all_of(offsets.shape[1], words)
        for level in range(levels):
            rows = slice(FIRST + level * CELLS, FIRST + (level + 1) * CELLS)
            filled = {"certain": certain[m, rows], "possible": possible[m, rows]}
            _fill_level(sight, turned[m], shift, radius[centre[m]], level, **filled)
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
        certain=certain,
        possible=possible,
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
def look_from(part, c, x, y, z, nx, ny, nz):
    """What a landmark at the offset (x, y, z) from centre c is like for the cameras there.

    Returns:
        reached, least, most, start, sure: see `criteria.from_around`; the rows of `certain` and `possible`.
    """
    radius, levels, sight = part.radius[c], np.int32((part.certain.shape[1] - FIRST) // CELLS), part.sight
    distance = math.sqrt(x * x + y * y + z * z)
    level = np.int32(-1)
    for i in range(LEVELS):
        level += np.int32(distance >= radius * 2.0 ** (i + 1))
    if radius > 0.0:
        reached, least, most, start, sure = from_around(sight, x, y, z, nx, ny, nz, radius)
    else:
        reached, least, most, sure = from_position(sight, x, y, z, nx, ny, nz, 0.0)
        start = -math.inf if sure == math.inf else least
    row = np.int32(FIRST) + min(level, levels - np.int32(1)) * np.int32(CELLS) + cell_of(x, y, z)
    row = row if level >= 0 else np.int32(ANY)
    return reached, least, most, start, sure, row if (level >= 0) & (sure > -math.inf) else np.int32(NONE), row


@inlined
def split(part, m, w, asked, x, y, z, least, most, start, sure, given, row):
    """Split the `asked` orientations of word w into those with which mount m surely covers a landmark, and undecided.

    The rest is what `look_from` says.
    """
    certain = part.certain[m, given, w] & asked
    left = part.possible[m, row, w] & asked
    if sure == math.inf and start == -math.inf:
        return certain, left & ~certain
    within, well = ZERO, ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            one, two = np.uint32(0), np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                depth = part.axes[m, 0, a] * x + part.axes[m, 1, a] * y + part.axes[m, 2, a] * z - part.depths[m, a]
                one |= np.uint32((depth >= least - MARGIN) & (depth <= most + MARGIN)) << np.uint32(lane)
                two |= np.uint32((depth >= start + MARGIN) & (depth <= sure - MARGIN)) << np.uint32(lane)
            within, well = within | np.uint64(one) << first, well | np.uint64(two) << first
    certain &= well & within
    return certain, left & within & ~certain


@inlined
def covers_from(part, m, a, px, py, pz, lx, ly, lz, nx, ny, nz, frame):
    """Whether mount m covers the landmark at (lx, ly, lz) with orientation a of the body at (px, py, pz)."""
    offsets = part.offsets
    x = lx - (px + offsets[m, 0, a])
    y = ly - (py + offsets[m, 1, a])
    z = lz - (pz + offsets[m, 2, a])
    reached, low, high, sure = from_position(part.sight, x, y, z, nx, ny, nz, 0.0)
    return reached and covers_one(part.sight, x, y, z, frame, low, high, sure, False, part.axes[m], a)


@inlined
def hides_from(part, m, a, px, py, pz, one, other):
    """Whether landmark `one` hides the `other`, six numbers each, from mount m with orientation a of the body."""
    offsets = part.offsets
    sx, sy, sz = px + offsets[m, 0, a], py + offsets[m, 1, a], pz + offsets[m, 2, a]
    ax, ay, az, ux, uy, uz = one
    bx, by, bz, vx, vy, vz = other
    ax, ay, az, bx, by, bz = ax - sx, ay - sy, az - sz, bx - sx, by - sy, bz - sz
    first, second = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    hides, _ = hide(part.sight, ax, ay, az, first, bx, by, bz, second, ux, uy, uz, vx, vy, vz)
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
    room = width * (longest + radius) + radius * math.sqrt(ex * ex + ey * ey + ez * ez)
    room = room * (1.0 + SINGLE_ERROR) + SINGLE_ERROR
    return cx * cx + cy * cy + cz * cz <= room * room


@inlined
def _look_around(part, c, view, count, px, py, pz, start, narrow):
    """Find what the first `count` landmarks of `view` are like from centre c of a body at (px, py, pz)."""
    near, x, y, z, squared, low, high, deep = (
        view.near, view.x, view.y, view.z, view.squared, view.low, view.high, view.deep
    )  # fmt: skip
    bottom, top, reached, u, v, w, close = view.bottom, view.top, view.reached, view.u, view.v, view.w, view.close
    cx, cy, cz, radius = px + part.centres[c, 0], py + part.centres[c, 1], pz + part.centres[c, 2], part.radius[c]
    for k in range(count):
        xk, yk, zk = near[0, k] - cx, near[1, k] - cy, near[2, k] - cz
        in_reach, least, most, begin, sure, given, row = look_from(
            part, c, xk, yk, zk, near[3, k], near[4, k], near[5, k]
        )
        x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
        reached[k], low[k], high[k], start[k], deep[k], bottom[k], top[k] = (
            in_reach, least, most, begin, sure, given, row
        )  # fmt: skip
    if part.sight.reach >= 0.0:
        width = math.sqrt(part.sight.reach)
        for k in range(count):
            here = squared[k] <= radius * radius
            scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            # The sine of the angle between two directions is at most the sum of these, see `_list_suspects`.
            narrow[k] = 1.0 if here else min(radius * scale, 1.0)
            beyond = math.sqrt(squared[k]) - radius
            close[k] = 2.0 if here or width >= beyond else width / beyond + narrow[k]


@inlined
def _list_suspects(k, view, count, narrow, suspects):
    """List the landmarks that may hide landmark k from some camera; returns how many.

    The direction of a landmark at the distance d turns by at most asin(radius / d), and it hides within
    asin(width / (d - radius)).
    """
    u, v, w, close = view.u, view.v, view.w, view.close
    uk, vk, wk, mine, found = u[k], v[k], w[k], np.float32(narrow[k]), np.int32(0)
    padded = (count + BLOCK - 1) & -BLOCK
    for j in range(np.uint64(padded)):
        cosine = u[j] * uk + v[j] * vk + w[j] * wk
        sine = close[j] + mine
        found += np.int32(cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR))
    if found <= 1 + padded - count:  # itself, and those that fill up
        return 0
    found = np.int32(0)
    for j in range(count):
        cosine = u[j] * uk + v[j] * vk + w[j] * wk
        sine = close[j] + mine
        suspects[found] = j
        found += np.int32((cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR)) & (j != k))
    return found


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
            find_ends(obstacles, sight, lx, ly, lz, nx, ny, nz, ends, k)
    near, x, y, z, reached, who = view.near, view.x, view.y, view.z, view.reached, view.who
    start, narrow, suspects, size = np.empty(total), np.empty(total), np.empty(total + 1, np.int64), len(part.places)
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
                _see_loosely(part, px, py, pz, near, k, slack[who[k]], seen[p, who[k]])
        for c in range(len(part.centres)):
            _look_around(part, c, view, count, px, py, pz, start, narrow)
            radius = part.radius[c]
            for k in range(count):
                name = who[k]
                if slack[name] > 0.0:
                    reached[k] = False
                    continue
                found, any_left = ZERO, ZERO
                doubtful[k] = not clear
                if reached[k]:
                    for m in range(part.mounts[c], part.mounts[c + 1]):
                        for w in range(words):
                            sure[k, m, w], undecided[k, m, w] = split(
                                part, m, w, ALL, x[k], y[k], z[k], view.low[k], view.high[k], start[k], view.deep[k],
                                view.bottom[k], view.top[k],
                            )  # fmt: skip
                            found |= sure[k, m, w]
                            any_left |= undecided[k, m, w]
                    reached[k] = (found | any_left) != ZERO
                    if reached[k] and sight.reach >= 0.0:
                        doubtful[k] |= _list_suspects(k, view, count, narrow, suspects) > 0
                for w in range(words):
                    if reached[k] and not doubtful[k]:
                        for m in range(part.mounts[c], part.mounts[c + 1]):
                            seen[p, name, w] |= sure[k, m, w]
                    if not keep:
                        _add_to(some, w, seen[p, name, w])
            for k in range(count):
                if not reached[k]:
                    continue
                name, first = who[k], True
                listed = 0
                lx, ly, lz, nx, ny, nz = _pose(near, k)
                frame = frame_of(sight, nx, ny, nz)
                for m in range(part.mounts[c], part.mounts[c + 1]):
                    for w in range(words):
                        mine, left = seen[p, name, w], undecided[k, m, w]
                        if doubtful[k]:
                            left |= sure[k, m, w]
                        left &= ~mine
                        if not keep:
                            left &= ~some[n - 1, w]
                        if left and first and doubtful[k] and sight.reach >= 0.0:
                            first = False
                            for i in range(_list_suspects(k, view, count, narrow, suspects)):
                                j = suspects[i]
                                suspects[listed] = j
                                listed += may_hide_around(x[j], y[j], z[j], x[k], y[k], z[k], radius, width)
                        cap = ZERO
                        while left:
                            bit = lowest(left)
                            a = w * np.uint64(BITS) + bit
                            left &= left - ONE
                            if (undecided[k, m, w] >> bit & ONE) != ZERO and not covers_from(
                                part, m, a, px, py, pz, lx, ly, lz, nx, ny, nz, frame
                            ):
                                continue
                            if not clear and is_blocked(obstacles, sight, p * size + part.place[m, a], ends, name):
                                continue
                            hidden = False
                            for i in range(listed):
                                one = _pose(near, suspects[i])
                                if hides_from(part, m, a, px, py, pz, one, (lx, ly, lz, nx, ny, nz)):
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
def _see_loosely(part, px, py, pz, near, k, slack, seen):
    """Add to `seen` `(W,)` the orientations that cover some landmark within `slack` metres of landmark k of `near`."""
    lx, ly, lz, nx, ny, nz = near[0, k], near[1, k], near[2, k], near[3, k], near[4, k], near[5, k]
    if slack == 0.0:
        return
    for m in range(len(part.axes)):
        axes = part.axes[m]
        for w in range(np.uint64(len(seen))):
            left = part.possible[m, ANY, w]
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                left &= left - ONE
                x = lx - (px + part.offsets[m, 0, a])
                y = ly - (py + part.offsets[m, 1, a])
                z = lz - (pz + part.offsets[m, 2, a])
                reached, low, _, _ = from_position(part.sight, x, y, z, nx, ny, nz, slack)
                if reached and covers(part.sight, x, y, z, nx, ny, nz, low, slack, axes, a):
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
    return (positions[:, None] + part.places).reshape(-1, 3)
