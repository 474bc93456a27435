"""What the moves of single landmarks work on: positions in blocks of neighbours, the coverage, working memory."""

from typing import NamedTuple

import numpy as np

from lmd.checks import FloatArray
from lmd.coverage.evaluator import Evaluator
from lmd.coverage.kernels import BLOCK
from lmd.visibility import TOLERANCE


class Fixed(NamedTuple):
    """What does not change while landmarks move.

    positions `(3, Q)` in blocks of `BLOCK` neighbours, the last block filled up with copies; place `(P,)` where each
    position of the evaluator is among them; centres `(3, Q / BLOCK)` and radii `(Q / BLOCK,)` of balls around the
    blocks; the rest as in `kernels.evaluate_range`.
    """

    positions: np.ndarray
    place: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    limits: np.ndarray
    reach: float
    mode: int
    axes: np.ndarray
    bands: np.ndarray
    weights: np.ndarray
    n: int


class State(NamedTuple):
    """Coverage of one deployment, positions in the order of `Fixed`.

    landmarks, normals `(3, K)`; counts `(Q, D)` landmarks covered per position and axis; reachable `(K, Q)` whether
    a landmark faces a position within reach of the camera; hidden `(K, Q)` how many others hide it, hiding `(K, Q)` how
    many others it hides; units `(Q,)` P_n.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    counts: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    hiding: np.ndarray
    units: np.ndarray


class Caps(NamedTuple):
    """The cap of one place seen from all positions, all `(Q,)`; see `kernels.cap_of`.

    x, y, z offset; low least depth; bottom, top height bins; reached whether there is a cap.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    low: np.ndarray
    bottom: np.ndarray
    top: np.ndarray
    reached: np.ndarray


class Neighbours(NamedTuple):
    """Landmarks near the line of sight of one place, by block of positions.

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


class Scratch(NamedTuple):
    """Working memory of `move`: what is seen of the old and of the new place, and the caps of one position.

    wanted `(Q / BLOCK,)` blocks in which to look for neighbours; apart `(K,)` distance of each landmark; flags `(K,)`;
    counts `(D,)` a row; difference `(K,)` in the number of landmarks that hide each; caps `(K + 2, 4)` that come or go
    at a position: offset and least depth, with ranges `(K + 2, 2)` of axes and signs `(K + 2,)`.
    """

    old: Caps
    new: Caps
    before: Neighbours
    after: Neighbours
    wanted: np.ndarray
    apart: np.ndarray
    flags: np.ndarray
    counts: np.ndarray
    difference: np.ndarray
    caps: np.ndarray
    ranges: np.ndarray
    signs: np.ndarray


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
    centres = blocks.mean(axis=1)
    radii = np.linalg.norm(blocks - centres[:, None], axis=2).max(axis=1) * (1.0 + TOLERANCE)
    positions, centres = np.ascontiguousarray(positions.T), np.ascontiguousarray(centres.T)
    return Fixed(positions, place, centres, radii, e.limits, e.reach, e.mode, e.axes, e.bands, e.weights, n)


def scratch_of(state: State) -> Scratch:
    """Working memory for trials on `state`."""
    count, size = state.reachable.shape
    blocks = size // BLOCK

    def caps() -> Caps:
        x, y, z, low = np.empty((4, size))
        bottom, top = np.empty((2, size), dtype=np.int32)
        return Caps(x, y, z, low, bottom, top, np.empty(size, dtype=np.bool_))

    def neighbours() -> Neighbours:
        hides, hidden_by = np.empty((2, blocks, count, BLOCK), dtype=np.bool_)
        count_hides, count_hidden = np.zeros((2, size), dtype=np.int64)
        # One column more: the search writes each landmark down before it decides whether to keep it.
        who = np.empty((blocks, count + 1), dtype=np.int32)
        return Neighbours(np.zeros(blocks, dtype=np.int64), who, hides, hidden_by, count_hides, count_hidden)

    return Scratch(
        old=caps(),
        new=caps(),
        before=neighbours(),
        after=neighbours(),
        wanted=np.empty(blocks, dtype=np.bool_),
        apart=np.empty(count),
        flags=np.empty(count, dtype=np.bool_),
        counts=np.empty_like(state.counts[0]),
        difference=np.zeros(count, dtype=np.int64),
        caps=np.empty((count + 2, 4)),
        ranges=np.empty((count + 2, 2), dtype=np.int64),
        signs=np.empty(count + 2, dtype=np.int16),
    )
