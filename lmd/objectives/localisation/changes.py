"""Landmarks that appear in views or disappear as one moves: the functions of `trial` that differ for camera and rig.

For a single camera (`camera_changes`) a landmark is hidden from a position with all orientations or with none, and its
moments are found once for a position. For a rig (`rig_changes`) both are found for each camera and orientation.
"""

from typing import Any

import numpy as np

from lmd.core.bits import Integer, WordArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, dispatched_call
from lmd.objectives.localisation.views import VIEW


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


@dispatched
def forget_moments(views: Any, p: Integer) -> None:
    """Forget the moments that the last move found at position p."""


@dispatched
def sum_views(
    known: Any, k: Integer, p: Integer, w: Integer, left: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    """Find the sums of the views `left` of word w after the move.

    Returns:
        number of the views.
    """


@dispatched
def change_sums(
    known: Any,
    k: Integer,
    p: Integer,
    w: Integer,
    changed: np.uint64,
    sign: float,
    field: Any,
    state: Any,
    scratch: Any,
) -> None:
    """Add the changes of a move to the sums of the views `changed` of word w, times `sign`."""


@dispatched
def sum_anew(known: Any, p: Integer, w: Integer, seen: np.uint64, field: Any, state: Any, scratch: Any) -> Any:
    """Add all landmarks to the sums of the views of word w in which some are `seen`, and take these views.

    Returns:
        number of the views.
    """


@inlined
def first_row(p: Integer, w: Integer, state: Any) -> Any:
    """Row of the sums of the first orientation of word w at position p."""
    return (p * np.uint64(state.localised.shape[1]) + w) * VIEW
