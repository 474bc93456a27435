"""Positions of the cameras of a rig (`lmd.scene.rig`), and compiled tests of the landmarks that these cameras cover.

A camera with a lever arm has another position for every orientation of the body, but stays within a radius of a
*centre*. Two bounds hold for all these positions:

- `criteria.from_around` bounds the depths of a landmark, given its offset from the centre.
- Tables of directions bound the orientations. The tables are shifted for each orientation
  (`lmd.sight.directions.fill_tables`); there is one table for each of `LEVELS` ranges of distance.

The bounds decide most orientations of most landmarks. The other orientations are tested one by one from the exact
position of the camera with the operations of the reference, so the result is exact. Most occlusions between landmarks
are excluded by a bound around the centre, too.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, Integer, in_words, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.geometry.vectors import Vector, column3, dot3, minus3
from lmd.scene.criteria import covers_one, from_around, from_position, horizon_of, sized
from lmd.scene.scene import Scene
from lmd.sight.directions import SIDE, cell_of, fill_tables
from lmd.sight.obstacles import is_blocked

LEVELS = 6  # number of ranges of distance; they begin at 2, 4, 8, ... radii
CELLS = SIDE * SIDE  # number of cells of directions
ANY, FIRST = 0, 1  # rows of the tables: all orientations possible; first cell of the first level
RADIUS_FACTOR = 1.01  # safety factor of the radius, for rounding and for axes that are not exactly unit vectors
MARGIN = 1e-6  # safety margin of depths and distances, metres, above their rounding errors


class MountGroup(NamedTuple):
    """M mounts of a rig with equal cameras; each camera stays near one of C centres when the body turns.

    The body has D orientations; a set of orientations is a bit set of W words of 64 bits.
    """

    number: int
    """Index of the group in the rig."""
    sight: Any
    """Model of sight compiled for these cameras."""
    obstacles: Any
    """Obstacles of the room for the camera positions, see `places_around`; None before a kernel is called."""
    horizon: float
    """Distance from the body's origin beyond which a landmark has no effect, metres."""
    centres: np.ndarray
    """`(C, 3)` offsets of the centres from the body's origin, world frame, metres."""
    radius: np.ndarray
    """`(C,)` upper bound on the distance between each centre and the cameras around the centre, metres."""
    mounts: np.ndarray
    """`(C + 1,)` first mount of each centre: mounts `mounts[c]` to `mounts[c + 1] - 1` belong to centre c."""
    offsets: np.ndarray
    """`(M, 3, 64 W)` offset of each camera from the body's origin for each orientation, world frame, metres."""
    axes: np.ndarray
    """`(M, 6, 64 W)` optical axis and direction to the right in the image of each camera, unit vectors, world frame."""
    depths: np.ndarray
    """`(M, 64 W)` for each camera and orientation: coordinate of the camera along its optical axis, measured from the
    centre to which its mount belongs, metres.
    """
    places: np.ndarray
    """`(G, 3)` distinct offsets among `offsets`, metres."""
    place: np.ndarray
    """`(M, 64 W)` index in `places` of each offset."""
    tables: np.ndarray
    """`(1 + levels * cells, 2 M W)` sets of orientations for each direction of a landmark from the centre, see
    `fill_tables`.

    A row has the certain sets of all mounts, then the possible sets, as both kinds of sets are read together.
    """


def mount_groups(scene: Scene) -> tuple[MountGroup, ...]:
    """Mounts of the scene's rig grouped by equal cameras; empty for a scene with a single camera."""
    if scene.rig is None:
        return ()
    cameras, (offsets, axes) = scene.rig.cameras, scene.rig.views(scene.orientations.axes)
    kinds = dict.fromkeys(cameras)
    return tuple(
        _group_of(number, scene.visibility.sight(kind), offsets[mounts], axes[mounts])
        for number, kind in enumerate(kinds)
        for mounts in [[m for m, camera in enumerate(cameras) if camera == kind]]
    )


def _group_of(number: int, sight: Any, offsets: FloatArray, axes: FloatArray) -> MountGroup:
    """Make the group of M mounts with equal cameras.

    Args:
        number: index of the group in the rig.
        sight: compiled model of sight of the cameras.
        offsets: offset of each camera from the body's origin for D orientations of the body, metres, `(M, D, 3)`.
        axes: optical axis and direction to the right in the image of each camera for these orientations, `(M, D, 6)`.
    """
    middle = np.round((offsets.min(axis=1) + offsets.max(axis=1)) / 2.0, 9)
    centres, centre = np.unique(middle, axis=0, return_inverse=True)
    order = np.argsort(centre.reshape(-1), kind="stable")
    centre, offsets, axes = centre.reshape(-1)[order], offsets[order], axes[order]
    around = offsets - centres[centre][:, None]
    radius = np.zeros(len(centres))
    np.maximum.at(radius, centre, np.linalg.norm(around, axis=2).max(axis=1))
    radius = np.where(radius > 0.0, RADIUS_FACTOR * radius + MARGIN, 0.0)
    places, place = np.unique(offsets.reshape(-1, 3), axis=0, return_inverse=True)
    turned, levels = in_words(np.swapaxes(axes, 1, 2)), LEVELS if radius.any() else 1
    words = turned.shape[2] // BITS
    found = np.zeros((FIRST + levels * CELLS, 2, len(axes), words), dtype=np.uint64)
    for m, shift in enumerate(in_words(np.swapaxes(around, 1, 2))):
        found[ANY, 1, m] = _all_of(offsets.shape[1], words)
        for level in range(levels):
            rows = slice(FIRST + level * CELLS, FIRST + (level + 1) * CELLS)
            certain, possible = np.zeros((2, CELLS, words), dtype=np.uint64)
            fill_tables(sight, turned[m], _shift_at(level, shift, radius[centre[m]]), certain, possible)
            found[rows, 0, m], found[rows, 1, m] = certain, possible
    return MountGroup(
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


def with_sight(group: MountGroup, sight: Any) -> MountGroup:
    """Copy of a mount group with another model of sight, such as one that ignores occlusion by landmarks."""
    return group._replace(sight=sight, horizon=_horizon(sight, group.places))


def places_around(positions: FloatArray, group: MountGroup) -> FloatArray:
    """Positions of the cameras for P positions of the body, metres, `(P G, 3)`.

    `MountGroup.places` has G different offsets of the cameras from the body's origin. Rows p G to p G + G - 1 of the
    result are position p of the body plus each offset.
    """
    return np.asarray((positions[:, None] + group.places).reshape(-1, 3))


def _all_of(size: int, words: int) -> np.ndarray:
    """Set of the first `size` orientations, as a bit set of `words` words of 64 bits."""
    return np.array([(1 << min(max(size - BITS * w, 0), BITS)) - 1 for w in range(words)], dtype=np.uint64)


def _shift_at(level: int, shift: FloatArray, radius: float) -> tuple[FloatArray, float, float]:
    """Make the argument `shift` of `fill_tables` for landmarks in one range of distances from the centre.

    The range is from 2^(level + 1) to 2^(level + 2) times `radius`; the last level has no upper limit. `shift`
    `(3, 64 W)` is the displacement of the camera from the centre for each orientation, metres.
    """
    if radius == 0.0:
        return 0.0 * shift, 0.0, 0.0
    nearest, farthest = 0.5 ** (level + 1), 0.5 ** (level + 2) if level < LEVELS - 1 else 0.0  # radii per distance
    middle = (nearest + farthest) / 2.0
    return middle / radius * shift, nearest, nearest - middle


@inlined
def bounds_from(group: Any, c: Integer, k: Integer, offset: Vector, normal: Vector) -> Any:
    """Bounds on the coverage of landmark k by the cameras around centre c, over all orientations.

    Args:
        offset: offset of the landmark from the centre, metres.
        normal: unit normal of the landmark.

    Returns:
        reached: False only if no camera covers the landmark.
        most: upper bound on the depth of a covered landmark, metres.
        start, sure: depths, metres. The landmark is covered if its depth is from `start` to `sure` and its image is at
            least `SightModel.inset` from the border of the field of view.
    """
    if group.radius[c] > 0.0:
        reached, most, start, sure = from_around(sized(group.sight, k), offset, normal, group.radius[c])
    else:
        reached, low, most, sure = from_position(sized(group.sight, k), offset, normal, 0.0)
        start = -math.inf if sure == math.inf else low
    return reached, most, start, sure


@inlined
def table_row(group: Any, c: Integer, offset: Vector) -> Any:
    """Index of the row of `MountGroup.tables` for a landmark at `offset` (metres) from centre c.

    The row is also prefetched into the processor's cache.
    """
    levels, level, squared = (len(group.tables) - FIRST) // CELLS, -1, dot3(offset, offset)
    for i in range(LEVELS):
        level += squared >= group.radius[c] * group.radius[c] * 4.0 ** (i + 1)
    row = ANY if level < 0 else FIRST + min(level, levels - 1) * CELLS + cell_of(offset)
    prefetch(group.tables, row * group.tables.shape[1])
    return np.uint64(row)


@inlined
def split_by_certainty(
    group: Any, m: Integer, w: Integer, asked: Any, words: Integer, offset: Vector, bounds: Vector, row: Integer
) -> Any:
    """Split orientations by bounds: coverage of a landmark is certain, needs the exact test, or is impossible.

    The camera on mount m must cover the landmark. Sets of orientations are bit sets, 64 orientations in a word; w is
    the index of this word.

    Args:
        asked: set of the orientations to split.
        words: number W of words of all orientations.
        offset: offset of the landmark from the centre, metres.
        bounds: `most`, `start` and `sure` of `bounds_from`.
        row: result of `table_row`.

    Returns:
        two sets: the orientations with certain coverage, and the orientations that need the exact test.
    """
    most, start, sure = bounds
    at, half = np.uint64(m) * words + w, np.uint64(group.tables.shape[1] // 2)
    certain = group.tables[row, at] & asked if sure > -math.inf else ZERO
    left = group.tables[row, half + at] & asked
    if sure == math.inf and start == -math.inf:
        return certain, left & ~certain
    within, well = ZERO, ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            one, two = np.uint32(0), np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                depth = dot3(column3(group.axes[m], a), offset) - group.depths[m, a]
                one |= np.uint32(depth <= most + MARGIN) << np.uint32(lane)
                two |= np.uint32((depth >= start + MARGIN) & (depth <= sure - MARGIN)) << np.uint32(lane)
            within, well = within | np.uint64(one) << first, well | np.uint64(two) << first
    certain &= well & within
    return certain, left & within & ~certain


@inlined
def camera_at(group: Any, m: Integer, a: Integer, body: Vector) -> Vector:
    """Position of the camera on mount m, metres, for the body with orientation a at the position `body`."""
    return body[0] + group.offsets[m, 0, a], body[1] + group.offsets[m, 1, a], body[2] + group.offsets[m, 2, a]


@inlined
def covers_from(group: Any, m: Integer, a: Integer, k: Integer, body: Vector, pose: Any, frame: Any) -> Any:
    """True if the camera on mount m covers landmark k, for the body with orientation a; the test is exact.

    Occlusion by other landmarks and by the room is ignored. `body` is the position of the body, metres. `pose` is the
    position and the unit normal of the landmark, and `frame` the result of `criteria.frame_of` for the landmark.
    """
    place, normal = pose
    offset, sight = minus3(place, camera_at(group, m, a, body)), sized(group.sight, k)
    reached, low, high, sure = from_position(sight, offset, normal, 0.0)
    return reached and covers_one(sight, offset, frame, (low, high, sure), False, group.axes[m], a)


@inlined
def covered_bits(group: Any, m: Integer, w: Integer, left: Any, k: Integer, body: Vector, pose: Any, frame: Any) -> Any:
    """Find those of the orientations in `left` at which the camera on mount m covers landmark k.

    `left` and the result are word w of bit sets of the body's orientations, with 64 orientations in a word. The other
    arguments are those of `covers_from`.
    """
    found = ZERO
    while left:
        bit = lowest(left)
        left &= left - ONE
        found |= np.uint64(covers_from(group, m, w * np.uint64(BITS) + bit, k, body, pose, frame)) << bit
    return found


@inlined
def blocked_bits(group: Any, m: Integer, w: Integer, left: Any, k: Integer, p: Integer, ends: Any, row: Integer) -> Any:
    """Find those of the orientations in `left` at which the room blocks landmark k from the camera on mount m.

    `left` and the result are word w of bit sets of the body's orientations, with 64 orientations in a word. The body is
    at position p. Row `row` of `ends` has the required points of the landmark, see `obstacles.find_ends`.
    """
    found, sight = ZERO, sized(group.sight, k)
    while left:
        bit = lowest(left)
        left &= left - ONE
        place = p * np.uint64(len(group.places)) + np.uint64(group.place[m, w * np.uint64(BITS) + bit])
        found |= np.uint64(is_blocked(group.obstacles, sight, place, ends, row)) << bit
    return found
