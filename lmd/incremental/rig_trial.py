"""Trying to move one landmark where a rig looks for it.

From every station, `hiding` finds who hides whom, as from any position of a camera. What is counted
are orientations of the body: the caps of all cameras of a landmark become one set, `shown`, and that comes and goes. So
a move changes the counts at a position by the set of the landmark that moves, and by those of others that appear or
disappear for one of the cameras: the *pairs* of a landmark and a position, of which there are few.

As in `trial`, `bound_rig_move` leaves out what the new place hides and what hides it, and looks at those orientations
only where P_n depends on them, with n - 1 other landmarks in view.
`rig_move.carry_out_rig` alone finds all.
"""

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ALL, BITS, ONE, ZERO, add_digit, at_least_so_far, equal_so_far, lowest
from lmd.core.compiled import allocating, inlined, inner
from lmd.incremental.hiding import find_flips, find_new, find_old, flips_with
from lmd.incremental.nearby import list_blocks
from lmd.scene.criteria import covering, covers_one, frame_of, from_position
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import NOWHERE, cell_of
from lmd.sight.kernels import weights_row
from lmd.sight.obstacles import find_ends, is_blocked, no_ends
from lmd.sight.stations import SEVERAL


@allocating
def _find_caps(part, scratch, asked, whole, fresh):
    """Add to `fresh` the `asked` orientations with which cameras of a part see the place tried.

    With `whole`, all of them are asked for and written to `cap`, `veil` and `reached`.
    """
    sight, members, words, size = part.sight, part.members, np.uint64(asked.shape[1]), np.uint64(asked.shape[0])
    positions, obstacles, may = part.positions, part.obstacles, scratch.may
    x, y, z, low, high, sure, _, reached = scratch.new
    target, hidden, listed, caps, veil = (
        scratch.target, scratch.after.count_hidden, scratch.listed, scratch.cap, scratch.veil
    )  # fmt: skip
    tx, ty, tz, nx, ny, nz = target[0], target[1], target[2], target[3], target[4], target[5]
    frame, ends = frame_of(sight, nx, ny, nz), no_ends(obstacles, 1)
    find_ends(obstacles, sight, tx, ty, tz, nx, ny, nz, ends, 0)
    if whole:
        caps[:] = ZERO
        veil[:] = ZERO
        reached[:] = False
    for g in range(np.uint64(len(members))):
        m, only, first = part.mount[g], part.alone[g], g * size
        axes, certain, possible = part.axes[m], part.certain[m], part.possible[m]
        several, one = only == SEVERAL, np.uint64(max(only, 0))
        ax, ay, az, count = axes[0, one], axes[1, one], axes[2, one], ZERO
        only_word, only_bit = one // np.uint64(BITS), one % np.uint64(BITS)
        everyone = whole | several
        for q in range(size):
            s = first + q
            px, py, pz = tx - positions[0, s], ty - positions[1, s], tz - positions[2, s]
            in_reach, least, most, deep = from_position(sight, px, py, pz, nx, ny, nz, 0.0)
            depth = ax * px + ay * py + az * pz
            x[q], y[q], z[q], low[q], high[q], sure[q] = px, py, pz, least, most, deep
            may[q] = in_reach & (several | ((depth >= least) & (depth <= most)))
        for q in range(size):
            wanted = everyone | ((asked[q, only_word] >> only_bit & ONE) != ZERO)
            listed[count] = q
            count += np.uint64(may[q] & wanted & (whole | (hidden[first + q] == 0)))
        for i in range(count):
            q = listed[i]
            s, some = first + q, ZERO
            if is_blocked(obstacles, sight, s, ends, 0):
                continue
            px, py, pz, least, most, deep, shown = x[q], y[q], z[q], low[q], high[q], sure[q], hidden[s] == 0
            if several:
                row = np.uint64(cell_of(px, py, pz))
                given = row if deep == np.inf else np.uint64(NOWHERE)
                for w in range(words):
                    left = members[g, w] if whole else members[g, w] & asked[q, w]
                    cap, well = certain[given, w] & left, certain[row, w]
                    left &= possible[row, w] & ~cap
                    if left:
                        cap |= covering(sight, left, w, px, py, pz, frame, least, most, deep, well, axes)
                    some |= cap
                    if shown:
                        fresh[q, w] |= cap
                    if whole:
                        caps[m, q, w] |= cap
            else:
                some = np.uint64(covers_one(sight, px, py, pz, frame, least, most, deep, False, axes, one)) << only_bit
                if shown:
                    fresh[q, only_word] |= some
                if whole:
                    caps[m, q, only_word] |= some
            if whole and some:
                reached[s] = True
                for w in range(words if not shown else ZERO):
                    veil[m, q, w] |= members[g, w]


@inner
def _forget_pairs(scratch):
    """Clear what the last trial left."""
    for e in range(scratch.found[0]):
        i, q = scratch.who[e], scratch.where[e]
        scratch.known[i, q] = scratch.touched[q] = False
        for j in range(len(scratch.parts)):
            flipped = scratch.parts[j].flipped
            for m in range(len(flipped)):
                for w in range(flipped.shape[3]):
                    flipped[m, i, q, w] = ZERO
    scratch.found[:] = 0


@inner
def _find_pairs(part, state, scratch, rig):
    """List the landmarks that appear or disappear for a camera of a part, and note down for which orientations."""
    members, size, flipped = part.members, np.uint64(len(rig.touched)), scratch.flipped
    found, who, change = scratch.turns
    for b in scratch.blocks[: scratch.near[0]]:
        for e in range(found[b]):
            i = np.uint64(who[b, e])
            for lane in range(np.uint64(BLOCK)):
                s = b * np.uint64(BLOCK) + lane
                was, now = state.hidden[i, s], state.hidden[i, s] + change[b, e, lane]
                if flips_with(state.reachable[i, s], was, now):
                    g, q = s // size, s % size
                    for w in range(np.uint64(members.shape[1])):
                        flipped[part.mount[g], i, q, w] ^= members[g, w]
                    if not rig.known[i, q]:
                        rig.known[i, q], rig.who[rig.found[0]], rig.where[rig.found[0]] = True, i, q
                        rig.found[0] += 1
                    if not rig.touched[q]:
                        rig.touched[q], rig.places[rig.found[1]] = True, q
                        rig.found[1] += 1


@inlined
def shown_by(i, q, w, state, scratch):
    """The orientations of word w with which some camera sees landmark i once what is `flipped` has."""
    shown = ZERO
    for j in range(len(state.parts)):
        caps, veiled, flipped = state.parts[j].caps, state.parts[j].veiled, scratch.parts[j].flipped
        for m in range(len(caps)):
            shown |= caps[m, i, q, w] & ~(veiled[m, i, q, w] ^ flipped[m, i, q, w])
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
def _ask(k, n, state, scratch):
    """Find where P_n depends on landmark k, the pairs having turned: where n - 1 others are seen."""
    counts, shown, asked, digits = state.counts, state.shown, scratch.asked, scratch.digits
    words = np.uint64(asked.shape[1])
    for q in range(np.uint64(len(asked))):
        for w in range(words):
            mine = shown[k, q, w]
            asked[q, w] = (state.short[q, w] & ~mine) | (state.just[q, w] & mine)
            if scratch.touched[q]:
                for j in range(np.uint64(digits.shape[2])):
                    digits[q, w, j] = counts[q, w, j]
                _add(q, w, mine, ALL, digits)
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
def _find_units(k, n, weights, state, scratch):
    """Find P_n with the sets in `fresh` for landmark k and the pairs as they turn."""
    counts, shown, fresh, asked, digits = state.counts, state.shown, scratch.fresh, scratch.asked, scratch.digits
    for q in range(np.uint64(len(fresh))):
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
def _look_again(k, parts, field, state, scratch):
    """Find P_n from who hides whom, as far as that is known."""
    _forget_pairs(scratch)
    for part in literal_unroll(parts):
        if part.sight.reach >= 0.0:
            _find_pairs(part, state.parts[part.number], scratch.parts[part.number], scratch)
    _ask(k, field.n, state, scratch)
    see_anew(parts, scratch, False)
    _find_units(k, field.n, field.weights, state, scratch)


@inner
def see_anew(parts, scratch, whole):
    """Find what all cameras see of the place tried, see `_find_caps`."""
    scratch.fresh[:] = ZERO
    for part in literal_unroll(parts):
        _find_caps(part, scratch.parts[part.number], scratch.asked, whole, scratch.fresh)


@inner
def _begin(k, parts, state, scratch):
    for part in literal_unroll(parts):
        list_blocks(k, part, state.parts[part.number], scratch.parts[part.number])
        if part.sight.reach >= 0.0:
            find_old(k, part, state.parts[part.number], scratch.parts[part.number])
            find_flips(state.parts[part.number], scratch.parts[part.number])


@inner
def _complete(k, parts, state, scratch):
    hides = False
    for part in literal_unroll(parts):
        if part.sight.reach >= 0.0:
            find_new(k, part, state.parts[part.number], scratch.parts[part.number])
            find_flips(state.parts[part.number], scratch.parts[part.number])
            hides = True
    return hides


@inner
def bound_rig_move(field, k, pose, surface, state, scratch):
    """See `trial.bound_move`."""
    scratch.surface[0] = surface
    for i in range(6):
        scratch.target[i] = pose[i]
    _begin(k, field.parts, state, scratch)
    _look_again(np.uint64(k), field.parts, field, state, scratch)


@inner
def finish_rig_move(field, k, state, scratch):
    """See `trial.finish_move`."""
    if _complete(k, field.parts, state, scratch):
        _look_again(np.uint64(k), field.parts, field, state, scratch)
