"""Surfaces: flat rectangles that may carry landmarks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lmd.checks import FloatArray, InputError

# A grid whose cells are more elongated than this gives way to one with rows of unequal number.
MAX_ELONGATION = 3.0


@dataclass(frozen=True)
class Surface:
    """A rectangle that may carry landmarks: points are origin + a u + b v, 0 <= (a, b) <= extent.

    `u` runs horizontally and `v` up on side walls; on floor and ceiling they run along x and y. `normal` points
    to where the camera is. Vectors are `(3,)` in the world frame, extents in metres.
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

    def inset(self, margin: float) -> "Surface":
        """The surface without a strip as wide as `margin`, metres, along its edges.

        Raises:
            InputError: nothing is left.
        """
        along, up = (length - 2.0 * margin for length in self.extent)
        if min(along, up) < 0.0:
            raise InputError(
                f"surface {self.name} is {min(self.extent):.4g} m wide, too narrow for plates of {2.0 * margin:.4g} m."
            )
        return replace(self, origin=self.origin + margin * (self.u + self.v), extent=(along, up))

    def point(self, a: FloatArray | float, b: FloatArray | float) -> FloatArray:
        """World points `(..., 3)` at surface coordinates `a`, `b` of shape `(...)`, metres."""
        a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        return np.asarray(self.origin + a[..., None] * self.u + b[..., None] * self.v)

    def coordinates(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Surface coordinates of the projections of world points `(..., 3)`, clipped to the surface."""
        offset = np.asarray(points) - self.origin
        return np.clip(offset @ self.u, 0.0, self.extent[0]), np.clip(offset @ self.v, 0.0, self.extent[1])

    def grid(self, count: int) -> list[tuple[float, float]]:
        """Surface coordinates of `count` cell centres, with cells as square as an even grid allows.

        The grid runs along the longer side; 15 landmarks on the paper's walls make 5 x 3.
        """
        if count == 0:
            return []
        swap = self.extent[1] > self.extent[0]
        long, short = max(self.extent), min(self.extent)

        def elongation(rows: int) -> float:
            cell = (long / (count / rows)) / (short / rows)
            return max(cell, 1.0 / cell)

        even = min((r for r in range(1, count + 1) if count % r == 0), key=elongation)
        rows = even if elongation(even) <= MAX_ELONGATION else min(range(1, count + 1), key=elongation)
        points = []
        for row in range(rows):
            in_row = count // rows + (row < count % rows)
            for i in range(in_row):
                along, across = long * (i + 0.5) / in_row, short * (row + 0.5) / rows
                points.append((across, along) if swap else (along, across))
        return points

    def distance(self, points: FloatArray) -> FloatArray:
        """How far world points `(..., 3)` are from the surface, `(...)`, metres."""
        return np.asarray(np.linalg.norm(points - self.point(*self.coordinates(points)), axis=-1))


class SurfaceArrays(NamedTuple):
    """Surfaces as arrays, for many landmarks at once and for compiled code.

    origin, u, v, normal `(W, 3)`; extent `(W, 2)`; shares `(W,)`, the cumulative share of the area, for drawing one.
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    normal: np.ndarray
    extent: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, surfaces: Sequence[Surface]) -> "SurfaceArrays":
        """The arrays of some surfaces, in their order."""
        origin, u, v, normal, extent = (
            np.array([getattr(surface, name) for surface in surfaces])
            for name in ("origin", "u", "v", "normal", "extent")
        )
        area = np.array([surface.area for surface in surfaces])
        return cls(origin, u, v, normal, extent, np.cumsum(area / area.sum()))

    def depth(self, points: FloatArray) -> FloatArray:
        """Height of points `(..., 3)` above the plane of each surface, `(..., W)`, metres."""
        return np.asarray(((points[..., None, :] - self.origin) * self.normal).sum(axis=-1))

    def points(self, surface: np.ndarray, at: FloatArray) -> FloatArray:
        """World points `(..., 3)` at coordinates `at` `(..., 2)`, clipped to the extent, on surfaces `(...)`."""
        at = np.clip(at, 0.0, self.extent[surface])
        return np.asarray(self.origin[surface] + at[..., :1] * self.u[surface] + at[..., 1:] * self.v[surface])

    def coordinates(self, surface: np.ndarray, points: FloatArray) -> FloatArray:
        """Coordinates `(..., 2)` of the projections of `points` `(..., 3)` to surfaces `(...)`, not clipped."""
        offset = points - self.origin[surface]
        at = [(offset * self.u[surface]).sum(axis=-1), (offset * self.v[surface]).sum(axis=-1)]
        return np.stack(at, axis=-1)
