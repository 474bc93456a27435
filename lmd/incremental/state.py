"""What the moves of single landmarks work on: the coverage of one deployment, and working memory."""

from typing import NamedTuple

import numpy as np

from lmd.incremental.counts import Counts
from lmd.incremental.nearby import Nearby, nearby_of
from lmd.sight.blocks import BLOCK


class State(NamedTuple):
    """The coverage of one deployment of K landmarks, from Q positions in the order of the field; W words of axes."""

    landmarks: np.ndarray
    """`(3, K)` where they are, metres."""
    normals: np.ndarray
    """`(3, K)` unit."""
    surfaces: np.ndarray
    """`(K,)` that they hang on."""
    caps: np.ndarray
    """`(K, Q, W)` the axes that cover a landmark nobody hides."""
    reachable: np.ndarray
    """`(K, Q)` whether any axis covers it, as if nobody hid it."""
    hidden: np.ndarray
    """`(K, Q)` how many others within the horizon hide it."""
    hiding: np.ndarray
    """`(K, Q)` how many others it hides."""
    counts: Counts
    """How many landmarks are covered."""
    units: np.ndarray
    """`(Q,)` P_n, as whole numbers."""


class Sighting(NamedTuple):
    """A landmark as it is seen from all positions, `(Q,)` each; `criteria.from_position` says what the bounds are."""

    x: np.ndarray
    """Its offset from the position, metres."""
    y: np.ndarray
    """The same along y."""
    z: np.ndarray
    """The same along z."""
    low: np.ndarray
    """The least depth at which it may be covered."""
    high: np.ndarray
    """The greatest depth at which it may be covered."""
    sure: np.ndarray
    """Up to this depth, from `low` on, every axis that has it well in view covers it."""
    cell: np.ndarray
    """Of the table of directions, in which its direction is."""
    reached: np.ndarray
    """Whether any axis covers it."""


class Neighbours(NamedTuple):
    """Landmarks that hide a place or are hidden by it, by block of positions."""

    found: np.ndarray
    """`(Q / BLOCK,)` how many of them."""
    who: np.ndarray
    """`(Q / BLOCK, K)` which."""
    hides: np.ndarray
    """`(Q / BLOCK, K, BLOCK)` whether the place hides the landmark, from each position of the block."""
    hidden_by: np.ndarray
    """`(Q / BLOCK, K, BLOCK)` whether the landmark hides the place."""
    count_hides: np.ndarray
    """`(Q,)` how many landmarks the place hides."""
    count_hidden: np.ndarray
    """`(Q,)` how many landmarks hide the place."""


class Turns(NamedTuple):
    """Landmarks that more or fewer others hide after a move, by block of positions."""

    found: np.ndarray
    """`(Q / BLOCK,)` how many of them."""
    who: np.ndarray
    """`(Q / BLOCK, K)` which."""
    change: np.ndarray
    """`(Q / BLOCK, K, BLOCK)` in the number of landmarks that hide it, from each position of the block."""


class Scratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `target`, `surface`, `units`, `cap`, `new.reached` and the counts of `after` are those
    of the place left. Lists have room for one more: an entry is written down before it is decided whether it stays.
    """

    target: np.ndarray
    """`(6,)` position and normal tried."""
    surface: np.ndarray
    """`(1,)` that they lie on."""
    units: np.ndarray
    """`(Q,)` P_n with the landmark there."""
    new: Sighting
    """How the landmark is seen there."""
    cap: np.ndarray
    """`(Q, W)` the axes that cover it there."""
    before: Neighbours
    """Neighbours of the old place."""
    after: Neighbours
    """Neighbours of the new place."""
    turns: Turns
    """What follows for the others."""
    flips: np.ndarray
    """`(Q,)` whether another landmark appears or disappears."""
    near: Nearby
    """Where the move may matter. This and what follows is working memory."""
    slot: np.ndarray
    """`(K,)` of each landmark in `turns`, -1 for none."""
    listed: np.ndarray
    """`(Q + 1,)` positions."""
    mask: np.ndarray
    """`(Q,)` of the old cap."""
    inner: np.ndarray
    """`(Q,)` rows of the table of axes that have a direction well in view."""
    outer: np.ndarray
    """`(Q,)` rows of the table of axes that may have it in view."""
    unsure: np.ndarray
    """`(Q W + 1,)` sets of axes to be tested."""
    places: np.ndarray
    """`(Q W + 1,)` where these are."""
    names: np.ndarray
    """`(K + 1,)` landmarks whose caps come or go."""
    goes: np.ndarray
    """`(K + 1,)` words: all bits of a cap that goes, none of one that comes."""
    digits: np.ndarray
    """`(J,)` of a count."""


def scratch_of(state: State) -> Scratch:
    """Working memory for moves of `state`."""
    count, size = state.reachable.shape
    words, digits = state.counts.digits.shape[1:]
    blocks = size // BLOCK

    def neighbours() -> Neighbours:
        hides, hidden_by = np.empty((2, blocks, count, BLOCK), dtype=np.int8)
        count_hides, count_hidden = np.zeros((2, size), dtype=np.int16)
        who = np.empty((blocks, count), dtype=np.int32)
        return Neighbours(np.zeros(blocks, dtype=np.int64), who, hides, hidden_by, count_hides, count_hidden)

    x, y, z, low, high, sure = np.empty((6, size))
    inner, outer = np.empty((2, size), dtype=np.int32)
    unsure, places = np.empty((2, size * words + 1), dtype=np.uint64)
    names, goes = np.empty((2, count + 1), dtype=np.uint64)
    return Scratch(
        target=np.empty(6),
        surface=np.empty(1, dtype=np.int64),
        units=state.units.copy(),
        new=Sighting(x, y, z, low, high, sure, np.empty(size, dtype=np.int32), np.zeros(size, dtype=np.bool_)),
        cap=np.zeros((size, words), dtype=np.uint64),
        before=neighbours(),
        after=neighbours(),
        turns=Turns(
            found=np.zeros(blocks, dtype=np.int64),
            who=np.empty((blocks, count), dtype=np.int32),
            change=np.empty((blocks, count, BLOCK), dtype=np.int8),
        ),
        flips=np.zeros(size, dtype=np.bool_),
        near=nearby_of(count, size),
        slot=np.full(count, -1, dtype=np.int64),
        listed=np.empty(size + 1, dtype=np.uint64),
        mask=np.empty(size, dtype=np.uint64),
        inner=inner,
        outer=outer,
        unsure=unsure,
        places=places,
        names=names,
        goes=goes,
        digits=np.empty(digits, dtype=np.uint64),
    )
