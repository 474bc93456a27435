"""Rooms whose camera positions are those of a grid in a box, as far as they can be reached."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.space.blockers import Blockers
from lmd.space.grid import cell_borders, combined, grid_axes, grid_counts, kronecker, latin_hypercube
from lmd.space.surface import FILE_TOLERANCE, PLACEMENT_TOLERANCE, Surface, SurfaceArrays, surface_near
from lmd.space.triangles import Triangles

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
