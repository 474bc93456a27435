"""Blocks of neighbouring positions: one distance test against a block's bounding box serves all its positions."""

import numpy as np

from lmd.core.checks import FloatArray

# Number of positions or landmarks in a block: loops over whole blocks vectorise without a remainder.
BLOCK = 16

# Upper bound on the error of a squared cosine in single precision: a dozen roundings of 6e-8.
SINGLE_ERROR = 2e-6


def boxes_around(positions: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Bounding boxes of blocks of `BLOCK` consecutive positions each.

    `positions` `(Q, 3)` are ordered by `in_blocks`, metres. Return centres and half the side lengths, `(3, Q / BLOCK)`
    each.
    """
    blocks = positions.reshape(-1, BLOCK, 3)
    least, most = blocks.min(axis=1), blocks.max(axis=1)
    halves = ((most - least) / 2.0 * (1.0 + SINGLE_ERROR)).astype(np.float32)  # rounded up
    return np.ascontiguousarray(((least + most) / 2.0).T), np.ascontiguousarray(halves.T)


def _block_order(positions: FloatArray) -> np.ndarray:
    """Permutation `(P,)` that puts positions `(P, 3)` into blocks of neighbours.

    Each round cuts every segment with more positions than a block into two, across the longest side of the segment's
    bounding box.
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
    """Order positions `(P, 3)` into blocks of neighbours; copies of a position pad the last block.

    Returns:
        order: indices of the positions, `(Q,)`, where Q is a multiple of `BLOCK`.
        index_of: for each position, its first index in `order`, `(P,)`.
    """
    order = _block_order(positions)
    order = np.append(order, np.full(-len(order) % BLOCK, order[-1]))
    index_of = np.empty(len(positions), dtype=np.int64)
    index_of[order[::-1]] = np.arange(len(order))[::-1]  # of several copies of a position, the first
    return order, index_of
