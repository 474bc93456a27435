"""The room: a cuboid with walls that may carry landmarks, and a reachable box inside it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lmd.checks import FloatArray, InputError, choice, real, vector
from lmd.space.relevance import Relevance

WALLS = ("x_min", "x_max", "y_min", "y_max", "floor", "ceiling")
# Landmarks this far (m) outside still count as inside: a CSV rounded to micrometres is not an error.
PLACEMENT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Wall:
    """A rectangle that may carry landmarks: points are origin + a u + b v, 0 <= (a, b) <= extent.

    `u` runs horizontally and `v` up on side walls; on floor and ceiling they run along x and y. `normal` points
    into the room. Vectors are `(3,)` in the world frame, extents in metres.
    """

    name: str
    origin: FloatArray
    u: FloatArray
    v: FloatArray
    normal: FloatArray
    extent: tuple[float, float]

    @property
    def area(self) -> float:
        """Square metres."""
        return self.extent[0] * self.extent[1]

    def point(self, a: FloatArray | float, b: FloatArray | float) -> FloatArray:
        """World points `(..., 3)` at wall coordinates `a`, `b` of shape `(...)`, metres."""
        a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        return np.asarray(self.origin + a[..., None] * self.u + b[..., None] * self.v)

    def coordinates(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Wall coordinates of the projections of world points `(..., 3)`, clipped to the wall."""
        offset = np.asarray(points) - self.origin
        return np.clip(offset @ self.u, 0.0, self.extent[0]), np.clip(offset @ self.v, 0.0, self.extent[1])


@dataclass(frozen=True)
class Room:
    """A cuboid room with a centred reachable box (Sec. V-A of the paper).

    Args:
        size: inner length, width, height along x, y, z, metres.
        reachable_size: size of the box the camera may visit, centred in the room, metres.
        spacing: largest distance between neighbouring positions, metres: one number or one per axis.
        positions: `cells` puts a position at the centre of each grid cell, `vertices` at each grid vertex.
        walls: names of the walls that may carry landmarks.
        relevance: Rel(p), how much each position matters.

    Raises:
        InputError: sizes are not positive, the reachable box exceeds the room, a wall is unknown or repeated.
    """

    size: tuple[float, float, float]
    reachable_size: tuple[float, float, float]
    spacing: float | tuple[float, float, float]
    positions: str = "cells"
    walls: tuple[str, ...] = WALLS
    relevance: Relevance = field(default_factory=Relevance)

    def __post_init__(self) -> None:
        size = vector("room.size", self.size, 3, above=0.0)
        reachable = vector("room.reachable_size", self.reachable_size, 3, above=0.0)
        if any(inner > outer for inner, outer in zip(reachable, size, strict=True)):
            raise InputError(f"room.reachable_size = {list(reachable)} exceeds room.size = {list(size)}.")
        if np.isscalar(self.spacing):
            object.__setattr__(self, "spacing", real("room.spacing", self.spacing, above=0.0))
        else:
            object.__setattr__(self, "spacing", vector("room.spacing", self.spacing, 3, above=0.0))
        choice("room.positions", self.positions, ("cells", "vertices"))
        if not isinstance(self.walls, list | tuple) or not self.walls or len(set(self.walls)) != len(self.walls):
            raise InputError(f"room.walls must list at least one wall, each once, got {self.walls!r}.")
        for name in self.walls:
            choice("room.walls", name, WALLS)
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "reachable_size", reachable)
        object.__setattr__(self, "walls", tuple(self.walls))

    @property
    def reachable_low(self) -> FloatArray:
        """Lower corner of the reachable box, `(3,)`, metres."""
        return np.asarray((np.asarray(self.size) - np.asarray(self.reachable_size)) / 2.0)

    @property
    def reachable_high(self) -> FloatArray:
        """Upper corner of the reachable box, `(3,)`, metres."""
        return np.asarray((np.asarray(self.size) + np.asarray(self.reachable_size)) / 2.0)

    def grid_shape(self) -> tuple[int, int, int]:
        """Number of positions along x, y, z."""
        # The small allowance keeps 4.5 / 0.5 at 9 cells however the division rounds.
        cells = np.ceil(np.asarray(self.reachable_size) / np.asarray(self.spacing) - 1e-9).astype(int)
        nx, ny, nz = (int(c) for c in np.maximum(cells, 1) + (self.positions == "vertices"))
        return nx, ny, nz

    def grid(self) -> FloatArray:
        """Discrete positions Omega_d, `(P, 3)` in the world frame, metres; z varies fastest."""
        return _combined(self._grid_axes())

    def finer(self) -> "Room":
        """The same room with half the spacing."""
        return replace(self, spacing=tuple(np.broadcast_to(self.spacing, 3) / 2.0))

    def jittered_grid(self, rng: np.random.Generator) -> FloatArray:
        """One uniformly drawn position in the cell of each grid position, `(P, 3)` in the order of `grid`, metres.

        The cell of a position is the part of the reachable box that is nearest to it.
        """
        lows, highs = [], []
        for axis, low, high in zip(self._grid_axes(), self.reachable_low, self.reachable_high, strict=True):
            between = (axis[1:] + axis[:-1]) / 2.0
            lows.append(np.append(low, between))
            highs.append(np.append(between, high))
        low, high = _combined(lows), _combined(highs)
        return low + rng.random(low.shape) * (high - low)

    def _grid_axes(self) -> list[FloatArray]:
        """Coordinates of the grid along x, y, z, metres."""
        axes = []
        for low, high, count in zip(self.reachable_low, self.reachable_high, self.grid_shape(), strict=True):
            if self.positions == "vertices":
                axes.append(np.linspace(low, high, count))
            else:
                axes.append(low + (high - low) * (np.arange(count) + 0.5) / count)
        return axes

    def landmark_walls(self) -> tuple[Wall, ...]:
        """The walls that may carry landmarks, in the order of `walls`."""
        return tuple(_wall(name, self.size) for name in self.walls)

    def contains(self, points: Any) -> Any:
        """Whether points `(..., 3)` lie in the closed room, `(...)` bool."""
        p = np.asarray(points)
        inside = (p >= -PLACEMENT_TOLERANCE) & (p <= np.asarray(self.size) + PLACEMENT_TOLERANCE)
        return inside.all(axis=-1)


def _combined(axes: Sequence[FloatArray]) -> FloatArray:
    """Every combination of coordinates along x, y, z, `(P, 3)`; z varies fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _wall(name: str, size: tuple[float, float, float]) -> Wall:
    ex, ey, ez = np.eye(3)
    zero = np.zeros(3)
    lx, ly, lz = size
    return {
        "x_min": Wall(name, zero, ey, ez, ex, (ly, lz)),
        "x_max": Wall(name, lx * ex, ey, ez, 0.0 - ex, (ly, lz)),
        "y_min": Wall(name, zero, ex, ez, ey, (lx, lz)),
        "y_max": Wall(name, ly * ey, ex, ez, 0.0 - ey, (lx, lz)),
        "floor": Wall(name, zero, ex, ey, ez, (lx, ly)),
        "ceiling": Wall(name, lz * ez, ex, ey, 0.0 - ez, (lx, ly)),
    }[name]
