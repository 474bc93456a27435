"""Functions of `trial` that differ for camera and rig: landmarks that appear in views or disappear.

For a single camera (`camera_changes`), a landmark is hidden at a position for all orientations or for none, and has one
set of moments per position. For a rig (`rig_changes`), occlusion and moments depend on mount and orientation.
"""

from typing import Any

import numpy as np

from lmd.core.bits import Integer, WordArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, dispatched_call
from lmd.objectives.localisation.views import VIEW


@dispatched_call
def see_place(known: Any, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: Any) -> Any:
    """Write the relevant orientations with which landmark k is seen at the place tried into `FRESH`.

    Args:
        known, trial: state and scratch of coverage.
        k: the landmark.
        n: landmarks that must be covered.
        localised: sets of localised views, `(Q, W)`.
        cover: field of coverage.

    Returns:
        number of positions in `LISTED` at which values may change.
    """


@dispatched_call
def see_touched(known: Any, k: Integer, n: Integer, positions: WordArray, cover: Any, trial: Any) -> None:
    """Repeat `see_place` at the touched `positions`."""


@dispatched_call
def see_rest(known: Any, k: Integer, cover: Any, trial: Any) -> None:
    """Add all other orientations to `FRESH`, for a move that is carried out."""


@dispatched_call
def find_turns(known: Any, trial: Any, lost: WordArray, gained: WordArray) -> None:
    """Add to `lost` and `gained` `(Q, W)` the orientations with which landmarks disappear and appear for a camera."""


@dispatched
def clear_moments(views: Any, p: Integer) -> None:
    """Discard the moments that the last move stored for position p."""


@dispatched
def sum_views(
    known: Any, k: Integer, p: Integer, w: Integer, left: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    """Compute the sums of the views `left` of word w after the move.

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
    """Add all landmarks to the sums of the views `seen` of word w, and begin these views.

    Returns:
        number of the views.
    """


@inlined
def first_row(p: Integer, w: Integer, state: Any) -> Any:
    """Index of the row of `sums` for the first orientation of word w at position p."""
    return (p * np.uint64(state.localised.shape[1]) + w) * VIEW
