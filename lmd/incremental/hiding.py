"""Which landmarks hide a place, which it hides, and which of these appear or disappear as one landmark moves.

Positions come in blocks of neighbours, and only those within the horizon of both landmarks count. Two stages, from
cheap to exact:

1. Seen from a whole block, most landmarks are so far off the direction of the place that no position of the block needs
   the exact test. Let m be the offset of the place a from the centre of the block, e = o - a the way from there to a
   landmark o. From a position delta away from the centre, a and o lie at a' = m - delta and o' = a' + e. One of them
   hides the other only within r = sqrt(reach) of the line of sight: if |a' x o'| <= r max(|a'|, |o'|). As
   a' x o' = m x e - delta x e, and the block fits into a box of half the size h, the first component of m x e is then
   at most

       h_y |e_z| + h_z |e_y| + r (|m| + |h| + |e|),

   and so on around. All landmarks are tested in single precision, and `SINGLE_ERROR` covers its rounding: each of
   the sums above is off by less than five roundings of 6e-8 of itself or of (|m| + |h|) |e|.
2. Those left are tested from each position, by the inequalities of the reference.
"""

import math

import numpy as np

from lmd.core.bits import ALL, LANES, ONE, ZERO, lowest
from lmd.core.compiled import inlined, inner
from lmd.incremental.nearby import is_near, pose_of, target_of
from lmd.incremental.state import (
    AFTER,
    AFTER_HIDDEN,
    AFTER_HIDING,
    AIMED,
    BEFORE,
    BLOCK_COUNT,
    BLOCKS,
    CHANGE,
    FIRST,
    FLIPS,
    FOUND,
    GOES,
    HIDDEN,
    HIDING,
    LAST,
    NAMES,
    OTHERS,
    REACHED,
    SLOT,
    SPAN_COUNT,
    TURNS,
    WANTED,
)
from lmd.scene.criteria import TOLERANCE, hide_between, sized
from lmd.sight.blocks import BLOCK, SINGLE_ERROR

# Signs of a move that is carried out, and of one that is taken back. Of Python's numbers each is a type of its own for
# numba, which would compile what it is handed to twice.
FORTH, BACK = np.int64(1), np.int64(-1)


@inlined
def line_radius(sight):
    """How far from a line of sight a landmark may be that hides something, metres."""
    return math.sqrt(sight.reach) * (1.0 + SINGLE_ERROR) + TOLERANCE


@inner
def find_ways(ax, ay, az, poses, horizon, others, ways):
    """List the landmarks within the horizon of (ax, ay, az), and the ways to them; see `Scratch`.

    Returns:
        how many there are, filled up to whole words.
    """
    count, most = poses.shape[1], np.float32(horizon * (1.0 + SINGLE_ERROR))
    for i in range(count):
        dx, dy, dz = poses[0, i] - ax, poses[1, i] - ay, poses[2, i] - az
        ways[0, i], ways[1, i], ways[2, i], ways[3, i] = dx, dy, dz, math.sqrt(dx * dx + dy * dy + dz * dz)
        others[i] = i
    if most < np.inf:
        count = 0
        for i in range(poses.shape[1]):
            dx, dy, dz, distance = ways[0, i], ways[1, i], ways[2, i], ways[3, i]
            others[count] = i
            ways[0, count], ways[1, count], ways[2, count], ways[3, count] = dx, dy, dz, distance
            count += distance <= most
    filled = (count + LANES - 1) & -LANES
    for i in range(count, filled):
        ways[3, i] = -np.inf  # nothing comes close to those that fill up
    return filled


@inlined
def near_line(start, mx, my, mz, hx, hy, hz, radius, ways):
    """Which of the ways from `start` on, as bits, lead to landmarks of the first stage above.

    Args:
        start: the first of `LANES`.
        mx, my, mz: offset of the place from the centre of the box.
        hx, hy, hz: half its sides.
        radius: of `line_radius`.
        ways: of `find_ways`.
    """
    far = math.sqrt(mx * mx + my * my + mz * mz) + math.sqrt(hx * hx + hy * hy + hz * hz)
    shift, slope = np.float32(radius * far), np.float32(radius + SINGLE_ERROR * far)
    ux, uy, uz = np.float32(mx), np.float32(my), np.float32(mz)
    close = np.uint32(0)
    for lane in range(np.uint64(LANES)):
        i = start + lane
        ex, ey, ez = ways[0, i], ways[1, i], ways[2, i]
        room = shift + slope * ways[3, i]
        near = abs(uy * ez - uz * ey) <= hz * abs(ey) + hy * abs(ez) + room
        near &= abs(uz * ex - ux * ez) <= hx * abs(ez) + hz * abs(ex) + room
        near &= abs(ux * ey - uy * ex) <= hy * abs(ex) + hx * abs(ey) + room
        close |= np.uint32(near) << np.uint32(lane)
    return close


@inner
def find_neighbours(k, place, field, poses, scratch, which, wanted):
    """Find whom a place of landmark k hides, position and normal, and who hides it, in the blocks that are `wanted`.

    `which` is `BEFORE` or `AFTER`, `wanted` a row of flags.
    """
    positions, boxes, sight, ways, lists = field.positions, field.boxes, field.sight, scratch.ways, scratch.lists
    ax, ay, az, nx, ny, nz = place
    others, found, who = lists[OTHERS], lists[FOUND + which], scratch.who[which]
    hides, hidden_by = scratch.pairs[2 * which + HIDING], scratch.pairs[2 * which + HIDDEN]
    count_hides, count_hidden = scratch.shorts[2 * which + HIDING], scratch.shorts[2 * which + HIDDEN]
    mine = sized(sight, k)
    radius, filled = line_radius(sight), find_ways(ax, ay, az, poses, field.horizon, others, ways)
    for b in lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        found[b] = 0
        if not wanted[b]:
            continue
        first, last = b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)
        for p in range(first, last):
            count_hides[p] = count_hidden[p] = 0
        mx, my, mz = ax - boxes[0, b], ay - boxes[1, b], az - boxes[2, b]
        hx, hy, hz = np.float32(boxes[3, b]), np.float32(boxes[4, b]), np.float32(boxes[5, b])
        kept = 0
        for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
            close = near_line(start, mx, my, mz, hx, hy, hz, radius, ways)
            while close:
                i = others[start + lowest(np.uint64(close))]
                close &= close - np.uint32(1)
                lx, ly, lz = poses[0, i], poses[1, i], poses[2, i]
                vx, vy, vz = poses[3, i], poses[4, i], poses[5, i]
                theirs, some = sized(sight, i), np.int64(0)
                for p in range(first, last):
                    x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
                    ox, oy, oz = lx - positions[0, p], ly - positions[1, p], lz - positions[2, p]
                    squared, other = x * x + y * y + z * z, ox * ox + oy * oy + oz * oz
                    one, two = hide_between(mine, theirs, x, y, z, squared, ox, oy, oz, other, nx, ny, nz, vx, vy, vz)
                    some += one | two
                if some == 0 or i == np.uint64(k) or not is_near(field, b, lx, ly, lz):
                    continue
                for p in range(first, last):
                    x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
                    ox, oy, oz = lx - positions[0, p], ly - positions[1, p], lz - positions[2, p]
                    squared, other = x * x + y * y + z * z, ox * ox + oy * oy + oz * oz
                    one, two = hide_between(mine, theirs, x, y, z, squared, ox, oy, oz, other, nx, ny, nz, vx, vy, vz)
                    hides[b, kept, p - first], hidden_by[b, kept, p - first] = one, two
                    count_hides[p] += one
                    count_hidden[p] += two
                who[b, kept] = i
                kept += 1
        found[b] = kept


@inlined
def flips_with(reachable, was, now):
    """Whether a landmark appears or disappears when `now` others hide it instead of `was`."""
    return reachable & ((was == 0) != (now == 0))


@inlined
def list_turning(p, sign, state, scratch):
    """List in `NAMES` and `GOES` the landmarks that appear or disappear at position p, and return how many.

    `sign` is `FORTH` or `BACK`.
    """
    reachable, hidden, names, goes = state.reachable, state.hides[HIDDEN], scratch.lists[NAMES], scratch.lists[GOES]
    found, who, change = scratch.lists[FOUND + TURNS], scratch.who[TURNS], scratch.pairs[CHANGE]
    b, q, count = p // np.uint64(BLOCK), p % np.uint64(BLOCK), ZERO
    for m in range(np.uint64(found[b])):
        i = np.uint64(who[b, m])
        was, now = hidden[i, p], hidden[i, p] + sign * change[b, m, q]
        names[count], goes[count] = i, ALL if was == 0 else ZERO
        count += np.uint64(flips_with(reachable[i, p], was, now))
    return count


@inner
def find_turns(scratch):
    """Merge what a landmark hides `BEFORE` and `AFTER` a move into how many more others hide each of the others."""
    lists, who, pairs = scratch.lists, scratch.who, scratch.pairs
    found, slot, change, turning = lists[FOUND + TURNS], lists[SLOT], pairs[CHANGE], who[TURNS]
    for b in lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        found[b] = 0
        for which in (BEFORE, AFTER):
            mine, hides = who[which], pairs[2 * which + HIDING]
            for j in range(lists[FOUND + which, b]):
                i = mine[b, j]
                if slot[i] == ALL:
                    slot[i], turning[b, found[b]] = found[b], i
                    change[b, found[b]] = 0
                    found[b] += ONE
                for q in range(BLOCK):
                    change[b, slot[i], q] += -hides[b, j, q] if which == BEFORE else hides[b, j, q]
        for m in range(found[b]):
            slot[turning[b, m]] = ALL


@inner
def find_old(k, field, state, scratch):
    """Fill `BEFORE` with what landmark k hides, and is hidden by, where it is."""
    hiding, hidden, wanted = state.hides[HIDING], state.hides[HIDDEN], scratch.flags[WANTED]
    for b in scratch.lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        some = np.int16(0)
        for p in range(b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)):
            some |= hiding[k, p] | hidden[k, p]
        wanted[b] = some != 0  # nearly everywhere there are none: then there is nothing to find again
    find_neighbours(k, pose_of(k, state), field, state.poses, scratch, BEFORE, wanted)


@inner
def find_new(k, field, state, scratch):
    """Fill `AFTER` with what landmark k hides, and is hidden by, at the place tried."""
    find_neighbours(k, target_of(scratch), field, state.poses, scratch, AFTER, scratch.flags[AIMED])


@inner
def find_flips(state, scratch):
    """Fill `TURNS` from `BEFORE` and `AFTER`; set `FLIPS` where another landmark appears or disappears."""
    reachable, hidden, flips = state.reachable, state.hides[HIDDEN], scratch.flags[FLIPS]
    find_turns(scratch)
    found, who, change = scratch.lists[FOUND + TURNS], scratch.who[TURNS], scratch.pairs[CHANGE]
    for b in scratch.lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        for m in range(found[b]):
            i = who[b, m]
            for q in range(np.uint64(BLOCK)):
                p = b * np.uint64(BLOCK) + q
                flips[p] |= flips_with(reachable[i, p], hidden[i, p], hidden[i, p] + change[b, m, q])


@inlined
def swap(one, other, first, last):
    """Exchange a part of two arrays; by itself, so that the loop vectorises."""
    for p in range(first, last):
        one[p], other[p] = other[p], one[p]


@inner
def exchange_hiding(k, sign, sight, state, scratch):
    """Exchange from where landmark k is reached, and who hides whom, for what `scratch` has of its other place.

    `sign` is `FORTH` or `BACK`.
    """
    hidden, hiding = state.hides[HIDDEN], state.hides[HIDING]
    lists, who, pairs = scratch.lists, scratch.who, scratch.pairs
    before, after, found = lists[FOUND + BEFORE], lists[FOUND + AFTER], lists[FOUND + TURNS]
    old, new, turning = who[BEFORE], who[AFTER], who[TURNS]
    hid_old, hid_new, change = pairs[HIDDEN], pairs[AFTER_HIDDEN], pairs[CHANGE]
    if sight.reach >= 0.0:
        for b in lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
            for q in range(np.uint64(BLOCK if found[b] + before[b] + after[b] else 0)):
                p = b * np.uint64(BLOCK) + q
                for m in range(found[b]):
                    hidden[turning[b, m], p] += sign * change[b, m, q]
                for m in range(before[b]):
                    hiding[old[b, m], p] -= sign * hid_old[b, m, q]
                for m in range(after[b]):
                    hiding[new[b, m], p] += sign * hid_new[b, m, q]
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = lists[FIRST, s], lists[LAST, s]
        swap(state.reachable[k], scratch.flags[REACHED], first, last)
        swap(hidden[k], scratch.shorts[AFTER_HIDDEN], first, last)
        swap(hiding[k], scratch.shorts[AFTER_HIDING], first, last)
