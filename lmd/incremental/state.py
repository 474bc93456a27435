"""State and scratch of moves of single landmarks: the coverage of one deployment, and working memory.

Arrays of one type and shape are rows of one array, with a name for each row: numba hands each array over as 5 + 2n
numbers, n its dimensions, to all that is not inlined.
"""

from typing import NamedTuple

import numpy as np

from lmd.core.bits import ALL, LANES
from lmd.incremental.counts import Counts
from lmd.sight.blocks import BLOCK

# Rows of `State.hides`, and of the pairs of rows of `Scratch.shorts` and `Scratch.pairs`.
HIDDEN = 0  # others hide the landmark, or the place
HIDING = 1  # it hides them

# Rows of `Scratch.who`, of `FOUND` in `Scratch.lists`; the first two of the pairs of rows of `shorts` and `pairs`.
# Of numpy: of Python's numbers each may be a type of its own for numba.
BEFORE = np.int64(0)  # neighbours of the place left
AFTER = np.int64(1)  # neighbours of the place tried
TURNS = np.int64(2)  # landmarks that more or fewer others hide after the move
AFTER_HIDDEN, AFTER_HIDING = 2 + HIDDEN, 2 + HIDING  # of `Scratch.shorts` and `Scratch.pairs`
OUTER = 4  # of `Scratch.shorts`: the row of the tables with the axes that may have the landmark in view, or `NOWHERE`
CHANGE = 4  # of `Scratch.pairs`: by how many more others a landmark of `TURNS` is hidden

# Rows of `Scratch.numbers`.
BLOCK_COUNT = 0  # how many `BLOCKS` are listed
SPAN_COUNT = 1  # how many spans `FIRST` and `LAST` list
SURFACE = 2  # that the place tried lies on

# Rows of `Scratch.seen`: the landmark as it is seen at the place tried; `criteria.from_position` explains the bounds.
X, Y, Z = 0, 1, 2  # its offset from the position, metres
LOW, HIGH = 3, 4  # the least and the greatest depth at which it may be covered, metres
SURE = 5  # up to this depth, from `LOW` on, every axis that has it well in view covers it, metres

# Rows of `Scratch.flags`; a rig has the first two.
AIMED = 0  # by block: it is near the place tried
WANTED = 1  # by block: it is to be searched for neighbours
REACHED = 2  # any axis covers the landmark at the place tried
FLIPS = 3  # another landmark appears or disappears

# Rows of `Scratch.lists`; a rig has the first five. An entry is written down before it is decided whether it stays.
LISTED = 0  # positions
BLOCKS = 1  # blocks of positions that the move may matter to
FIRST, LAST = 2, 3  # spans of positions that these are: the first position, and the one behind the last
OTHERS = 4  # landmarks within the horizon of a place
NEAR_LISTS = 5  # how many these are
OLD = 5  # by position: all bits where the landmark is seen at the place left, else none
NAMES = 6  # landmarks whose caps come or go
GOES = 7  # of these: all bits of a word if the cap goes, none if it comes
SLOT = 8  # by landmark: where it is in `TURNS`, `ALL` for nowhere
DIGITS = 9  # binary digits of a count, the lowest first
UNSURE = 10  # sets of axes to be tested
PLACES = 11  # where these are, a position and a word: p << HALF | w
FOUND = 12  # by block, three rows: how many landmarks of `BEFORE`, `AFTER` and `TURNS` there are


class State(NamedTuple):
    """The coverage of one deployment of K landmarks, from Q positions in the order of the field; W words of axes."""

    poses: np.ndarray
    """`(6, K)` where they are, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` that they hang on."""
    caps: np.ndarray
    """`(K, Q, W)` the axes that cover a landmark nobody hides."""
    reachable: np.ndarray
    """`(K, Q)` whether any axis covers it, as if nobody hid it."""
    hides: np.ndarray
    """`(2, K, Q)` int16: by how many others within the horizon it is `HIDDEN`, and how many it is `HIDING`."""
    counts: Counts
    """How many landmarks are covered."""
    units: np.ndarray
    """`(Q,)` P_n, as whole numbers."""


class Scratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `target`, `SURFACE`, `units`, `cap`, `REACHED` and what `shorts` has of `AFTER` are
    those of the place left.
    """

    target: np.ndarray
    """`(6,)` position and normal tried."""
    numbers: np.ndarray
    """`(3,)` int64: `BLOCK_COUNT`, `SPAN_COUNT`, `SURFACE`."""
    units: np.ndarray
    """`(Q,)` P_n with the landmark there."""
    seen: np.ndarray
    """`(6, Q)`: `X`, `Y`, `Z`, `LOW`, `HIGH`, `SURE`."""
    cell: np.ndarray
    """`(Q,)` int32, of the tables of directions, in which its direction is."""
    flags: np.ndarray
    """`(4, Q)` bool: `AIMED`, `WANTED`, `REACHED`, `FLIPS`."""
    cap: np.ndarray
    """`(Q, W)` the axes that cover the landmark at the place tried."""
    shorts: np.ndarray
    """`(5, Q)` int16: how many landmarks hide the place left, how many it hides, both of the place tried, and `OUTER`.

    A loop that writes to two rows of an array, or reads one and writes another, may not vectorise: so `OUTER` is here.
    """
    who: np.ndarray
    """`(3, Q / BLOCK, K)` int32: the landmarks of `BEFORE`, `AFTER` and `TURNS`, by block of positions."""
    pairs: np.ndarray
    """`(5, Q / BLOCK, K, BLOCK)` int8, from each position of the block: whether a landmark of `BEFORE` hides the place
    left, whether that hides it, both of `AFTER` and the place tried, and `CHANGE`."""
    ways: np.ndarray
    """`(4, K + 1)`, filled up to whole words: the way to each of the `OTHERS`, and how long it is, metres."""
    lists: np.ndarray
    """`(15, max(Q W, K) + 1)` uint64: `LISTED` to `FOUND`."""


def lists_of(number: int, *sizes: int) -> np.ndarray:
    """So many lists with room for so many landmarks, positions or words, and for one more."""
    return np.zeros((number, max(sizes) + 1), dtype=np.uint64)


def ways_of(count: int) -> np.ndarray:
    """Room for the ways to K landmarks."""
    return np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32)


def scratch_of(state: State) -> Scratch:
    """Working memory for moves of `state`."""
    count, size = state.reachable.shape
    words, blocks = state.counts.digits.shape[1], size // BLOCK
    lists = lists_of(FOUND + 3, count, size * words)
    lists[SLOT] = ALL
    return Scratch(
        target=np.empty(6),
        numbers=np.zeros(3, dtype=np.int64),
        units=state.units.copy(),
        seen=np.empty((6, size)),
        cell=np.empty(size, dtype=np.int32),
        flags=np.zeros((4, size), dtype=np.bool_),
        cap=np.zeros((size, words), dtype=np.uint64),
        shorts=np.zeros((5, size), dtype=np.int16),
        who=np.empty((3, blocks, count), dtype=np.int32),
        pairs=np.empty((5, blocks, count, BLOCK), dtype=np.int8),
        ways=ways_of(count),
        lists=lists,
    )
