"""Landmarks that appear in views or disappear as one moves: the functions of `trial` that differ for camera and rig.

For a single camera a landmark is hidden from a position with all orientations or with none, and its moments are found
once for a position. For a rig both are found for each camera and orientation.
"""

from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ALL, Integer, WordArray
from lmd.core.compiled import inlined, inner
from lmd.core.dispatch import dispatched_call
from lmd.geometry.squares import upright_sides
from lmd.incremental.counts import ENOUGH, SHORT
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.rig import list_near
from lmd.incremental.state import (
    ASKED,
    CAPS,
    FIRST,
    LAST,
    LISTED,
    PAIR_COUNT,
    REACHED,
    SPAN_COUNT,
    TOUCHED,
    VEILED,
    WHERE,
    WHO,
    RigScratch,
    RigState,
    Scratch,
    State,
)
from lmd.incremental.trial import ask_touched, fresh_of, list_changing, see, see_whole, shown_of, turned
from lmd.objectives.localisation.information import Precision, half_of
from lmd.objectives.localisation.pairs import Mounts, Place, Tag, add_to_body, add_up
from lmd.objectives.localisation.views import LEFT, OTHER, TRIED, add_to_camera, landmark_moments


@dispatched_call
def see_place(known: Any, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: Any) -> Any:
    """Find in `FRESH` all orientations that matter with which landmark k is seen at the place tried.

    Args:
        known, trial: state and scratch of coverage.
        k: the landmark.
        n: landmarks that must be covered.
        localised: `(Q, W)` views that are localised.
        cover: field of coverage.

    Returns:
        number of positions in `LISTED` at which values may change.
    """


@dispatched_call
def see_touched(known: Any, k: Integer, n: Integer, positions: WordArray, cover: Any, trial: Any) -> None:
    """`see_place` anew at `positions` that are touched."""


@dispatched_call
def see_rest(known: Any, k: Integer, cover: Any, trial: Any) -> None:
    """Find in `FRESH` all other orientations, for a move that is carried out."""


@dispatched_call
def find_turns(known: Any, trial: Any, lost: WordArray, gained: WordArray) -> None:
    """Add to `lost` and `gained` `(Q, W)` the orientations with which landmarks disappear and appear for a camera."""


@dispatched_call
def look_from(known: Any, k: Integer, p: Integer, field: Any, scratch: Any) -> None:
    """Find the moments of landmark k from position p, before `add_changes` there."""


@dispatched_call
def add_changes(
    known: Any, k: Integer, p: Integer, w: Integer, sign: float, field: Any, scratch: Any
) -> None:  # fmt: skip
    """Add the changes of a move to the views taken, of word w, times `sign`."""


@dispatched_call
def add_shown(known: Any, p: Integer, w: Integer, field: Any, scratch: Any) -> None:
    """Add all landmarks to the views taken, of word w."""


# A single camera.


@see_place.register(State)
def _see_place(known: State, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: Scratch) -> Integer:
    see_whole(k, cover, known, trial)  # to ask for some orientations only would take longer: the tables settle most
    ask_touched(k, n, True, known, trial)
    count: Integer = list_changing(known, k, trial)
    return count


@see_touched.register(State)
def _see_touched(known: State, k: Integer, n: Integer, positions: WordArray, cover: Any, trial: Scratch) -> None:
    asked = trial.sets[ASKED]
    for p in positions:
        for w in range(np.uint64(asked.shape[1])):
            asked[p, w] = ALL
    see(known, k, positions, cover, trial)
    ask_touched(k, n, True, known, trial)


@see_rest.register(State)
def _see_rest(known: State, k: Integer, cover: Any, trial: Scratch) -> None:
    """Nothing: the trial found all."""


@find_turns.register(State)
def _find_turns(known: State, trial: Scratch, lost: WordArray, gained: WordArray) -> None:
    who, where = trial.pairs[WHO], trial.pairs[WHERE]
    for e in range(trial.numbers[PAIR_COUNT]):
        i, p = np.uint64(who[e]), np.uint64(where[e])
        for w in range(np.uint64(lost.shape[1])):
            was, now = turned(known, i, p, w, trial)
            lost[p, w] |= was & ~now
            gained[p, w] |= now & ~was


@inlined
def _offset(pose: Any, p: Integer, field: Any) -> Place:
    """Offset of a landmark with a `pose` from position p, metres."""
    positions = field.coverage.positions
    return pose[0] - positions[0, p], pose[1] - positions[1, p], pose[2] - positions[2, p]


@inner
def _find_moments(which: int, pose: Any, k: Integer, p: Integer, field: Any, scratch: Any) -> None:
    x, y, z = _offset(pose, p, field)
    landmark_moments(x, y, z, pose[3], pose[4], pose[5], field.precision, k, scratch.views.moments[which])


@look_from.register(State)
def _look_from(known: State, k: Integer, p: Integer, field: Any, scratch: Any) -> None:
    if known.reachable[k, p]:
        _find_moments(LEFT, pose_of(k, known), k, p, field, scratch)
    if scratch.coverage.flags[REACHED, p]:
        _find_moments(TRIED, target_of(scratch.coverage), k, p, field, scratch)


@inner
def _add(
    which: int, pose: Any, seen: np.uint64, p: Integer, w: Integer, sign: float, field: Any,
    scratch: Any,
) -> None:  # fmt: skip
    """Add a landmark with these moments and a `pose` to the views in which it is `seen`, times `sign`."""
    camera, (x, y, z) = field.coverage.cameras, _offset(pose, p, field)
    add_to_camera(which, seen, x, y, z, camera.sight, camera.axes, w, sign, scratch.views)


@add_changes.register(State)
def _add_changes(
    known: State, k: Integer, p: Integer, w: Integer, sign: float, field: Any, scratch: Any
) -> None:  # fmt: skip
    trial = scratch.coverage
    _add(LEFT, pose_of(k, known), shown_of(known, k, p, w), p, w, -sign, field, scratch)
    _add(TRIED, target_of(trial), fresh_of(trial, p, w), p, w, sign, field, scratch)
    for i in range(np.uint64(known.poses.shape[1] if trial.flags[TOUCHED, p] else 0)):
        if not trial.known[p, i]:
            continue
        was, now = turned(known, i, p, w, trial)
        if was != now:
            _find_moments(OTHER, pose_of(i, known), i, p, field, scratch)
            _add(OTHER, pose_of(i, known), was & ~now, p, w, -sign, field, scratch)
            _add(OTHER, pose_of(i, known), now & ~was, p, w, sign, field, scratch)


@add_shown.register(State)
def _add_shown(known: State, p: Integer, w: Integer, field: Any, scratch: Any) -> None:
    for i in range(np.uint64(known.poses.shape[1])):
        seen = shown_of(known, i, p, w)
        if seen:
            _find_moments(OTHER, pose_of(i, known), i, p, field, scratch)
            _add(OTHER, pose_of(i, known), seen, p, w, 1.0, field, scratch)


# A rig.


@see_place.register(RigState)
def _see_place_by_rig(
    known: RigState, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: RigScratch
) -> Integer:
    # Landmark k matters with n - 1 others in view or more, unless the view is localised and does not show k.
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
def _find_turns_of_part(
    mine: WordArray, flipped: WordArray, trial: RigScratch, lost: WordArray, gained: WordArray
) -> None:
    caps, veiled, who, where = mine[CAPS], mine[VEILED], trial.pairs[WHO], trial.pairs[WHERE]
    mounts, words = caps.shape[2], np.uint64(caps.shape[3])
    for e in range(trial.numbers[PAIR_COUNT]):
        i, q = np.uint64(who[e]), np.uint64(where[e])
        for m in range(mounts):
            for w in range(words):
                turns = caps[i, q, m, w] & flipped[i, q, m, w]
                lost[q, w] |= turns & ~veiled[i, q, m, w]
                gained[q, w] |= turns & veiled[i, q, m, w]


@find_turns.register(RigState)
def _find_turns_of_rig(known: RigState, trial: RigScratch, lost: WordArray, gained: WordArray) -> None:
    for j in range(len(known.parts)):
        _find_turns_of_part(known.parts[j], trial.parts[j].flipped, trial, lost, gained)


@look_from.register(RigState)
def _look_from_rig(known: RigState, k: Integer, p: Integer, field: Any, scratch: Any) -> None:
    """Nothing: moments are those of each camera and orientation."""


@inlined
def _tag(k: Integer, pose: Any, precision: Precision) -> Tag:
    """Landmark k with a `pose`, see `pairs.tags_of`."""
    return pose[0], pose[1], pose[2], *upright_sides(half_of(precision, k), pose[3], pose[4], pose[5])


@inlined
def _place(q: Integer, field: Any) -> Place:
    """Position q of the body."""
    positions = field.coverage.positions
    return positions[0, q], positions[1, q], positions[2, q]


@inner
def _add_changes_of_part(
    mounts: Mounts, known: RigState, k: Integer, q: Integer, w: Integer, sign: float, field: Any, scratch: Any
) -> None:
    trial, views, count = scratch.coverage, scratch.views, len(mounts.axes)
    mine, other = known.parts[mounts.number], trial.parts[mounts.number]
    caps, veiled, cap, veil = mine[CAPS], mine[VEILED], other.sets[CAPS], other.sets[VEILED]
    place, precision = _place(q, field), field.precision
    old, new = _tag(k, pose_of(k, known), precision), _tag(k, target_of(trial), precision)
    for m in range(count):
        goes, comes = caps[k, q, m, w] & ~veiled[k, q, m, w], cap[q, m, w] & ~veil[q, m, w]
        add_to_body(mounts, m, w, goes, place, old, -sign, precision, views)
        add_to_body(mounts, m, w, comes, place, new, sign, precision, views)
    for i in range(caps.shape[0] if trial.flags[TOUCHED, q] else 0):
        for m in range(count if trial.known[q, i] else 0):
            was, turns = veiled[i, q, m, w], caps[i, q, m, w] & other.flipped[i, q, m, w]
            if turns:
                tag = _tag(i, pose_of(i, known), precision)
                add_to_body(mounts, m, w, turns & ~was, place, tag, -sign, precision, views)
                add_to_body(mounts, m, w, turns & was, place, tag, sign, precision, views)


@add_changes.register(RigState)
def _add_changes_of_rig(
    known: RigState, k: Integer, p: Integer, w: Integer, sign: float, field: Any, scratch: Any
) -> None:  # fmt: skip
    for mounts in literal_unroll(field.mounts):
        _add_changes_of_part(mounts, known, k, p, w, sign, field, scratch)
    add_up(field.precision, scratch.views)


@inner
def _add_shown_to_part(mounts: Mounts, known: RigState, q: Integer, w: Integer, field: Any, scratch: Any) -> None:
    mine, place, precision, views = (
        known.parts[mounts.number], _place(q, field), field.precision, scratch.views
    )  # fmt: skip
    caps, veiled = mine[CAPS], mine[VEILED]
    for i in range(caps.shape[0]):
        for m in range(caps.shape[2]):
            seen = caps[i, q, m, w] & ~veiled[i, q, m, w]
            if seen:
                tag = _tag(i, pose_of(i, known), precision)
                add_to_body(mounts, m, w, seen, place, tag, 1.0, precision, views)


@add_shown.register(RigState)
def _add_shown_to_rig(known: RigState, p: Integer, w: Integer, field: Any, scratch: Any) -> None:
    for mounts in literal_unroll(field.mounts):
        _add_shown_to_part(mounts, known, p, w, field, scratch)
    add_up(field.precision, scratch.views)
