"""Functions for landmarks that appear in the views of a rig or disappear from these views.

The functions are declared in `lmd.objectives.localisation.views`; `camera_changes` has the versions for a camera.
"""

from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import Integer, WordArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import upright_sides
from lmd.geometry.vectors import column3
from lmd.incremental.occlusion import pose_of, target_of
from lmd.incremental.rig import list_near
from lmd.incremental.state import (
    ASKED,
    COVERED,
    ENOUGH,
    FIRST,
    LANDMARK,
    LAST,
    LISTED,
    OCCLUDED,
    PAIR_COUNT,
    POSITION,
    SHORT,
    SPAN_COUNT,
    TOUCHED,
    RigScratch,
    RigState,
)
from lmd.incremental.trial import ask_touched, see, see_whole
from lmd.objectives.localisation.information import Precision, Square, half_of
from lmd.objectives.localisation.pairs import (
    Mounts,
    add_to_body,
    add_up,
    fill_views,
    load_sums,
    prefetch_sums,
    store_sums,
)
from lmd.objectives.localisation.views import (
    change_sums,
    find_turns,
    first_row,
    see_place,
    see_rest,
    see_touched,
    sum_anew,
    sum_views,
)


@see_place.register(RigState)
def _see_place_by_rig(
    known: RigState, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: RigScratch
) -> Integer:
    # Landmark k matters if at least n - 1 others are in view, unless the view is localised without showing k.
    asked, short, enough = trial.sets[ASKED], known.counts.sets[SHORT], known.counts.sets[ENOUGH]
    first, last = trial.lists[FIRST], trial.lists[LAST]
    for s in range(trial.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            for w in range(np.uint64(asked.shape[1])):
                mine = known.shown[k, q, w]
                asked[q, w] = (enough[q, w] & (mine | ~localised[q, w])) | (short[q, w] & ~mine)
    ask_touched(k, n, True, known, trial)
    count: Integer = list_near(trial, False)
    see(known, k, trial.lists[LISTED][:count], cover, trial)
    return count


@see_touched.register(RigState)
def _see_touched_by_rig(
    known: RigState, k: Integer, n: Integer, positions: WordArray, cover: Any, trial: RigScratch
) -> None:
    ask_touched(k, n, True, known, trial)
    see(known, k, positions, cover, trial)


@see_rest.register(RigState)
def _see_rest_by_rig(known: RigState, k: Integer, cover: Any, trial: RigScratch) -> None:
    see_whole(k, cover, known, trial)


@inner
def _find_turns_of_group(
    mine: WordArray, flipped: WordArray, trial: RigScratch, lost: WordArray, gained: WordArray
) -> None:
    covered, occluded, landmark, position = mine[COVERED], mine[OCCLUDED], trial.pairs[LANDMARK], trial.pairs[POSITION]
    mounts, words = covered.shape[2], np.uint64(covered.shape[3])
    for e in range(trial.numbers[PAIR_COUNT]):
        i, q = np.uint64(landmark[e]), np.uint64(position[e])
        for m in range(mounts):
            for w in range(words):
                turns = covered[i, q, m, w] & flipped[i, q, m, w]
                lost[q, w] |= turns & ~occluded[i, q, m, w]
                gained[q, w] |= turns & occluded[i, q, m, w]


@find_turns.register(RigState)
def _find_turns_of_rig(known: RigState, trial: RigScratch, lost: WordArray, gained: WordArray) -> None:
    for j in range(len(known.groups)):
        _find_turns_of_group(known.groups[j], trial.groups[j].flipped, trial, lost, gained)


@inlined
def _tag(k: Integer, pose: Any, precision: Precision) -> Square:
    """Centre of landmark k at `pose`, and vectors from it to the midpoints of the right and upper edges, metres."""
    right, up = upright_sides(half_of(precision, k), pose[1])
    return pose[0], right, up


@inner
def _add_changes_of_group(
    mounts: Mounts, known: RigState, k: Integer, q: Integer, w: Integer, sign: float, field: Any, scratch: Any
) -> None:
    trial, views, count = scratch.coverage, scratch.views, len(mounts.axes)
    mine, other = known.groups[mounts.number], trial.groups[mounts.number]
    covered, occluded = mine[COVERED], mine[OCCLUDED]
    tried_covered, tried_occluded = other.sets[COVERED], other.sets[OCCLUDED]
    place, precision = column3(field.coverage.positions, q), field.precision
    old, new = _tag(k, pose_of(k, known), precision), _tag(k, target_of(trial), precision)
    for m in range(count):
        was, now = covered[k, q, m, w] & ~occluded[k, q, m, w], tried_covered[q, m, w] & ~tried_occluded[q, m, w]
        add_to_body(mounts, m, w, was, place, old, -sign, precision, views)
        add_to_body(mounts, m, w, now, place, new, sign, precision, views)
    for i in range(covered.shape[0] if trial.flags[TOUCHED, q] else 0):
        for m in range(count if trial.known[q, i] else 0):
            hidden, turns = occluded[i, q, m, w], covered[i, q, m, w] & other.flipped[i, q, m, w]
            if turns:
                tag = _tag(i, pose_of(i, known), precision)
                add_to_body(mounts, m, w, turns & ~hidden, place, tag, -sign, precision, views)
                add_to_body(mounts, m, w, turns & hidden, place, tag, sign, precision, views)


@inner
def _add_changes(known: RigState, k: Integer, p: Integer, w: Integer, sign: float, field: Any, scratch: Any) -> None:
    for mounts in literal_unroll(field.mounts):
        _add_changes_of_group(mounts, known, k, p, w, sign, field, scratch)
    add_up(field.precision, scratch.views)


@sum_views.register(RigState)
def _sum_views_of_rig(
    known: RigState, k: Integer, p: Integer, w: Integer, left: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    views, first = scratch.views, first_row(p, w, state)
    count = fill_views(left, field.precision, views)
    prefetch_sums(state.sums, first, views, count)
    _add_changes(known, k, p, w, 1.0, field, scratch)
    load_sums(state.sums, first, field.precision, views, count)
    return count


@change_sums.register(RigState)
def _change_sums_of_rig(
    known: RigState, k: Integer, p: Integer, w: Integer, changed: np.uint64, sign: float, field: Any, state: Any,
    scratch: Any,
) -> None:  # fmt: skip
    views, first = scratch.views, first_row(p, w, state)
    count = fill_views(changed, field.precision, views)
    prefetch_sums(state.sums, first, views, count)
    _add_changes(known, k, p, w, sign, field, scratch)
    store_sums(state.sums, first, field.precision, views, count)


@inner
def _add_shown_of_group(mounts: Mounts, known: RigState, q: Integer, w: Integer, field: Any, scratch: Any) -> None:
    mine, precision, views = known.groups[mounts.number], field.precision, scratch.views
    place = column3(field.coverage.positions, q)
    covered, occluded = mine[COVERED], mine[OCCLUDED]
    for i in range(covered.shape[0]):
        for m in range(covered.shape[2]):
            seen = covered[i, q, m, w] & ~occluded[i, q, m, w]
            if seen:
                tag = _tag(i, pose_of(i, known), precision)
                add_to_body(mounts, m, w, seen, place, tag, 1.0, precision, views)


@inner
def _add_shown(known: RigState, p: Integer, w: Integer, field: Any, scratch: Any) -> None:
    for mounts in literal_unroll(field.mounts):
        _add_shown_of_group(mounts, known, p, w, field, scratch)
    add_up(field.precision, scratch.views)


@sum_anew.register(RigState)
def _sum_anew_of_rig(
    known: RigState, p: Integer, w: Integer, seen: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    count = fill_views(seen, field.precision, scratch.views)
    _add_shown(known, p, w, field, scratch)
    store_sums(state.sums, first_row(p, w, state), field.precision, scratch.views, count)
    return count
