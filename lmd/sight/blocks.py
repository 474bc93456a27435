"""Blocks of neighbouring positions: what is far from a block is far from all of them, so it is looked at only once."""

import numpy as np

from lmd.checks import FloatArray
from lmd.compiled import kernel

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


@kernel
def _cut(positions, order):  # type: ignore[no-untyped-def]
    """Sort the indices `order` of `positions` `(P, 3)` in place, so that neighbours come in blocks."""
    left = [(0, len(order))]
    while left:
        first, last = left.pop()
        if last - first <= BLOCK:
            continue
        part, side, longest = order[first:last], 0, -1.0
        for i in range(3):
            values = positions[part, i]
            if values.max() - values.min() > longest:
                side, longest = i, values.max() - values.min()
        part[:] = part[np.argsort(positions[part, side], kind="mergesort")]
        middle = first + ((last - first) // BLOCK + 1) // 2 * BLOCK
        left.append((first, middle))
        left.append((middle, last))


def in_blocks(positions: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Indices `(Q,)` that put positions `(P, 3)` into blocks of neighbours, and where each is then, `(P,)`.

    The longest side is cut in two; the last block is filled up with copies.
    """
    order = np.arange(len(positions))
    _cut(positions, order)
    order = np.append(order, np.full(-len(order) % BLOCK, order[-1]))
    index_of = np.empty(len(positions), dtype=np.int64)
    index_of[order[::-1]] = np.arange(len(order))[::-1]  # the first of several copies
    return order, index_of
