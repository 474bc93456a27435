"""State and scratch of moves of single landmarks: the coverage of one deployment, and working memory.

A camera and a rig share the fields that have the same name. Arrays of one type and shape are rows of one array, with a
name for each row: numba hands each array over as 5 + 2n numbers, n its dimensions, to all that is not inlined.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import LANES
from lmd.incremental.counts import Counts

# Rows of `State.hides`, `Scratch.hides` and `Scratch.changes`.
HIDDEN = 0  # number of other landmarks that hide this one
HIDING = 1  # number of other landmarks that this one hides

# Rows of the groups of `RigState`, and of `GroupScratch.sets`.
CAPS = 0  # orientations with which a camera covers a landmark, occlusion ignored
OCCLUDED = 1  # those of them with which another landmark hides it

# Rows of `Scratch.numbers`.
BLOCK_COUNT = 0  # number of `BLOCKS`
SPAN_COUNT = 1  # number of spans in `FIRST` and `LAST`
SURFACE = 2  # surface of the place tried
PAIR_COUNT = 3  # number of `pairs`
TOUCHED_COUNT = 4  # number of positions in `TOUCHED_LIST`

# Rows of `Scratch.flags`.
AIMED = 0  # by block: within the horizon of the place tried
WANTED = 1  # by block: may be searched for neighbours of the place left
TOUCHED = 2  # by position: another landmark appears or disappears, or hides the place tried
REACHED = 3  # by position: some orientation covers the place tried, occlusion ignored; of a single camera

# Rows of `Scratch.lists`.
LISTED = 0  # positions to work on
BLOCKS = 1  # blocks of positions within the horizon of the place left or tried
FIRST, LAST = 2, 3  # spans of their positions: the first position, and the one behind the last
OTHERS = 4  # landmarks within the horizon of a place
TOUCHED_LIST = 5  # positions that are `TOUCHED`
VISIBLE = 6  # by position: all bits where the landmark is seen at the place left, else none; of a single camera
UNSURE, PLACES = 7, 8  # sets of axes to be tested, and their position and word: p << HALF | w; of a single camera
NAMES, GOES = 9, 10  # landmarks that turn at a position; all bits for one that disappears; of a single camera

# Rows of `Scratch.sets`.
FRESH = 0  # orientations among those `ASKED` with which the place tried is covered; of a camera, occlusion ignored
ASKED = 1  # orientations that are tested

# Rows of `Scratch.pairs`.
WHO, WHERE = 0, 1  # a landmark, and a position; of `GroupScratch.pairs` a centre around a position, c Q + q

# Rows of `seen`: the place tried as it is seen; `criteria.from_position` and `from_around` explain the bounds.
X, Y, Z = 0, 1, 2  # its offset from the position, or from the centre, metres
LOW, HIGH = 3, 4  # least and greatest depth at which it may be covered, metres
SURE = 5  # depth up to which, from `LOW` on, every axis that has it well in view covers it, metres


class State(NamedTuple):
    """The coverage of one deployment of K landmarks by a camera, from Q positions in the field's order, W words."""

    poses: np.ndarray
    """`(6, K)` positions of the landmarks, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` surfaces that the landmarks hang on."""
    counts: Counts
    """Number of landmarks covered."""
    units: np.ndarray
    """`(Q,)` P_n in integer units."""
    caps: np.ndarray
    """`(K, Q, W)` axes that cover each landmark, occlusion ignored."""
    reachable: np.ndarray
    """`(K, Q)` True where any axis covers the landmark, occlusion ignored."""
    hides: np.ndarray
    """`(2, K, Q)` int16: `HIDDEN`, `HIDING`, within the horizon."""


class RigState(NamedTuple):
    """The coverage of one deployment by a rig; orientations are those of its body."""

    poses: np.ndarray
    """As in `State`."""
    surfaces: np.ndarray
    """As in `State`."""
    counts: Counts
    """As in `State`."""
    units: np.ndarray
    """As in `State`."""
    groups: tuple[np.ndarray, ...]
    """`(2, K, Q, M, W)` of each group with M cameras: `CAPS`, `OCCLUDED`."""
    shown: np.ndarray
    """`(K, Q, W)` orientations with which some camera sees a landmark."""


class Scratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `target`, `SURFACE`, `units`, `FRESH`, `REACHED`, `hides` and `changes` are those of
    the way back.
    """

    target: np.ndarray
    """`(6,)` position and normal tried."""
    numbers: np.ndarray
    """`(5,)` int64: `BLOCK_COUNT` to `TOUCHED_COUNT`."""
    units: np.ndarray
    """`(Q,)` P_n with the landmark at the place tried."""
    flags: np.ndarray
    """`(4, Q)` bool: `AIMED` to `REACHED`."""
    lists: np.ndarray
    """`(11, max(Q W, K) + 1)` uint64: `LISTED` to `GOES`."""
    ways: np.ndarray
    """`(4, K + 1)`, filled up to whole words: vectors to the `OTHERS`, and their lengths, metres, single precision."""
    sets: np.ndarray
    """`(2, Q, W)`: `FRESH`, `ASKED`."""
    digits: np.ndarray
    """`(Q, W, J)` binary digits of the counts without the landmark where positions are `TOUCHED`."""
    pairs: np.ndarray
    """`(2, K Q)` uint32 pairs of another landmark and a position that the move concerns: `WHO`, `WHERE`."""
    known: np.ndarray
    """`(Q, K)` True for the `pairs`."""
    changes: np.ndarray
    """`(2, K, Q)` int8 changes of `State.hides`, for the `pairs`."""
    hides: np.ndarray
    """`(2, Q)` int16: `HIDDEN`, `HIDING` of the place tried."""
    seen: np.ndarray
    """`(6, Q)`: `X` to `SURE`."""
    cell: np.ndarray
    """`(2, Q)` int32: cell of the tables of directions, and the row of the axes that may have the place in view."""


class GroupScratch(NamedTuple):
    """The move tried last as one group of a rig sees it, and working memory for Q positions."""

    sets: np.ndarray
    """`(2, Q, M, W)`: `CAPS`, `OCCLUDED` of the place tried among the orientations `ASKED`."""
    flipped: np.ndarray
    """`(K, Q, M, W)` changes of `OCCLUDED` of the others, for the pairs in `RigScratch`."""
    occluders: np.ndarray
    """`(1,)` number of `pairs`."""
    pairs: np.ndarray
    """`(2, K C Q)` uint32 pairs of another landmark and a centre around which it may hide the place tried: `WHO`,
    `WHERE`."""
    seen: np.ndarray
    """`(6, Q)`: `X` to `SURE`, from the centre looked from last."""
    lists: np.ndarray
    """`(2, Q + 1)` uint64: rows of the tables of directions, and positions that are not settled yet."""
    reached: np.ndarray
    """`(Q,)` True where any orientation may cover the place tried."""


class RigScratch(NamedTuple):
    """The move tried last by all groups of a rig, and working memory.

    Once the move is carried out, `target`, `SURFACE`, `units`, `FRESH`, and `sets` of the groups are those of the place
    left.
    """

    target: np.ndarray
    """As in `Scratch`."""
    numbers: np.ndarray
    """As in `Scratch`."""
    units: np.ndarray
    """As in `Scratch`."""
    flags: np.ndarray
    """As in `Scratch`."""
    lists: np.ndarray
    """As in `Scratch`."""
    ways: np.ndarray
    """As in `Scratch`."""
    sets: np.ndarray
    """As in `Scratch`."""
    digits: np.ndarray
    """As in `Scratch`."""
    pairs: np.ndarray
    """As in `Scratch`."""
    known: np.ndarray
    """As in `Scratch`."""
    groups: tuple[GroupScratch, ...]
    """The move as each group sees it."""


def _shared_fields(state: State | RigState) -> dict[str, Any]:
    """Fields of a scratch that do not depend on whether a camera or a rig looks."""
    count, (size, words) = len(state.surfaces), state.counts.sets.shape[1:]
    return {
        "target": np.empty(6),
        "numbers": np.zeros(5, dtype=np.int64),
        "units": state.units.copy(),
        "flags": np.zeros((4, size), dtype=np.bool_),
        "lists": np.zeros((GOES + 1, max(size * words, count) + 1), dtype=np.uint64),
        "ways": np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32),
        "sets": np.zeros((2, size, words), dtype=np.uint64),
        "digits": np.empty_like(state.counts.digits),
        "pairs": np.empty((2, count * size), dtype=np.uint32),
        "known": np.zeros((size, count), dtype=np.bool_),
    }


def scratch_of(state: State) -> Scratch:
    """Working memory for moves of the landmarks of a camera's `state`."""
    count, size, _ = state.caps.shape
    return Scratch(
        **_shared_fields(state),
        changes=np.zeros((2, count, size), dtype=np.int8),
        hides=np.zeros((2, size), dtype=np.int16),
        seen=np.empty((6, size)),
        cell=np.empty((2, size), dtype=np.int32),
    )


def rig_scratch_of(state: RigState, centres: tuple[int, ...]) -> RigScratch:
    """Working memory for moves of the landmarks of a rig's `state`; `centres` has their number in each group."""
    count, size = state.shown.shape[:2]
    groups = tuple(
        GroupScratch(
            sets=np.zeros((2, *group.shape[2:]), dtype=np.uint64),
            flipped=np.zeros(group.shape[1:], dtype=np.uint64),
            occluders=np.zeros(1, dtype=np.int64),
            pairs=np.empty((2, count * around * size), dtype=np.uint32),
            seen=np.empty((6, size)),
            lists=np.empty((2, size + 1), dtype=np.uint64),
            reached=np.empty(size, dtype=np.bool_),
        )
        for group, around in zip(state.groups, centres, strict=True)
    )
    return RigScratch(**_shared_fields(state), groups=groups)
