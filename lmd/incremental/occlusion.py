"""Occlusion between a moving landmark and the others: pairs of another landmark and a position.

Only blocks of positions within the horizon of both landmarks are searched, in two stages:

1. A bound excludes most landmarks for all positions of a block. Let m be the offset of the place a from the centre of
   the block, and e = o - a the vector to a landmark o. From the position delta away from the centre, a and o have the
   offsets a' = m - delta and o' = a' + e. One of them hides the other only within r = sqrt(reach) of the line of sight:
   if |a' x o'| <= r max(|a'|, |o'|). As a' x o' = m x e - delta x e, and the block fits into a box with the half sides
   h, the first component of m x e is then at most

       h_y |e_z| + h_z |e_y| + r (|m| + |h| + |e|),

   and the other components by cyclic permutation. The test is in float32; `SINGLE_ERROR` covers its rounding: the error
   of each sum is below 5 * 6e-8 times the larger of the sum and (|m| + |h|) |e|.
2. `note_neighbour` tests the remaining landmarks from each position: for a camera by the inequalities of the reference.
   For a rig by a bound for all cameras around a centre, and then by the inequalities for each orientation.

A camera is treated as a mount group with one centre, the position itself, and the radius 0.
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
    LANDMARK,
    OTHERS,
    PAIR_COUNT,
    POSITION,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    WANTED,
)
from lmd.scene.criteria import TOLERANCE
from lmd.sight.blocks import SINGLE_ERROR

# Roles of a place in a search: old place, place tried, or place of a landmark that is counted for the first time. The
# roles are NumPy integers, as numba gives each Python constant a type of its own.
OLD_PLACE, NEW_PLACE, FIRST_PLACE = np.int64(0), np.int64(1), np.int64(2)


@inlined
def line_radius(sight: Any) -> Any:
    """Greatest distance from a line of sight at which a landmark hides another, metres."""
    return math.sqrt(sight.reach) * (1.0 + SINGLE_ERROR) + TOLERANCE


@inner
def find_offsets(
    ax: float, ay: float, az: float, poses: FloatArray, horizon: float, others: np.ndarray, offsets: FloatArray
) -> Any:
    """List the landmarks within the horizon of (ax, ay, az) in `others`, and the vectors to the landmarks in `offsets`.

    See `Scratch.offsets`.

    Returns:
        number of landmarks, rounded up to a multiple of `LANES`.
    """
    count, most = poses.shape[1], np.float32(horizon * (1.0 + SINGLE_ERROR))
    for i in range(count):
        dx, dy, dz = poses[0, i] - ax, poses[1, i] - ay, poses[2, i] - az
        offsets[0, i], offsets[1, i], offsets[2, i], offsets[3, i] = dx, dy, dz, math.sqrt(dx * dx + dy * dy + dz * dz)
        others[i] = i
    if most < np.inf:
        count = 0
        for i in range(poses.shape[1]):
            dx, dy, dz, distance = offsets[0, i], offsets[1, i], offsets[2, i], offsets[3, i]
            others[count] = i
            offsets[0, count], offsets[1, count], offsets[2, count], offsets[3, count] = dx, dy, dz, distance
            count += distance <= most
    filled = (count + LANES - 1) & -LANES
    for i in range(count, filled):
        offsets[3, i] = -np.inf  # padding that fails every test
    return filled


@inlined
def near_line(
    start: Any, mx: float, my: float, mz: float, hx: Any, hy: Any, hz: Any, radius: float, offsets: FloatArray
) -> Any:
    """Bit set of the landmarks that pass the first stage of the search.

    Args:
        start: index of the first of `LANES` landmarks.
        mx, my, mz: offset of the place from the centre of the box, metres.
        hx, hy, hz: half sides of the box, metres.
        radius: result of `line_radius`, metres.
        offsets: array filled by `find_offsets`.
    """
    far = math.sqrt(mx * mx + my * my + mz * mz) + math.sqrt(hx * hx + hy * hy + hz * hz)
    shift, slope = np.float32(radius * far), np.float32(radius + SINGLE_ERROR * far)
    ux, uy, uz = np.float32(mx), np.float32(my), np.float32(mz)
    close = np.uint32(0)
    for lane in range(np.uint64(LANES)):
        i = start + lane
        ex, ey, ez = offsets[0, i], offsets[1, i], offsets[2, i]
        room = shift + slope * offsets[3, i]
        near = abs(uy * ez - uz * ey) <= hz * abs(ey) + hy * abs(ez) + room
        near &= abs(uz * ex - ux * ez) <= hx * abs(ez) + hz * abs(ex) + room
        near &= abs(ux * ey - uy * ex) <= hy * abs(ex) + hx * abs(ey) + room
        close |= np.uint32(near) << np.uint32(lane)
    return close


@dispatched
def note_neighbour(
    state: Any, cameras: Any, c: Integer, b: Integer, i: Integer, k: Integer, role: Any, place: Any, box: Any,
    mine: Any, other: Any, field: Any, scratch: Any,
) -> None:  # fmt: skip
    """Record the positions of block b from which landmark k at a `place` hides landmark i or is hidden by landmark i.

    Args:
        cameras: a `OneCamera`, or a `MountGroup` of a rig.
        c, b: indices of the centre and of the block of positions.
        role: `OLD_PLACE`, `NEW_PLACE` or `FIRST_PLACE`.
        place: position (metres) and unit normal, six numbers.
        box: offset of the place from the centre of the block as seen from c, and half the diagonal of the block's box,
            four numbers, metres.
        mine, other: fields of a state and of a scratch for the mount group; unused for a camera.
    """


@inner
def search(cameras: Any, k: Integer, role: Any, mine: Any, other: Any, field: Any, state: Any, scratch: Any) -> None:
    """Call `note_neighbour` for all landmarks that may hide landmark k at a place, or may be hidden by k.

    Arguments as in `note_neighbour`; `role` selects the old place or the place tried.
    """
    boxes, poses, offsets, width = field.boxes, state.poses, scratch.offsets, line_radius(cameras.sight)
    blocks, others = scratch.lists[BLOCKS], scratch.lists[OTHERS]
    wanted = scratch.flags[WANTED if role == OLD_PLACE else AIMED]
    place = pose_of(k, state) if role == OLD_PLACE else target_of(scratch)
    ax, ay, az = place[0], place[1], place[2]
    filled = find_offsets(ax, ay, az, poses, cameras.horizon, others, offsets)
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
                close = near_line(start, mx, my, mz, hx, hy, hz, width, offsets)
                while close:
                    i = others[start + lowest(np.uint64(close))]
                    close &= close - np.uint32(1)
                    if i != np.uint64(k):
                        box = mx, my, mz, math.sqrt(hx * hx + hy * hy + hz * hz)
                        note_neighbour(state, cameras, c, b, i, k, role, place, box, mine, other, field, scratch)


@inlined
def touch(p: Integer, scratch: Any) -> None:
    """Mark position p as `TOUCHED`."""
    numbers = scratch.numbers
    if not scratch.flags[TOUCHED, p]:
        scratch.flags[TOUCHED, p], scratch.lists[TOUCHED_LIST, numbers[TOUCHED_COUNT]] = True, p
        numbers[TOUCHED_COUNT] += 1


@inlined
def note_pair(i: Integer, p: Integer, scratch: Any) -> None:
    """Append landmark i and position p to `Scratch.pairs`."""
    known, pairs, numbers = scratch.known, scratch.pairs, scratch.numbers
    if not known[p, i]:
        known[p, i], pairs[LANDMARK, numbers[PAIR_COUNT]], pairs[POSITION, numbers[PAIR_COUNT]] = True, i, p
        numbers[PAIR_COUNT] += 1
