"""Blocks of positions within the horizon of a landmark's old place, or of its tried place.

A trial works in these blocks alone: from other positions neither place is visible, and neither affects another
landmark. Each trial clears the entries that the previous trial wrote, so no loop runs over the whole room.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ONE, Integer
from lmd.core.compiled import inlined, inner
from lmd.geometry.vectors import Vector, pair3
from lmd.incremental.state import AIMED, BLOCK_COUNT, BLOCKS, FIRST, LAST, SPAN_COUNT, WANTED
from lmd.sight.blocks import BLOCK


@inlined
def is_near(field: Any, b: Integer, point: Vector) -> Any:
    """True if block b is within the horizon of a point, metres."""
    (x, y, z), (hx, hy, hz) = pair3(field.boxes, b)
    dx, dy, dz = max(abs(point[0] - x) - hx, 0.0), max(abs(point[1] - y) - hy, 0.0), max(abs(point[2] - z) - hz, 0.0)
    return dx * dx + dy * dy + dz * dz <= field.horizon * field.horizon


@inlined
def target_of(scratch: Any) -> Any:
    """Position (metres) and unit normal of the place tried."""
    target = scratch.target
    return (target[0], target[1], target[2]), (target[3], target[4], target[5])


@inlined
def pose_of(k: Integer, state: Any) -> Any:
    """Position (metres) and unit normal of landmark k."""
    return pair3(state.poses, k)


@inner
def list_blocks(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """List the blocks near landmark k or near the place tried."""
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
