"""Where the cameras of a rig are, and whether they cover a landmark: the compiled side of `lmd.scene.rig`.

A camera with a translation is elsewhere for every orientation of the body, but never far from a *centre*, around which
the body turns it. So the landmarks are looked at from the centre once, with bounds that hold for all places within the
radius of the cameras there (`criteria.from_around`), and with tables of directions that are shifted for each
orientation (`lmd.sight.directions.fill_tables`), one for each range of distances, `LEVELS` of them. These settle most
orientations of most landmarks. The others are tested one by one, from where the camera then is, by the reference's
operations: nothing is approximated. Whether one landmark may hide another is likewise asked from the centre first.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, in_words, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.scene.criteria import covers_one, from_around, from_position, hide_between, horizon_of, sized
from lmd.scene.scene import Scene
from lmd.sight.blocks import SINGLE_ERROR
from lmd.sight.directions import SIDE, cell_of, fill_tables
from lmd.sight.obstacles import is_blocked

LEVELS = 6  # from 2 radii on, 4, 8, ...
CELLS = SIDE * SIDE
ANY, FIRST = 0, 1  # rows of the tables: with all orientations possible; the first of the first level
WIDER = 1.01  # radii, so that rounding and normals of a length not quite 1 do not matter
MARGIN = 1e-6  # metres, far more than rounding moves a depth


class Part(NamedTuple):
    """The cameras of a rig that are alike: M mounts around C centres, and D orientations of the body."""

    number: int
    """Index of the part in the rig."""
    sight: Any
    """The model compiled for these cameras."""
    obstacles: Any
    """Obstacles of the room before the places around some positions, see `obstacles`; None where none are looked at."""
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
    if scene.rig is None:
        return ()
    cameras, (offsets, axes) = scene.rig.cameras, scene.rig.views(scene.orientations.axes)
    kinds = dict.fromkeys(cameras)
    return tuple(
        _part(number, scene.visibility.sight(kind), offsets[mounts], axes[mounts])
        for number, kind in enumerate(kinds)
        for mounts in [[m for m, camera in enumerate(cameras) if camera == kind]]
    )


def _part(number: int, sight: Any, offsets: FloatArray, axes: FloatArray) -> Part:
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
        number=number,
        sight=sight,
        obstacles=None,
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


def places_around(positions: FloatArray, part: Part) -> FloatArray:
    """Where cameras are: the places of a position one after the other, `(P G, 3)`, metres."""
    return np.asarray((positions[:, None] + part.places).reshape(-1, 3))


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
def covered_bits(part, m, w, left, k, px, py, pz, lx, ly, lz, nx, ny, nz, frame):
    """Orientations of the set `left` of word w with which `covers_from`."""
    found = ZERO
    while left:
        bit = lowest(left)
        left &= left - ONE
        covered = covers_from(part, m, w * np.uint64(BITS) + bit, k, px, py, pz, lx, ly, lz, nx, ny, nz, frame)
        found |= np.uint64(covered) << bit
    return found


@inlined
def blocked_bits(part, m, w, left, k, p, ends, row):
    """Orientations of the set `left` of word w with which something of the room is before landmark k at position p.

    `ends` has its points in a `row`, see `obstacles.find_ends`.
    """
    found, sight = ZERO, sized(part.sight, k)
    while left:
        bit = lowest(left)
        left &= left - ONE
        place = p * np.uint64(len(part.places)) + np.uint64(part.place[m, w * np.uint64(BITS) + bit])
        found |= np.uint64(is_blocked(part.obstacles, sight, place, ends, row)) << bit
    return found


@inlined
def hidden_bits(part, m, w, left, i, k, px, py, pz, one, other):
    """Orientations of the set `left` of word w with which `hides_from`."""
    found = ZERO
    while left:
        bit = lowest(left)
        left &= left - ONE
        found |= np.uint64(hides_from(part, m, w * np.uint64(BITS) + bit, i, k, px, py, pz, one, other)) << bit
    return found


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
    hides, _ = hide_between(mine, theirs, ax, ay, az, first, bx, by, bz, second, ux, uy, uz, vx, vy, vz)
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
