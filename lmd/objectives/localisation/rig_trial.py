"""Moving one landmark where a rig looks for it: L at every position of its body.

What covers what, and who hides whom, is the field of coverage's (`lmd.incremental.rig`). To it come the sums of
the 21 numbers of every view (`body`), exact in any order, and which views are localised. A camera is elsewhere for each
orientation, so what a landmark tells it is found for each view anew, of those alone that have to be decided: see
`trial`.
"""

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ALL, ZERO, at_least
from lmd.core.compiled import inlined, inner, kernel
from lmd.geometry.squares import upright_sides
from lmd.incremental.counts import ENOUGH, SHORT, enough_with
from lmd.incremental.move import take_back
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.occlusion import COMES
from lmd.incremental.rig import list_near
from lmd.incremental.state import (
    ASKED,
    CAPS,
    FIRST,
    FRESH,
    LAST,
    LISTED,
    PAIR_COUNT,
    SPAN_COUNT,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    VEILED,
    WHERE,
    WHO,
)
from lmd.incremental.trial import ask_touched, begin_move, find_pairs, see, see_whole
from lmd.objectives.localisation.ambiguity import asks_apart
from lmd.objectives.localisation.changes import mixed
from lmd.objectives.localisation.information import half_of
from lmd.objectives.localisation.move import exchange
from lmd.objectives.localisation.rig_ambiguity import several
from lmd.objectives.localisation.slots import (
    VIEW,
    add_landmark,
    add_up,
    ask_for,
    fill_slots,
    give_sums,
    met_slots,
    take_sums,
)
from lmd.objectives.localisation.state import LOCALISED
from lmd.sight.kernels import sum_weights

# Rows of `RigLocalisationScratch.sets` beside `LOCALISED`: the orientations with which the move
LOST = 1  # takes a landmark from some camera
GAINED = 2  # gives it one


@inlined
def _tag(half, x, y, z, nx, ny, nz):
    """A landmark with half an edge as `tags_of` has it."""
    return x, y, z, *upright_sides(half, nx, ny, nz)


@inlined
def _tag_of(i, precision, state):
    """The same of landmark i."""
    return _tag(half_of(precision, i), *pose_of(i, state.coverage))


@inlined
def _place(q, field):
    """Position q of the body."""
    positions = field.coverage.positions
    return positions[0, q], positions[1, q], positions[2, q]


@inner
def _add_changes(mounts, k, q, w, sign, field, state, scratch):
    """Add to the views taken what the move changes for the cameras of a part, times `sign`: see `add_landmark`."""
    trial, slots, count = scratch.coverage, scratch.slots, len(mounts.axes)
    mine, other = state.coverage.parts[mounts.number], trial.parts[mounts.number]
    caps, veiled, cap, veil = mine[CAPS], mine[VEILED], other.sets[CAPS], other.sets[VEILED]
    place, precision = _place(q, field), field.precision
    old, new = _tag_of(k, precision, state), _tag(half_of(precision, k), *target_of(trial))
    for m in range(count):
        goes, comes = caps[k, q, m, w] & ~veiled[k, q, m, w], cap[q, m, w] & ~veil[q, m, w]
        add_landmark(mounts, m, w, goes, place, old, -sign, precision, slots)
        add_landmark(mounts, m, w, comes, place, new, sign, precision, slots)
    for i in range(caps.shape[0] if trial.flags[TOUCHED, q] else 0):
        for m in range(count if trial.known[q, i] else 0):
            was, turns = veiled[i, q, m, w], caps[i, q, m, w] & other.flipped[i, q, m, w]
            if turns:
                tag = _tag_of(i, precision, state)
                add_landmark(mounts, m, w, turns & ~was, place, tag, -sign, precision, slots)
                add_landmark(mounts, m, w, turns & was, place, tag, sign, precision, slots)


@inner
def _find_turns_of(mine, flipped, trial, lost, gained):
    """See `_find_turns`, of the pairs as a part sees them."""
    caps, veiled, who, where = mine[CAPS], mine[VEILED], trial.pairs[WHO], trial.pairs[WHERE]
    mounts, words = caps.shape[2], np.uint64(caps.shape[3])
    for e in range(trial.numbers[PAIR_COUNT]):  # at positions that are touched, all of which are in `positions`
        i, q = np.uint64(who[e]), np.uint64(where[e])
        for m in range(mounts):
            for w in range(words):
                turns = caps[i, q, m, w] & flipped[i, q, m, w]
                lost[q, w] |= turns & ~veiled[i, q, m, w]
                gained[q, w] |= turns & veiled[i, q, m, w]


@inner
def _find_turns(k, positions, state, scratch):
    """Find with which orientations the cameras lose a landmark at `positions`, and gain one."""
    lost, gained, shown, fresh = (
        scratch.sets[LOST], scratch.sets[GAINED], state.coverage.shown, scratch.coverage.sets[FRESH]
    )  # fmt: skip
    for q in positions:
        for w in range(np.uint64(lost.shape[1])):
            lost[q, w], gained[q, w] = shown[k, q, w], fresh[q, w]
    for j in range(len(state.coverage.parts)):
        mine, flipped = state.coverage.parts[j], scratch.coverage.parts[j].flipped
        _find_turns_of(mine, flipped, scratch.coverage, lost, gained)


@inner
def _add_all_changes(k, q, w, sign, field, state, scratch):
    """See `_add_changes`, of all parts."""
    for mounts in literal_unroll(field.mounts):
        _add_changes(mounts, k, q, w, sign, field, state, scratch)
    add_up(field.precision, scratch.slots)


@inner
def _localised(k, q, w, has, two, field, state, scratch):
    """The orientations of word w that are localised, of those that cover enough, `has`; `two` cover two or more."""
    sums, slots, known = state.sums, scratch.slots, state.localised[q, w]
    lost, gained = scratch.sets[LOST, q, w], scratch.sets[GAINED, q, w]
    left = has & ((lost & gained) | (lost & known) | (gained & ~known))
    good, first = known & has & ~left, (q * np.uint64(state.localised.shape[1]) + w) * VIEW
    if left == ZERO:
        return good
    count = fill_slots(left, field.precision, slots)
    ask_for(sums, first, slots, count)
    _add_all_changes(k, q, w, 1.0, field, state, scratch)
    take_sums(sums, first, field.precision, slots, count)
    return good | met_slots(field.precision, slots, count, two)


@inlined
def _sum_up(q, located, covered, weight, values):
    """Write the values of position q to those of a state or a scratch."""
    values.located[q], values.coverage.units[q], values.units[q] = located, covered, mixed(located, covered, weight)


@inner
def _decide(k, positions, field, state, scratch):
    """Find the values at `positions`, with what `fresh` has of landmark k and the pairs as they turn."""
    known, trial, n, weights = state.coverage, scratch.coverage, field.coverage.n, field.coverage.weights
    shown, counts, enough, digits = known.shown, known.counts, known.counts.sets[ENOUGH], trial.digits
    fresh, asked, touched, localised = (
        trial.sets[FRESH], trial.sets[ASKED], trial.flags[TOUCHED], scratch.sets[LOCALISED]
    )  # fmt: skip
    if field.asks:
        _find_turns(k, positions, state, scratch)
    for q in positions:
        located, covered = state.located[q], known.units[q]
        for w in range(np.uint64(fresh.shape[1])):
            was, now, before = shown[k, q, w], fresh[q, w], enough[q, w]
            has = enough_with(q, w, was, now, counts)
            if touched[q]:
                has = at_least(digits[q, w], n) | (now & asked[q, w])
            two = ALL
            if asks_apart(field.precision):
                two = several(ZERO, now, digits[q, w]) if touched[q] else several(was, now, counts.digits[q, w])
            good = _localised(k, q, w, has, two, field, state, scratch) if field.asks else has
            covered += sum_weights(before, has, weights, q, w)
            located += sum_weights(state.localised[q, w], good, weights, q, w)
            localised[q, w] = good
        _sum_up(q, located, covered, field.weight, scratch)


@inner
def _ask(k, state, scratch):
    """Ask where landmark k may matter, and copy the values near it: no pair turning.

    It does where n - 1 others are seen or more, unless the view is localised and k is not among what it shows.
    """
    asked, shown = scratch.coverage.sets[ASKED], state.coverage.shown
    short, enough = state.coverage.counts.sets[SHORT], state.coverage.counts.sets[ENOUGH]
    first, last, tried = scratch.coverage.lists[FIRST], scratch.coverage.lists[LAST], scratch.sets[LOCALISED]
    for s in range(scratch.coverage.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            scratch.located[q], scratch.coverage.units[q] = state.located[q], state.coverage.units[q]
            for w in range(np.uint64(asked.shape[1])):
                mine, localised = shown[k, q, w], state.localised[q, w]
                asked[q, w] = (enough[q, w] & (mine | ~localised)) | (short[q, w] & ~mine)
                tried[q, w] = localised


@inner
def bound_localised_move(field, k, pose, surface, state, scratch):
    """See `trial.bound_move`."""
    cover, known, trial, k = field.coverage, state.coverage, scratch.coverage, np.uint64(k)
    begin_move(k, pose, surface, cover, known, trial)
    for q in range(len(scratch.units)):
        scratch.units[q] = state.units[q]
    _ask(k, state, scratch)
    ask_touched(k, cover.n, True, known, trial)
    positions = trial.lists[LISTED][: list_near(trial, False)]
    see(known, k, positions, cover, trial)
    _decide(k, positions, field, state, scratch)


@inner
def finish_localised_move(field, k, state, scratch):
    """See `trial.finish_move`."""
    cover, known, trial, k = field.coverage, state.coverage, scratch.coverage, np.uint64(k)
    find_pairs(known, k, COMES, cover, trial)
    ask_touched(k, cover.n, True, known, trial)
    positions = trial.lists[TOUCHED_LIST][: trial.numbers[TOUCHED_COUNT]]
    see(known, k, positions, cover, trial)
    _decide(k, positions, field, state, scratch)


@inner
def _change_sums(k, sign, field, state, scratch):
    """Change the sums by the move tried last, or with a `sign` of -1 back; landmark k is still where it was."""
    if not field.asks:
        return
    words, trial, slots = np.uint64(state.localised.shape[1]), scratch.coverage, scratch.slots
    positions = trial.lists[LISTED][: list_near(trial, True)]
    _find_turns(k, positions, state, scratch)
    for q in positions:
        for w in range(words):
            turns = scratch.sets[LOST, q, w] | scratch.sets[GAINED, q, w]
            if turns == ZERO:
                continue
            count, first = fill_slots(turns, field.precision, slots), (q * words + w) * VIEW
            ask_for(state.sums, first, slots, count)
            _add_all_changes(k, q, w, sign, field, state, scratch)
            give_sums(state.sums, first, field.precision, slots, count)


@inner
def carry_out_localised(field, k, state, scratch):
    """See `move.carry_out`."""
    see_whole(np.uint64(k), field.coverage, state.coverage, scratch.coverage)
    _change_sums(np.uint64(k), 1.0, field, state, scratch)
    take_back(field.coverage, k, state.coverage, scratch.coverage)
    exchange(state, scratch)


@inner
def take_back_localised(field, k, state, scratch):
    """See `move.take_back`."""
    take_back(field.coverage, k, state.coverage, scratch.coverage)
    _change_sums(np.uint64(k), -1.0, field, state, scratch)
    exchange(state, scratch)


@inner
def _add_shown(mounts, q, w, field, state, scratch):
    """Add to the views taken what all landmarks tell the cameras of a part."""
    mine, place, precision, slots = (
        state.coverage.parts[mounts.number], _place(q, field), field.precision, scratch.slots
    )  # fmt: skip
    caps, veiled = mine[CAPS], mine[VEILED]
    for i in range(caps.shape[0]):
        for m in range(caps.shape[2]):
            seen = caps[i, q, m, w] & ~veiled[i, q, m, w]
            if seen:
                add_landmark(mounts, m, w, seen, place, _tag_of(i, precision, state), 1.0, precision, slots)


@inner
def _met_anew(q, w, field, state, scratch):
    """Sum up what all landmarks tell in word w, and find where it is enough."""
    seen, slots, first = ZERO, scratch.slots, (q * np.uint64(state.localised.shape[1]) + w) * VIEW
    for i in range(state.coverage.shown.shape[0]):
        seen |= state.coverage.shown[i, q, w]
    count = fill_slots(seen, field.precision, slots)
    for mounts in literal_unroll(field.mounts):
        _add_shown(mounts, q, w, field, state, scratch)
    add_up(field.precision, slots)
    give_sums(state.sums, first, field.precision, slots, count)
    return met_slots(field.precision, slots, count, several(ZERO, ZERO, state.coverage.counts.digits[q, w]))


@kernel
def sum_up_anew(field, state, scratch):
    """Sum up what all landmarks tell, and find the values."""
    known, weights = state.coverage, field.coverage.weights
    for q in range(np.uint64(len(state.units))):
        located = np.int64(0)
        for w in range(np.uint64(state.localised.shape[1])):
            good = known.counts.sets[ENOUGH, q, w]
            if field.asks:
                good &= _met_anew(q, w, field, state, scratch)
            state.localised[q, w] = good
            located += sum_weights(ZERO, good, weights, q, w)
        _sum_up(q, located, known.units[q], field.weight, state)
