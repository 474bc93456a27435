"""Grids of positions in an axis-parallel box."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from lmd.checks import FloatArray, real, vector
from lmd.memory import check_memory

KINDS = ("cells", "vertices")
# What a position takes before anything is seen from it, bytes: three coordinates twice over, a value and a weight.
POSITION_BYTES = 64


def checked_spacing(value: Any, size: Sequence[float]) -> float | tuple[float, ...]:
    """The spacing of a grid in a box of `size`, metres: one number or one per axis.

    Raises:
        InputError: it is not positive, or so many positions would not fit into memory.
    """
    spacing: float | tuple[float, ...]
    if isinstance(value, Iterable) and not isinstance(value, str):
        spacing = vector("spacing", value, 3, above=0.0)
    else:
        spacing = real("spacing", value, above=0.0)
    steps = spacing if isinstance(spacing, tuple) else 3 * (spacing,)
    positions = math.prod(length / step for length, step in zip(size, steps, strict=True))
    check_memory(POSITION_BYTES * positions, f"spacing = {spacing} makes {positions:.4g} positions, which", "spacing")
    return spacing


def grid_counts(size: FloatArray, spacing: float | Sequence[float], kind: str) -> tuple[int, int, int]:
    """Number of positions along x, y, z in a box of `size` `(3,)`; `kind` as in `grid_axes`."""
    # The small allowance keeps 4.5 / 0.5 at 9 cells however the division rounds.
    cells = np.ceil(np.asarray(size) / np.asarray(spacing) - 1e-9).astype(int)
    nx, ny, nz = (int(c) for c in np.maximum(cells, 1) + (kind == "vertices"))
    return nx, ny, nz


def grid_axes(low: FloatArray, high: FloatArray, counts: tuple[int, int, int], kind: str) -> list[FloatArray]:
    """Coordinates of a grid along x, y, z in a box with corners `low` and `high` `(3,)`, metres.

    `cells` puts a position at the centre of each cell, `vertices` at each vertex.
    """
    if kind == "vertices":
        return [np.linspace(a, b, count) for a, b, count in zip(low, high, counts, strict=True)]
    return [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]


def cell_borders(axes: list[FloatArray], low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners of the parts of the box that are nearest to each position, `(P, 3)` each."""
    lows, highs = [], []
    for axis, start, stop in zip(axes, low, high, strict=True):
        between = (axis[1:] + axis[:-1]) / 2.0
        lows.append(np.append(start, between))
        highs.append(np.append(between, stop))
    return combined(lows), combined(highs)


def combined(axes: Sequence[FloatArray]) -> FloatArray:
    """Every combination of coordinates along x, y, z, `(P, 3)`; z varies fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
