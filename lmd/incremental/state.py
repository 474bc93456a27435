"""What the moves of single landmarks work on: the coverage of one deployment, and working memory."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import LANES
from lmd.sight.blocks import BLOCK


class State(NamedTuple):
    """Coverage of one deployment, positions in the order of the field.

    landmarks, normals `(3, K)`; surfaces `(K,)` that they hang on; caps `(K, Q, W)` the axes that cover a landmark
    nobody hides; reachable `(K, Q)` whether there are any in reach; hidden `(K, Q)` how many others within the horizon
    hide it, hiding `(K, Q)` how many it hides; counts `(Q, W, J)` the number of landmarks covered, binary digit by
    binary digit, the lowest first; short, just `(Q, W)` where it is n - 1, and n; units `(Q,)` P_n.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray
    caps: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    hiding: np.ndarray
    counts: np.ndarray
    short: np.ndarray
    just: np.ndarray
    units: np.ndarray


class Sighting(NamedTuple):
    """A landmark as seen from all positions, all `(Q,)`; see `criteria.from_position`.

    x, y, z offset; cell of the direction; reached whether any axis covers it.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sure: np.ndarray
    cell: np.ndarray
    reached: np.ndarray


class Neighbours(NamedTuple):
    """Landmarks that hide a place or are hidden by it, by block of positions.

    found `(Q / BLOCK,)` how many of them; who `(Q / BLOCK, K)` which; hides, hidden_by `(Q / BLOCK, K, BLOCK)` whether
    the place hides the landmark, or is hidden by it, seen from each position of the block; count_hides, count_hidden
    `(Q,)` how many of them do.
    """

    found: np.ndarray
    who: np.ndarray
    hides: np.ndarray
    hidden_by: np.ndarray
    count_hides: np.ndarray
    count_hidden: np.ndarray


class Turns(NamedTuple):
    """Landmarks that are hidden by more or fewer others after a move, by block of positions.

    found `(Q / BLOCK,)` how many of them; who `(Q / BLOCK, K)` which; change `(Q / BLOCK, K, BLOCK)` in the number of
    landmarks that hide it, seen from each position of the block.
    """

    found: np.ndarray
    who: np.ndarray
    change: np.ndarray


class Scratch(NamedTuple):
    """The move tried last, and working memory.

    target `(6,)` position and normal tried, surface `(1,)` they lie on; units `(Q,)` P_n there; new: how it is seen;
    cap `(Q, W)` axes that cover it; before, after: neighbours of both;
    turns: what follows for the others; flips `(Q,)` whether another landmark appears or disappears. Once the move is
    carried out, target, surface, units, cap, reached of `new` and the counts of `after` are those of the place left.

    Working memory of `nearby`: aimed `(Q / BLOCK,)` whether a block is near the target; blocks `(Q / BLOCK + 1,)` that
    the move may matter to, and spans `(Q / BLOCK, 2)` of positions that these are, from the first to the one behind
    the last; near `(2,)` how many blocks and spans there are. It and `hiding` have wanted `(Q / BLOCK,)`, blocks to
    look in. Of `hiding`: others `(K + 1,)` landmarks nearby, ways `(4, K + 1)`,
    filled up to whole words, to each of them and how long; slot `(K,)` of each landmark in `turns`, -1 for none. Of
    `trial` and `move`: listed `(Q + 1,)` positions; mask `(Q,)` of the old cap; inner, outer `(Q,)` rows of the tables
    of `cones`; unsure, places `(Q W + 1,)` sets of axes to be tested and where; names, goes `(K + 1,)` caps that come
    or go; digits `(J,)`. Lists have room for one more, as an entry is written down before it is decided whether it
    stays.
    """

    target: np.ndarray
    surface: np.ndarray
    units: np.ndarray
    new: Sighting
    cap: np.ndarray
    before: Neighbours
    after: Neighbours
    turns: Turns
    flips: np.ndarray
    aimed: np.ndarray
    blocks: np.ndarray
    spans: np.ndarray
    near: np.ndarray
    wanted: np.ndarray
    others: np.ndarray
    ways: np.ndarray
    slot: np.ndarray
    listed: np.ndarray
    mask: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    unsure: np.ndarray
    places: np.ndarray
    names: np.ndarray
    goes: np.ndarray
    digits: np.ndarray


def surroundings(count: int, size: int) -> dict[str, Any]:
    """The fields of a `Scratch` that `nearby` and `hiding` work on, for K landmarks and Q positions."""
    blocks = size // BLOCK

    def neighbours() -> Neighbours:
        hides, hidden_by = np.empty((2, blocks, count, BLOCK), dtype=np.int8)
        count_hides, count_hidden = np.zeros((2, size), dtype=np.int16)
        who = np.empty((blocks, count), dtype=np.int32)
        return Neighbours(np.zeros(blocks, dtype=np.int64), who, hides, hidden_by, count_hides, count_hidden)

    x, y, z, low, high, sure = np.empty((6, size))
    return {
        "new": Sighting(x, y, z, low, high, sure, np.empty(size, dtype=np.int32), np.zeros(size, dtype=np.bool_)),
        "before": neighbours(),
        "after": neighbours(),
        "turns": Turns(
            found=np.zeros(blocks, dtype=np.int64),
            who=np.empty((blocks, count), dtype=np.int32),
            change=np.empty((blocks, count, BLOCK), dtype=np.int8),
        ),
        "flips": np.zeros(size, dtype=np.bool_),
        "aimed": np.empty(blocks, dtype=np.bool_),
        "blocks": np.empty(blocks + 1, dtype=np.uint64),
        "spans": np.empty((blocks, 2), dtype=np.uint64),
        "near": np.zeros(2, dtype=np.int64),
        "wanted": np.empty(blocks, dtype=np.bool_),
        "others": np.empty(count + 1, dtype=np.uint64),
        "ways": np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32),
        "slot": np.full(count, -1, dtype=np.int64),
        "listed": np.empty(size + 1, dtype=np.uint64),
    }


def scratch_of(state: State) -> Scratch:
    """Working memory for moves of `state`."""
    count, size = state.reachable.shape
    words, digits = state.counts.shape[1:]
    inner, outer = np.empty((2, size), dtype=np.int32)
    unsure, places = np.empty((2, size * words + 1), dtype=np.uint64)
    names, goes = np.empty((2, count + 1), dtype=np.uint64)
    return Scratch(
        **surroundings(count, size),
        target=np.empty(6),
        surface=np.empty(1, dtype=np.int64),
        units=state.units.copy(),
        cap=np.zeros((size, words), dtype=np.uint64),
        mask=np.empty(size, dtype=np.uint64),
        inner=inner,
        outer=outer,
        unsure=unsure,
        places=places,
        names=names,
        goes=goes,
        digits=np.empty(digits, dtype=np.uint64),
    )
