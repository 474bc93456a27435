"""What the moves of single landmarks work on where a rig looks for them: see `lmd.sight.stations` and `state`."""

from typing import Any, NamedTuple

import numpy as np

from lmd.incremental.counts import Counts
from lmd.incremental.state import NEAR_LISTS, lists_of, ways_of
from lmd.sight.stations import Part

# Rows of the parts of `RigState`, and of `StationScratch.sets`.
CAPS = 0  # the orientations with which a camera covers a landmark nobody hides
VEILED = 1  # those of them with which another landmark hides it

# Rows of `StationScratch.seen`: the place tried as it is seen from the centre looked at last. `X`, `Y`, `Z` and `SURE`
# are as in `Scratch.seen`; see `stations.bounds_from`.
MOST, START = 3, 4

# Rows of `StationScratch.lists`.
ROW = 0  # what `stations.row_from` says of each of the positions looked at
LEFT_OVER = 1  # which of these are not settled yet

# Rows of `StationScratch.pairs` and `RigScratch.pairs`.
WHO = 0  # landmarks
WHERE = 1  # their positions; of a part their centres around positions, c Q + q

# Rows of `RigScratch.sets`.
FRESH = 0  # the orientations with which some camera would see the landmark, as far as they are `ASKED`
ASKED = 1  # the orientations that were asked for

# Beyond those of `Scratch`: rows of `RigScratch.numbers`, `flags` and `lists`.
PAIR_COUNT = 3  # how many pairs of another landmark and a position there are where it appears or disappears
TOUCHED_COUNT = 4  # how many positions are `TOUCHED`
TOUCHED = 2  # by position: another landmark appears or disappears, or hides the place tried
TOUCHED_LIST = NEAR_LISTS  # these positions


class Stations(NamedTuple):
    """The cameras of a rig that are alike, around Q positions of its body."""

    number: int
    """Which part of the rig they are."""
    part: Part
    """The part."""
    obstacles: Any
    """What of the room stands in the way of their places, place g of position q at q G + g; see `obstacles`."""


class RigState(NamedTuple):
    """Coverage of one deployment by a rig: K landmarks, Q positions and orientations of its body."""

    poses: np.ndarray
    """`(6, K)` as in `State`, as are `surfaces`."""
    surfaces: np.ndarray
    parts: tuple[np.ndarray, ...]
    """`(2, K, Q, M, W)` of each part with M cameras: `CAPS`, `VEILED`."""
    shown: np.ndarray
    """`(K, Q, W)` the orientations with which some camera sees a landmark."""
    counts: Counts
    """As in `State`, as are the `units`."""
    units: np.ndarray


class StationScratch(NamedTuple):
    """The move tried last as one part sees it, and working memory for Q positions."""

    sets: np.ndarray
    """`(2, Q, M, W)`: `CAPS`, `VEILED` of the place tried, for the orientations that were asked for, where any were."""
    flipped: np.ndarray
    """`(K, Q, M, W)` what changes in `VEILED` of the others, for the pairs listed in `RigScratch`."""
    rivals: np.ndarray
    """`(1,)` how many pairs there are of another landmark and a centre around which it may hide the place tried."""
    pairs: np.ndarray
    """`(2, K C Q)` uint32, these pairs: `WHO`, `WHERE`."""
    seen: np.ndarray
    """`(6, Q)`: `X`, `Y`, `Z`, `MOST`, `START`, `SURE`."""
    lists: np.ndarray
    """`(2, Q + 1)` uint64: `ROW`, `LEFT_OVER`."""
    reached: np.ndarray
    """`(Q,)` whether any orientation may cover it."""


class RigScratch(NamedTuple):
    """The move tried last by all parts, and working memory.

    Once the move is carried out, `target`, `SURFACE`, `units`, `FRESH`, and `sets` of the parts are those of the place
    left.
    """

    target: np.ndarray
    """`(6,)` position and normal tried."""
    numbers: np.ndarray
    """`(5,)` int64: `BLOCK_COUNT`, `SPAN_COUNT`, `SURFACE`, `PAIR_COUNT`, `TOUCHED_COUNT`."""
    units: np.ndarray
    """`(Q,)` P_n with the landmark there."""
    parts: tuple[StationScratch, ...]
    """The move as each part sees it."""
    sets: np.ndarray
    """`(2, Q, W)`: `FRESH`, `ASKED`."""
    pairs: np.ndarray
    """`(2, K Q)` uint32, pairs of another landmark and a position where it appears or disappears: `WHO`, `WHERE`."""
    known: np.ndarray
    """`(Q, K)` whether a pair is among them."""
    flags: np.ndarray
    """`(3, Q)` bool: `AIMED`, `WANTED`, `TOUCHED`."""
    digits: np.ndarray
    """`(Q, W, J)` the counts where positions are `TOUCHED`."""
    ways: np.ndarray
    """As in `Scratch`."""
    lists: np.ndarray
    """`(6, max(Q, K) + 1)` uint64: `LISTED` to `OTHERS`, `TOUCHED_LIST`."""


def rig_scratch_of(state: RigState, centres: tuple[int, ...]) -> RigScratch:
    """Working memory for moves of `state`, of parts with so many centres."""
    count, size = state.shown.shape[:2]
    parts = tuple(
        StationScratch(
            sets=np.zeros((2, *part.shape[2:]), dtype=np.uint64),
            flipped=np.zeros(part.shape[1:], dtype=np.uint64),
            rivals=np.zeros(1, dtype=np.int64),
            pairs=np.empty((2, count * around * size), dtype=np.uint32),
            seen=np.empty((6, size)),
            lists=np.empty((2, size + 1), dtype=np.uint64),
            reached=np.empty(size, dtype=np.bool_),
        )
        for part, around in zip(state.parts, centres, strict=True)
    )
    return RigScratch(
        target=np.empty(6),
        numbers=np.zeros(5, dtype=np.int64),
        units=state.units.copy(),
        parts=parts,
        sets=np.zeros((2, *state.shown.shape[1:]), dtype=np.uint64),
        pairs=np.empty((2, count * size), dtype=np.uint32),
        known=np.zeros((size, count), dtype=np.bool_),
        flags=np.zeros((3, size), dtype=np.bool_),
        digits=np.empty_like(state.counts.digits),
        ways=ways_of(count),
        lists=lists_of(NEAR_LISTS + 1, count, size),
    )
