"""Trying to move one landmark where a rig looks for it.

What is counted are orientations of the body: the caps of all cameras of a landmark become one set, `shown`, and that
comes and goes. So a move changes the counts at a position by the set of the landmark that moves, and by those of others
that appear or disappear for one of the cameras: the *pairs* of a landmark and a position, of which there are few.

Who may hide whom is found for blocks of positions, as in `hiding`, then for each position from the centres of the
cameras (`stations.may_hide_around`), and what is left is tested with each orientation that covers the landmark.

As in `trial`, `bound_rig_move` leaves out what the new place hides and what hides it, and looks at those orientations
only where P_n depends on them, with n - 1 other landmarks in view. `rig_move.carry_out_rig` alone finds all.
"""

import math

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, add_digit, at_least_so_far, equal_so_far, lowest
from lmd.core.compiled import allocating, inlined, inner
from lmd.incremental.hiding import find_ways, line_radius, near_line
from lmd.incremental.nearby import list_blocks
from lmd.scene.criteria import frame_of, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.kernels import weights_row
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends
from lmd.sight.stations import bounds_from, covers_from, hides_from, line_room, may_hide_around, row_from, split

# What `_find_pairs` looks at: a place that is left, one that is come to, one where there was nothing yet.
LEAVES, COMES, ARRIVES = np.int64(0), np.int64(1), np.int64(2)


@allocating
def _find_caps(k, stations, positions, body, scratch, rig, whole):
    """Find in `cap` the orientations that are `asked`, or with `whole` all, with which cameras cover the place tried.

    k is the landmark, `body` are the positions of the body, `(3, Q)`, `positions` those of them to look at.
    """
    part, obstacles, asked, cap = stations.part, stations.obstacles, rig.asked, scratch.cap
    x, y, z, most, start, sure, row, reached = (
        scratch.x, scratch.y, scratch.z, scratch.most, scratch.start, scratch.sure, scratch.row, scratch.reached
    )  # fmt: skip
    target, words, size = rig.target, np.uint64(asked.shape[1]), len(part.places)
    tx, ty, tz, nx, ny, nz = target[0], target[1], target[2], target[3], target[4], target[5]
    sight = sized(part.sight, k)
    clear, frame, ends = is_clear(obstacles), frame_of(sight, nx, ny, nz), no_ends(obstacles, 1)
    if not clear:
        find_ends(obstacles, sight, tx, ty, tz, nx, ny, nz, ends, 0)
    for c in range(len(part.centres)):
        cx, cy, cz = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2]
        for i in range(np.uint64(len(positions))):
            q = positions[i]
            xq, yq, zq = tx - (body[0, q] + cx), ty - (body[1, q] + cy), tz - (body[2, q] + cz)
            x[i], y[i], z[i] = xq, yq, zq
            reached[i], most[i], start[i], sure[i] = bounds_from(part, c, k, xq, yq, zq, nx, ny, nz)
        for i in range(np.uint64(len(positions))):
            if reached[i]:
                row[i] = row_from(part, c, x[i], y[i], z[i])
        for i in range(np.uint64(len(positions))):
            q = positions[i]
            px, py, pz = body[0, q], body[1, q], body[2, q]
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(words):
                    if not reached[i]:
                        cap[q, m, w] = ZERO
                        continue
                    left = ALL if whole else asked[q, w]
                    found, left = split(part, m, w, left, words, x[i], y[i], z[i], most[i], start[i], sure[i], row[i])
                    while left:
                        bit = lowest(left)
                        left &= left - ONE
                        a = w * np.uint64(BITS) + bit
                        covered = covers_from(part, m, a, k, px, py, pz, tx, ty, tz, nx, ny, nz, frame)
                        found |= np.uint64(covered) << bit
                    if not clear:
                        left = found
                        while left:
                            bit = lowest(left)
                            left &= left - ONE
                            place = q * np.uint64(size) + np.uint64(part.place[m, w * np.uint64(BITS) + bit])
                            if is_blocked(obstacles, sight, place, ends, 0):
                                found &= ~(ONE << bit)
                    cap[q, m, w] = found


@inner
def _hidden_bits(part, m, w, bits, i, k, px, py, pz, one, other):
    """Those orientations of a set of word w with which landmark i, `one`, hides k, the `other`, from mount m."""
    found = ZERO
    while bits:
        bit = lowest(bits)
        bits &= bits - ONE
        found |= np.uint64(hides_from(part, m, w * np.uint64(BITS) + bit, i, k, px, py, pz, one, other)) << bit
    return found


@inlined
def _pose(k, state):
    """Position and normal of landmark k."""
    landmarks, normals = state.landmarks, state.normals
    return landmarks[0, k], landmarks[1, k], landmarks[2, k], normals[0, k], normals[1, k], normals[2, k]


@inner
def _without_hidden(part, c, m, w, bits, px, py, pz, i, k, state):
    """The orientations of a set with which no landmark but k hides landmark i."""
    other = _pose(i, state)
    x, y, z = (
        other[0] - (px + part.centres[c, 0]), other[1] - (py + part.centres[c, 1]), other[2] - (pz + part.centres[c, 2])
    )  # fmt: skip
    width = line_radius(part.sight)
    for j in range(np.uint64(len(state.surfaces))):
        one = _pose(j, state)
        ax, ay, az = x + (one[0] - other[0]), y + (one[1] - other[1]), z + (one[2] - other[2])
        if may_hide_around(ax, ay, az, x, y, z, part.radius[c], width) and j != i and j != k:
            bits &= ~_hidden_bits(part, m, w, bits, j, i, px, py, pz, one, other)
    return bits


@inlined
def _touch(q, rig):
    """Note a position where others come into play."""
    if not rig.touched[q]:
        rig.touched[q], rig.places[rig.found[1]] = True, q
        rig.found[1] += 1


@inlined
def _find_pair(part, c, i, k, q, px, py, pz, place, how, mine, other, state, rig):
    """Find what landmark k at a `place` hides of landmark i from position q, and note it down."""
    pose, changed = _pose(i, state), False
    if how == COMES:
        _touch(q, rig)
    for m in range(part.mounts[c], part.mounts[c + 1]):
        for w in range(np.uint64(mine.caps.shape[3])):
            cap, veiled, flips = mine.caps[i, q, m, w], mine.veiled[i, q, m, w], other.flipped[i, q, m, w]
            bits = cap if how == COMES else cap & veiled
            found = _hidden_bits(part, m, w, bits, k, i, px, py, pz, place, pose) if bits else ZERO
            if found == ZERO:
                continue
            if how == LEAVES:
                flips |= _without_hidden(part, c, m, w, found, px, py, pz, i, k, state)
            else:
                flips = (flips & ~found) | (found & ~veiled)
            changed |= flips != other.flipped[i, q, m, w]
            other.flipped[i, q, m, w] = flips
    if changed:
        _touch(q, rig)
        if not rig.known[i, q]:
            rig.known[i, q], rig.who[rig.found[0]], rig.where[rig.found[0]] = True, i, q
            rig.found[0] += 1


@inner
def _find_pairs(k, how, stations, field, state, rig):
    """Find whom landmark k hides where it is, or where it is tried, and there who may hide it: see `LEAVES`."""
    part, mine, other, size = stations.part, state.parts[stations.number], rig.parts[stations.number], len(rig.touched)
    body, target, width = field.positions, rig.target, line_radius(part.sight)
    place = _pose(k, state)
    if how != LEAVES:
        place = target[0], target[1], target[2], target[3], target[4], target[5]
    ax, ay, az = place[0], place[1], place[2]
    filled = find_ways(ax, ay, az, state.landmarks, part.horizon, rig.others, rig.ways)
    for c in range(len(part.centres)):
        cx, cy, cz, radius = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2], part.radius[c]
        for e in range(rig.near[0]):
            b = rig.blocks[e]
            mx, my, mz = ax - field.centres[0, b] - cx, ay - field.centres[1, b] - cy, az - field.centres[2, b] - cz
            hx, hy, hz = (
                np.float32(field.halves[0, b] + radius), np.float32(field.halves[1, b] + radius),
                np.float32(field.halves[2, b] + radius),
            )  # fmt: skip
            for start in range(np.uint64(0), np.uint64(filled), np.uint64(LANES)):
                close = near_line(start, mx, my, mz, hx, hy, hz, width, rig.ways)
                while close:
                    i = rig.others[start + lowest(np.uint64(close))]
                    close &= close - np.uint32(1)
                    lx, ly, lz = state.landmarks[0, i], state.landmarks[1, i], state.landmarks[2, i]
                    ex, ey, ez, lanes = lx - ax, ly - ay, lz - az, np.uint32(0)
                    apart, far = math.sqrt(ex * ex + ey * ey + ez * ez), math.sqrt(mx * mx + my * my + mz * mz)
                    most = line_room(far + apart + math.sqrt(hx * hx + hy * hy + hz * hz), apart, radius, width)
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
                            other.who[other.rivals[0]], other.where[other.rivals[0]] = i, np.uint64(c * size) + q
                            other.rivals[0] += 1


@inner
def _find_veils(k, stations, field, state, rig):
    """Find in `veil` with which orientations of `cap` the rivals hide landmark k in the place tried."""
    part, other, size, body = stations.part, rig.parts[stations.number], np.uint64(len(rig.touched)), field.positions
    target = rig.target
    place = target[0], target[1], target[2], target[3], target[4], target[5]
    for e in range(other.rivals[0]):
        i, c, q = np.uint64(other.who[e]), other.where[e] // size, other.where[e] % size
        for m in range(part.mounts[c], part.mounts[c + np.uint64(1)]):
            for w in range(np.uint64(other.cap.shape[2])):
                bits = other.cap[q, m, w] & ~other.veil[q, m, w]
                if bits:
                    px, py, pz = body[0, q], body[1, q], body[2, q]
                    other.veil[q, m, w] |= _hidden_bits(
                        part, m, w, bits, i, k, px, py, pz, _pose(i, state), place
                    )  # fmt: skip


@inner
def forget(scratch):
    """Clear what the last trial left."""
    for e in range(scratch.found[0]):
        i, q = scratch.who[e], scratch.where[e]
        scratch.known[i, q] = False
        for j in range(len(scratch.parts)):
            flipped = scratch.parts[j].flipped
            for m in range(flipped.shape[2]):
                for w in range(flipped.shape[3]):
                    flipped[i, q, m, w] = ZERO
    for e in range(scratch.found[1]):
        scratch.touched[scratch.places[e]] = False
    scratch.found[0] = scratch.found[1] = 0
    for j in range(len(scratch.parts)):
        cap, veil = scratch.parts[j].cap, scratch.parts[j].veil
        scratch.parts[j].rivals[0] = 0
        for s in range(scratch.near[1]):
            for q in range(scratch.spans[s, 0], scratch.spans[s, 1]):
                for m in range(cap.shape[1]):
                    for w in range(cap.shape[2]):
                        cap[q, m, w] = veil[q, m, w] = ZERO
    for s in range(scratch.near[1]):
        for q in range(scratch.spans[s, 0], scratch.spans[s, 1]):
            for w in range(scratch.fresh.shape[1]):
                scratch.fresh[q, w] = scratch.asked[q, w] = ZERO


@inlined
def shown_by(i, q, w, state, scratch):
    """The orientations of word w with which some camera sees landmark i once what is `flipped` has."""
    shown = ZERO
    for j in range(len(state.parts)):
        caps, veiled, flipped = state.parts[j].caps, state.parts[j].veiled, scratch.parts[j].flipped
        for m in range(caps.shape[2]):
            shown |= caps[i, q, m, w] & ~(veiled[i, q, m, w] ^ flipped[i, q, m, w])
    return shown


@inlined
def _add(q, w, changed, goes, digits):
    """Count one less in `digits` at the orientations `changed` that are in `goes`, one more at the others."""
    for j in range(np.uint64(digits.shape[2])):
        digits[q, w, j], changed = add_digit(digits[q, w, j], changed, goes)


@inlined
def _weigh(left, w, weights, row):
    """The weight of the orientations `left` of word w, by a row of the `weights`."""
    total = np.int64(0)
    while left:
        total += weights[row, w * np.uint64(BITS) + lowest(left)]
        left &= left - ONE
    return total


@inner
def _ask(k, state, scratch):
    """Find where P_n depends on landmark k, no pair turning: where n - 1 others are seen."""
    shown, asked, short, just = state.shown, scratch.asked, state.short, state.just
    for s in range(scratch.near[1]):
        for q in range(scratch.spans[s, 0], scratch.spans[s, 1]):
            for w in range(np.uint64(asked.shape[1])):
                mine = shown[k, q, w]
                asked[q, w] = (short[q, w] & ~mine) | (just[q, w] & mine)


@inner
def _ask_again(k, n, state, scratch):
    """The same at positions that are touched, the pairs having turned."""
    counts, shown, asked, digits = state.counts, state.shown, scratch.asked, scratch.digits
    words = np.uint64(asked.shape[1])
    for e in range(scratch.found[1]):
        q = scratch.places[e]
        for w in range(words):
            for j in range(np.uint64(digits.shape[2])):
                digits[q, w, j] = counts[q, w, j]
            _add(q, w, shown[k, q, w], ALL, digits)
    for e in range(scratch.found[0]):
        i, q = np.uint64(scratch.who[e]), np.uint64(scratch.where[e])
        for w in range(words):
            was, now = shown[i, q, w], shown_by(i, q, w, state, scratch)
            if was != now:
                _add(q, w, was ^ now, was, digits)
    for e in range(scratch.found[1]):
        q = scratch.places[e]
        for w in range(words):
            asked[q, w] = ALL
            for j in range(np.uint64(digits.shape[2])):
                asked[q, w] = equal_so_far(asked[q, w], digits[q, w, j], n - 1, j)


@inner
def join(positions, scratch):
    """Find in `fresh` what all cameras see of the place tried at `positions`."""
    for q in positions:
        for w in range(np.uint64(scratch.fresh.shape[1])):
            fresh = ZERO
            for j in range(len(scratch.parts)):
                cap, veil = scratch.parts[j].cap, scratch.parts[j].veil
                for m in range(cap.shape[1]):
                    fresh |= cap[q, m, w] & ~veil[q, m, w]
            scratch.fresh[q, w] = fresh


@inner
def _find_units(k, positions, n, weights, state, scratch):
    """Find P_n at `positions` with the sets in `fresh` for landmark k and the pairs as they turn."""
    counts, shown, fresh, asked, digits = state.counts, state.shown, scratch.fresh, scratch.asked, scratch.digits
    for q in positions:
        change, row = np.int64(0), weights_row(weights, q)
        for w in range(np.uint64(fresh.shape[1])):
            seen = fresh[q, w] & asked[q, w]
            had = shown[k, q, w] & asked[q, w]
            if scratch.touched[q]:
                had, has = ALL, ALL
                for j in range(np.uint64(counts.shape[2])):
                    had = at_least_so_far(had, counts[q, w, j], n, j)
                    has = at_least_so_far(has, digits[q, w, j], n, j)
                seen |= has
            change += _weigh(seen & ~had, w, weights, row) - _weigh(had & ~seen, w, weights, row)
        scratch.units[q] = state.units[q] + change


@inner
def find_pairs(k, how, parts, field, state, scratch):
    """See `_find_pairs`, of all parts."""
    for stations in literal_unroll(parts):
        if stations.part.sight.reach >= 0.0:
            _find_pairs(k, how, stations, field, state, scratch)


@inner
def see_anew(k, parts, positions, whole, field, state, scratch):
    """Find what all cameras see of landmark k in the place tried at `positions`, see `_find_caps`."""
    for stations in literal_unroll(parts):
        _find_caps(k, stations, positions, field.positions, scratch.parts[stations.number], scratch, whole)
        _find_veils(k, stations, field, state, scratch)
    join(positions, scratch)


@inner
def list_near(scratch, all_of_them):
    """List the positions near the place left and the place tried, all or those that are asked or touched."""
    listed, count = scratch.listed, ZERO
    for s in range(scratch.near[1]):
        for q in range(scratch.spans[s, 0], scratch.spans[s, 1]):
            some = ZERO
            for w in range(np.uint64(scratch.asked.shape[1])):
                some |= scratch.asked[q, w]
            listed[count] = q
            count += np.uint64(all_of_them | (some != ZERO) | scratch.touched[q])
    return count


@inner
def bound_rig_move(field, k, pose, surface, state, scratch):
    """See `trial.bound_move`."""
    scratch.surface[0], units, before = surface, scratch.units, state.units
    for i in range(6):
        scratch.target[i] = pose[i]
    forget(scratch)
    list_blocks(k, field, state, scratch)
    find_pairs(np.uint64(k), LEAVES, field.parts, field, state, scratch)
    _ask(np.uint64(k), state, scratch)
    _ask_again(np.uint64(k), field.n, state, scratch)
    positions = scratch.listed[: list_near(scratch, False)]
    see_anew(np.uint64(k), field.parts, positions, False, field, state, scratch)
    for q in range(len(units)):
        units[q] = before[q]
    _find_units(np.uint64(k), positions, field.n, field.weights, state, scratch)


@inner
def finish_rig_move(field, k, state, scratch):
    """See `trial.finish_move`."""
    find_pairs(np.uint64(k), COMES, field.parts, field, state, scratch)
    _ask_again(np.uint64(k), field.n, state, scratch)
    positions = scratch.places[: scratch.found[1]]
    see_anew(np.uint64(k), field.parts, positions, False, field, state, scratch)
    _find_units(np.uint64(k), positions, field.n, field.weights, state, scratch)
