"""What the moves of single landmarks work on where a rig looks for them: see `lmd.sight.stations` and `state`."""

from typing import Any, NamedTuple

import numpy as np

from lmd.incremental.counts import Counts
from lmd.incremental.nearby import Nearby, nearby_of
from lmd.sight.stations import Part


class Stations(NamedTuple):
    """The cameras of a rig that are alike, around Q positions of its body."""

    number: int
    """Which part of the rig they are."""
    part: Part
    """The part."""
    obstacles: Any
    """What of the room stands in the way of their places, place g of position q at q G + g; see `obstacles`."""


class StationState(NamedTuple):
    """What the M cameras of a part have in view of K landmarks."""

    caps: np.ndarray
    """`(K, Q, M, W)` the orientations with which a camera covers a landmark nobody hides."""
    veiled: np.ndarray
    """`(K, Q, M, W)` those of them with which another landmark hides it."""


class RigState(NamedTuple):
    """Coverage of one deployment by a rig: K landmarks, Q positions and orientations of its body."""

    landmarks: np.ndarray
    """`(3, K)` metres."""
    normals: np.ndarray
    """`(3, K)` unit."""
    surfaces: np.ndarray
    """`(K,)` that they hang on."""
    parts: tuple[StationState, ...]
    """What the cameras of each part have in view."""
    shown: np.ndarray
    """`(K, Q, W)` the orientations with which some camera sees a landmark."""
    counts: Counts
    """As in `State`, as are the `units`."""
    units: np.ndarray


class StationScratch(NamedTuple):
    """The move tried last as one part sees it, and working memory for Q positions."""

    cap: np.ndarray
    """`(Q, M, W)` what `caps` would be of the landmark, for the orientations that were asked for, where any were."""
    veil: np.ndarray
    """`(Q, M, W)` what `veiled` would be of it."""
    flipped: np.ndarray
    """`(K, Q, M, W)` what changes in `veiled` of the others, for the pairs listed in `RigScratch`."""
    rivals: np.ndarray
    """`(1,)` how many pairs there are of another landmark and a centre around which it may hide the place tried."""
    who: np.ndarray
    """`(K C Q,)` the landmarks of these pairs."""
    where: np.ndarray
    """`(K C Q,)` their centres around positions, c Q + q."""
    x: np.ndarray
    """`(Q,)` offset of the place from the centre looked at last, metres; so are y and z."""
    y: np.ndarray
    z: np.ndarray
    most: np.ndarray
    """`(Q,)` what `stations.bounds_from` says of it, as are `start` and `sure`."""
    start: np.ndarray
    sure: np.ndarray
    row: np.ndarray
    """`(Q,)` what `stations.row_from` says of it."""
    reached: np.ndarray
    """`(Q,)` whether any orientation may cover it."""
    left_over: np.ndarray
    """`(Q + 1,)` from which of the positions looked at that is not settled yet."""


class RigScratch(NamedTuple):
    """The move tried last by all parts, and working memory.

    Once the move is carried out, `target`, `surface`, `units`, `fresh`, and `cap` and `veil` of the parts are those of
    the place left.
    """

    target: np.ndarray
    """`(6,)` position and normal tried."""
    surface: np.ndarray
    """`(1,)` that they lie on."""
    units: np.ndarray
    """`(Q,)` P_n with the landmark there."""
    parts: tuple[StationScratch, ...]
    """The move as each part sees it."""
    fresh: np.ndarray
    """`(Q, W)` the orientations with which some camera would see the landmark, as far as they are `asked`."""
    asked: np.ndarray
    """`(Q, W)` the orientations that were asked for."""
    found: np.ndarray
    """`(2,)` how many pairs of another landmark and a position there are where it appears or disappears, and how many
    positions where one does, or hides the place tried."""
    who: np.ndarray
    """`(K Q,)` the landmarks of these pairs."""
    where: np.ndarray
    """`(K Q,)` their positions."""
    known: np.ndarray
    """`(Q, K)` whether a pair is among them."""
    places: np.ndarray
    """`(Q,)` these positions."""
    touched: np.ndarray
    """`(Q,)` whether a position is among them."""
    digits: np.ndarray
    """`(Q, W, J)` the counts there."""
    near: Nearby
    """As in `Scratch`, as is `listed`."""
    listed: np.ndarray


def rig_scratch_of(state: RigState, centres: tuple[int, ...]) -> RigScratch:
    """Working memory for moves of `state`, of parts with so many centres."""
    count, size = state.shown.shape[:2]
    parts = []
    for part, around in zip(state.parts, centres, strict=True):
        cap, veil = np.zeros((2, *part.caps.shape[1:]), dtype=np.uint64)
        who, where = np.empty((2, count * around * size), dtype=np.uint32)
        rivals, reached = np.zeros(1, np.int64), np.empty(size, np.bool_)
        row, left_over = np.empty((2, size + 1), np.uint64)
        seen = (*np.empty((6, size)), row, reached, left_over)
        parts.append(StationScratch(cap, veil, np.zeros_like(part.caps), rivals, who, where, *seen))
    fresh, asked = np.zeros((2, *state.shown.shape[1:]), dtype=np.uint64)
    who, where = np.empty((2, count * size), dtype=np.uint32)
    return RigScratch(
        target=np.empty(6),
        surface=np.empty(1, dtype=np.int64),
        units=state.units.copy(),
        parts=tuple(parts),
        fresh=fresh,
        asked=asked,
        found=np.zeros(2, dtype=np.int64),
        who=who,
        where=where,
        known=np.zeros((size, count), dtype=np.bool_),
        places=np.empty(size, dtype=np.uint64),
        touched=np.zeros(size, dtype=np.bool_),
        digits=np.empty_like(state.counts.digits),
        near=nearby_of(count, size),
        listed=np.empty(size + 1, dtype=np.uint64),
    )
