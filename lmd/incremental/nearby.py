"""What a move can matter to: blocks of positions within the horizon of the place that it leaves or of that it tries.

Whatever a trial notes down, it notes in these blocks. Elsewhere nothing is reached, hidden or hides: so the next trial
clears what the last one left, and no loop need look at the whole room.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ONE
from lmd.core.compiled import allocating, inlined, inner
from lmd.incremental.state import (
    AFTER_HIDDEN,
    AFTER_HIDING,
    AIMED,
    BLOCK_COUNT,
    BLOCKS,
    FIRST,
    FLIPS,
    FOUND,
    HIGH,
    LAST,
    LOW,
    REACHED,
    SPAN_COUNT,
    SURE,
    WANTED,
    X,
    Y,
    Z,
)
from lmd.scene.criteria import from_position, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import cell_of
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends


@inlined
def is_near(field, b, x, y, z):  # type: ignore[no-untyped-def]
    """Whether block b is within the horizon of (x, y, z): alike whenever it is asked, so that who hides whom is."""
    boxes = field.boxes
    dx = max(abs(x - boxes[0, b]) - boxes[3, b], 0.0)
    dy = max(abs(y - boxes[1, b]) - boxes[4, b], 0.0)
    dz = max(abs(z - boxes[2, b]) - boxes[5, b], 0.0)
    return dx * dx + dy * dy + dz * dz <= field.horizon * field.horizon


@inlined
def target_of(scratch: Any) -> tuple[float, float, float, float, float, float]:
    """The place tried, six numbers: position and normal."""
    target = scratch.target
    return target[0], target[1], target[2], target[3], target[4], target[5]


@inlined
def pose_of(k, state):  # type: ignore[no-untyped-def]
    """The same of where landmark k is."""
    poses = state.poses
    return poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]


@inner
def _forget(scratch):  # type: ignore[no-untyped-def]
    """Clear what the last trial left."""
    blocks, first, last = scratch.lists[BLOCKS], scratch.lists[FIRST], scratch.lists[LAST]
    one, two, three = scratch.lists[FOUND], scratch.lists[FOUND + 1], scratch.lists[FOUND + 2]
    reached, flips = scratch.flags[REACHED], scratch.flags[FLIPS]
    hides, hidden = scratch.shorts[AFTER_HIDING], scratch.shorts[AFTER_HIDDEN]
    for m in range(scratch.numbers[BLOCK_COUNT]):
        b = blocks[m]
        one[b] = two[b] = three[b] = 0
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = flips[p] = False
            hides[p] = hidden[p] = 0


@inner
def list_blocks(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """List the blocks near landmark k or its target."""
    target, poses, numbers, size = scratch.target, state.poses, scratch.numbers, field.boxes.shape[1]
    ax, ay, az = target[0], target[1], target[2]
    mx, my, mz = poses[0, k], poses[1, k], poses[2, k]
    aimed, wanted = scratch.flags[AIMED], scratch.flags[WANTED]
    blocks, first, last = scratch.lists[BLOCKS], scratch.lists[FIRST], scratch.lists[LAST]
    for b in range(size):  # without a branch, so that it vectorises
        aimed[b] = is_near(field, b, ax, ay, az)
        wanted[b] = aimed[b] | is_near(field, b, mx, my, mz)
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


@inner
def look_around(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """Forget the last trial, `list_blocks`, and find what they see of the target."""
    _forget(scratch)
    list_blocks(k, field, state, scratch)
    positions, sight, seen = field.positions, sized(field.sight, k), scratch.seen
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached, first, last = scratch.cell, scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    ax, ay, az, nx, ny, nz = target_of(scratch)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            x[p], y[p], z[p] = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            reached[p], low[p], high[p], sure[p] = from_position(sight, x[p], y[p], z[p], nx, ny, nz, 0.0)
            cell[p] = cell_of(x[p], y[p], z[p])
    if not is_clear(field.obstacles):
        _block(k, field, scratch)


@allocating
def _block(k, field, scratch):  # type: ignore[no-untyped-def]
    """Do not let landmark k reach the target where something of the room stands in the way."""
    reached, first, last = scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    ends, sight = no_ends(field.obstacles, 1), sized(field.sight, k)
    find_ends(field.obstacles, sight, *target_of(scratch), ends, 0)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = reached[p] and not is_blocked(field.obstacles, sight, p, ends, 0)
