"""Bounding volume hierarchy that is traversed without a stack."""

from collections.abc import Sequence

import numpy as np

from lmd.core.checks import FloatArray, IntArray

# Maximum numbers of triangles: in a leaf, and in a box that is cut at the median instead of by surface area.
LEAF, SMALL = 4, 48


def box_tree(
    low: FloatArray, high: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, IntArray, IntArray, IntArray]:
    """Build a hierarchy of T boxes that approximately minimises the expected cost of a ray.

    Args:
        low: lower corners of the boxes, `(T, 3)`.
        high: upper corners of the boxes, `(T, 3)`.

    Returns:
        permutation of the boxes, `(T,)`; centres, halves `(N, 3)`, skip, first and stop `(N,)` of the nodes as in
        `lmd.space.triangles.Triangles`.
    """
    middle = low + high
    order: list[IntArray] = []
    centres: list[FloatArray] = []
    halves: list[FloatArray] = []
    skip: list[int] = []
    first: list[int] = []
    stop: list[int] = []

    def grow(part: IntArray, placed: int) -> None:
        node = len(skip)
        lowest, highest = low[part].min(axis=0), high[part].max(axis=0)
        centres.append((lowest + highest) / 2.0)
        halves.append((highest - lowest) / 2.0)
        is_leaf = len(part) <= LEAF
        first.append(placed)
        stop.append(placed + len(part) if is_leaf else placed)
        skip.append(0)
        if is_leaf:
            order.append(part)
        else:
            one, other = _cut(part, low, high, middle)
            grow(one, placed)
            grow(other, placed + len(one))
        skip[node] = len(skip)

    grow(np.arange(len(low)), 0)
    numbers = (np.array(part, dtype=np.int64) for part in (skip, first, stop))
    return np.concatenate(order), np.array(centres), np.array(halves), *numbers  # type: ignore[return-value]


def _cut(part: IntArray, low: FloatArray, high: FloatArray, middle: FloatArray) -> Sequence[IntArray]:
    """Cut boxes into two parts, by the surface area heuristic (MacDonald and Booth, 1990) or, if few, at the median."""
    if len(part) <= SMALL:
        part = part[np.argsort(middle[part, np.argmax(np.ptp(middle[part], axis=0))], kind="stable")]
        return part[: len(part) // 2], part[len(part) // 2 :]
    best, least = part[:0], np.inf
    counts = np.arange(1, len(part))
    for axis in range(3):
        along = part[np.argsort(middle[part, axis], kind="stable")]
        before, after = (
            _areas(np.minimum.accumulate(low[way]), np.maximum.accumulate(high[way])) for way in (along, along[::-1])
        )
        cost = before[:-1] * counts + after[:-1][::-1] * counts[::-1]
        at = int(np.argmin(cost))
        if cost[at] < least:
            best, least, size = along, cost[at], at + 1
    return best[:size], best[size:]


def _areas(low: FloatArray, high: FloatArray) -> FloatArray:
    """Half the surface areas of boxes with corners `low` and `high` `(M, 3)`, `(M,)`."""
    x, y, z = (high - low).T
    return np.asarray(x * y + y * z + z * x)
