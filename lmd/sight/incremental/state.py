"""What the moves of single landmarks work on: positions in blocks of neighbours, the coverage, working memory."""

from typing import NamedTuple

import numpy as np

from lmd.checks import FloatArray
from lmd.sight.evaluator import Evaluator
from lmd.sight.incremental.bits import BITS, LANES
from lmd.sight.incremental.directions import cones
from lmd.sight.kernels import BLOCK, SINGLE_ERROR


class Fixed(NamedTuple):
    """What does not change while landmarks move.

    positions `(3, Q)` in blocks of `BLOCK` neighbours, the last block filled up with copies; place `(P,)` where each
    position of the evaluator is among them; centres and halves `(3, Q / BLOCK)` of the
    sides of boxes around the blocks; axes `(3, 64 W)` filled up with zeros to whole words; certain, possible the tables
    of `cones`; the rest as in `kernels.evaluate_range`.
    """

    positions: np.ndarray
    place: np.ndarray
    centres: np.ndarray
    halves: np.ndarray
    limits: np.ndarray
    reach: float
    mode: int
    axes: np.ndarray
    certain: np.ndarray
    possible: np.ndarray
    weights: np.ndarray
    n: int


class State(NamedTuple):
    """Coverage of one deployment, positions in the order of `Fixed`.

    landmarks, normals `(3, K)`; caps `(K, Q, W)` the axes that cover a landmark nobody hides; reachable `(K, Q)`
    whether there are any in reach; hidden `(K, Q)` how many others hide it, hiding `(K, Q)` how many others it hides;
    counts `(Q, W, J)` the number of landmarks covered, binary digit by binary digit, the lowest first; short,
    just `(Q, W)` where it is n - 1, and n; units `(Q,)` P_n.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    caps: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    hiding: np.ndarray
    counts: np.ndarray
    short: np.ndarray
    just: np.ndarray
    units: np.ndarray


class Place(NamedTuple):
    """A place seen from all positions, all `(Q,)`; see `kernels.cap_of`.

    x, y, z offset; low least depth; cell of the direction; limited whether the cap is less than a cone; reached whether
    there is a cap.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    low: np.ndarray
    cell: np.ndarray
    limited: np.ndarray
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

    place `(6,)` position and normal tried; units `(Q,)` P_n there; new: what is seen of it; cap `(Q, W)` axes that
    cover it; old `(3, Q)` offset of the place that it leaves; before, after: neighbours of both; turns: what follows
    for the others; flips `(Q,)` whether another landmark appears or disappears. Once the move is carried out, place,
    units, cap, reached of `new` and the counts of `after` are those of the place left.

    Working memory of `neighbours`: wanted `(Q / BLOCK,)` blocks to look in; ways `(4, K)`, filled up to whole words, to
    each landmark and how long; slot `(K,)` of each landmark in `turns`, -1 for none. Of `trial` and `incremental`:
    listed `(Q + 1,)` positions; mask `(Q,)` of the old cap; inner, outer `(Q,)` rows of the tables of `cones`; unsure,
    places `(Q W + 1,)` sets of axes to be tested and where; names, goes `(K + 1,)` caps that come or go; digits `(J,)`.
    Lists have room for one more, as an entry is written down before it is decided whether it stays.
    """

    place: np.ndarray
    units: np.ndarray
    new: Place
    cap: np.ndarray
    old: np.ndarray
    before: Neighbours
    after: Neighbours
    turns: Turns
    flips: np.ndarray
    wanted: np.ndarray
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


def _in_blocks(positions: FloatArray) -> np.ndarray:
    """Indices `(Q,)` that put positions `(P, 3)` into blocks of neighbours, by cutting the longest side in two."""

    def cut(part: np.ndarray) -> list[np.ndarray]:
        if len(part) <= BLOCK:
            return [part]
        side = np.argmax(np.ptp(positions[part], axis=0))
        part = part[np.argsort(positions[part, side], kind="stable")]
        middle = (len(part) // BLOCK + 1) // 2 * BLOCK
        return cut(part[:middle]) + cut(part[middle:])

    order = np.concatenate(cut(np.arange(len(positions))))
    return np.append(order, np.full(-len(order) % BLOCK, order[-1]))


def fixed_of(evaluator: Evaluator, n: int) -> Fixed:
    """The fixed part of an evaluator's scene."""
    e = evaluator
    order = _in_blocks(e.positions)
    place = np.empty(len(e.positions), dtype=np.int64)
    place[order[::-1]] = np.arange(len(order))[::-1]  # the first of several copies
    positions = e.positions[order]
    blocks = positions.reshape(-1, BLOCK, 3)
    least, most = blocks.min(axis=1), blocks.max(axis=1)
    centres = (least + most) / 2.0
    halves = ((most - least) / 2.0 * (1.0 + SINGLE_ERROR)).astype(np.float32)  # never less for the rounding
    positions, centres, halves = (np.ascontiguousarray(part.T) for part in (positions, centres, halves))
    certain, possible = cones(e.axes, e.limits[0])
    axes = np.pad(e.axes, [(0, 0), (0, BITS * possible.shape[1] - e.axes.shape[1])])
    scene = e.limits, e.reach, e.mode, axes, certain, possible, e.weights
    return Fixed(positions, place, centres, halves, *scene, n)


def scratch_of(state: State) -> Scratch:
    """Working memory for moves of `state`."""
    count, size = state.reachable.shape
    blocks, words, digits = size // BLOCK, *state.counts.shape[1:]

    def neighbours() -> Neighbours:
        hides, hidden_by = np.empty((2, blocks, count, BLOCK), dtype=np.int8)
        count_hides, count_hidden = np.zeros((2, size), dtype=np.int64)
        who = np.empty((blocks, count), dtype=np.int32)
        return Neighbours(np.zeros(blocks, dtype=np.int64), who, hides, hidden_by, count_hides, count_hidden)

    x, y, z, low = np.empty((4, size))
    limited, reached = np.empty((2, size), dtype=np.bool_)
    ways = np.zeros((4, -(-count // LANES) * LANES), dtype=np.float32)
    ways[3] = -np.inf  # nothing comes close to those that fill up
    inner, outer = np.empty((2, size), dtype=np.int32)
    unsure, places = np.empty((2, size * words + 1), dtype=np.uint64)
    names, goes = np.empty((2, count + 1), dtype=np.uint64)
    return Scratch(
        place=np.empty(6),
        units=state.units.copy(),
        new=Place(x, y, z, low, np.empty(size, dtype=np.int32), limited, reached),
        cap=np.zeros((size, words), dtype=np.uint64),
        old=np.empty((3, size)),
        before=neighbours(),
        after=neighbours(),
        turns=Turns(
            found=np.zeros(blocks, dtype=np.int64),
            who=np.empty((blocks, count), dtype=np.int32),
            change=np.empty((blocks, count, BLOCK), dtype=np.int8),
        ),
        flips=np.zeros(size, dtype=np.bool_),
        wanted=np.empty(blocks, dtype=np.bool_),
        ways=ways,
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
