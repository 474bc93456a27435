"""Landmarks in the frames of drives while one landmark moves: sights, occlusion and information.

`see` lists the frames whose landmarks in view change by a move. Only landmarks near the lines of sight to the moving
one are asked whether they hide it or are hidden (`lmd.incremental.occlusion`), block by block of frames.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, Integer, lowest
from lmd.core.bits import LANES as OTHERS_AT_ONCE
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import upright_sides
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
    """Word of a landmark in a bit set."""
    return np.uint64(k) // np.uint64(BITS)


@inlined
def bit_of(k: Integer) -> Any:
    """Bit of a landmark in its word."""
    return ONE << np.uint64(k) % np.uint64(BITS)


@inlined
def _is_covered(state: Any, f: Integer, k: Integer) -> Any:
    """True if frame f covers landmark k, hidden by others or not."""
    return state.covered[f, word_of(k)] & bit_of(k) != ZERO


@inlined
def offset_of(poses: FloatArray, k: Integer, f: Integer, field: Any) -> Any:
    """Offset of landmark k from frame f, metres, and its squared length, m^2."""
    at = field.positions
    x, y, z = poses[0, k] - at[0, f], poses[1, k] - at[1, f], poses[2, k] - at[2, f]
    return x, y, z, x * x + y * y + z * z


@inlined
def covers_alone(
    f: Integer, x: float, y: float, z: float, nx: float, ny: float, nz: float, mine: Any, clear: Any, ends: Any,
    field: Any,
) -> Any:  # fmt: skip
    """True if frame f covers a landmark at the offset (x, y, z), whose points are the first of `ends`."""
    reached, low, _, _ = from_position(mine, x, y, z, nx, ny, nz, 0.0)
    if not reached or not covers(mine, x, y, z, nx, ny, nz, low, 0.0, field.axes, f):
        return False
    return clear or not is_blocked(field.obstacles, mine, f, ends, 0)


@inlined
def add_landmark(
    row: FloatArray, sign: float, f: Integer, k: Integer, x: float, y: float, z: float, nx: float, ny: float,
    nz: float, field: Any, scratch: Any,
) -> None:  # fmt: skip
    """Add the information of landmark k at the offset (x, y, z) from frame f to a row of `sums`, times `sign`."""
    moment = scratch.moment
    landmark_moments(x, y, z, nx, ny, nz, field.precision, k, moment)
    weight = pixel_density(field.sight, x, y, z, field.axes, f)
    for j in range(np.uint64(SUMS)):
        row[j] += sign * share_of(moment[j], weight)


@inner
def _mark_ahead(field: Any, scratch: Any) -> None:
    """Mark the frames whose field of view may contain the place tried."""
    at, axes, ahead = field.positions, field.axes, scratch.covered
    px, py, pz, cosine = scratch.pose[0], scratch.pose[1], scratch.pose[2], field.cosine
    for f in range(np.uint64(len(ahead))):
        x, y, z = px - at[0, f], py - at[1, f], pz - at[2, f]
        depth = axes[0, f] * x + axes[1, f] * y + axes[2, f] * z
        ahead[f] = depth >= cosine * math.sqrt(x * x + y * y + z * z)


@inner
def _flush(role: Integer, count: Integer, k: Integer, normal: Any, field: Any, scratch: Any) -> None:
    """Add the information of landmark k at the first `count` of the `spots` of a role to the sums of their frames."""
    spots, shares, frames, asked = scratch.spots[role], scratch.shares, scratch.spotted[role], field.precision
    rx, ry, rz, ux, uy, uz = upright_sides(half_of(asked, k), normal[0], normal[1], normal[2])
    for i in range(CHUNK):
        (
            shares[i], shares[i + _1], shares[i + _2], shares[i + _3], shares[i + _4], shares[i + _5], shares[i + _6],
            shares[i + _7], shares[i + _8], shares[i + _9], shares[i + _10], shares[i + _11], shares[i + _12],
            shares[i + _13], shares[i + _14],
        ) = moments(spots[i], spots[i + _1], spots[i + _2], rx, ry, rz, ux, uy, uz, asked.share)  # fmt: skip
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
def _spot(
    role: Integer, count: Integer, f: Integer, k: Integer, x: float, y: float, z: float, normal: Any, field: Any,
    scratch: Any,
) -> Any:  # fmt: skip
    """Note that frame f shows the moving landmark at the offset (x, y, z); the new number of the `spots` of a role."""
    spots, i = scratch.spots[role], np.uint64(count)
    spots[i], spots[i + _1], spots[i + _2] = x, y, z
    spots[i + _3] = pixel_density(field.sight, x, y, z, field.axes, f)
    scratch.spotted[role, i] = f
    if i + np.uint64(1) < CHUNK:
        return count + 1
    _flush(role, CHUNK, k, normal, field, scratch)
    return np.int64(0)


@inner
def _list_near(b: Integer, k: Integer, width: float, state: Any, field: Any, scratch: Any) -> None:
    """List the landmarks that may hide landmark k, or be hidden by it, from the frames of block b."""
    boxes, near = field.boxes, scratch.near
    hx, hy, hz = np.float32(boxes[3, b]), np.float32(boxes[4, b]), np.float32(boxes[5, b])
    for role in range(2):
        for w in range(near.shape[1]):
            near[role, w] = ZERO
        if role == 0:
            ax, ay, az = state.poses[0, k], state.poses[1, k], state.poses[2, k]
        else:
            ax, ay, az = scratch.pose[0], scratch.pose[1], scratch.pose[2]
        others, offsets = scratch.others[role], scratch.offsets[role]
        mx, my, mz = ax - boxes[0, b], ay - boxes[1, b], az - boxes[2, b]
        for start in range(np.uint64(0), np.uint64(offsets.shape[1]), np.uint64(OTHERS_AT_ONCE)):
            close = near_line(start, mx, my, mz, hx, hy, hz, width, offsets)
            while close:
                j = np.uint64(others[start + lowest(np.uint64(close))])
                close &= close - np.uint32(1)
                near[role, word_of(j)] |= bit_of(j)
        near[role, word_of(k)] &= ~bit_of(k)


@inner
def begin(field: Any, k: Integer, pose: FloatArray, surface: Integer, state: Any, scratch: Any) -> None:
    """Take the place tried, and forget the last move."""
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
        find_offsets(
            old[0, k], old[1, k], old[2, k], old, field.horizon, scratch.others[0], scratch.offsets[0]
        )  # fmt: skip
        find_offsets(pose[0], pose[1], pose[2], old, field.horizon, scratch.others[1], scratch.offsets[1])


@inner
def see(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Find the changed frames, and their information."""
    poses, pose, width, reaches = state.poses, scratch.pose, 0.0, field.sight.reach >= 0.0
    mine, clear, ends, d = sized(field.sight, k), is_clear(field.obstacles), scratch.ends, 0
    nx, ny, nz, ux, uy, uz = pose[3], pose[4], pose[5], poses[3, k], poses[4, k], poses[5, k]
    if reaches:
        width = line_radius(field.sight)
    if not clear:
        find_ends(field.obstacles, mine, pose[0], pose[1], pose[2], nx, ny, nz, ends, 0)
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
            at = field.positions
            x, y, z, covered = pose[0] - at[0, f], pose[1] - at[1, f], pose[2] - at[2, f], False
            if facing:
                covered = covers_alone(f, x, y, z, nx, ny, nz, mine, clear, ends, field)
            was, hiders, turning = _is_covered(state, f, k) & (state.hidden[f, k] == 0), 0, scratch.numbers[PAIRS]
            for w in range(np.uint64(scratch.near.shape[1])):
                left = scratch.near[0, w] | scratch.near[1, w]
                if not covered:
                    left &= state.covered[f, w]
                while left:
                    j = w * np.uint64(BITS) + lowest(left)
                    left &= left - ONE
                    hiders += _meet(j, f, k, covered, x, y, z, field, state, scratch)
            now = covered & (hiders == 0)
            scratch.covered[f], scratch.hidden[f] = covered, hiders
            if not was and not now and turning == scratch.numbers[PAIRS]:
                continue
            row, count = scratch.sums[f], state.counts[f] + np.int16(now) - np.int16(was)
            for t in range(SUMS):
                row[t] = state.sums[f, t]
            if was:
                ox, oy, oz, _ = offset_of(poses, k, f, field)
                lost = _spot(0, lost, f, k, ox, oy, oz, (ux, uy, uz), field, scratch)
            if now:
                gained = _spot(1, gained, f, k, x, y, z, (nx, ny, nz), field, scratch)
            turned = was | now
            for e in range(turning, scratch.numbers[PAIRS]):
                i, hid = np.int64(scratch.pairs[1, e]), state.hidden[f, scratch.pairs[1, e]]
                before, after = hid == 0, hid + scratch.pairs[2, e] == 0
                if before != after:
                    ox, oy, oz, _ = offset_of(poses, i, f, field)
                    sign = 1.0 if after else -1.0
                    add_landmark(row, sign, f, i, ox, oy, oz, poses[3, i], poses[4, i], poses[5, i], field, scratch)
                    count, turned = count + np.int16(sign), True
            if not turned:
                continue
            while f >= field.first[d + 1]:
                d += 1
            scratch.counts[f], scratch.changed[f] = count, 1
            scratch.starts[d] = min(scratch.starts[d], f)
    _flush(0, lost, k, (ux, uy, uz), field, scratch)
    _flush(1, gained, k, (nx, ny, nz), field, scratch)


@inlined
def _meet(
    j: Integer, f: Integer, k: Integer, covered: Any, x: float, y: float, z: float, field: Any, state: Any,
    scratch: Any,
) -> Any:  # fmt: skip
    """Count landmark j if it hides landmark k at the place tried from frame f, and note it if k hides it or did so."""
    seen, hides, poses, pose = _is_covered(state, f, j), False, state.poses, scratch.pose
    before, after = scratch.near[0, word_of(j)] & bit_of(j), scratch.near[1, word_of(j)] & bit_of(j)
    mine, theirs, change = sized(field.sight, k), sized(field.sight, j), np.int64(0)
    jx, jy, jz, squared = offset_of(poses, j, f, field)
    vx, vy, vz = poses[3, j], poses[4, j], poses[5, j]
    if seen and before:
        ox, oy, oz, square = offset_of(poses, k, f, field)
        hid, _ = hide_between(
            mine, theirs, ox, oy, oz, square, jx, jy, jz, squared, poses[3, k], poses[4, k], poses[5, k], vx, vy, vz
        )
        change -= np.int64(hid)
    if after:
        square = x * x + y * y + z * z
        hid, hides = hide_between(
            mine, theirs, x, y, z, square, jx, jy, jz, squared, pose[3], pose[4], pose[5], vx, vy, vz
        )
        change += np.int64(hid & seen)
    if change != 0:
        e = scratch.numbers[PAIRS]
        scratch.pairs[0, e], scratch.pairs[1, e], scratch.pairs[2, e] = f, j, change
        scratch.numbers[PAIRS] = e + 1
    return np.int64(hides & covered)
