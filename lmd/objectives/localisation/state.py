"""What the moves of single landmarks work on: the views that one deployment localises, and working memory."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS
from lmd.core.memory import check_views
from lmd.incremental.state import Scratch, scratch_of
from lmd.objectives.localisation.information import WIDTH


class LocalisationState(NamedTuple):
    """Views localised by one deployment, positions in the order of the field.

    landmarks, normals `(3, K)` and surfaces `(K,)` are those of `coverage`, the state of coverage, a `State` or of a
    rig a `RigState`; units `(Q,)` the values; located `(Q,)` L in units; enough, localised `(Q, W)` sets of axes from
    which at least n landmarks are covered, and which are localised; sums `(64 Q W, WIDTH)`, or of a rig `(64 Q W,
    BODY_WIDTH)`, of all landmarks that cover a view, the views of a position in the order of the axes.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray
    units: np.ndarray
    located: np.ndarray
    enough: np.ndarray
    localised: np.ndarray
    sums: np.ndarray
    coverage: Any


class LocalisationScratch(NamedTuple):
    """The move tried last, and working memory.

    units, located, enough, localised: as in the state, after the move; coverage: the scratch of coverage, whose `cap`
    is filled for all positions that reach the new place, and whose `units` are P_n; old, new `(Q, WIDTH)` moments of
    the landmark moved, where it is seen. Once the move is carried out, the first four are those of before.

    Working memory: views, leaving, coming `(64 Q W + 1,)` views to be decided, and 1 / z^3 of the old and the new place
    in them, 0 where it does not cover them; first `(Q + 1,)` of each position among them; the landmarks that come or
    go at a position, `(K + 2, ...)`: goes which of the two, as a set of all or of none, caps sets of axes, offsets from
    the camera, moments; row `(1, WIDTH)`.
    """

    units: np.ndarray
    located: np.ndarray
    enough: np.ndarray
    localised: np.ndarray
    coverage: Scratch
    old: np.ndarray
    new: np.ndarray
    first: np.ndarray
    views: np.ndarray
    leaving: np.ndarray
    coming: np.ndarray
    goes: np.ndarray
    caps: np.ndarray
    offsets: np.ndarray
    moments: np.ndarray
    row: np.ndarray


def blank_state(known: Any, width: int, each: float) -> LocalisationState:
    """A state with the coverage `known`, nothing summed up yet.

    Args:
        known: the coverage of the deployment, which becomes part of the state.
        width: of the sums.
        each: bytes that a view takes, sums and lists; 0 where nothing is asked of it, and no sums are kept.
    """
    size, words = known.short.shape
    check_views(each, size, BITS * words)
    return LocalisationState(
        landmarks=known.landmarks,
        normals=known.normals,
        surfaces=known.surfaces,
        units=np.zeros(size, dtype=np.int64),
        located=np.zeros(size, dtype=np.int64),
        enough=np.zeros((size, words), dtype=np.uint64),
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
        enough=state.enough.copy(),
        localised=state.localised.copy(),
        coverage=scratch_of(state.coverage),
        old=np.zeros((size, WIDTH)),
        new=np.zeros((size, WIDTH)),
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
