"""Grids of positions in an axis-parallel box."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, real, vector
from lmd.core.memory import check_memory

KINDS = ("cells", "vertices")
# What a position takes before anything is seen from it, bytes: three coordinates twice over, a value and a weight.
POSITION_BYTES = 64
# Inverse powers of the root of x^4 = x + 1, the golden ratio of three dimensions (Roberts, 2018): in trials with other
# irrational steps, square roots for instance, some shapes were hit worse than by independent points; with these, none.
KRONECKER_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


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


def latin_hypercube(repeats: int, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Random numbers in [0, 1) `(repeats, *shape)`: each is uniform, but the `repeats` at one place are spread out.

    One of them lies in each of `repeats` equal parts of the interval. As a rule, means over such samples err less than
    over independent ones.
    """
    part = rng.permuted(np.broadcast_to(np.arange(repeats).reshape(-1, *len(shape) * (1,)), (repeats, *shape)), axis=0)
    drawn = (part + rng.random(part.shape)) / repeats
    return np.asarray(np.minimum(drawn, np.nextafter(1.0, 0.0)))  # the sum may have been rounded up


def kronecker(shift: FloatArray) -> Callable[[int], FloatArray]:
    """A function of a number that returns the next so many points of a sequence that fills the unit cube, `(count, 3)`.

    A Kronecker sequence. From a random `shift` `(3,)`, the first point, each point is uniform, but as a rule means over
    many err less than over independent ones.
    """
    drawn = 0

    def following(count: int) -> FloatArray:
        nonlocal drawn
        index = np.arange(drawn, drawn + count)[:, None]
        drawn += count
        return np.asarray((shift + index * KRONECKER_STEPS) % 1.0)

    return following
