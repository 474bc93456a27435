"""What a move can matter to: blocks of positions within the horizon of the place that it leaves or of that it tries.

Whatever a trial notes down, it notes in these blocks. Elsewhere nothing is reached, hidden or hides: so the next trial
clears what the last one left, and no loop need look at the whole room.
"""

from typing import NamedTuple

import numpy as np

from lmd.core.bits import LANES, ONE
from lmd.core.compiled import allocating, inlined, inner
from lmd.scene.criteria import from_position, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import cell_of
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends


class Nearby(NamedTuple):
    """The blocks of positions that the move tried last may matter to, of Q positions, and working memory."""

    aimed: np.ndarray
    """`(Q / BLOCK,)` whether a block is near the target."""
    wanted: np.ndarray
    """`(Q / BLOCK,)` blocks to look for neighbours in."""
    blocks: np.ndarray
    """`(Q / BLOCK + 1,)` that the move may matter to."""
    spans: np.ndarray
    """`(Q / BLOCK, 2)` of positions that these are: the first, and the one behind the last."""
    found: np.ndarray
    """`(2,)` how many blocks and spans there are."""
    others: np.ndarray
    """`(K + 1,)` landmarks nearby."""
    ways: np.ndarray
    """`(4, K + 1)`, filled up to whole words: the way to each of them, and how long it is."""


def nearby_of(count: int, size: int) -> Nearby:
    """Such memory for K landmarks and Q positions."""
    blocks = size // BLOCK
    return Nearby(
        aimed=np.empty(blocks, dtype=np.bool_),
        wanted=np.empty(blocks, dtype=np.bool_),
        blocks=np.empty(blocks + 1, dtype=np.uint64),
        spans=np.empty((blocks, 2), dtype=np.uint64),
        found=np.zeros(2, dtype=np.int64),
        others=np.empty(count + 1, dtype=np.uint64),
        ways=np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32),
    )


@inlined
def is_near(field, b, x, y, z):  # type: ignore[no-untyped-def]
    """Whether block b is within the horizon of (x, y, z): alike whenever it is asked, so that who hides whom is."""
    dx = max(abs(x - field.centres[0, b]) - field.halves[0, b], 0.0)
    dy = max(abs(y - field.centres[1, b]) - field.halves[1, b], 0.0)
    dz = max(abs(z - field.centres[2, b]) - field.halves[2, b], 0.0)
    return dx * dx + dy * dy + dz * dz <= field.horizon * field.horizon


@inlined
def target_of(scratch):  # type: ignore[no-untyped-def]
    """The place tried, six numbers: position and normal."""
    target = scratch.target
    return target[0], target[1], target[2], target[3], target[4], target[5]


@inlined
def pose_of(k, state):  # type: ignore[no-untyped-def]
    """The same of where landmark k is."""
    landmarks, normals = state.landmarks, state.normals
    return landmarks[0, k], landmarks[1, k], landmarks[2, k], normals[0, k], normals[1, k], normals[2, k]


@inner
def _forget(scratch):  # type: ignore[no-untyped-def]
    """Clear what the last trial left."""
    blocks, spans, near = scratch.near.blocks, scratch.near.spans, scratch.near.found
    one, two, three = scratch.before.found, scratch.after.found, scratch.turns.found
    reached, flips = scratch.new.reached, scratch.flips
    hides, hidden = scratch.after.count_hides, scratch.after.count_hidden
    for m in range(near[0]):
        b = blocks[m]
        one[b] = two[b] = three[b] = 0
    for s in range(near[1]):
        for p in range(spans[s, 0], spans[s, 1]):
            reached[p] = flips[p] = False
            hides[p] = hidden[p] = 0


@inner
def list_blocks(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """List the blocks near landmark k or its target."""
    target, landmarks = scratch.target, state.landmarks
    ax, ay, az = target[0], target[1], target[2]
    mx, my, mz = landmarks[0, k], landmarks[1, k], landmarks[2, k]
    aimed, wanted, blocks, spans, found, _, _ = scratch.near
    for b in range(len(aimed)):  # without a branch, so that it vectorises
        aimed[b] = is_near(field, b, ax, ay, az)
        wanted[b] = aimed[b] | is_near(field, b, mx, my, mz)
    count = number = 0
    for b in range(len(wanted)):
        blocks[count] = b
        count += wanted[b]
    for m in range(count):
        b = blocks[m]
        if m == 0 or b != blocks[m - 1] + ONE:
            spans[number, 0] = b * np.uint64(BLOCK)
            number += 1
        spans[number - 1, 1] = (b + ONE) * np.uint64(BLOCK)
    found[0], found[1] = count, number


@inner
def look_around(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """Forget the last trial, `list_blocks`, and find what they see of the target."""
    _forget(scratch)
    list_blocks(k, field, state, scratch)
    positions, sight, spans = field.positions, sized(field.sight, k), scratch.near.spans
    x, y, z, low, high, sure, cell, reached = scratch.new
    ax, ay, az, nx, ny, nz = target_of(scratch)
    for s in range(scratch.near.found[1]):
        for p in range(spans[s, 0], spans[s, 1]):
            x[p], y[p], z[p] = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            reached[p], low[p], high[p], sure[p] = from_position(sight, x[p], y[p], z[p], nx, ny, nz, 0.0)
            cell[p] = cell_of(x[p], y[p], z[p])
    if not is_clear(field.obstacles):
        _block(k, field, scratch)


@allocating
def _block(k, field, scratch):  # type: ignore[no-untyped-def]
    """Do not let landmark k reach the target where something of the room stands in the way."""
    reached, spans = scratch.new.reached, scratch.near.spans
    ends, sight = no_ends(field.obstacles, 1), sized(field.sight, k)
    find_ends(field.obstacles, sight, *target_of(scratch), ends, 0)
    for s in range(scratch.near.found[1]):
        for p in range(spans[s, 0], spans[s, 1]):
            reached[p] = reached[p] and not is_blocked(field.obstacles, sight, p, ends, 0)
