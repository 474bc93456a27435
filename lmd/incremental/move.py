"""Moves of single landmarks that are carried out: counts and P_n are updated instead of recomputed.

A state has the data of the old place, and a scratch has the data of the place tried. `carry_out` finds all axes that
cover the place tried, then exchanges the data of state and scratch, P_n included. A second exchange undoes the move.
After any sequence of moves, the counts equal the counts of a full evaluation bit for bit.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, Integer
from lmd.core.compiled import borrowing, inner
from lmd.incremental.counts import sum_up, update_counts
from lmd.incremental.occlusion import FIRST_PLACE
from lmd.incremental.state import (
    FIRST,
    HIDDEN,
    LANDMARK,
    LAST,
    LISTED,
    PAIR_COUNT,
    POSITION,
    SPAN_COUNT,
    SURFACE,
)
from lmd.incremental.trial import (
    begin_place,
    exchange_sets,
    exchange_views,
    find_pairs,
    list_changing,
    see_whole,
    turned,
)


@inner
def exchange(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Exchange the data of landmark k and of the pairs between state and scratch, and update the counts."""
    words, landmark, position = (
        np.uint64(state.counts.digits.shape[1]),
        scratch.pairs[LANDMARK],
        scratch.pairs[POSITION],
    )
    for p in scratch.lists[LISTED][: list_changing(state, k, scratch)]:
        for w in range(words):
            was, now = exchange_sets(state, k, p, w, scratch)
            if was != now:
                update_counts(p, w, was ^ now, was, field.n, state.counts)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(landmark[e]), np.uint64(position[e])
        for w in range(words):
            was, now = turned(state, i, p, w, scratch)
            if was != now:
                update_counts(p, w, was ^ now, was, field.n, state.counts)
    exchange_views(state, k, scratch)


@inner
def exchange_place(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Exchange the place of landmark k for the place in `scratch`.

    This undoes the last `carry_out` with this scratch; all later moves must have been undone.
    """
    k, first, last, units = np.uint64(k), scratch.lists[FIRST], scratch.lists[LAST], scratch.units
    exchange(k, field, state, scratch)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            state.units[p], units[p] = units[p], state.units[p]
    poses, target, surfaces, numbers = state.poses, scratch.target, state.surfaces, scratch.numbers
    for i in range(6):
        poses[i, k], target[i] = target[i], poses[i, k]
    surfaces[k], numbers[SURFACE] = numbers[SURFACE], surfaces[k]


@inner
def carry_out(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Move landmark k to the place tried last; no other move may have been tried or carried out since."""
    see_whole(np.uint64(k), field, state, scratch)
    exchange_place(field, k, state, scratch)


@borrowing
def fill(field: Any, state: Any, scratch: Any) -> None:
    """Count all landmarks of an empty `state`, one after the other, and compute P_n."""
    for k in range(np.uint64(state.poses.shape[1])):
        for i in range(6):
            scratch.target[i] = state.poses[i, k]
        begin_place(k, field, state, scratch)
        find_pairs(state, k, FIRST_PLACE, field, scratch)
        see_whole(k, field, state, scratch)
        exchange(k, field, state, scratch)
    sum_up(field, state)


@borrowing
def remove_sets(missed: Any, field: Any, state: Any) -> None:
    """Remove the axes `missed`, sets `(K, Q, W)`, from the axes that cover the landmarks; occlusion stays unchanged."""
    covered = state.covered
    for k in range(np.uint64(covered.shape[0])):
        for p in range(np.uint64(covered.shape[1])):
            shown = state.reachable[k, p] & (state.hides[HIDDEN, k, p] == 0)
            for w in range(np.uint64(covered.shape[2])):
                gone = covered[k, p, w] & missed[k, p, w]
                covered[k, p, w] ^= gone
                if shown and gone:
                    update_counts(p, w, gone, ALL, field.n, state.counts)
    sum_up(field, state)
