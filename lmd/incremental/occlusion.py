"""Occlusion between a landmark that moves and the others: pairs of another landmark and a position.

Positions come in blocks of neighbours, and only those within the horizon of both landmarks count. Two stages, from
cheap to exact:

1. Seen from a whole block, most landmarks are so far off the direction of the place that no position of the block needs
   the exact test. Let m be the offset of the place a from the centre of the block, e = o - a the way from there to a
   landmark o. From a position delta away from the centre, a and o lie at a' = m - delta and o' = a' + e. One of them
   hides the other only within r = sqrt(reach) of the line of sight: if |a' x o'| <= r max(|a'|, |o'|). As
   a' x o' = m x e - delta x e, and the block fits into a box of half the size h, the first component of m x e is then
   at most

       h_y |e_z| + h_z |e_y| + r (|m| + |h| + |e|),

   and so on around. All landmarks are tested in single precision, and `SINGLE_ERROR` covers its rounding: each of
   the sums above is off by less than five roundings of 6e-8 of itself or of (|m| + |h|) |e|.
2. Those left are tested from each position by `note_neighbour`: for a camera by the inequalities of the reference, for
   a rig by a bound for all cameras around a centre, then by those inequalities with each orientation.

A camera is searched as a group of a rig with one centre, the position itself, and the radius 0.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import LANES, Integer, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.core.dispatch import dispatched
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.state import (
    AIMED,
    BLOCK_COUNT,
    BLOCKS,
    OTHERS,
    PAIR_COUNT,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    WANTED,
    WHERE,
    WHO,
)
from lmd.scene.criteria import TOLERANCE
from lmd.sight.blocks import SINGLE_ERROR

# Reasons to search around a place: a landmark leaves it, comes to it from another, or is counted for the first time.
# NumPy's: of Python's numbers each may be a type of its own for numba.
LEAVES, COMES, ARRIVES = np.int64(0), np.int64(1), np.int64(2)


@inlined
def line_radius(sight: Any) -> Any:
    """Greatest distance from a line of sight at which a landmark hides another, metres."""
    return math.sqrt(sight.reach) * (1.0 + SINGLE_ERROR) + TOLERANCE


@inner
def find_ways(
    ax: float, ay: float, az: float, poses: FloatArray, horizon: float, others: np.ndarray, ways: FloatArray
) -> Any:
    """List the landmarks within the horizon of (ax, ay, az), and the vectors to them; see `Scratch.ways`.

    Returns:
        their number, filled up to whole words.
    """
    count, most = poses.shape[1], np.float32(horizon * (1.0 + SINGLE_ERROR))
    for i in range(count):
        dx, dy, dz = poses[0, i] - ax, poses[1, i] - ay, poses[2, i] - az
        ways[0, i], ways[1, i], ways[2, i], ways[3, i] = dx, dy, dz, math.sqrt(dx * dx + dy * dy + dz * dz)
        others[i] = i
    if most < np.inf:
        count = 0
        for i in range(poses.shape[1]):
            dx, dy, dz, distance = ways[0, i], ways[1, i], ways[2, i], ways[3, i]
            others[count] = i
            ways[0, count], ways[1, count], ways[2, count], ways[3, count] = dx, dy, dz, distance
            count += distance <= most
    filled = (count + LANES - 1) & -LANES
    for i in range(count, filled):
        ways[3, i] = -np.inf  # nothing comes close to those that fill up
    return filled


@inlined
def near_line(
    start: Any, mx: float, my: float, mz: float, hx: Any, hy: Any, hz: Any, radius: float, ways: FloatArray
) -> Any:
    """Landmarks that pass the first stage above, as bits.

    Args:
        start: the first of `LANES`.
        mx, my, mz: offset of the place from the centre of the box.
        hx, hy, hz: half its sides.
        radius: from `line_radius`.
        ways: from `find_ways`.
    """
    far = math.sqrt(mx * mx + my * my + mz * mz) + math.sqrt(hx * hx + hy * hy + hz * hz)
    shift, slope = np.float32(radius * far), np.float32(radius + SINGLE_ERROR * far)
    ux, uy, uz = np.float32(mx), np.float32(my), np.float32(mz)
    close = np.uint32(0)
    for lane in range(np.uint64(LANES)):
        i = start + lane
        ex, ey, ez = ways[0, i], ways[1, i], ways[2, i]
        room = shift + slope * ways[3, i]
        near = abs(uy * ez - uz * ey) <= hz * abs(ey) + hy * abs(ez) + room
        near &= abs(uz * ex - ux * ez) <= hx * abs(ez) + hz * abs(ex) + room
        near &= abs(ux * ey - uy * ex) <= hy * abs(ex) + hx * abs(ey) + room
        close |= np.uint32(near) << np.uint32(lane)
    return close


@dispatched
def note_neighbour(
    state: Any, cameras: Any, c: Integer, b: Integer, i: Integer, k: Integer, how: Any, place: Any, box: Any,
    mine: Any, other: Any, field: Any, scratch: Any,
) -> None:  # fmt: skip
    """Find which of landmark i and landmark k at a `place` hides the other from block b, and note it down.

    Args:
        cameras: a `OneCamera`, or a `MountGroup` of a rig.
        c, b: centre of the cameras, and block of positions.
        how: `LEAVES`, `COMES` or `ARRIVES`.
        place: position and normal, six numbers.
        box: offset of the place from the centre of the block seen from c, metres, three numbers, and half the length
            of the box's diagonal.
        mine, other: what a state and a scratch have of the group of a rig.
    """


@inner
def search(cameras: Any, k: Integer, how: Any, mine: Any, other: Any, field: Any, state: Any, scratch: Any) -> None:
    """Find the landmarks that hide landmark k where it is or where it is tried, and those that it hides there."""
    boxes, poses, ways, width = field.boxes, state.poses, scratch.ways, line_radius(cameras.sight)
    blocks, others = scratch.lists[BLOCKS], scratch.lists[OTHERS]
    wanted = scratch.flags[WANTED if how == LEAVES else AIMED]
    place = pose_of(k, state) if how == LEAVES else target_of(scratch)
    ax, ay, az = place[0], place[1], place[2]
    filled = find_ways(ax, ay, az, poses, cameras.horizon, others, ways)
    for c in range(len(cameras.centres)):
        cx, cy, cz, radius = cameras.centres[c, 0], cameras.centres[c, 1], cameras.centres[c, 2], cameras.radius[c]
        for e in range(scratch.numbers[BLOCK_COUNT]):
            b = blocks[e]
            if not wanted[b]:
                continue
            mx, my, mz = ax - boxes[0, b] - cx, ay - boxes[1, b] - cy, az - boxes[2, b] - cz
            hx, hy, hz = (
                np.float32(boxes[3, b] + radius), np.float32(boxes[4, b] + radius), np.float32(boxes[5, b] + radius)
            )  # fmt: skip
            for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
                close = near_line(start, mx, my, mz, hx, hy, hz, width, ways)
                while close:
                    i = others[start + lowest(np.uint64(close))]
                    close &= close - np.uint32(1)
                    if i != np.uint64(k):
                        box = mx, my, mz, math.sqrt(hx * hx + hy * hy + hz * hz)
                        note_neighbour(state, cameras, c, b, i, k, how, place, box, mine, other, field, scratch)


@inlined
def touch(p: Integer, scratch: Any) -> None:
    """List position p among those that are `TOUCHED`."""
    numbers = scratch.numbers
    if not scratch.flags[TOUCHED, p]:
        scratch.flags[TOUCHED, p], scratch.lists[TOUCHED_LIST, numbers[TOUCHED_COUNT]] = True, p
        numbers[TOUCHED_COUNT] += 1


@inlined
def note_pair(i: Integer, p: Integer, scratch: Any) -> None:
    """List the pair of landmark i and position p."""
    known, pairs, numbers = scratch.known, scratch.pairs, scratch.numbers
    if not known[p, i]:
        known[p, i], pairs[WHO, numbers[PAIR_COUNT]], pairs[WHERE, numbers[PAIR_COUNT]] = True, i, p
        numbers[PAIR_COUNT] += 1
