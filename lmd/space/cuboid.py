"""Cuboid room with a reachable box."""

import itertools
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Annotated

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, InputError, vector
from lmd.space.gridded import Gridded, GridKind, checked_spacing, grid_counts, kronecker
from lmd.space.parts import box_surfaces, checked_names
from lmd.space.space import Relevance
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface

Size = Annotated[tuple[float, float, float], partial(vector, size=3, above=0.0)]
WALLS = ("x_min", "x_max", "y_min", "y_max", "floor", "ceiling")


@dataclass(frozen=True)
class Cuboid(Gridded):
    """Cuboid room with a centred reachable box (Sec. V-A of the paper); implements `lmd.space.space.Space`.

    Raises:
        InputError: sizes are not positive, the reachable box exceeds the room, a wall is unknown or repeated, or the
            positions would not fit into memory.
    """

    size: Size
    """Inner length, width and height along x, y, z, metres."""
    reachable_size: Size
    """Size of the reachable box, centred in the room, metres."""
    spacing: float | tuple[float, float, float]
    """Largest distance between neighbouring positions, metres: one number or one per axis."""
    positions: GridKind = "cells"
    """`cells` for the centres of the grid cells, `vertices` for the vertices."""
    walls: Annotated[tuple[str, ...], partial(checked_names, known=WALLS)] = WALLS
    """Names of the walls that may carry landmarks."""
    relevance: Relevance = field(default_factory=Relevance)
    """Relevance Rel(p): weights of the camera positions."""

    def _validate(self) -> None:
        size, reachable = self.size, self.reachable_size
        if any(inner > outer for inner, outer in zip(reachable, size, strict=True)):
            raise InputError(f"reachable_size = {list(reachable)} exceeds size = {list(size)}.", "reachable_size")
        object.__setattr__(self, "spacing", checked_spacing(self.spacing, reachable))

    @property
    def reachable_low(self) -> FloatArray:
        """Lower corner of the reachable box, `(3,)`, metres."""
        return np.asarray((np.asarray(self.size) - np.asarray(self.reachable_size)) / 2.0)

    @property
    def reachable_high(self) -> FloatArray:
        """Upper corner of the reachable box, `(3,)`, metres."""
        return np.asarray((np.asarray(self.size) + np.asarray(self.reachable_size)) / 2.0)

    @override
    def grid_shape(self) -> tuple[int, int, int]:
        return grid_counts(np.asarray(self.reachable_size), self.spacing, self.positions)

    @property
    @override
    def box(self) -> tuple[FloatArray, FloatArray]:
        return self.reachable_low, self.reachable_high

    @override
    def reaches(self, points: FloatArray) -> BoolArray:
        return np.ones(points.shape[:-1], dtype=np.bool_)

    @override
    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        return self.reachable_low + kronecker(rng.random(3))(size) * (self.reachable_high - self.reachable_low)

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        """Walls that may carry landmarks, in the order of `walls`."""
        walls = _walls(self.size)
        return tuple(walls[name] for name in self.walls)

    @override
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.zeros(3), np.asarray(self.size)

    @override
    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` in the closed room, `(...)`."""
        p = np.asarray(points)
        inside = (p >= -PLACEMENT_TOLERANCE) & (p <= np.asarray(self.size) + PLACEMENT_TOLERANCE)
        return np.asarray(inside[..., 0] & inside[..., 1] & inside[..., 2])  # five times faster than `all`

    @override
    def blockers(self) -> None:
        """See `Space.blockers`: a cuboid is convex and empty."""

    def outline(self) -> dict[str, FloatArray]:
        """See `Space.outline`."""
        reachable = box_edges(self.reachable_low, self.reachable_high)
        return {"room": box_edges(*self.bounds()), "reachable area": reachable}


@lru_cache
def _walls(size: tuple[float, float, float]) -> dict[str, Surface]:
    """All six walls by name; cached, as a run calls the function thousands of times."""
    walls = box_surfaces(np.zeros(3), np.array(size), WALLS, inwards=True)
    return dict(zip(WALLS, walls, strict=True))


def box_edges(low: FloatArray, high: FloatArray) -> FloatArray:
    """Edges, `(12, 2, 3)`, of an axis-aligned box with the corners `low` and `high`, `(3,)` each.

    The axes of the result are edge, end of the edge, and coordinate.
    """
    bits = np.array(list(itertools.product((0, 1), repeat=3)))
    pairs = [(a, b) for a, b in itertools.combinations(bits, 2) if np.abs(a - b).sum() == 1]
    return np.asarray(low + np.array(pairs) * (high - low))
