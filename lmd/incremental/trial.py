"""Trying to move one landmark: P_n if it stood elsewhere, first bounded, then exact.

A moved landmark changes the counts at a position in at most four ways: its old cap goes, caps it used to hide come
back, caps it now hides go, its new cap comes. Everything else at that position, and every position where none of
the four happens, stays as it is. The decisions are those of `kernels`, operation by operation.

Sets of axes are bits. The caps of all landmarks where they are, and at each position the axes one landmark short of n
and those with just n, are known beforehand. So a trial tests few axes.

`bound_move` leaves out what the new place hides and what hides it. Both only take caps away, and P_n never falls with
another cap, so what it finds is never below P_n:

1. `look_around`: what is seen of the new place from all positions in sight, without a branch, so that the loop
   vectorises.
2. `find_old`, `find_flips`: what the old place hides comes back, at a few positions.
3. `_try_caps`, at the other positions that see the old or the new place: P_n changes only at an axis that is one short
   and not in the old cap, or has just n and is in it. The tables of `cones` settle most of these.
4. `_try_flips`, at the positions of step 2: counts, as binary digits of whole sets, with the caps added or taken away.

`finish_move` makes it exact:

5. `find_new`, `find_flips`: who hides whom now.
6. `_try_flips` again, where another landmark may appear or disappear or the new place is hidden.
"""

import numpy as np

from lmd.core.bits import ALL, BITS, HALF, LOWER, ONE, ZERO, add_set, at_least, exactly, lowest
from lmd.core.compiled import inner
from lmd.incremental.counts import ENOUGH, JUST, SHORT
from lmd.incremental.hiding import FORTH, find_flips, find_new, find_old, list_turning
from lmd.incremental.nearby import look_around
from lmd.incremental.state import (
    AFTER_HIDDEN,
    DIGITS,
    FIRST,
    FLIPS,
    GOES,
    HIDDEN,
    HIGH,
    LAST,
    LISTED,
    LOW,
    NAMES,
    OLD,
    OUTER,
    PLACES,
    REACHED,
    SPAN_COUNT,
    SURE,
    SURFACE,
    UNSURE,
    X,
    Y,
    Z,
)
from lmd.scene.criteria import covers_one, frame_of, sized
from lmd.sight.directions import CERTAIN, NOWHERE, POSSIBLE
from lmd.sight.kernels import sum_weights, weights_row

# Indices are unsigned where it counts: signed ones cost extra instructions, as they might be negative.


@inner
def _try_caps(k, field, state, scratch):
    """Bound P_n where landmark k comes or goes and no other appears; copy it elsewhere."""
    sight, axes, weights = sized(field.sight, k), field.axes, field.weights
    certain, possible = field.tables[CERTAIN], field.tables[POSSIBLE]
    target, seen, flags, lists = scratch.target, scratch.seen, scratch.flags, scratch.lists
    frame = frame_of(sight, target[3], target[4], target[5])
    caps, reachable, hidden, before = state.caps, state.reachable, state.hides[HIDDEN], state.units
    short, just = state.counts.sets[SHORT], state.counts.sets[JUST]
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, outer, reached, flips = scratch.cell, scratch.shorts[OUTER], flags[REACHED], flags[FLIPS]
    old, listed, firsts, lasts = lists[OLD], lists[LISTED], lists[FIRST], lists[LAST]
    units, unsure, places = scratch.units, lists[UNSURE], lists[PLACES]
    count, found, size = ZERO, ZERO, np.uint64(caps.shape[2])
    for p in range(np.uint64(len(units))):
        units[p] = before[p]
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = firsts[s], lasts[s]
        for p in range(first, last):
            shown = reached[p] & (not flips[p])
            outer[p] = cell[p] if shown else NOWHERE
            old[p] = ALL if reachable[k, p] & (hidden[k, p] == 0) & (not flips[p]) else ZERO
        for p in range(first, last):
            listed[count] = p
            count += np.uint64((old[p] != ZERO) | (outer[p] != NOWHERE))
    for m in range(count):
        p = listed[m]
        o = np.uint64(outer[p])
        i = o if sure[p] == np.inf else np.uint64(NOWHERE)
        for w in range(size):
            was = caps[k, p, w] & old[p]
            unsure[found] = (short[p, w] & ~was & possible[o, w]) | (just[p, w] & was & ~certain[i, w])
            places[found] = p << HALF | w
            found += np.uint64(unsure[found] != ZERO)
    for m in range(found):
        left, p, w = unsure[m], places[m] >> HALF, places[m] & LOWER
        px, py, pz, least = x[p], y[p], z[p], low[p] if outer[p] != NOWHERE else np.inf
        well = certain[np.uint64(outer[p]), w]
        was, change, row = caps[k, p, w] & old[p], np.int64(0), weights_row(weights, p)
        while left:
            bit = lowest(left)
            a = w * np.uint64(BITS) + bit
            central = (well >> bit & ONE) != ZERO
            inside = covers_one(sight, px, py, pz, frame, least, high[p], sure[p], central, axes, a)
            change += weights[row, a] * (np.int64(inside) - np.int64(was >> bit & ONE))
            left &= left - ONE
        units[p] += change


@inner
def _try_flips(k, positions, field, state, scratch):
    """Find P_n at `positions`, where other landmarks may appear or disappear."""
    sight, axes, weights, n = sized(field.sight, k), field.axes, field.weights, field.n
    certain, possible = field.tables[CERTAIN], field.tables[POSSIBLE]
    target, seen, flags, lists = scratch.target, scratch.seen, scratch.flags, scratch.lists
    frame = frame_of(sight, target[3], target[4], target[5])
    caps, reachable, hidden, before = state.caps, state.reachable, state.hides[HIDDEN], state.units
    counts, enough = state.counts.digits, state.counts.sets[ENOUGH]
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached, count_hidden, units = scratch.cell, flags[REACHED], scratch.shorts[AFTER_HIDDEN], scratch.units
    size = np.uint64(counts.shape[2])
    names, goes, digits = lists[NAMES], lists[GOES], lists[DIGITS][:size]
    for p in positions:
        flipped = list_turning(p, FORTH, state, scratch)
        names[flipped], goes[flipped] = k, ALL
        flipped += np.uint64(reachable[k, p] & (hidden[k, p] == 0))
        row = np.uint64(cell[p] if reached[p] & (count_hidden[p] == 0) else NOWHERE)
        px, py, pz, least = x[p], y[p], z[p], low[p]
        units[p] = before[p]
        for w in range(np.uint64(counts.shape[1])):
            for j in range(size):
                digits[j] = counts[p, w, j]
            for m in range(flipped):
                add_set(digits, caps[names[m], p, w], goes[m])
            has, left = at_least(digits, n), possible[row, w]
            if left:
                left &= exactly(digits, n - 1)
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                central = (certain[row, w] >> bit & ONE) != ZERO
                inside = covers_one(sight, px, py, pz, frame, least, high[p], sure[p], central, axes, a)
                has |= np.uint64(inside) << bit
                left &= left - ONE
            if has != enough[p, w]:
                units[p] += sum_weights(enough[p, w], has, weights, p, w)


@inner
def begin_move(k, pose, surface, field, state, scratch):
    """Look at landmark k at `pose` `(6,)`, position and normal, on a surface, as if nothing hid or were hidden there.

    Fills `seen`, `CELL`, `REACHED`, and `FLIPS` with what appears as k leaves its place.
    """
    scratch.numbers[SURFACE] = surface
    for i in range(6):
        scratch.target[i] = pose[i]
    look_around(k, field, state, scratch)
    if field.sight.reach >= 0.0:
        find_old(k, field, state, scratch)
        find_flips(state, scratch)


@inner
def complete_move(k, field, state, scratch):
    """Find who hides whom with landmark k at its new place."""
    find_new(k, field, state, scratch)
    find_flips(state, scratch)


@inner
def list_flips(scratch):
    """List in `LISTED` where another landmark appears or disappears or hides the place tried; returns how many."""
    flips, listed, first, last = scratch.flags[FLIPS], scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST]
    reached, count_hidden, count = scratch.flags[REACHED], scratch.shorts[AFTER_HIDDEN], ZERO
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            listed[count] = p
            count += np.uint64(flips[p] | (reached[p] & (count_hidden[p] != 0)))
    return count


@inner
def bound_move(field, k, pose, surface, state, scratch):
    """Find what P_n is at most with landmark k at `pose` `(6,)`, position and normal, on a surface: `scratch.units`."""
    begin_move(k, pose, surface, field, state, scratch)
    _try_caps(np.uint64(k), field, state, scratch)
    _try_flips(np.uint64(k), scratch.lists[LISTED][: list_flips(scratch)], field, state, scratch)


@inner
def finish_move(field, k, state, scratch):
    """Make what `bound_move` found exact."""
    if field.sight.reach >= 0.0:
        complete_move(k, field, state, scratch)
        _try_flips(np.uint64(k), scratch.lists[LISTED][: list_flips(scratch)], field, state, scratch)
