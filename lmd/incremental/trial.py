"""Trial of a move of one landmark: upper bounds on P_n with the landmark at its new place, then the exact P_n.

P_n is the probability, at a position, that n landmarks are covered.

A move of landmark k changes the counts at a position in at most four ways. At its old place k is no longer covered, and
landmarks that k hid appear. At its new place k is covered, and landmarks that k hides disappear. The decisions repeat
the operations of `lmd.sight.kernels`.

Axes are orientations, and sets of axes are bit sets. A state has the axes that cover each landmark and, at each
position, the axes that cover n - 1 and n landmarks. The moving landmark changes P_n only through axes that cover n - 1
or n landmarks, so a trial tests few axes.

1. `bound_move` ignores that the landmark at the new place hides other landmarks or is hidden. Occlusion can only reduce
   the set of axes from which a landmark is covered, and P_n does not decrease when such a set grows, so the result is
   an upper bound. At *touched* positions, where another landmark appears, the other landmarks are counted first
   (`_count_others`).
2. `finish_move` searches for occlusion around the new place, which touches more positions, and computes P_n at all
   touched positions.

Camera and rig share this source, which is compiled separately for each. Only the functions declared first in this file
differ: `lmd.incremental.camera` and `lmd.incremental.rig` register versions for their states. Occlusion and bounds
depend on the position alone for a camera, and also on the orientation for a rig. Treating a camera as a rig with one
mount would be slower: 1.3 to 1.8 times for a trial, and 1.9 to 2.7 times for a move that is carried out.

A state has the data of the old place, and a scratch has the data of the new place. `carry_out` finds all axes that
cover the new place, then exchanges the data of state and scratch, P_n included. A second exchange undoes the move.
After any sequence of moves, the counts equal the counts of a full evaluation bit for bit.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, Integer, add_set, at_least, exactly
from lmd.core.checks import FloatArray
from lmd.core.compiled import borrowing, inner
from lmd.core.dispatch import dispatched, dispatched_call
from lmd.incremental.occlusion import FIRST_PLACE, NEW_PLACE, OLD_PLACE, list_blocks
from lmd.incremental.state import (
    ASKED,
    ENOUGH,
    FIRST,
    HIDDEN,
    LANDMARK,
    LAST,
    LISTED,
    PAIR_COUNT,
    POSITION,
    SPAN_COUNT,
    SURFACE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    sum_up,
    update_counts,
)
from lmd.sight.kernels import sum_weights

# Indices in inner loops are unsigned; signed indices need extra instructions, as they may be negative.


@dispatched
def shown_of(state: Any, k: Integer, p: Integer, w: Integer) -> Any:
    """Bit set of the orientations of word w (64 orientations) with which landmark k is seen from position p."""


@dispatched
def turned(state: Any, i: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    """Bit sets of the orientations with which landmark i is seen from position p before and after the trial move.

    The sets are limited to word w (64 orientations). Landmark i is not the moving one; the move may change its
    occlusion.
    """


@dispatched_call
def find_pairs(state: Any, k: Integer, role: Any, field: Any, scratch: Any) -> None:
    """Find each other landmark and position for which landmark k hides the other landmark or is hidden by it.

    `role` selects the place of landmark k: its old place, the new place of the trial, or the place at which it is first
    counted. The pairs of a landmark and a position are recorded in the scratch.
    """


@dispatched_call
def bound_views(state: Any, k: Integer, field: Any, scratch: Any) -> Any:
    """Begin to compute upper bounds on P_n, the probability that n landmarks are covered, for a trial move.

    Only positions that are not touched are handled. There, the move is assumed to change no occlusion. The function
    writes the bounds into the scratch, or lists the positions at which `see` and `_find_units` must compute them.

    Returns:
        number of positions in the row `LISTED`, which also has the touched positions.
    """


@dispatched_call
def see(state: Any, k: Integer, positions: np.ndarray, field: Any, scratch: Any) -> None:
    """Find the orientations that cover landmark k at the new place of the trial move.

    Only the orientations in the row `ASKED` of `scratch.sets` are tested, at the `positions` (indices). The result is
    written to the row `FRESH`.
    """


@dispatched
def fresh_of(scratch: Any, p: Integer, w: Integer) -> Any:
    """Bit set of the orientations with which the moving landmark is seen from position p at its new place.

    The set is limited to word w (64 orientations), and to the orientations that `see` has tested.
    """


@dispatched_call
def list_changing(state: Any, k: Integer, scratch: Any) -> Any:
    """Write into the row `LISTED` the positions whose views a move of landmark k may change.

    Returns:
        number of these positions.
    """


@dispatched
def exchange_sets(state: Any, k: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    """Swap two bit sets of orientations that cover landmark k, one in the state and one in the scratch.

    The sets belong to the old and to the new place of landmark k, as seen from position p. Only word w (64
    orientations) of each set is swapped.

    Returns:
        two bit sets: the orientations with which landmark k is seen from position p, before and after the swap.
    """


@dispatched_call
def exchange_views(state: Any, k: Integer, scratch: Any) -> None:
    """Swap the data about the occlusion and the reach of landmark k between state and scratch.

    The state's occlusion of the other landmarks in `pairs` is updated too. A second call undoes the first.
    `exchange_sets`, which swaps the remaining sets, must be called before.
    """


@dispatched_call
def clear_views(scratch: Any) -> None:
    """Reset the entries of the scratch (working memory) that the last trial move wrote."""


@inner
def begin_place(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Reset the scratch after the last trial move, and list the blocks of positions near two places of landmark k.

    The places are the present place of landmark k and its new place.
    """
    numbers, landmark, position = scratch.numbers, scratch.pairs[LANDMARK], scratch.pairs[POSITION]
    touched, places, known = scratch.flags[TOUCHED], scratch.lists[TOUCHED_LIST], scratch.known
    clear_views(scratch)
    for e in range(numbers[PAIR_COUNT]):
        known[position[e], landmark[e]] = False
    for e in range(numbers[TOUCHED_COUNT]):
        touched[places[e]] = False
    numbers[PAIR_COUNT] = numbers[TOUCHED_COUNT] = 0
    list_blocks(k, field, state, scratch)


@inner
def begin_move(k: Integer, pose: Any, surface: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Begin a trial move of landmark k to `pose` `(6,)`: position (metres) and unit normal.

    The function finds the pairs (`find_pairs`) of the old place, and copies P_n of the state to the scratch.
    """
    scratch.numbers[SURFACE], units, before = surface, scratch.units, state.units
    for i in range(6):
        scratch.target[i] = pose[i]
    begin_place(k, field, state, scratch)
    find_pairs(state, k, OLD_PLACE, field, scratch)
    for p in range(len(units)):
        units[p] = before[p]


@inner
def _count_others(k: Integer, state: Any, scratch: Any) -> None:
    """Count the landmarks other than k that are seen from each touched position after the trial move.

    At a touched position, the move changes the occlusion of a landmark. The counts for all orientations are written to
    `digits` as binary digits.
    """
    landmark, position = scratch.pairs[LANDMARK], scratch.pairs[POSITION]
    counts, digits = state.counts.digits, scratch.digits
    words = np.uint64(counts.shape[1])
    for p in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(words):
            for j in range(np.uint64(digits.shape[2])):
                digits[p, w, j] = counts[p, w, j]
            add_set(digits[p, w], shown_of(state, k, p, w), ALL)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(landmark[e]), np.uint64(position[e])
        for w in range(words):
            was, now = turned(state, i, p, w, scratch)
            if was != now:
                add_set(digits[p, w], was ^ now, was)


@inner
def ask_touched(k: Integer, n: Integer, or_more: bool, state: Any, scratch: Any) -> None:
    """Select the orientations that `see` tests at touched positions, and write them to the row `ASKED`.

    At a touched position, the trial move changes the occlusion of a landmark. An orientation is selected if exactly n -
    1 landmarks other than k are seen, or at least n - 1 if `or_more` is True.
    """
    asked, digits = scratch.sets[ASKED], scratch.digits
    _count_others(k, state, scratch)
    for p in scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]:
        for w in range(np.uint64(asked.shape[1])):
            asked[p, w] = at_least(digits[p, w], n - 1) if or_more else exactly(digits[p, w], n - 1)


@inner
def _find_units(k: Integer, positions: FloatArray, n: Integer, weights: Any, state: Any, scratch: Any) -> None:
    """Compute P_n, the probability that n landmarks are covered, at `positions` after the trial move.

    P_n is written to `scratch.units`, and follows from the row `FRESH`, the orientations that cover landmark k at its
    new place, and from the changed occlusion of the landmarks in `pairs`.
    """
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
    """Run `see` with all orientations, including those that cannot change the result of the trial move."""
    positions, asked = scratch.lists[LISTED][: list_changing(state, k, scratch)], scratch.sets[ASKED]
    for p in positions:
        for w in range(np.uint64(asked.shape[1])):
            asked[p, w] = ALL
    see(state, k, positions, field, scratch)


@inner
def bound_move(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Write upper bounds on P_n, the probability that n landmarks are covered, after a move of landmark k.

    The quantised bounds are written to `scratch.units`, see `field.bound`. `pose` `(6,)` is the new position (metres)
    and unit normal of the landmark.
    """
    k = np.uint64(k)
    begin_move(k, pose, surface, field, state, scratch)
    ask_touched(k, field.n, False, state, scratch)
    positions = scratch.lists[LISTED][: bound_views(state, k, field, scratch)]
    see(state, k, positions, field, scratch)
    _find_units(k, positions, field.n, field.weights, state, scratch)


@inner
def finish_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Replace the bounds of `bound_move` in `scratch.units` by the exact P_n.

    P_n is the probability that n landmarks are covered after the move.
    """
    k = np.uint64(k)
    find_pairs(state, k, NEW_PLACE, field, scratch)
    ask_touched(k, field.n, False, state, scratch)
    positions = scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]]
    see(state, k, positions, field, scratch)
    _find_units(k, positions, field.n, field.weights, state, scratch)


@inner
def exchange(k: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Swap the views of landmark k between state and scratch, and update the counts of covered landmarks.

    The occlusion of the other landmarks in `pairs` is updated too.
    """
    landmark, position = scratch.pairs[LANDMARK], scratch.pairs[POSITION]
    words = np.uint64(state.counts.digits.shape[1])
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
    """Swap the place of landmark k, and all data that depend on its place, between state and scratch.

    After `carry_out` with this scratch, the swap undoes the move. Moves that were carried out later, with other
    scratches, must have been undone before.
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
    """Move landmark k to the new place of the last trial.

    No other move may have been tried or carried out since this trial.
    """
    see_whole(np.uint64(k), field, state, scratch)
    exchange_place(field, k, state, scratch)


@borrowing
def fill(field: Any, state: Any, scratch: Any) -> None:
    """Count all landmarks of a state, and compute P_n, the probability that n landmarks are covered.

    No landmark of the state may have been counted before.
    """
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
    """Remove orientations from the sets of orientations that cover each landmark, and update counts and P_n.

    `missed` `(K, Q, W)` are bit sets of the orientations to remove. The occlusion between landmarks does not change.
    """
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
