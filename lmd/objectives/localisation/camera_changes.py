"""Functions for landmarks that appear in the views of a single camera or disappear from these views.

The functions are declared in `lmd.objectives.localisation.views`; `rig_changes` has the versions for a rig.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, Integer, WordArray
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.vectors import Vector, column3, minus3
from lmd.incremental.occlusion import pose_of, target_of
from lmd.incremental.state import ASKED, LANDMARK, PAIR_COUNT, POSITION, REACHED, TOUCHED, Scratch, State
from lmd.incremental.trial import ask_touched, fresh_of, list_changing, see, see_whole, shown_of, turned
from lmd.objectives.localisation.views import (
    APPEARS,
    DISAPPEARS,
    LEFT,
    TRIED,
    CameraViews,
    add_moments,
    add_to_sums,
    change_sums,
    clear_moments,
    find_turns,
    first_row,
    landmark_moments,
    load_rows,
    read_rows,
    replace_moments,
    see_place,
    see_rest,
    see_touched,
    sum_anew,
    sum_views,
    weigh,
)


@see_place.register(State)
def _see_place(known: State, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: Scratch) -> Integer:
    see_whole(k, cover, known, trial)  # all orientations: the tables decide most of them quickly
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
    """Do nothing: `see_place` has found all orientations already."""


@find_turns.register(State)
def _find_turns(known: State, trial: Scratch, lost: WordArray, gained: WordArray) -> None:
    landmark, position = trial.pairs[LANDMARK], trial.pairs[POSITION]
    for e in range(trial.numbers[PAIR_COUNT]):
        i, p = np.uint64(landmark[e]), np.uint64(position[e])
        for w in range(np.uint64(lost.shape[1])):
            was, now = turned(known, i, p, w, trial)
            lost[p, w] |= was & ~now
            gained[p, w] |= now & ~was


@inlined
def _offset(pose: Any, p: Integer, field: Any) -> Vector:
    """Offset of a landmark at `pose` from position p, metres."""
    return minus3(pose[0], column3(field.coverage.positions, p))


@inner
def _find_moments(pose: Any, k: Integer, p: Integer, field: Any, row: FloatArray) -> None:
    landmark_moments(_offset(pose, p, field), pose[1], field.precision, k, row)


@clear_moments.register(CameraViews)
def _clear_moments(views: CameraViews, p: Integer) -> None:
    views.found[p] = 0


@inner
def _update_moments(known: State, k: Integer, p: Integer, field: Any, scratch: Any) -> None:
    """Compute the `information.moments` of landmark k as seen from position p, at its old place and at its new place.

    Nothing is computed if the scratch has these moments already.
    """
    views = scratch.views
    if views.found[p] == 0:
        views.found[p] = 1
        if known.reachable[k, p]:
            _find_moments(pose_of(k, known), k, p, field, views.moments[LEFT, p])
        if scratch.coverage.flags[REACHED, p]:
            _find_moments(target_of(scratch.coverage), k, p, field, views.moments[TRIED, p])


@inner
def _sum_turning(p: Integer, w: Integer, count: Integer, field: Any, known: State, scratch: Any) -> None:
    """Update the information of views for the landmarks, other than the moving one, that appear or disappear.

    The views are those set up in the scratch: at position p, with orientations of word w (64 orientations).
    """
    trial, views, camera = scratch.coverage, scratch.views, field.coverage.cameras
    for i in range(np.uint64(known.poses.shape[1])):
        if not trial.known[p, i]:
            continue
        was, now = turned(known, i, p, w, trial)
        if was != now:
            pose = pose_of(i, known)
            _find_moments(pose, i, p, field, views.other)
            weigh(DISAPPEARS, was ^ now, _offset(pose, p, field), camera, w, views, count)
            add_moments(views.rows, views.other, views.weights[DISAPPEARS], 1.0 if now else -1.0, count)


@sum_views.register(State)
def _sum_views(
    known: State, k: Integer, p: Integer, w: Integer, left: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    trial, views, camera, first = scratch.coverage, scratch.views, field.coverage.cameras, first_row(p, w, state)
    count = load_rows(left, first, state.sums, views)
    _update_moments(known, k, p, field, scratch)
    weigh(DISAPPEARS, shown_of(known, k, p, w), _offset(pose_of(k, known), p, field), camera, w, views, count)
    weigh(APPEARS, fresh_of(trial, p, w), _offset(target_of(trial), p, field), camera, w, views, count)
    read_rows(first, state.sums, views, count)
    replace_moments(views.rows, views.moments[LEFT, p], views.moments[TRIED, p], views.weights, count)
    if trial.flags[TOUCHED, p]:
        _sum_turning(p, w, count, field, known, scratch)
    return count


@inlined
def _add(
    moments: FloatArray, pose: Any, seen: np.uint64, p: Integer, w: Integer, sign: float, field: Any, state: Any
) -> None:
    """Add the information of a landmark, times `sign`, to the state's information of several views from position p.

    The bit set `seen` has the orientations of these views, among the 64 orientations of word w. `moments` are the
    landmark's `information.moments` for position p; `pose` is the landmark's position and normal.
    """
    look = field.coverage.cameras.sight, field.coverage.cameras.axes
    add_to_sums(moments, seen, _offset(pose, p, field), look, w, sign, first_row(p, w, state), state.sums)


@change_sums.register(State)
def _change_sums(
    known: State, k: Integer, p: Integer, w: Integer, changed: np.uint64, sign: float, field: Any, state: Any,
    scratch: Any,
) -> None:  # fmt: skip
    _update_moments(known, k, p, field, scratch)
    trial, moments, other = scratch.coverage, scratch.views.moments, scratch.views.other
    _add(moments[LEFT, p], pose_of(k, known), shown_of(known, k, p, w), p, w, -sign, field, state)
    _add(moments[TRIED, p], target_of(trial), fresh_of(trial, p, w), p, w, sign, field, state)
    for i in range(np.uint64(known.poses.shape[1] if trial.flags[TOUCHED, p] else 0)):
        if trial.known[p, i]:
            was, now = turned(known, i, p, w, trial)
            if was != now:
                _find_moments(pose_of(i, known), i, p, field, other)
                _add(other, pose_of(i, known), was ^ now, p, w, sign if now else -sign, field, state)


@sum_anew.register(State)
def _sum_anew(known: State, p: Integer, w: Integer, seen: np.uint64, field: Any, state: Any, scratch: Any) -> Any:
    for i in range(np.uint64(known.poses.shape[1])):
        shown = shown_of(known, i, p, w)
        if shown:
            _find_moments(pose_of(i, known), i, p, field, scratch.views.other)
            _add(scratch.views.other, pose_of(i, known), shown, p, w, 1.0, field, state)
    first = first_row(p, w, state)
    count = load_rows(seen, first, state.sums, scratch.views)
    read_rows(first, state.sums, scratch.views, count)
    return count
