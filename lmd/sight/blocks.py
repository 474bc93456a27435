"""Blocks of neighbouring positions: what is far from a block is far from all of them, so it is looked at only once."""

import numpy as np

from lmd.core.checks import FloatArray

# Positions and landmarks come in blocks of this many: loops over whole blocks vectorise without a remainder.
BLOCK = 16

# The square of a cosine in single precision is off by less than this: a dozen roundings of 6e-8.
SINGLE_ERROR = 2e-6


def boxes_around(positions: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around blocks of `BLOCK` positions `(Q, 3)`: centres, and half the sides, `(3, Q / BLOCK)`."""
    blocks = positions.reshape(-1, BLOCK, 3)
    least, most = blocks.min(axis=1), blocks.max(axis=1)
    halves = ((most - least) / 2.0 * (1.0 + SINGLE_ERROR)).astype(np.float32)  # never less for the rounding
    return np.ascontiguousarray(((least + most) / 2.0).T), np.ascontiguousarray(halves.T)


def _by_blocks(positions: FloatArray) -> np.ndarray:
    """Indices `(P,)` that put positions `(P, 3)` into an order in which neighbours come in blocks.

    Each round cuts all parts that are longer than a block in two, across their longest side.
    """
    order, edges = np.arange(len(positions)), np.array([0, len(positions)])
    while (too_long := np.diff(edges) > BLOCK).any():
        first, sizes, ordered = edges[:-1], np.diff(edges), positions[order]
        sides = np.maximum.reduceat(ordered, first) - np.minimum.reduceat(ordered, first)
        part = np.repeat(np.arange(len(first)), sizes)
        along = ordered[np.arange(len(order)), sides.argmax(axis=1)[part]]
        order = order[np.lexsort((np.where(too_long[part], along, 0.0), part))]  # stable
        middle = first + (sizes // BLOCK + 1) // 2 * BLOCK
        edges = np.sort(np.append(edges, middle[too_long]))
    return order


def in_blocks(positions: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Indices `(Q,)` that put positions `(P, 3)` into blocks of neighbours, and where each is then, `(P,)`.

    The longest side is cut in two; the last block is filled up with copies.
    """
    order = _by_blocks(positions)
    order = np.append(order, np.full(-len(order) % BLOCK, order[-1]))
    index_of = np.empty(len(positions), dtype=np.int64)
    index_of[order[::-1]] = np.arange(len(order))[::-1]  # the first of several copies
    return order, index_of
