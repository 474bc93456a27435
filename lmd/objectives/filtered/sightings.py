"""Landmarks in the frames of drives while one landmark moves: sights, occlusion and information.

`see` lists the frames whose landmarks in view change by a move. Only landmarks near the lines of sight to the moving
one are asked whether they hide it or are hidden (`lmd.incremental.occlusion`), block by block of frames.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import LANES as OTHERS_AT_ONCE
from lmd.core.bits import Integer, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.incremental.occlusion import find_offsets, line_radius, near_line
from lmd.objectives.localisation.information import NUMBERS as SUMS
from lmd.objectives.localisation.information import share_of
from lmd.objectives.localisation.views import landmark_moments
from lmd.scene.criteria import covers, from_position, hide_between, pixel_density, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.obstacles import find_ends, is_blocked, is_clear

OLD, TRIED = np.uint8(1), np.uint8(2)  # marks of `FilteredScratch.marks`
PAIRS, NEAR = 0, 1  # entries of `FilteredScratch.numbers`


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


@inlined
def _list_ahead(b: Integer, pose: FloatArray, field: Any) -> Any:
    """Bit set of the frames of block b whose field of view may contain the place tried."""
    at, axes, found, first = field.positions, field.axes, np.uint32(0), np.uint64(b) * np.uint64(BLOCK)
    for lane in range(np.uint64(BLOCK)):
        f = first + lane
        x, y, z = pose[0] - at[0, f], pose[1] - at[1, f], pose[2] - at[2, f]
        depth = axes[0, f] * x + axes[1, f] * y + axes[2, f] * z
        found |= np.uint32(depth >= field.cosine * math.sqrt(x * x + y * y + z * z)) << np.uint32(lane)
    return found


@inner
def _list_near(b: Integer, k: Integer, width: float, state: Any, field: Any, scratch: Any) -> None:
    """List the landmarks that may hide landmark k, or be hidden by it, from the frames of block b."""
    boxes, marks, near, count = field.boxes, scratch.marks, scratch.near, 0
    hx, hy, hz = np.float32(boxes[3, b]), np.float32(boxes[4, b]), np.float32(boxes[5, b])
    for role in range(2):
        if role == 0:
            ax, ay, az = state.poses[0, k], state.poses[1, k], state.poses[2, k]
        else:
            ax, ay, az = scratch.pose[0], scratch.pose[1], scratch.pose[2]
        others, offsets, mark = scratch.others[role], scratch.offsets[role], OLD if role == 0 else TRIED
        mx, my, mz = ax - boxes[0, b], ay - boxes[1, b], az - boxes[2, b]
        for start in range(np.uint64(0), np.uint64(offsets.shape[1]), np.uint64(OTHERS_AT_ONCE)):
            close = near_line(start, mx, my, mz, hx, hy, hz, width, offsets)
            while close:
                j = others[start + lowest(np.uint64(close))]
                close &= close - np.uint32(1)
                if j != np.int64(k):
                    if marks[j] == 0:
                        near[count] = j
                        count += 1
                    marks[j] |= mark
    scratch.numbers[NEAR] = count


@inner
def begin(field: Any, k: Integer, pose: FloatArray, surface: Integer, state: Any, scratch: Any) -> None:
    """Take the place tried, and forget the last move."""
    scratch.surface[0], scratch.numbers[PAIRS], scratch.numbers[NEAR] = surface, 0, 0
    for i in range(6):
        scratch.pose[i] = pose[i]
    for f in range(len(state.units)):
        scratch.units[f], scratch.changed[f] = state.units[f], 0
    for d in range(len(field.first) - 1):
        scratch.starts[d] = field.first[d + 1]
    for j in range(len(scratch.marks)):
        scratch.marks[j] = 0
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
    for b in range(field.boxes.shape[1]):
        if reaches:
            _list_near(b, k, width, state, field, scratch)
        ahead = _list_ahead(b, pose, field)
        for f in range(b * BLOCK, min((b + 1) * BLOCK, len(state.units))):
            scratch.covered[f], scratch.hidden[f], facing = 0, 0, ahead >> np.uint32(f - b * BLOCK) & np.uint32(1)
            if facing == 0 and state.covered[f, k] == 0 and scratch.numbers[NEAR] == 0:
                continue
            at = field.positions
            x, y, z, covered = pose[0] - at[0, f], pose[1] - at[1, f], pose[2] - at[2, f], False
            if facing != 0:
                covered = covers_alone(f, x, y, z, nx, ny, nz, mine, clear, ends, field)
            was, hiders, turning = (state.covered[f, k] != 0) & (state.hidden[f, k] == 0), 0, scratch.numbers[PAIRS]
            for e in range(scratch.numbers[NEAR]):
                hiders += _meet(scratch.near[e], f, k, covered, x, y, z, field, state, scratch)
            now = covered & (hiders == 0)
            scratch.covered[f], scratch.hidden[f] = covered, hiders
            if not was and not now and turning == scratch.numbers[PAIRS]:
                continue
            row, count = scratch.sums[f], state.counts[f] + np.int16(now) - np.int16(was)
            for j in range(SUMS):
                row[j] = state.sums[f, j]
            if was:
                ox, oy, oz, _ = offset_of(poses, k, f, field)
                add_landmark(row, -1.0, f, k, ox, oy, oz, ux, uy, uz, field, scratch)
            if now:
                add_landmark(row, 1.0, f, k, x, y, z, nx, ny, nz, field, scratch)
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
        for e in range(scratch.numbers[NEAR]):
            scratch.marks[scratch.near[e]] = 0


@inlined
def _meet(
    j: Integer, f: Integer, k: Integer, covered: Any, x: float, y: float, z: float, field: Any, state: Any,
    scratch: Any,
) -> Any:  # fmt: skip
    """Count landmark j if it hides landmark k at the place tried from frame f, and note it if k hides it or did so."""
    seen, mark, hides, poses, pose = state.covered[f, j] != 0, scratch.marks[j], False, state.poses, scratch.pose
    if not seen and not covered:
        return 0
    mine, theirs, change = sized(field.sight, k), sized(field.sight, j), np.int64(0)
    jx, jy, jz, squared = offset_of(poses, j, f, field)
    vx, vy, vz = poses[3, j], poses[4, j], poses[5, j]
    if seen and mark & OLD:
        ox, oy, oz, square = offset_of(poses, k, f, field)
        hid, _ = hide_between(
            mine, theirs, ox, oy, oz, square, jx, jy, jz, squared, poses[3, k], poses[4, k], poses[5, k], vx, vy, vz
        )
        change -= np.int64(hid)
    if mark & TRIED:
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
