"""Who hides whom from a rig: the pairs of a landmark and a position where a move of another one turns it.

Who may hide whom is found for blocks of positions, as in `hiding`, then for each position from the centres of the
cameras (`stations.may_hide_around`), and what is left is tested with each orientation that covers the landmark.
"""

import math

import numpy as np
from numba import literal_unroll

from lmd.core.bits import BITS, LANES, ONE, ZERO, lowest
from lmd.core.compiled import inlined, inner
from lmd.incremental.hiding import find_ways, line_radius, near_line
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.rig_state import ASKED, CAPS, PAIR_COUNT, TOUCHED, TOUCHED_COUNT, TOUCHED_LIST, VEILED, WHERE, WHO
from lmd.incremental.state import BLOCK_COUNT, BLOCKS, OTHERS
from lmd.sight.blocks import BLOCK
from lmd.sight.stations import hides_from, line_room, may_hide_around

# What `_find_pairs` looks at: a place that is left, one that is come to, one where there was nothing yet.
LEAVES, COMES, ARRIVES = np.int64(0), np.int64(1), np.int64(2)


@inner
def _hidden_bits(part, m, w, bits, i, k, px, py, pz, one, other):
    """Those orientations of a set of word w with which landmark i, `one`, hides k, the `other`, from mount m."""
    found = ZERO
    while bits:
        bit = lowest(bits)
        bits &= bits - ONE
        found |= np.uint64(hides_from(part, m, w * np.uint64(BITS) + bit, i, k, px, py, pz, one, other)) << bit
    return found


@inner
def _drop_hidden(part, c, i, k, q, px, py, pz, state, flipped):
    """Take out of what is `flipped` of landmark i from position q with what another one but k hides it."""
    other, width = pose_of(i, state), line_radius(part.sight)
    x, y, z = (
        other[0] - (px + part.centres[c, 0]), other[1] - (py + part.centres[c, 1]), other[2] - (pz + part.centres[c, 2])
    )  # fmt: skip
    for j in range(np.uint64(len(state.surfaces))):
        one = pose_of(j, state)
        ax, ay, az = x + (one[0] - other[0]), y + (one[1] - other[1]), z + (one[2] - other[2])
        if may_hide_around(ax, ay, az, x, y, z, part.radius[c], width) and j != i and j != k:
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(np.uint64(flipped.shape[3])):
                    bits = flipped[i, q, m, w]
                    flipped[i, q, m, w] ^= _hidden_bits(part, m, w, bits, j, i, px, py, pz, one, other)


@inlined
def _touch(q, rig):
    """Note a position where others turn or are in the way."""
    numbers = rig.numbers
    if not rig.flags[TOUCHED, q]:
        rig.flags[TOUCHED, q], rig.lists[TOUCHED_LIST, numbers[TOUCHED_COUNT]] = True, q
        numbers[TOUCHED_COUNT] += 1


@inlined
def _find_pair(part, c, i, k, q, px, py, pz, place, how, mine, other, state, rig):
    """Find what landmark k at a `place` hides of landmark i from position q, and note it down."""
    pose, changed, caps, veiled, numbers = pose_of(i, state), False, mine[CAPS], mine[VEILED], rig.numbers
    for m in range(part.mounts[c], part.mounts[c + 1]):
        for w in range(np.uint64(caps.shape[3])):
            # Little more is read than is needed: these sets are too many for the cache.
            bits = caps[i, q, m, w] if how == COMES else veiled[i, q, m, w]
            found = _hidden_bits(part, m, w, bits, k, i, px, py, pz, place, pose) if bits else ZERO
            if found == ZERO:
                continue
            was = flips = other.flipped[i, q, m, w]
            flips = found if how == LEAVES else (flips & ~found) | (found & ~veiled[i, q, m, w])
            changed |= flips != was
            other.flipped[i, q, m, w] = flips
    if changed and how == LEAVES:
        _drop_hidden(part, c, i, k, q, px, py, pz, state, other.flipped)
    if changed:
        _touch(q, rig)
        if not rig.known[q, i]:
            rig.known[q, i], rig.pairs[WHO, numbers[PAIR_COUNT]], rig.pairs[WHERE, numbers[PAIR_COUNT]] = True, i, q
            numbers[PAIR_COUNT] += 1


@inner
def _find_pairs(k, how, stations, field, state, rig):
    """Find whom landmark k hides where it is, or where it is tried, and there who may hide it: see `LEAVES`."""
    part, mine, other, size = stations.part, state.parts[stations.number], rig.parts[stations.number], len(rig.units)
    body, boxes, poses, width = field.positions, field.boxes, state.poses, line_radius(part.sight)
    blocks, others, who, where = rig.lists[BLOCKS], rig.lists[OTHERS], other.pairs[WHO], other.pairs[WHERE]
    place = pose_of(k, state) if how == LEAVES else target_of(rig)
    ax, ay, az = place[0], place[1], place[2]
    filled = find_ways(ax, ay, az, poses, part.horizon, others, rig.ways)
    for c in range(len(part.centres)):
        cx, cy, cz, radius = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2], part.radius[c]
        for e in range(rig.numbers[BLOCK_COUNT]):
            b = blocks[e]
            mx, my, mz = ax - boxes[0, b] - cx, ay - boxes[1, b] - cy, az - boxes[2, b] - cz
            hx, hy, hz = (
                np.float32(boxes[3, b] + radius), np.float32(boxes[4, b] + radius), np.float32(boxes[5, b] + radius)
            )  # fmt: skip
            for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
                close = near_line(start, mx, my, mz, hx, hy, hz, width, rig.ways)
                while close:
                    i = others[start + lowest(np.uint64(close))]
                    close &= close - np.uint32(1)
                    lx, ly, lz = poses[0, i], poses[1, i], poses[2, i]
                    ex, ey, ez, lanes = lx - ax, ly - ay, lz - az, np.uint32(0)
                    vx, vy, vz, apart = mx + ex, my + ey, mz + ez, math.sqrt(ex * ex + ey * ey + ez * ez)
                    far = math.sqrt(max(mx * mx + my * my + mz * mz, vx * vx + vy * vy + vz * vz))
                    most = line_room(far + math.sqrt(hx * hx + hy * hy + hz * hz), apart, radius, width)
                    for lane in range(np.uint64(BLOCK)):
                        q = b * np.uint64(BLOCK) + lane
                        ux, uy, uz = ax - (body[0, q] + cx), ay - (body[1, q] + cy), az - (body[2, q] + cz)
                        sx, sy, sz = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
                        lanes |= np.uint32(sx * sx + sy * sy + sz * sz <= most) << np.uint32(lane)
                    while lanes and i != np.uint64(k):
                        q = b * np.uint64(BLOCK) + lowest(np.uint64(lanes))
                        lanes &= lanes - np.uint32(1)
                        if how != ARRIVES:
                            px, py, pz = body[0, q], body[1, q], body[2, q]
                            _find_pair(part, c, i, k, q, px, py, pz, place, how, mine, other, state, rig)
                        if how != LEAVES:
                            who[other.rivals[0]], where[other.rivals[0]] = i, np.uint64(c * size) + q
                            other.rivals[0] += 1


@inner
def find_veils(k, stations, field, state, rig):
    """Find in `VEILED` with which of the orientations of `CAPS` that are `ASKED` rivals hide the place tried."""
    part, other, size, body = stations.part, rig.parts[stations.number], np.uint64(len(rig.units)), field.positions
    place, asked, cap, veil = target_of(rig), rig.sets[ASKED], other.sets[CAPS], other.sets[VEILED]
    who, where = other.pairs[WHO], other.pairs[WHERE]
    for e in range(other.rivals[0]):
        i, c, q = np.uint64(who[e]), where[e] // size, where[e] % size
        for m in range(part.mounts[c], part.mounts[c + np.uint64(1)]):
            for w in range(np.uint64(cap.shape[2])):
                bits = cap[q, m, w] & asked[q, w] & ~veil[q, m, w]
                if bits:
                    px, py, pz = body[0, q], body[1, q], body[2, q]
                    found = _hidden_bits(part, m, w, bits, i, k, px, py, pz, pose_of(i, state), place)
                    if found:
                        veil[q, m, w] |= found
                        _touch(q, rig)


@inner
def find_pairs(k, how, parts, field, state, scratch):
    """See `_find_pairs`, of all parts."""
    for stations in literal_unroll(parts):
        if stations.part.sight.reach >= 0.0:
            _find_pairs(k, how, stations, field, state, scratch)
            if how == COMES:
                find_veils(k, stations, field, state, scratch)
