"""Rooms whose camera positions are those of a grid in a box, as far as they can be reached."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, real, vector
from lmd.core.memory import check_memory
from lmd.space.blockers import Blockers
from lmd.space.surface import FILE_TOLERANCE, PLACEMENT_TOLERANCE, Surface, SurfaceArrays, surface_near
from lmd.space.triangles import Triangles

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


# Draws of a position that is in the reachable volume, before its grid position is taken instead.
MOST_DRAWS = 100
LEAST_SHARE = 1e-4  # of the box around it that the reachable volume fills
# Normals whose products with a third differ by less are the same.
SAME_WAY = 1e-6


def clear_of(blockers: Blockers | Triangles | None, starts: FloatArray, ends: FloatArray) -> BoolArray:
    """Whether none of what blocks stands between points `(..., 3)`, `(...)`."""
    if blockers is None:
        return np.ones(np.broadcast_shapes(starts.shape, ends.shape)[:-1], dtype=np.bool_)
    return blockers.clear(starts, ends)


class Gridded(ABC):
    """What such rooms share; a subclass is a frozen dataclass that also has the fields below."""

    reachable: Any
    spacing: Any
    positions: str

    @property
    @abstractmethod
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Corners of the box around the reachable volume, `(3,)` each."""

    @abstractmethod
    def reaches(self, points: FloatArray) -> BoolArray:
        """Whether the camera may be at points `(..., 3)` of the box, `(...)`."""

    @abstractmethod
    def contains(self, points: FloatArray) -> BoolArray:
        """See `Space.contains`."""

    @abstractmethod
    def surfaces(self) -> tuple[Surface, ...]:
        """See `Space.surfaces`."""

    @abstractmethod
    def blockers(self) -> Blockers | Triangles | None:
        """See `Space.blockers`."""

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.clear`."""
        return clear_of(self.blockers(), starts, ends)

    def grid_shape(self) -> tuple[int, int, int]:
        """Number of positions along x, y, z of the box."""
        low, high = self.box
        return grid_counts(high - low, self.spacing, self.positions)

    def _grid_axes(self) -> list[FloatArray]:
        return grid_axes(*self.box, self.grid_shape(), self.positions)

    @cached_property
    def _grid(self) -> tuple[FloatArray, BoolArray]:
        """All positions of the grid in the box, and which of them are in the reachable volume."""
        positions = combined(self._grid_axes())
        return positions, self.reaches(positions)

    def grid(self) -> FloatArray:
        """See `Space.grid`; z varies fastest."""
        positions, reached = self._grid
        return positions[reached]

    def finer(self) -> Self:
        """See `Space.finer`."""
        return replace(self, spacing=tuple(np.broadcast_to(self.spacing, 3) / 2.0))  # type: ignore[type-var]

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.jittered_grid`: in the part of each cell that is in the reachable volume."""
        positions, reached = self._grid
        borders = (corner[reached] for corner in cell_borders(self._grid_axes(), *self.box))
        low, high = (np.tile(corner, (repeats, 1)) for corner in borders)
        drawn, left = np.tile(positions[reached], (repeats, 1)), np.arange(len(low))
        offsets = latin_hypercube(repeats, (reached.sum(), 3), rng).reshape(-1, 3)
        for _ in range(MOST_DRAWS):
            tried = low[left] + offsets * (high[left] - low[left])
            good = self.reaches(tried)
            drawn[left[good]] = tried[good]
            left = left[~good]
            if not len(left):
                break
            offsets = rng.random((len(left), 3))
        return drawn

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample`."""
        return self._reached(size, lambda count: rng.random((count, 3)))

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample_evenly`."""
        low, high = self.box
        # From a first point that can be reached: the sequence comes back to what can be reached again and again, and
        # each time at a uniform point. From anywhere, it would more often come to where it has been away from for long.
        extent = np.where(high > low, high - low, 1.0)  # a robot on the ground may have one height
        return self._reached(size, kronecker((self.sample(1, rng)[0] - low) / extent))

    def _reached(self, size: int, following: Callable[[int], FloatArray]) -> FloatArray:
        """The first `size` of the points of the unit cube `following`, laid over the box, that can be reached."""
        low, high = self.box
        drawn, tries = np.empty((0, 3)), 0
        while len(drawn) < size:
            if tries > (size + 1) / LEAST_SHARE:
                raise InputError(
                    f"reachable.clearance = {self.reachable.clearance:g} leaves positions of the grid, but next to no "
                    "volume around them.",
                    "reachable.clearance",
                )
            tried = low + following(size - len(drawn)) * (high - low)
            tries += len(tried)
            drawn = np.concatenate([drawn, tried[self.reaches(tried)]])
        return drawn

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """See `Space.surfaces_of`; at an edge between two surfaces, the one whose normal is nearer.

        Of surfaces in one plane, whose rectangles may overlap, it is the one on which something may hang there.
        """
        carriers, within, allowed = self._carried(positions)
        hangs = within & self.contains(positions)[..., None]
        facing = np.where(hangs, normals @ carriers.normal.T, -np.inf)
        same = allowed & (facing >= facing.max(axis=-1, keepdims=True) - SAME_WAY)
        return np.where(hangs.any(axis=-1), np.argmax(np.where(same, facing + 1.0, facing), axis=-1), -1)

    def _carried(self, points: FloatArray) -> tuple[SurfaceArrays, BoolArray, BoolArray]:
        """The surfaces, which of their rectangles points `(..., 3)` lie on, and where of these landmarks may hang."""
        carriers = SurfaceArrays.of(self.surfaces())
        every = np.arange(len(carriers.normal))
        at = carriers.coordinates(every, np.asarray(points)[..., None, :])
        within = ((at >= -PLACEMENT_TOLERANCE) & (at <= carriers.extent + PLACEMENT_TOLERANCE)).all(axis=-1)
        within &= np.abs(carriers.depth(points)) <= PLACEMENT_TOLERANCE
        allowed = within.copy()
        allowed[within] = carriers.allow(np.broadcast_to(every, within.shape)[within], at[within], FILE_TOLERANCE)
        return carriers, within, allowed

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """See `Space.surface_near`."""
        return surface_near(self.surfaces(), positions, normals)
