"""What the moves of single landmarks work on: the views that one deployment localises, and working memory."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS
from lmd.core.memory import check_views
from lmd.incremental.field import placed
from lmd.incremental.state import Scratch, scratch_of
from lmd.objectives.localisation.information import WIDTH

# Rows of `LocalisationScratch.sets`; a rig's has the first, too.
LOCALISED = 0  # as in the state, after the move
COVERED = 1  # the axes that cover n landmarks or more after the move

# Rows of `LocalisationScratch.told`.
LEFT, TRIED = 0, 1  # by position: moments of the landmark at the place left, and at the place tried, where it is seen
CHANGES = 2  # moments of each landmark that comes or goes at a position; the last row is of the view that is decided
OFFSETS = 3  # from the camera to each of these, metres: the first three numbers of a row

# Rows of `LocalisationScratch.densities`: 1 / z^3 in each of the `views`, 0 where it is not covered.
LEAVING, COMING = 0, 1  # of the place left, and of the place tried


class LocalisationState(NamedTuple):
    """The views that one deployment localises; Q positions in the order of the field, axes in W words."""

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


@placed.register(LocalisationState)
def _placed(state):  # type: ignore[no-untyped-def]
    return state.coverage


class LocalisationScratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `units`, `located` and `LOCALISED` are those of before.
    """

    units: np.ndarray
    """`(Q,)` as in the state, after the move; so is `located`."""
    located: np.ndarray
    sets: np.ndarray
    """`(2, Q, W)`: `LOCALISED`, `COVERED`."""
    coverage: Scratch
    """Scratch of coverage: `FRESH` is whole at all positions that reach the new place, `units` are P_n."""
    told: np.ndarray
    """`(4, max(Q, K + 3), WIDTH)`: `LEFT`, `TRIED`, `CHANGES`, `OFFSETS`. This and what follows is working memory."""
    first: np.ndarray
    """`(Q + 1,)` the first of the `views` of each position."""
    views: np.ndarray
    """`(64 Q W + 1,)` views to be decided."""
    densities: np.ndarray
    """`(2, 64 Q W + 1)`: `LEAVING`, `COMING`."""
    caps: np.ndarray
    """`(K + 2, W + 1)` for landmarks that come or go at a position: the axes that cover each of them, and all bits of a
    word if it goes, none if it comes."""


def blank_state(known: Any, width: int, each: float) -> LocalisationState:
    """A state with the coverage `known`, nothing summed up yet.

    Args:
        known: the coverage of the deployment, which becomes part of the state.
        width: of the sums.
        each: bytes that a view takes, sums and lists; 0 where nothing is asked of it, and no sums are kept.
    """
    size, words = known.counts.sets.shape[1:]
    check_views(each, size, BITS * words)
    return LocalisationState(
        units=np.zeros(size, dtype=np.int64),
        located=np.zeros(size, dtype=np.int64),
        localised=np.zeros((size, words), dtype=np.uint64),
        sums=np.zeros((BITS * size * words if each else 1, width)),
        coverage=known,
    )


def localisation_scratch(state: LocalisationState) -> LocalisationScratch:
    """Working memory for moves of `state`."""
    count, (size, words) = len(state.coverage.surfaces), state.localised.shape
    return LocalisationScratch(
        units=state.units.copy(),
        located=state.located.copy(),
        sets=np.stack([state.localised, np.zeros_like(state.localised)]),
        coverage=scratch_of(state.coverage),
        told=np.zeros((4, max(size, count + 3), WIDTH)),
        first=np.zeros(size + 1, dtype=np.uint64),
        views=np.zeros(BITS * words * size + 1, dtype=np.uint64),
        densities=np.zeros((2, BITS * words * size + 1)),
        caps=np.zeros((count + 2, words + 1), dtype=np.uint64),
    )
