"""Carrying out moves of single landmarks: exact counts and probabilities, updated instead of recomputed.

`carry_out` makes the last trial true, and it alone needs the new cap with all its axes. It exchanges what a state and a
scratch have of the two places, P_n included, so that `take_back` only has to exchange them again. After any sequence of
moves the counts equal those of a full evaluation, bit for bit.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, Integer
from lmd.core.compiled import borrowing, inner
from lmd.incremental.counts import ripple, sum_up
from lmd.incremental.occlusion import ARRIVES
from lmd.incremental.state import FIRST, HIDDEN, LAST, LISTED, PAIR_COUNT, SPAN_COUNT, SURFACE, WHERE, WHO
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
    """Exchange what a state and a scratch have of landmark k and of the pairs, and update the counts."""
    words, who, where = np.uint64(state.counts.digits.shape[1]), scratch.pairs[WHO], scratch.pairs[WHERE]
    for p in scratch.lists[LISTED][: list_changing(state, k, scratch)]:
        for w in range(words):
            was, now = exchange_sets(state, k, p, w, scratch)
            if was != now:
                ripple(p, w, was ^ now, was, field.n, state.counts)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(who[e]), np.uint64(where[e])
        for w in range(words):
            was, now = turned(state, i, p, w, scratch)
            if was != now:
                ripple(p, w, was ^ now, was, field.n, state.counts)
    exchange_views(state, k, scratch)


@inner
def take_back(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Exchange landmark k for the other place in `scratch`: undo the last `carry_out`, all later ones being undone."""
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
    """Move landmark k to where it was tried last; no other move may have been tried or carried out since."""
    see_whole(np.uint64(k), field, state, scratch)
    take_back(field, k, state, scratch)


@borrowing
def fill(field: Any, state: Any, scratch: Any) -> None:
    """Count the landmarks of `state`, one after the other."""
    for k in range(np.uint64(state.poses.shape[1])):
        for i in range(6):
            scratch.target[i] = state.poses[i, k]
        begin_place(k, field, state, scratch)
        find_pairs(state, k, ARRIVES, field, scratch)
        see_whole(k, field, state, scratch)
        exchange(k, field, state, scratch)
    sum_up(field, state)


@borrowing
def overlook(missed: Any, field: Any, state: Any) -> None:
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
