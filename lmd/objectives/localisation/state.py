"""What the moves of single landmarks work on: the views that one deployment localises, and working memory."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS
from lmd.core.memory import check_views
from lmd.incremental.state import Scratch, scratch_of
from lmd.objectives.localisation.information import WIDTH


class LocalisationState(NamedTuple):
    """The views that one deployment localises; Q positions in the order of the field, axes in W words."""

    landmarks: np.ndarray
    """`(3, K)`, those of `coverage`; so are `normals` and `surfaces`."""
    normals: np.ndarray
    surfaces: np.ndarray
    units: np.ndarray
    """`(Q,)` the values, as whole numbers."""
    located: np.ndarray
    """`(Q,)` L, as whole numbers."""
    localised: np.ndarray
    """`(Q, W)` the axes from which the camera is localised."""
    sums: np.ndarray
    """`(64 Q W, WIDTH)`, of a rig as wide as `rig_ambiguity.width_of` says: sums over the landmarks that cover a view;
    the views of a position are in the order of the axes."""
    coverage: Any
    """The state of coverage: a `State`, or of a rig a `RigState`."""


class LocalisationScratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `units`, `located` and `localised` are those of before.
    """

    units: np.ndarray
    """`(Q,)` as in the state, after the move; so are `located` and `localised`."""
    located: np.ndarray
    localised: np.ndarray
    coverage: Scratch
    """The scratch of coverage. Its `cap` is filled for all positions that reach the new place; its `units` are P_n."""
    old: np.ndarray
    """`(Q, WIDTH)` moments of the landmark at its old place, where it is seen."""
    new: np.ndarray
    """`(Q, WIDTH)` the same at the new place."""
    enough: np.ndarray
    """`(Q, W)` the axes that cover n landmarks or more after the move. This and what follows is working memory."""
    first: np.ndarray
    """`(Q + 1,)` the first of the `views` of each position."""
    views: np.ndarray
    """`(64 Q W + 1,)` views to be decided."""
    leaving: np.ndarray
    """`(64 Q W + 1,)` 1 / z^3 of the old place in each; 0 where it does not cover it."""
    coming: np.ndarray
    """`(64 Q W + 1,)` 1 / z^3 of the new place in each; 0 where it does not cover it."""
    goes: np.ndarray
    """`(K + 2,)` for landmarks that come or go at a position: all bits of a word if one goes, none if it comes."""
    caps: np.ndarray
    """`(K + 2, W)` the axes that cover each of them."""
    offsets: np.ndarray
    """`(K + 2, 3)` from the camera to each, metres."""
    moments: np.ndarray
    """`(K + 2, WIDTH)` of each."""
    row: np.ndarray
    """`(1, WIDTH)` of the view that is being decided."""


def blank_state(known: Any, width: int, each: float) -> LocalisationState:
    """A state with the coverage `known`, nothing summed up yet.

    Args:
        known: the coverage of the deployment, which becomes part of the state.
        width: of the sums.
        each: bytes that a view takes, sums and lists; 0 where nothing is asked of it, and no sums are kept.
    """
    size, words = known.counts.enough.shape
    check_views(each, size, BITS * words)
    return LocalisationState(
        landmarks=known.landmarks,
        normals=known.normals,
        surfaces=known.surfaces,
        units=np.zeros(size, dtype=np.int64),
        located=np.zeros(size, dtype=np.int64),
        localised=np.zeros((size, words), dtype=np.uint64),
        sums=np.zeros((BITS * size * words if each else 1, width)),
        coverage=known,
    )


def localisation_scratch(state: LocalisationState) -> LocalisationScratch:
    """Working memory for moves of `state`."""
    count, (size, words) = state.landmarks.shape[1], state.localised.shape
    leaving, coming = np.zeros((2, BITS * words * size + 1))
    return LocalisationScratch(
        units=state.units.copy(),
        located=state.located.copy(),
        localised=state.localised.copy(),
        coverage=scratch_of(state.coverage),
        old=np.zeros((size, WIDTH)),
        new=np.zeros((size, WIDTH)),
        enough=np.zeros_like(state.localised),
        first=np.zeros(size + 1, dtype=np.uint64),
        views=np.zeros(BITS * words * size + 1, dtype=np.uint64),
        leaving=leaving,
        coming=coming,
        goes=np.zeros(count + 2, dtype=np.uint64),
        caps=np.zeros((count + 2, words), dtype=np.uint64),
        offsets=np.zeros((count + 2, 3)),
        moments=np.zeros((count + 2, WIDTH)),
        row=np.zeros((1, WIDTH)),
    )
