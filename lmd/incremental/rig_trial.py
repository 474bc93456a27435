"""Trying to move one landmark where a rig looks for it.

What is counted are orientations of the body: the caps of all cameras of a landmark become one set, `shown`, and that
comes and goes. So a move changes the counts at a position by the set of the landmark that moves, and by those of others
that appear or disappear for one of the cameras: the *pairs* of a landmark and a position (`rig_pairs`), of which there
are few.

As in `trial`, `bound_rig_move` leaves out what the new place hides and what hides it, and looks at those orientations
only where P_n depends on them, with n - 1 other landmarks in view. `rig_move.carry_out_rig` alone finds all.
"""

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ALL, BITS, ONE, ZERO, add_set, at_least, exactly, lowest
from lmd.core.compiled import allocating, inlined, inner
from lmd.incremental.counts import ENOUGH, JUST, SHORT
from lmd.incremental.nearby import list_blocks, target_of
from lmd.incremental.rig_pairs import COMES, LEAVES, find_pairs, find_veils
from lmd.incremental.rig_state import (
    ASKED,
    CAPS,
    FRESH,
    LEFT_OVER,
    MOST,
    PAIR_COUNT,
    ROW,
    START,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    VEILED,
    WHERE,
    WHO,
)
from lmd.incremental.state import FIRST, LAST, LISTED, SPAN_COUNT, SURE, SURFACE, X, Y, Z
from lmd.scene.criteria import frame_of, sized
from lmd.sight.kernels import sum_weights
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends
from lmd.sight.stations import bounds_from, covers_from, row_from, split


@allocating
def _find_caps(k, stations, positions, body, scratch, rig):
    """Find in `CAPS` with which orientations of those `ASKED` cameras cover the place tried; add them to `FRESH`.

    In `VEILED` there is nothing yet. k is the landmark, `body` are the positions of the body, `(3, Q)`, `positions`
    those of them to look at.
    """
    part, obstacles, asked, fresh = stations.part, stations.obstacles, rig.sets[ASKED], rig.sets[FRESH]
    cap, veil, seen = scratch.sets[CAPS], scratch.sets[VEILED], scratch.seen
    x, y, z, most, start, sure = seen[X], seen[Y], seen[Z], seen[MOST], seen[START], seen[SURE]
    row, left_over, reached = scratch.lists[ROW], scratch.lists[LEFT_OVER], scratch.reached
    words, size, half = np.uint64(asked.shape[1]), len(part.places), np.uint64(part.tables.shape[1] // 2)
    tx, ty, tz, nx, ny, nz = target_of(rig)
    sight = sized(part.sight, k)
    clear, frame, ends = is_clear(obstacles), frame_of(sight, nx, ny, nz), no_ends(obstacles, 1)
    if not clear:
        find_ends(obstacles, sight, tx, ty, tz, nx, ny, nz, ends, 0)
    for q in positions:
        for m in range(cap.shape[1]):
            for w in range(words):
                cap[q, m, w] = veil[q, m, w] = ZERO
    for c in range(len(part.centres)):
        cx, cy, cz, count, kept = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2], ZERO, ZERO
        for i in range(np.uint64(len(positions))):
            q = positions[i]
            xq, yq, zq = tx - (body[0, q] + cx), ty - (body[1, q] + cy), tz - (body[2, q] + cz)
            x[i], y[i], z[i] = xq, yq, zq
            reached[i], most[i], start[i], sure[i] = bounds_from(part, c, k, xq, yq, zq, nx, ny, nz)
        for i in range(np.uint64(len(positions))):
            left_over[count] = i
            count += np.uint64(reached[i])
        for i in left_over[:count]:
            row[i] = row_from(part, c, x[i], y[i], z[i])
        for i in left_over[:count]:
            q, some = positions[i], ZERO
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(words):
                    left = part.tables[row[i], half + np.uint64(m) * words + w] & asked[q, w]
                    cap[q, m, w] = left
                    some |= left
            left_over[kept] = i
            kept += np.uint64(some != ZERO)
        for i in left_over[:kept]:
            q = positions[i]
            px, py, pz, bounds = body[0, q], body[1, q], body[2, q], (most[i], start[i], sure[i])
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(words):
                    if cap[q, m, w] == ZERO:
                        continue
                    found, left = split(part, m, w, cap[q, m, w], words, x[i], y[i], z[i], *bounds, row[i])
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
                    fresh[q, w] |= found


@inner
def forget(scratch):
    """Clear what the last trial left."""
    numbers, who, where = scratch.numbers, scratch.pairs[WHO], scratch.pairs[WHERE]
    touched, places = scratch.flags[TOUCHED], scratch.lists[TOUCHED_LIST]
    for j in range(len(scratch.parts)):
        part = scratch.parts[j]  # copied: outside of other loops
        flipped = part.flipped
        part.rivals[0] = 0
        for e in range(numbers[PAIR_COUNT]):
            i, q = who[e], where[e]
            for m in range(flipped.shape[2]):
                for w in range(flipped.shape[3]):
                    flipped[i, q, m, w] = ZERO
    for e in range(numbers[PAIR_COUNT]):
        scratch.known[where[e], who[e]] = False
    for e in range(numbers[TOUCHED_COUNT]):
        touched[places[e]] = False
    numbers[PAIR_COUNT] = numbers[TOUCHED_COUNT] = 0


@inlined
def shown_by(i, q, w, state, scratch):
    """The orientations of word w with which some camera sees landmark i once what is `flipped` has."""
    shown = ZERO
    for j in range(len(state.parts)):
        caps, veiled, flipped = state.parts[j][CAPS], state.parts[j][VEILED], scratch.parts[j].flipped
        for m in range(caps.shape[2]):
            shown |= caps[i, q, m, w] & ~(veiled[i, q, m, w] ^ flipped[i, q, m, w])
    return shown


@inner
def _ask(k, state, scratch):
    """Find where P_n depends on landmark k, no pair turning: where n - 1 others are seen."""
    shown, asked, short, just = state.shown, scratch.sets[ASKED], state.counts.sets[SHORT], state.counts.sets[JUST]
    first, last = scratch.lists[FIRST], scratch.lists[LAST]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            for w in range(np.uint64(asked.shape[1])):
                mine = shown[k, q, w]
                asked[q, w] = (short[q, w] & ~mine) | (just[q, w] & mine)


@inner
def _count_others(k, state, scratch):
    """Count in `digits` the landmarks but k at positions that are touched, the pairs having turned."""
    counts, shown, digits = state.counts.digits, state.shown, scratch.digits
    words, who, where = np.uint64(shown.shape[2]), scratch.pairs[WHO], scratch.pairs[WHERE]
    for q in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(words):
            for j in range(np.uint64(digits.shape[2])):
                digits[q, w, j] = counts[q, w, j]
            add_set(digits[q, w], shown[k, q, w], ALL)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, q = np.uint64(who[e]), np.uint64(where[e])
        for w in range(words):
            was, now = shown[i, q, w], shown_by(i, q, w, state, scratch)
            if was != now:
                add_set(digits[q, w], was ^ now, was)


@inner
def ask_again(k, n, or_more, state, scratch):
    """The same at positions that are touched: where n - 1 others are seen, `or_more`."""
    asked, digits = scratch.sets[ASKED], scratch.digits
    _count_others(k, state, scratch)
    for q in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(np.uint64(asked.shape[1])):
            asked[q, w] = at_least(digits[q, w], n - 1) if or_more else exactly(digits[q, w], n - 1)


@inner
def _join(positions, scratch):
    """Find in `FRESH` what all cameras see of the place tried at `positions`, where others may be in the way."""
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for j in range(len(scratch.parts)):
        sets = scratch.parts[j].sets
        cap, veil = sets[CAPS], sets[VEILED]
        for q in positions:
            for m in range(cap.shape[1]):
                for w in range(np.uint64(fresh.shape[1])):
                    fresh[q, w] |= cap[q, m, w] & ~veil[q, m, w]


@inner
def _find_units(k, positions, n, weights, state, scratch):
    """Find P_n at `positions` with the sets in `FRESH` for landmark k and the pairs as they turn."""
    shown, enough, fresh, asked = state.shown, state.counts.sets[ENOUGH], scratch.sets[FRESH], scratch.sets[ASKED]
    touched, digits = scratch.flags[TOUCHED], scratch.digits
    for q in positions:
        change = np.int64(0)
        for w in range(np.uint64(fresh.shape[1])):
            seen = fresh[q, w] & asked[q, w]
            had = shown[k, q, w] & asked[q, w]
            if touched[q]:
                had = enough[q, w]
                seen |= at_least(digits[q, w], n)
            change += sum_weights(had, seen, weights, q, w)
        scratch.units[q] = state.units[q] + change


@inner
def see_anew(k, parts, positions, field, state, scratch):
    """Find what all cameras see of landmark k in the place tried at `positions`, of what is `ASKED`."""
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for stations in literal_unroll(parts):
        _find_caps(k, stations, positions, field.positions, scratch.parts[stations.number], scratch)
        find_veils(k, stations, field, state, scratch)
    _join(scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]], scratch)


@inner
def list_near(scratch, all_of_them):
    """List the positions near the place left and the place tried, all or those that are asked or touched."""
    listed, first, last, count = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST], ZERO
    asked, touched = scratch.sets[ASKED], scratch.flags[TOUCHED]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            some = ZERO
            for w in range(np.uint64(asked.shape[1])):
                some |= asked[q, w]
            listed[count] = q
            count += np.uint64(all_of_them | (some != ZERO) | touched[q])
    return count


@inner
def begin_rig_move(k, pose, surface, field, state, scratch):
    """Find whom landmark k no longer hides, and copy all values: see `trial.begin_move`."""
    scratch.numbers[SURFACE], units, before = surface, scratch.units, state.units
    for i in range(6):
        scratch.target[i] = pose[i]
    forget(scratch)
    list_blocks(k, field, state, scratch)
    find_pairs(np.uint64(k), LEAVES, field.parts, field, state, scratch)
    for q in range(len(units)):
        units[q] = before[q]


@inner
def bound_rig_move(field, k, pose, surface, state, scratch):
    """See `trial.bound_move`."""
    begin_rig_move(k, pose, surface, field, state, scratch)
    _ask(np.uint64(k), state, scratch)
    ask_again(np.uint64(k), field.n, False, state, scratch)
    positions = scratch.lists[LISTED][: list_near(scratch, False)]
    see_anew(np.uint64(k), field.parts, positions, field, state, scratch)
    _find_units(np.uint64(k), positions, field.n, field.weights, state, scratch)


@inner
def finish_rig_move(field, k, state, scratch):
    """See `trial.finish_move`."""
    find_pairs(np.uint64(k), COMES, field.parts, field, state, scratch)
    ask_again(np.uint64(k), field.n, False, state, scratch)
    positions = scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]
    see_anew(np.uint64(k), field.parts, positions, field, state, scratch)
    _find_units(np.uint64(k), positions, field.n, field.weights, state, scratch)
