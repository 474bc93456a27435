"""Search for occlusion: for each other landmark, positions from which it hides the moving landmark or is hidden by it.

Only blocks of positions within the horizon (the distance beyond which a landmark has no effect) of both landmarks are
searched, in two stages:

1. An inequality excludes most of the other landmarks for all positions of a block. Let a be the place of the moving
   landmark, o the place of another landmark, and e = o - a. Let m be the offset of a from the centre of the block. The
   offsets of a and o from a position at delta from the centre are a' = m - delta and o' = a' + e. Let r be the greatest
   distance from a line of sight at which a landmark blocks the line. One landmark can hide the other only if |a' x o'|
   <= r max(|a'|, |o'|). Here a' x o' = m x e - delta x e, and the block fits into a box with the half sides h. The
   first component of m x e is then at most

       h_y |e_z| + h_z |e_y| + r (|m| + |h| + |e|),

   and the other components by cyclic permutation. The test is in float32; `SINGLE_ERROR` covers its rounding: the error
   of each sum is below 5 * 6e-8 times the larger of the sum and (|m| + |h|) |e|.
2. `note_neighbour` tests the remaining landmarks from each position. For a camera it uses the inequalities of the
   reference. For a rig it uses a bound for all cameras around a centre, and then the inequalities for each orientation.

A camera is treated as a mount group with one centre, the position itself, and the radius 0.

The module also lists the blocks of positions within the horizon of the moving landmark's old place or of its new place.
A trial works in these blocks alone: from other positions a landmark at either place is not visible and hides no other
landmark. Each trial clears the entries that the previous trial wrote, so no loop runs over the whole room.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import LANES, ONE, Integer, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.core.dispatch import dispatched
from lmd.geometry.vectors import Vector, column3, dot3, minus3, pair3, row3
from lmd.incremental.state import (
    AIMED,
    BLOCK_COUNT,
    BLOCKS,
    FIRST,
    LANDMARK,
    LAST,
    OTHERS,
    PAIR_COUNT,
    POSITION,
    SPAN_COUNT,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    WANTED,
)
from lmd.scene.criteria import TOLERANCE
from lmd.sight.blocks import BLOCK, SINGLE_ERROR


@inlined
def is_near(field: Any, b: Integer, point: Vector) -> Any:
    """True if the bounding box of block b of positions is at most the horizon (`field.horizon`) away from `point`. The
    coordinates of `point` are in metres.
    """
    (x, y, z), (hx, hy, hz) = pair3(field.boxes, b)
    dx, dy, dz = max(abs(point[0] - x) - hx, 0.0), max(abs(point[1] - y) - hy, 0.0), max(abs(point[2] - z) - hz, 0.0)
    return dx * dx + dy * dy + dz * dz <= field.horizon * field.horizon


@inlined
def target_of(scratch: Any) -> Any:
    """Position (metres) and unit normal of the moving landmark's new place."""
    target = scratch.target
    return (target[0], target[1], target[2]), (target[3], target[4], target[5])


@inlined
def pose_of(k: Integer, state: Any) -> Any:
    """Position (metres) and unit normal of landmark k."""
    return pair3(state.poses, k)


@inner
def list_blocks(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """List the blocks of positions that are near landmark k, or near its new place.

    Near means: at most `field.horizon` away, the distance beyond which a landmark has no effect. The scratch gets the
    blocks (`BLOCKS`), and the contiguous ranges of positions that they form (`FIRST`, `LAST`).
    """
    numbers, size, (there, _), (here, _) = scratch.numbers, field.boxes.shape[1], target_of(scratch), pose_of(k, state)
    aimed, wanted = scratch.flags[AIMED], scratch.flags[WANTED]
    blocks, first, last = scratch.lists[BLOCKS], scratch.lists[FIRST], scratch.lists[LAST]
    for b in range(size):  # without a branch, so that the loop vectorises
        aimed[b] = is_near(field, b, there)
        wanted[b] = aimed[b] | is_near(field, b, here)
    count = number = 0
    for b in range(size):
        blocks[count] = b
        count += wanted[b]
    for m in range(count):
        b = blocks[m]
        if m == 0 or b != blocks[m - 1] + ONE:
            first[number] = b * np.uint64(BLOCK)
            number += 1
        last[number - 1] = (b + ONE) * np.uint64(BLOCK)
    numbers[BLOCK_COUNT], numbers[SPAN_COUNT] = count, number


# Roles of a place in a search: old place, place tried, or place of a landmark that is counted for the first time. The
# roles are NumPy integers, as numba gives each Python constant a type of its own.
OLD_PLACE, NEW_PLACE, FIRST_PLACE = np.int64(0), np.int64(1), np.int64(2)


@inlined
def line_radius(sight: Any) -> Any:
    """Greatest distance from a line of sight at which a landmark can block this line, metres, plus rounding errors."""
    return math.sqrt(sight.reach) * (1.0 + SINGLE_ERROR) + TOLERANCE


@inner
def find_offsets(place: Vector, poses: FloatArray, horizon: float, others: np.ndarray, offsets: FloatArray) -> Any:
    """List the landmarks that are at most `horizon` metres from a place, and the vectors to them.

    The indices of the landmarks are written into `others`. The vectors from the place, and in the last row their
    lengths, are written into `offsets` `(4, L)`, metres.

    Returns:
        number of landmarks, rounded up to a multiple of `LANES`. The additional entries are padding, which no test
            accepts.
    """
    count, most = poses.shape[1], np.float32(horizon * (1.0 + SINGLE_ERROR))
    for i in range(count):
        d = minus3(column3(poses, i), place)
        (offsets[0, i], offsets[1, i], offsets[2, i]), offsets[3, i], others[i] = d, math.sqrt(dot3(d, d)), i
    if most < np.inf:
        count = 0
        for i in range(poses.shape[1]):
            distance = offsets[3, i]
            offsets[0, count], offsets[1, count], offsets[2, count] = column3(offsets, i)
            offsets[3, count], others[count] = distance, i
            count += distance <= most
    filled = (count + LANES - 1) & -LANES
    for i in range(count, filled):
        offsets[3, i] = -np.inf  # padding that fails every test
    return filled


@inlined
def near_line(start: Any, middle: Vector, sides: Vector, radius: float, offsets: FloatArray) -> Any:
    """Test `LANES` landmarks for occlusion by, or of, a landmark at a given place, as seen from a block of positions.

    A landmark that fails the test neither hides the place nor is hidden by a landmark there, from any position of the
    block. The test is the first stage of the search, see the module.

    Args:
        start: column of `offsets` with the first of the landmarks.
        middle: offset of the place from the centre of the block's bounding box, metres.
        sides: half the side lengths of the box, metres.
        radius: result of `line_radius`, metres.
        offsets: array filled by `find_offsets`.

    Returns:
        bit set of the landmarks that pass the test; bit j stands for the landmark in column `start + j`.
    """
    (mx, my, mz), (hx, hy, hz) = middle, sides
    far = math.sqrt(dot3(middle, middle)) + math.sqrt(dot3(sides, sides))
    shift, slope = np.float32(radius * far), np.float32(radius + SINGLE_ERROR * far)
    ux, uy, uz = np.float32(mx), np.float32(my), np.float32(mz)
    close = np.uint32(0)
    for lane in range(np.uint64(LANES)):
        i = start + lane
        ex, ey, ez = column3(offsets, i)
        room = shift + slope * offsets[3, i]
        near = abs(uy * ez - uz * ey) <= hz * abs(ey) + hy * abs(ez) + room
        near &= abs(uz * ex - ux * ez) <= hx * abs(ez) + hz * abs(ex) + room
        near &= abs(ux * ey - uy * ex) <= hy * abs(ex) + hx * abs(ey) + room
        close |= np.uint32(near) << np.uint32(lane)
    return close


@dispatched
def note_neighbour(state: Any, groups: Any, near: Any, role: Any, place: Any, field: Any, scratch: Any) -> None:
    """Record the positions of a block from which landmark k at a `place` hides landmark i, or i hides k.

    Args:
        groups: a tuple: a `OneCamera`, or a `MountGroup` of a rig, and the arrays of the state and of the scratch for
            it.
        near: five values. Four are indices: centre c of the cameras (`MountGroup.centres`), block b, and landmarks i
            and k. The fifth is a pair in metres, for the body at the middle of the block: the offset of the place from
            centre c, and a radius around c. The cameras stay within this radius for all positions of the block.
        role: `OLD_PLACE`, `NEW_PLACE` or `FIRST_PLACE` (place at which landmark k is counted for the first time).
        place: position (metres) and unit normal.
    """


@inner
def search(groups: Any, k: Integer, role: Any, field: Any, state: Any, scratch: Any) -> None:
    """Call `note_neighbour` for each landmark that landmark k may hide, or that may hide landmark k.

    `role` selects the place of landmark k: its old place or its new place. `groups` is as in `note_neighbour`.
    """
    cameras, boxes, offsets = groups[0], field.boxes, scratch.offsets
    blocks, others = scratch.lists[BLOCKS], scratch.lists[OTHERS]
    wanted = scratch.flags[WANTED if role == OLD_PLACE else AIMED]
    place, width = pose_of(k, state) if role == OLD_PLACE else target_of(scratch), line_radius(cameras.sight)
    filled = find_offsets(place[0], state.poses, cameras.horizon, others, offsets)
    for c in range(len(cameras.centres)):
        centre, radius = row3(cameras.centres, c), cameras.radius[c]
        for e in range(scratch.numbers[BLOCK_COUNT]):
            b = blocks[e]
            if not wanted[b]:
                continue
            middle, half = pair3(boxes, b)
            away = minus3(minus3(place[0], middle), centre)
            sides = np.float32(half[0] + radius), np.float32(half[1] + radius), np.float32(half[2] + radius)
            for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
                close = near_line(start, away, sides, width, offsets)
                while close:
                    i = others[start + lowest(np.uint64(close))]
                    close &= close - np.uint32(1)
                    if i != np.uint64(k):
                        near = c, b, i, k, (away, math.sqrt(dot3(sides, sides)))
                        note_neighbour(state, groups, near, role, place, field, scratch)


@inlined
def touch(p: Integer, scratch: Any) -> None:
    """Mark position p as touched by the trial move, and append it to `TOUCHED_LIST` unless it is listed already."""
    numbers = scratch.numbers
    if not scratch.flags[TOUCHED, p]:
        scratch.flags[TOUCHED, p], scratch.lists[TOUCHED_LIST, numbers[TOUCHED_COUNT]] = True, p
        numbers[TOUCHED_COUNT] += 1


@inlined
def note_pair(i: Integer, p: Integer, scratch: Any) -> None:
    """List the pair of landmark i and position p in `Scratch.pairs`, unless it is listed already.

    The trial move may change the occlusion of landmark i as seen from position p.
    """
    known, pairs, numbers = scratch.known, scratch.pairs, scratch.numbers
    if not known[p, i]:
        known[p, i], pairs[LANDMARK, numbers[PAIR_COUNT]], pairs[POSITION, numbers[PAIR_COUNT]] = True, i, p
        numbers[PAIR_COUNT] += 1
