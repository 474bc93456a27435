"""Blocks of positions within the horizon of a landmark's old place, or of its tried place.

A trial works in these blocks alone: from other positions neither place is visible, and neither affects another
landmark. Each trial clears the entries that the previous trial wrote, so no loop runs over the whole room.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ONE, Integer
from lmd.core.compiled import inlined, inner
from lmd.incremental.state import AIMED, BLOCK_COUNT, BLOCKS, FIRST, LAST, SPAN_COUNT, WANTED
from lmd.sight.blocks import BLOCK


@inlined
def is_near(field: Any, b: Integer, x: float, y: float, z: float) -> Any:
    """True if block b is within the horizon of the point (x, y, z), metres."""
    boxes = field.boxes
    dx = max(abs(x - boxes[0, b]) - boxes[3, b], 0.0)
    dy = max(abs(y - boxes[1, b]) - boxes[4, b], 0.0)
    dz = max(abs(z - boxes[2, b]) - boxes[5, b], 0.0)
    return dx * dx + dy * dy + dz * dz <= field.horizon * field.horizon


@inlined
def target_of(scratch: Any) -> Any:
    """Position (metres) and unit normal of the place tried, six numbers."""
    target = scratch.target
    return target[0], target[1], target[2], target[3], target[4], target[5]


@inlined
def pose_of(k: Integer, state: Any) -> Any:
    """Position (metres) and unit normal of landmark k, six numbers."""
    poses = state.poses
    return poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]


@inner
def list_blocks(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """List the blocks near landmark k or near the place tried."""
    target, poses, numbers, size = scratch.target, state.poses, scratch.numbers, field.boxes.shape[1]
    ax, ay, az = target[0], target[1], target[2]
    mx, my, mz = poses[0, k], poses[1, k], poses[2, k]
    aimed, wanted = scratch.flags[AIMED], scratch.flags[WANTED]
    blocks, first, last = scratch.lists[BLOCKS], scratch.lists[FIRST], scratch.lists[LAST]
    for b in range(size):  # without a branch, so that the loop vectorises
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
