"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed.

`trial` (the module) finds what a move would lead to; `carry_out` makes the last trial true, and it alone needs the new
cap with all its axes. It exchanges what `state` and `scratch` know of the two places, P_n included, so that `take_back`
only has to exchange them again. The decisions are those of `kernels`, operation by operation, so after any sequence of
moves the counts equal a full evaluation's, bit for bit.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, BITS, ZERO
from lmd.core.compiled import borrowing, inner
from lmd.core.memory import check_views
from lmd.incremental.counts import given_counts, ripple, sum_up
from lmd.incremental.field import places_of
from lmd.incremental.hiding import BACK, FORTH, exchange_hiding, find_new, list_turning, swap
from lmd.incremental.nearby import look_around
from lmd.incremental.state import (
    AFTER_HIDDEN,
    AFTER_HIDING,
    FIRST,
    FLIPS,
    GOES,
    HIDDEN,
    HIDING,
    HIGH,
    LAST,
    LISTED,
    LOW,
    NAMES,
    REACHED,
    SPAN_COUNT,
    SURE,
    SURFACE,
    State,
    X,
    Y,
    Z,
    scratch_of,
)
from lmd.scene.criteria import covering, frame_of, sized
from lmd.scene.deployment import Deployment
from lmd.sight.directions import CERTAIN, NOWHERE, POSSIBLE

# What is kept of a landmark in a view: a bit whether it is covered, and as much again of what hides it.
LANDMARK_BYTES = 0.25

# Indices are unsigned where it counts: signed ones cost extra instructions, as they might be negative.


@inner
def find_cap(k, positions, field, scratch):
    """Find the axes that cover landmark k in the place tried at `positions`, nobody hiding it."""
    sight, axes, certain, possible = sized(field.sight, k), field.axes, field.tables[CERTAIN], field.tables[POSSIBLE]
    target, caps, seen = scratch.target, scratch.cap, scratch.seen
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached = scratch.cell, scratch.flags[REACHED]
    frame = frame_of(sight, target[3], target[4], target[5])
    for p in positions:
        row = np.uint64(cell[p] if reached[p] else NOWHERE)
        given = row if sure[p] == np.inf else np.uint64(NOWHERE)
        px, py, pz, least, most, deep = x[p], y[p], z[p], low[p], high[p], sure[p]
        for w in range(np.uint64(caps.shape[1])):
            cap, well = certain[given, w], certain[row, w]
            left = possible[row, w] & ~cap
            if left:
                cap |= covering(sight, left, w, px, py, pz, frame, least, most, deep, well, axes)
            caps[p, w] = cap


@inner
def _recount(k, positions, sign, field, state, scratch):
    """Exchange the cap of landmark k for the other in `scratch` at `positions`, and update the counts.

    `sign` says whether other landmarks turn as in `TURNS`, or, with -1, back.
    """
    n, caps, other, names, goes = field.n, state.caps, scratch.cap, scratch.lists[NAMES], scratch.lists[GOES]
    reachable, hidden, counts = state.reachable, state.hides[HIDDEN], state.counts
    reached, count_hidden, flips = scratch.flags[REACHED], scratch.shorts[AFTER_HIDDEN], scratch.flags[FLIPS]
    words = np.uint64(caps.shape[2])
    for p in positions:
        shown = ALL if reachable[k, p] & (hidden[k, p] == 0) else ZERO
        seen = ALL if reached[p] & (count_hidden[p] == 0) else ZERO
        for w in range(words if reachable[k, p] | reached[p] else ZERO):
            old, new = caps[k, p, w], other[p, w]
            caps[k, p, w], other[p, w] = new, old
            changed = (old & shown) ^ (new & seen)
            if changed:
                ripple(p, w, changed, old & shown, n, counts)
        if not flips[p]:
            continue
        for m in range(list_turning(p, sign, state, scratch)):
            for w in range(words):
                ripple(p, w, caps[names[m], p, w], goes[m], n, counts)


@inner
def list_touched(k, state, scratch):
    """List the positions at which a move of landmark k may change anything in `LISTED`; returns how many."""
    reachable, reached, flips = state.reachable, scratch.flags[REACHED], scratch.flags[FLIPS]
    listed, first, last = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST]
    count = ZERO
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            listed[count] = p
            count += np.uint64(reachable[k, p] | reached[p] | flips[p])
    return count


@inner
def exchange_place(k, state, scratch):
    """Exchange where landmark k is for the other place in `scratch`."""
    poses, target, surfaces, numbers = state.poses, scratch.target, state.surfaces, scratch.numbers
    for i in range(6):
        poses[i, k], target[i] = target[i], poses[i, k]
    surfaces[k], numbers[SURFACE] = numbers[SURFACE], surfaces[k]


@inner
def exchange_move(k, sign, field, state, scratch):
    """Exchange landmark k for what `scratch` has of its other place."""
    lists = scratch.lists
    _recount(np.uint64(k), lists[LISTED][: list_touched(k, state, scratch)], sign, field, state, scratch)
    exchange_hiding(k, sign, field.sight, state, scratch)
    for s in range(scratch.numbers[SPAN_COUNT]):
        swap(state.units, scratch.units, lists[FIRST, s], lists[LAST, s])
    exchange_place(k, state, scratch)


@inner
def carry_out(field, k, state, scratch):
    """Move landmark k to where it was tried last; no other move may have been tried or carried out since."""
    find_cap(k, scratch.lists[LISTED][: list_touched(k, state, scratch)], field, scratch)
    exchange_move(k, FORTH, field, state, scratch)


@inner
def take_back(field, k, state, scratch):
    """Undo the last `carry_out` with this `scratch`, all later ones being undone."""
    exchange_move(k, BACK, field, state, scratch)


@borrowing
def overlook(missed, field, state):
    """Take the sets of axes `missed` `(K, Q, W)` out of the caps; landmarks hide each other as before."""
    caps = state.caps
    for k in range(np.uint64(caps.shape[0])):
        for p in range(np.uint64(caps.shape[1])):
            shown = state.reachable[k, p] & (state.hides[HIDDEN, k, p] == 0)
            for w in range(np.uint64(caps.shape[2])):
                gone = caps[k, p, w] & missed[k, p, w]
                caps[k, p, w] ^= gone
                if shown and gone:
                    ripple(p, w, gone, ALL, field.n, state.counts)
    sum_up(field, state)


@borrowing
def _fill(field, state, scratch):
    """Let the landmarks of `state` come, one after the other."""
    poses, hides, after = state.poses, state.hides, scratch.shorts
    reachable, reached = state.reachable, scratch.flags[REACHED]
    for k in range(poses.shape[1]):
        for i in range(6):
            scratch.target[i] = poses[i, k]
        look_around(k, field, state, scratch)
        if field.sight.reach >= 0.0:
            find_new(k, field, state, scratch)
        positions = scratch.lists[LISTED][: list_touched(k, state, scratch)]
        find_cap(k, positions, field, scratch)
        _recount(np.uint64(k), positions, FORTH, field, state, scratch)
        for p in range(np.uint64(len(reached))):
            reachable[k, p] = reached[p]
            hides[HIDDEN, k, p], hides[HIDING, k, p] = after[AFTER_HIDDEN, p], after[AFTER_HIDING, p]
    sum_up(field, state)


def state_of(field: Any, deployment: Deployment) -> State:
    """The coverage of `deployment`, ready for moves; `field` a `lmd.incremental.coverage_field.CoverageField`."""
    positions, count, words = field.positions.shape[1], len(deployment), field.given.shape[1]
    check_views(LANDMARK_BYTES, positions, BITS * words, count)
    state = State(
        **places_of(deployment)._asdict(),
        caps=np.zeros((count, positions, words), dtype=np.uint64),
        reachable=np.zeros((count, positions), dtype=np.bool_),
        hides=np.zeros((2, count, positions), dtype=np.int16),
        counts=given_counts(field.given, count, field.n),
        units=np.zeros(positions, dtype=np.int64),
    )
    _fill(field, state, scratch_of(state))
    return state
