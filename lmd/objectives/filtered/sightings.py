"""Effect of a trial move of one landmark on the images of drives: landmarks in view, occlusion and information.

`see` lists the frames in which the move changes the landmarks in view. Frames are handled in blocks of neighbours.
Occlusion is tested only for landmarks near the lines of sight from a block to the moving landmark
(`lmd.incremental.occlusion`).
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, Integer, lowest
from lmd.core.bits import LANES as OTHERS_AT_ONCE
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import upright_sides
from lmd.geometry.vectors import Vector, column3, dot3, minus3, pair3, read3, write3
from lmd.incremental.occlusion import find_offsets, line_radius, near_line
from lmd.objectives.localisation.information import NUMBERS as SUMS
from lmd.objectives.localisation.information import half_of, moments, share_of
from lmd.objectives.localisation.views import landmark_moments
from lmd.scene.criteria import covers, from_position, hide_between, pixel_density, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.obstacles import find_ends, is_blocked, is_clear

PAIRS = 0  # entry of `FilteredScratch.numbers`
SPOTS = 64  # landmarks whose information is computed at once
CHUNK = np.uint64(SPOTS)
# First entry of each number of the spots, unsigned: numba tests whether a signed index is negative.
_1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14 = (np.uint64(SPOTS * j) for j in range(1, SUMS))


@inlined
def word_of(k: Integer) -> Any:
    """Index of the 64-bit word that has the bit of landmark k, in a bit set of landmarks."""
    return np.uint64(k) // np.uint64(BITS)


@inlined
def bit_of(k: Integer) -> Any:
    """Bit of landmark k within its 64-bit word (`word_of`), as a mask."""
    return ONE << np.uint64(k) % np.uint64(BITS)


@inlined
def _is_covered(state: Any, f: Integer, k: Integer) -> Any:
    """True if the camera covers landmark k in frame f, occlusion by other landmarks ignored."""
    return state.covered[f, word_of(k)] & bit_of(k) != ZERO


@inlined
def offset_of(place: Vector, f: Integer, field: Any) -> Vector:
    """Offset of a place from the camera in frame f, metres."""
    return minus3(place, column3(field.positions, f))


@inlined
def tried_pose(scratch: Any) -> Any:
    """Position (metres) and unit normal of the moving landmark's new place."""
    pose = scratch.pose
    return (pose[0], pose[1], pose[2]), (pose[3], pose[4], pose[5])


@inlined
def hide_each_other(i: Integer, pose: Any, k: Integer, other: Any, f: Integer, field: Any) -> Any:
    """Two flags for landmarks i and k as seen in frame f: True if i hides k, and True if k hides i. `pose` and `other`
    are the positions and normals of i and of k.
    """
    a, b = offset_of(pose[0], f, field), offset_of(other[0], f, field)
    mine, theirs = sized(field.sight, i), sized(field.sight, k)
    return hide_between(mine, theirs, a, dot3(a, a), b, dot3(b, b), pose[1], other[1])


@inlined
def covers_alone(f: Integer, pose: Any, mine: Any, clear: Any, ends: Any, field: Any) -> Any:
    """True if the camera covers a landmark at `pose` in frame f, other landmarks ignored.

    `mine` is the model of sight: the numbers of the visibility model for this landmark. `clear` is True if the room has
    no obstacles. Otherwise row 0 of `ends` has the points of the landmark that must be in view, see
    `lmd.sight.obstacles.find_ends`.
    """
    offset = offset_of(pose[0], f, field)
    reached, low, _, _ = from_position(mine, offset, pose[1], 0.0)
    if not reached or not covers(mine, offset, pose[1], low, 0.0, field.axes, f):
        return False
    return clear or not is_blocked(field.obstacles, mine, f, ends, 0)


@inlined
def add_landmark(row: FloatArray, sign: float, f: Integer, k: Integer, pose: Any, field: Any, scratch: Any) -> None:
    """Add the information of landmark k at `pose` in frame f, times `sign`, to `row`, the information of the frame."""
    moment, offset = scratch.moment, offset_of(pose[0], f, field)
    landmark_moments(offset, pose[1], field.precision, k, moment)
    weight = pixel_density(field.sight, offset, field.axes, f)
    for j in range(np.uint64(SUMS)):
        row[j] += sign * share_of(moment[j], weight)


@inner
def _mark_ahead(field: Any, scratch: Any) -> None:
    """Mark in `scratch.covered` the frames whose image may show the moving landmark at its new place."""
    ahead, (place, _) = scratch.covered, tried_pose(scratch)
    for f in range(np.uint64(len(ahead))):
        offset = offset_of(place, f, field)
        ahead[f] = dot3(column3(field.axes, f), offset) >= field.cosine * math.sqrt(dot3(offset, offset))


@inner
def _flush(role: Integer, count: Integer, k: Integer, normal: Any, field: Any, scratch: Any) -> None:
    """Update the information of the frames in a buffer for one place of the moving landmark k.

    With the `role` 0, the information at the old place is subtracted; with the `role` 1, the information at the new
    place is added. Each role has its own buffer (`spots`), of which the first `count` entries are frames that see the
    landmark at this place. `normal` is the unit normal there.
    """
    spots, shares, frames, asked = scratch.spots[role], scratch.shares, scratch.spotted[role], field.precision
    right, up = upright_sides(half_of(asked, k), normal)
    for i in range(CHUNK):
        (
            shares[i], shares[i + _1], shares[i + _2], shares[i + _3], shares[i + _4], shares[i + _5], shares[i + _6],
            shares[i + _7], shares[i + _8], shares[i + _9], shares[i + _10], shares[i + _11], shares[i + _12],
            shares[i + _13], shares[i + _14],
        ) = moments((read3(spots, i, _1), right, up), asked.share)  # fmt: skip
    for j in range(np.uint64(SUMS)):
        for i in range(CHUNK):
            shares[i + j * CHUNK] = share_of(shares[i + j * CHUNK], spots[i + _3])
    for i in range(count):
        row = scratch.sums[frames[i]]
        for j in range(np.uint64(SUMS)):
            if role == 0:
                row[j] -= shares[np.uint64(i) + j * CHUNK]
            else:
                row[j] += shares[np.uint64(i) + j * CHUNK]


@inlined
def _spot(role: Integer, count: Integer, f: Integer, k: Integer, pose: Any, field: Any, scratch: Any) -> Any:
    """Append frame f to the buffer (`spots`) of the frames that see the moving landmark at `pose`.

    `role` is 0 for the old place and 1 for the new place. A full buffer is emptied by `_flush`.

    Returns:
        number of entries in the buffer.
    """
    spots, i, offset = scratch.spots[role], np.uint64(count), offset_of(pose[0], f, field)
    write3(spots, i, _1, offset)
    spots[i + _3] = pixel_density(field.sight, offset, field.axes, f)
    scratch.spotted[role, i] = f
    if i + np.uint64(1) < CHUNK:
        return count + 1
    _flush(role, CHUNK, k, pose[1], field, scratch)
    return np.int64(0)


@inner
def _list_near(b: Integer, k: Integer, width: float, state: Any, field: Any, scratch: Any) -> None:
    """Find the landmarks that may hide landmark k, or be hidden by it, from the frames of block b.

    The bit set for the old place of landmark k and the bit set for its new place are written to `scratch.near`.
    """
    near, (middle, half) = scratch.near, pair3(field.boxes, b)
    sides = np.float32(half[0]), np.float32(half[1]), np.float32(half[2])
    for role in range(2):
        for w in range(near.shape[1]):
            near[role, w] = ZERO
        place, _ = pair3(state.poses, k) if role == 0 else tried_pose(scratch)
        others, offsets, away = scratch.others[role], scratch.offsets[role], minus3(place, middle)
        for start in range(np.uint64(0), np.uint64(offsets.shape[1]), np.uint64(OTHERS_AT_ONCE)):
            close = near_line(start, away, sides, width, offsets)
            while close:
                j = np.uint64(others[start + lowest(np.uint64(close))])
                close &= close - np.uint32(1)
                near[role, word_of(j)] |= bit_of(j)
        near[role, word_of(k)] &= ~bit_of(k)


@inner
def begin(field: Any, k: Integer, pose: FloatArray, surface: Integer, state: Any, scratch: Any) -> None:
    """Begin a trial move of landmark k: store its new place in the scratch, and clear the last trial."""
    scratch.surface[0], scratch.numbers[PAIRS] = surface, 0
    for i in range(6):
        scratch.pose[i] = pose[i]
    for f in range(len(state.units)):
        scratch.units[f], scratch.changed[f] = state.units[f], 0
    for d in range(len(field.first) - 1):
        scratch.starts[d] = field.first[d + 1]
    for role in range(2):
        for w in range(scratch.near.shape[1]):
            scratch.near[role, w] = ZERO
    for role in range(2):
        offsets = scratch.offsets[role]
        for i in range(offsets.shape[1]):
            offsets[3, i] = -np.inf
    old = state.poses
    if field.sight.reach >= 0.0:
        find_offsets(column3(old, k), old, field.horizon, scratch.others[0], scratch.offsets[0])
        find_offsets(tried_pose(scratch)[0], old, field.horizon, scratch.others[1], scratch.offsets[1])


@inner
def see(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Find the frames in which the move of landmark k changes the landmarks in view.

    The information of these frames after the move is written to the scratch.
    """
    poses, width, reaches, mine = state.poses, 0.0, field.sight.reach >= 0.0, sized(field.sight, k)
    clear, ends, d, old, new = is_clear(field.obstacles), scratch.ends, 0, pair3(state.poses, k), tried_pose(scratch)
    if reaches:
        width = line_radius(field.sight)
    if not clear:
        find_ends(field.obstacles, mine, new[0], new[1], ends, 0)
    _mark_ahead(field, scratch)
    lost = gained = np.int64(0)
    for b in range(field.boxes.shape[1]):
        if reaches:
            _list_near(b, k, width, state, field, scratch)
        for f in range(b * BLOCK, min((b + 1) * BLOCK, len(state.units))):
            facing, scratch.covered[f], scratch.hidden[f] = scratch.covered[f] != 0, 0, 0
            some = _is_covered(state, f, k)
            for w in range(np.uint64(scratch.near.shape[1])):
                some |= ((scratch.near[0, w] | scratch.near[1, w]) & state.covered[f, w]) != ZERO
            if not facing and not some:
                continue
            covered = facing and covers_alone(f, new, mine, clear, ends, field)
            was, hiders, turning = _is_covered(state, f, k) & (state.hidden[f, k] == 0), 0, scratch.numbers[PAIRS]
            for w in range(np.uint64(scratch.near.shape[1])):
                left = scratch.near[0, w] | scratch.near[1, w]
                if not covered:
                    left &= state.covered[f, w]
                while left:
                    j = w * np.uint64(BITS) + lowest(left)
                    left &= left - ONE
                    hiders += _meet(j, f, k, covered, field, state, scratch)
            now = covered & (hiders == 0)
            scratch.covered[f], scratch.hidden[f] = covered, hiders
            if not was and not now and turning == scratch.numbers[PAIRS]:
                continue
            row, count = scratch.sums[f], state.counts[f] + np.int16(now) - np.int16(was)
            for t in range(SUMS):
                row[t] = state.sums[f, t]
            if was:
                lost = _spot(0, lost, f, k, old, field, scratch)
            if now:
                gained = _spot(1, gained, f, k, new, field, scratch)
            turned = was | now
            for e in range(turning, scratch.numbers[PAIRS]):
                i, hid = np.int64(scratch.pairs[1, e]), state.hidden[f, scratch.pairs[1, e]]
                before, after = hid == 0, hid + scratch.pairs[2, e] == 0
                if before != after:
                    sign = 1.0 if after else -1.0
                    add_landmark(row, sign, f, i, pair3(poses, i), field, scratch)
                    count, turned = count + np.int16(sign), True
            if not turned:
                continue
            while f >= field.first[d + 1]:
                d += 1
            scratch.counts[f], scratch.changed[f] = count, 1
            scratch.starts[d] = min(scratch.starts[d], f)
    _flush(0, lost, k, old[1], field, scratch)
    _flush(1, gained, k, new[1], field, scratch)


@inlined
def _meet(j: Integer, f: Integer, k: Integer, covered: Any, field: Any, state: Any, scratch: Any) -> Any:
    """Test the occlusion between landmark j and the moving landmark k in frame f.

    If the move changes whether k hides j, frame and landmark are listed in `scratch.pairs`.

    Returns:
        1 if the camera covers k at the new place of k (`covered`) and j hides k there, else 0.
    """
    seen, hiding, change, other = _is_covered(state, f, j), False, np.int64(0), pair3(state.poses, j)
    before, after = scratch.near[0, word_of(j)] & bit_of(j), scratch.near[1, word_of(j)] & bit_of(j)
    if seen and before:
        hid, _ = hide_each_other(k, pair3(state.poses, k), j, other, f, field)
        change -= np.int64(hid)
    if after:
        hid, hiding = hide_each_other(k, tried_pose(scratch), j, other, f, field)
        change += np.int64(hid & seen)
    if change != 0:
        e = scratch.numbers[PAIRS]
        scratch.pairs[0, e], scratch.pairs[1, e], scratch.pairs[2, e] = f, j, change
        scratch.numbers[PAIRS] = e + 1
    return np.int64(hiding & covered)
