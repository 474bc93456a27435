"""Moves of single landmarks: bounds on L, exact L, and moves that are carried out or undone.

L is the probability of a localised view. Counts and occlusion come from the field of coverage
(`lmd.incremental.trial`). The field of localisation adds, for every view, the sums of the landmarks' information
(`information`), which are exact in any order, and the sets of localised views. Further landmarks never reduce the
information of a view. So the limits of `Precision` are tested again in few views. Such views cover n landmarks after
the move, and meet one of three conditions:

- landmarks only disappear from the view, which is localised before the move.
- landmarks only appear in the view, which is not localised before the move.
- landmarks appear and disappear.

`bound_move` ignores that the landmark at the new place hides other landmarks or is hidden; occlusion only reduces
information. `finish_move` repeats the tests at the positions with such occlusion.

Camera and rig share this source, which is compiled separately for each; `views` declares the functions that differ.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, ZERO, Integer, WordArray, at_least
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.incremental.occlusion import NEW_PLACE
from lmd.incremental.state import (
    ASKED,
    ENOUGH,
    FIRST,
    LAST,
    LISTED,
    SPAN_COUNT,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    enough_with,
)
from lmd.incremental.trial import begin_move, exchange_place, find_pairs, fresh_of, list_changing, shown_of
from lmd.objectives.localisation.ambiguity import resolves_ambiguity
from lmd.objectives.localisation.views import (
    change_sums,
    clear_moments,
    find_turns,
    met_views,
    see_place,
    see_rest,
    see_touched,
    seen_twice,
    sum_anew,
    sum_views,
)
from lmd.sight.kernels import sum_weights

# Rows of `LocalisationScratch.sets`.
LOCALISED = 0  # localised views, as in the state, after the move
LOST = 1  # views of touched positions in which another landmark disappears for some camera
GAINED = 2  # views of touched positions in which another landmark appears for some camera


@inlined
def mixed(located: Any, covered: Any, weight: float) -> Any:
    """Quantised value (1 - weight) L + weight P_n of a position, from its quantised L (`located`) and P_n (`covered`).

    L is the probability of a localised view, P_n that of n covered landmarks. The value never decreases when L or P_n
    increases.
    """
    return located + np.int64(weight * (covered - located))


@inner
def _find_turns(state: Any, scratch: Any) -> None:
    """Find the views in which the move makes a landmark, other than the moving one, disappear or appear.

    The views are written to the rows `LOST` and `GAINED` at the touched positions.
    """
    lost, gained, trial = scratch.sets[LOST], scratch.sets[GAINED], scratch.coverage
    for q in trial.lists[TOUCHED_LIST][: trial.numbers[TOUCHED_COUNT]]:
        for w in range(np.uint64(lost.shape[1])):
            lost[q, w] = gained[q, w] = ZERO
    find_turns(state.coverage, trial, lost, gained)


@inner
def _decide_word(
    where: Any, lost: np.uint64, gained: np.uint64, has: np.uint64, several: np.uint64, field: Any, state: Any,
    scratch: Any,
) -> Any:  # fmt: skip
    """Bit set of the orientations with which the view is localised after the move, at one position.

    Only orientations of one word (64 orientations) are decided. The sets below have the orientations of this word.

    Args:
        where: index k of the moving landmark, q of the position, and w of the word.
        lost, gained: orientations with which some camera ceases to see a landmark, and with which some camera begins
            to.
        has: orientations that cover n landmarks or more after the move.
        several: orientations that cover two landmarks or more after the move.
        field, state, scratch: field, state and scratch of localisation.
    """
    k, q, w = where
    known = state.localised[q, w]
    left = has & ((lost & gained) | (lost & known) | (gained & ~known))
    good = known & has & ~left
    if left == ZERO:
        return good
    count = sum_views(state.coverage, k, q, w, left, field, state, scratch)
    return good | met_views(field.precision, scratch.views, count, several)


@inlined
def _sum_up(q: Integer, located: np.int64, covered: np.int64, weight: float, values: Any) -> None:
    """Write L (`located`), P_n (`covered`) and the value (`mixed`) of position q to `values`, a state or a scratch."""
    values.located[q], values.coverage.units[q], values.units[q] = located, covered, mixed(located, covered, weight)


@inner
def _decide(k: Integer, positions: WordArray, field: Any, state: Any, scratch: Any) -> None:
    """Compute the values of `positions` after the move, and write them to the scratch.

    The values follow from the orientations with which landmark k is seen at its new place, and from the changed
    occlusion of other landmarks.
    """
    known, trial, n, weights = state.coverage, scratch.coverage, field.coverage.n, field.coverage.weights
    counts, enough, digits = known.counts, known.counts.sets[ENOUGH], trial.digits
    asked, touched, localised = trial.sets[ASKED], trial.flags[TOUCHED], scratch.sets[LOCALISED]
    if field.asks:
        _find_turns(state, scratch)
    for q in positions:
        located, covered = state.located[q], known.units[q]
        for w in range(np.uint64(localised.shape[1])):
            was, now, before = shown_of(known, k, q, w), fresh_of(trial, q, w), enough[q, w]
            lost, gained, has = was, now, enough_with(q, w, was, now, counts)
            if touched[q]:
                has = at_least(digits[q, w], n) | (now & asked[q, w])
                lost, gained = lost | scratch.sets[LOST, q, w], gained | scratch.sets[GAINED, q, w]
            elif was | now == ZERO:
                continue
            several = ALL
            if resolves_ambiguity(field.precision):
                several = (
                    seen_twice(ZERO, now, digits[q, w]) if touched[q] else seen_twice(was, now, counts.digits[q, w])
                )
            good = _decide_word((k, q, w), lost, gained, has, several, field, state, scratch) if field.asks else has
            covered += sum_weights(before, has, weights, q, w)
            located += sum_weights(state.localised[q, w], good, weights, q, w)
            localised[q, w] = good
        _sum_up(q, located, covered, field.weight, scratch)


@inner
def bound_move(field: Any, k: Integer, pose: FloatArray, surface: Integer, state: Any, scratch: Any) -> None:
    """Write upper bounds on the positions' values after a move of landmark k to `scratch.units`, quantised.

    The value of a position is (1 - w) L + w P_n. L is the probability of a localised view, P_n that of n covered
    landmarks, and w is `field.weight`. `pose` `(6,)` is the new position (metres) and unit normal of the landmark.
    """
    cover, known, trial, i = field.coverage, state.coverage, scratch.coverage, np.uint64(k)
    begin_move(i, pose, surface, cover, known, trial)
    for q in range(len(scratch.units)):
        scratch.units[q] = state.units[q]
    first, last, tried = trial.lists[FIRST], trial.lists[LAST], scratch.sets[LOCALISED]
    for s in range(trial.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            scratch.located[q] = state.located[q]
            clear_moments(scratch.views, q)
            for w in range(np.uint64(tried.shape[1])):
                tried[q, w] = state.localised[q, w]
    count = see_place(known, i, cover.n, state.localised, cover, trial)
    _decide(i, trial.lists[LISTED][:count], field, state, scratch)


@inner
def finish_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Replace the bounds of `bound_move` in `scratch.units` by the exact values of the positions."""
    cover, known, trial, i = field.coverage, state.coverage, scratch.coverage, np.uint64(k)
    find_pairs(known, i, NEW_PLACE, cover, trial)
    positions = trial.lists[TOUCHED_LIST][: trial.numbers[TOUCHED_COUNT]]
    see_touched(known, i, cover.n, positions, cover, trial)
    _decide(i, positions, field, state, scratch)


@inner
def _change_sums(k: Integer, sign: float, field: Any, state: Any, scratch: Any) -> None:
    """Update the information of the state's views for the move tried last (`sign` 1), or undo this update (`sign` -1).

    In both cases, landmark k must be at its old place in the state.
    """
    if not field.asks:
        return
    known, trial = state.coverage, scratch.coverage
    positions = trial.lists[LISTED][: list_changing(known, k, trial)]
    _find_turns(state, scratch)
    for q in positions:
        for w in range(np.uint64(state.localised.shape[1])):
            changed = shown_of(known, k, q, w) | fresh_of(trial, q, w)
            if trial.flags[TOUCHED, q]:
                changed |= scratch.sets[LOST, q, w] | scratch.sets[GAINED, q, w]
            if changed:
                change_sums(known, k, q, w, changed, sign, field, state, scratch)


@inner
def _exchange(state: Any, scratch: Any) -> None:
    """Swap values, L and localised views between state and scratch at all positions that the move may affect."""
    first, last, localised = scratch.coverage.lists[FIRST], scratch.coverage.lists[LAST], scratch.sets[LOCALISED]
    for s in range(scratch.coverage.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            state.units[p], scratch.units[p] = scratch.units[p], state.units[p]
            state.located[p], scratch.located[p] = scratch.located[p], state.located[p]
            for w in range(state.localised.shape[1]):
                state.localised[p, w], localised[p, w] = localised[p, w], state.localised[p, w]


@inner
def carry_out(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Move landmark k to the new place of the last trial, see `lmd.incremental.trial.carry_out`."""
    see_rest(state.coverage, np.uint64(k), field.coverage, scratch.coverage)
    _change_sums(np.uint64(k), 1.0, field, state, scratch)
    exchange_place(field.coverage, k, state.coverage, scratch.coverage)
    _exchange(state, scratch)


@inner
def undo_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Undo the last `carry_out`, see `lmd.incremental.trial.exchange_place`."""
    exchange_place(field.coverage, k, state.coverage, scratch.coverage)
    _change_sums(np.uint64(k), -1.0, field, state, scratch)
    _exchange(state, scratch)


@inner
def _meet_anew(q: Integer, w: Integer, field: Any, state: Any, scratch: Any) -> np.uint64:
    """Sum the information of all landmarks in the views of word w (64 orientations) at position q into a new state.

    Returns:
        bit set of the orientations whose views are within the limits of `Precision`.
    """
    known, seen = state.coverage, ZERO
    for k in range(np.uint64(known.poses.shape[1])):
        seen |= shown_of(known, k, q, w)
    count = sum_anew(known, q, w, seen, field, state, scratch)
    several = seen_twice(ZERO, ZERO, known.counts.digits[q, w])
    return met_views(field.precision, scratch.views, count, several)


@kernel
def sum_up_anew(field: Any, state: Any, scratch: Any) -> None:
    """Compute the information of all views, and the values of all positions, from all landmarks of a state."""
    known, weights = state.coverage, field.coverage.weights
    for q in range(np.uint64(len(state.units))):
        located = np.int64(0)
        for w in range(np.uint64(state.localised.shape[1])):
            good = known.counts.sets[ENOUGH, q, w]
            if field.asks:
                good &= _meet_anew(q, w, field, state, scratch)
            state.localised[q, w] = good
            located += sum_weights(ZERO, good, weights, q, w)
        _sum_up(q, located, known.units[q], field.weight, state)
