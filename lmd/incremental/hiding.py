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
def find_ways(ax, ay, az, landmarks, horizon, others, ways):
    """List the landmarks within the horizon of (ax, ay, az), and the ways to them; see `Nearby`.

    Returns:
        how many there are, filled up to whole words.
    """
    count, most = landmarks.shape[1], np.float32(horizon * (1.0 + SINGLE_ERROR))
    for i in range(count):
        dx, dy, dz = landmarks[0, i] - ax, landmarks[1, i] - ay, landmarks[2, i] - az
        ways[0, i], ways[1, i], ways[2, i], ways[3, i] = dx, dy, dz, math.sqrt(dx * dx + dy * dy + dz * dz)
        others[i] = i
    if most < np.inf:
        count = 0
        for i in range(landmarks.shape[1]):
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
def find_neighbours(k, place, field, state, near, wanted, neighbours):
    """Fill `neighbours` of a place of landmark k, position and normal, in the `wanted` ones of the blocks `near`."""
    positions, centres, halves, sight = field.positions, field.centres, field.halves, field.sight
    landmarks, normals, others, ways = state.landmarks, state.normals, near.others, near.ways
    ax, ay, az, nx, ny, nz = place
    found, who, hides, hidden_by, count_hides, count_hidden = neighbours
    mine = sized(sight, k)
    radius, filled = line_radius(sight), find_ways(ax, ay, az, landmarks, field.horizon, others, ways)
    for b in near.blocks[: near.found[0]]:
        found[b] = 0
        if not wanted[b]:
            continue
        first, last = b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)
        for p in range(first, last):
            count_hides[p] = count_hidden[p] = 0
        mx, my, mz = ax - centres[0, b], ay - centres[1, b], az - centres[2, b]
        hx, hy, hz = halves[0, b], halves[1, b], halves[2, b]
        kept = 0
        for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
            close = near_line(start, mx, my, mz, hx, hy, hz, radius, ways)
            while close:
                i = others[start + lowest(np.uint64(close))]
                close &= close - np.uint32(1)
                lx, ly, lz = landmarks[0, i], landmarks[1, i], landmarks[2, i]
                vx, vy, vz = normals[0, i], normals[1, i], normals[2, i]
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
    """List in `names` and `goes` the landmarks that appear or disappear at position p, and return how many.

    `sign` is `FORTH` or `BACK`.
    """
    reachable, hidden, names, goes = state.reachable, state.hidden, scratch.names, scratch.goes
    found, who, change = scratch.turns
    b, q, count = p // np.uint64(BLOCK), p % np.uint64(BLOCK), ZERO
    for m in range(np.uint64(found[b])):
        i = np.uint64(who[b, m])
        was, now = hidden[i, p], hidden[i, p] + sign * change[b, m, q]
        names[count], goes[count] = i, ALL if was == 0 else ZERO
        count += np.uint64(flips_with(reachable[i, p], was, now))
    return count


@inner
def find_turns(blocks, before, after, turns, slot):
    """Merge what a landmark hides `before` and `after` a move into how many more others hide each of the others."""
    found, who, change = turns
    for b in blocks:
        found[b] = 0
        for m in range(before.found[b] + after.found[b]):
            new = m >= before.found[b]
            j = m - before.found[b] if new else m
            i = after.who[b, j] if new else before.who[b, j]
            if slot[i] < 0:
                slot[i], who[b, found[b]] = found[b], i
                change[b, found[b]] = 0
                found[b] += 1
            for q in range(BLOCK):
                change[b, slot[i], q] += after.hides[b, j, q] if new else -before.hides[b, j, q]
        for m in range(found[b]):
            slot[who[b, m]] = -1


@inner
def find_old(k, field, state, scratch):
    """Fill `before` with what landmark k hides, and is hidden by, where it is."""
    hiding, hidden, near, wanted = state.hiding, state.hidden, scratch.near, scratch.near.wanted
    for b in near.blocks[: near.found[0]]:
        some = np.int16(0)
        for p in range(b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)):
            some |= hiding[k, p] | hidden[k, p]
        wanted[b] = some != 0  # nearly everywhere there are none: then there is nothing to find again
    find_neighbours(k, pose_of(k, state), field, state, near, wanted, scratch.before)


@inner
def find_new(k, field, state, scratch):
    """Fill `after` with what landmark k hides, and is hidden by, at the place tried."""
    find_neighbours(k, target_of(scratch), field, state, scratch.near, scratch.near.aimed, scratch.after)


@inner
def find_flips(state, scratch):
    """Fill `turns` from `before` and `after`; set `flips` where another landmark appears or disappears."""
    reachable, hidden, flips = state.reachable, state.hidden, scratch.flips
    blocks = scratch.near.blocks[: scratch.near.found[0]]
    find_turns(blocks, scratch.before, scratch.after, scratch.turns, scratch.slot)
    found, who, change = scratch.turns
    for b in blocks:
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
    hidden, hiding, before, after = state.hidden, state.hiding, scratch.before, scratch.after
    found, who, change = scratch.turns
    if sight.reach >= 0.0:
        for b in scratch.near.blocks[: scratch.near.found[0]]:
            for q in range(np.uint64(BLOCK if found[b] + before.found[b] + after.found[b] else 0)):
                p = b * np.uint64(BLOCK) + q
                for m in range(found[b]):
                    hidden[who[b, m], p] += sign * change[b, m, q]
                for m in range(before.found[b]):
                    hiding[before.who[b, m], p] -= sign * before.hidden_by[b, m, q]
                for m in range(after.found[b]):
                    hiding[after.who[b, m], p] += sign * after.hidden_by[b, m, q]
    for s in range(scratch.near.found[1]):
        first, last = scratch.near.spans[s, 0], scratch.near.spans[s, 1]
        swap(state.reachable[k], scratch.new.reached, first, last)
        swap(hidden[k], after.count_hidden, first, last)
        swap(hiding[k], after.count_hides, first, last)
