"""Trying to move one landmark: P_n if it stood elsewhere, first bounded, then exact.

A moved landmark changes the counts at a position in at most four ways: its old cap goes, caps that it hid come back,
caps that it now hides go, its new cap comes. Everything else stays as it is, there and at every position where none of
the four happens. The decisions are those of `lmd.sight.kernels`, operation by operation.

Sets of axes are bits. The caps of all landmarks where they are, and at each position the axes one landmark short of n
and those with just n, are known beforehand. So a trial tests few axes: those where P_n depends on the landmark.

1. `bound_move` leaves out what the new place hides and what hides it. Both only take caps away, and P_n never falls
   with another cap, so its values are never below P_n. `bound_views` finds them; at *touched* positions, where another
   landmark appears, the others are counted first (`count_others`).
2. `finish_move` searches around the new place, which touches more positions, and finds P_n at all touched ones.

The source is one for a camera and for a rig, and is compiled for each. They differ in the functions declared first,
which `lmd.incremental.camera` and `lmd.incremental.rig` register for their states: for a camera occlusion and bounds
depend on the position alone, for a rig on the orientation, too. One loop for both was measured: a camera as a rig of
one mount takes 1.3 to 1.8 times as long for a trial, 1.9 to 2.7 times for a move that is carried out.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, Integer, add_set, at_least, exactly
from lmd.core.checks import FloatArray
from lmd.core.compiled import inner
from lmd.core.dispatch import dispatched, dispatched_call
from lmd.incremental.counts import ENOUGH
from lmd.incremental.nearby import list_blocks
from lmd.incremental.occlusion import COMES, LEAVES
from lmd.incremental.state import (
    ASKED,
    LISTED,
    PAIR_COUNT,
    SURFACE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    WHERE,
    WHO,
)
from lmd.sight.kernels import sum_weights

# Indices are unsigned where it counts: signed ones cost extra instructions, as they might be negative.


@dispatched
def shown_of(state: Any, k: Integer, p: Integer, w: Integer) -> Any:
    """Orientations of word w with which landmark k is seen from position p."""


@dispatched
def turned(state: Any, i: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    """`shown_of` a landmark of `Scratch.pairs` before and after the move."""


@dispatched_call
def find_pairs(state: Any, k: Integer, how: Any, field: Any, scratch: Any) -> None:
    """Find the pairs that landmark k concerns as it leaves its place, comes to the place tried or arrives there."""


@dispatched_call
def bound_views(state: Any, k: Integer, field: Any, scratch: Any) -> Any:
    """Bound P_n at positions that are not touched.

    Returns:
        number of positions in `LISTED`, at which `see` and `find_units` have to finish; all touched ones are there.
    """


@dispatched_call
def see(state: Any, k: Integer, positions: np.ndarray, field: Any, scratch: Any) -> None:
    """Find in `FRESH` with which orientations among those `ASKED` landmark k is covered at the place tried."""


@dispatched
def fresh_of(scratch: Any, p: Integer, w: Integer) -> Any:
    """Orientations in `FRESH` with which the landmark is seen at the place tried."""


@dispatched_call
def list_changing(state: Any, k: Integer, scratch: Any) -> Any:
    """List in `LISTED` the positions at which a move of landmark k may change anything.

    Returns:
        their number.
    """


@dispatched
def exchange_sets(state: Any, k: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    """Exchange the sets of landmark k in word w at position p.

    Returns:
        the orientations with which it was seen, and those with which it is seen now.
    """


@dispatched_call
def exchange_views(state: Any, k: Integer, scratch: Any) -> None:
    """Exchange what else a state and a scratch have of the places of landmark k, and apply the pairs.

    Done twice, it changes nothing.
    """


@dispatched_call
def forget_views(scratch: Any) -> None:
    """Clear what the last trial found, by the lists of that trial."""


@inner
def begin_place(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Clear the last trial, and list the blocks near landmark k or the place tried."""
    numbers, who, where = scratch.numbers, scratch.pairs[WHO], scratch.pairs[WHERE]
    touched, places, known = scratch.flags[TOUCHED], scratch.lists[TOUCHED_LIST], scratch.known
    forget_views(scratch)
    for e in range(numbers[PAIR_COUNT]):
        known[where[e], who[e]] = False
    for e in range(numbers[TOUCHED_COUNT]):
        touched[places[e]] = False
    numbers[PAIR_COUNT] = numbers[TOUCHED_COUNT] = 0
    list_blocks(k, field, state, scratch)


@inner
def begin_move(k: Integer, pose: Any, surface: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Find what changes as landmark k leaves its place for `pose` `(6,)`, position and normal; copy all values."""
    scratch.numbers[SURFACE], units, before = surface, scratch.units, state.units
    for i in range(6):
        scratch.target[i] = pose[i]
    begin_place(k, field, state, scratch)
    find_pairs(state, k, LEAVES, field, scratch)
    for p in range(len(units)):
        units[p] = before[p]


@inner
def _count_others(k: Integer, state: Any, scratch: Any) -> None:
    """Count in `digits` the landmarks but k at positions that are touched, the pairs having turned."""
    counts, digits, who, where = state.counts.digits, scratch.digits, scratch.pairs[WHO], scratch.pairs[WHERE]
    words = np.uint64(counts.shape[1])
    for p in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(words):
            for j in range(np.uint64(digits.shape[2])):
                digits[p, w, j] = counts[p, w, j]
            add_set(digits[p, w], shown_of(state, k, p, w), ALL)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(who[e]), np.uint64(where[e])
        for w in range(words):
            was, now = turned(state, i, p, w, scratch)
            if was != now:
                add_set(digits[p, w], was ^ now, was)


@inner
def ask_touched(k: Integer, n: Integer, or_more: bool, state: Any, scratch: Any) -> None:
    """Ask at touched positions for the orientations with n - 1 other landmarks in view, `or_more`."""
    asked, digits = scratch.sets[ASKED], scratch.digits
    _count_others(k, state, scratch)
    for p in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(np.uint64(asked.shape[1])):
            asked[p, w] = at_least(digits[p, w], n - 1) if or_more else exactly(digits[p, w], n - 1)


@inner
def _find_units(k: Integer, positions: FloatArray, n: Integer, weights: Any, state: Any, scratch: Any) -> None:
    """Find P_n at `positions` with the sets in `FRESH` for landmark k and the pairs as they turn."""
    enough, asked = state.counts.sets[ENOUGH], scratch.sets[ASKED]
    touched, digits = scratch.flags[TOUCHED], scratch.digits
    for p in positions:
        change = np.int64(0)
        for w in range(np.uint64(asked.shape[1])):
            seen = fresh_of(scratch, p, w) & asked[p, w]
            had = shown_of(state, k, p, w) & asked[p, w]
            if touched[p]:
                had = enough[p, w]
                seen |= at_least(digits[p, w], n)
            change += sum_weights(had, seen, weights, p, w)
        scratch.units[p] = state.units[p] + change


@inner
def see_whole(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Find all orientations that cover landmark k at the place tried."""
    positions, asked = scratch.lists[LISTED][: list_changing(state, k, scratch)], scratch.sets[ASKED]
    for p in positions:
        for w in range(np.uint64(asked.shape[1])):
            asked[p, w] = ALL
    see(state, k, positions, field, scratch)


@inner
def bound_move(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Find upper bounds on P_n with landmark k at `pose` `(6,)`, position and normal, on a surface: `scratch.units`."""
    k = np.uint64(k)
    begin_move(k, pose, surface, field, state, scratch)
    ask_touched(k, field.n, False, state, scratch)
    positions = scratch.lists[LISTED][: bound_views(state, k, field, scratch)]
    see(state, k, positions, field, scratch)
    _find_units(k, positions, field.n, field.weights, state, scratch)


@inner
def finish_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Make the values that `bound_move` found exact."""
    k = np.uint64(k)
    find_pairs(state, k, COMES, field, scratch)
    ask_touched(k, field.n, False, state, scratch)
    positions = scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]
    see(state, k, positions, field, scratch)
    _find_units(k, positions, field.n, field.weights, state, scratch)
