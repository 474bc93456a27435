"""Surfaces: flat rectangles that may carry landmarks, everywhere or only in an allowed region."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.space.allowed import (
    EDGE_TOLERANCE,
    eroded,
    find_nearest,
    gathered,
    polygons,
    sizes,
    spread,
    trapezoids,
)

# Largest distance outside a room or a surface that counts as inside, metres: files are rounded to micrometres.
PLACEMENT_TOLERANCE = 1e-6
# Tolerance for a file's landmarks, metres: distance from the allowed region, and overlap of two footprints.
FILE_TOLERANCE = 2e-6
# Largest distance of a landmark from the surface to which it belongs, metres: more than measurement errors and the
# thickness of a board.
NEAR_SURFACE = 0.05
# Least cosine of the angle between the normals of a landmark and of the surface to which it belongs.
FACING_COSINE = math.sqrt(0.5)
# Largest |n_z| of the unit normal of a wall, and least |n_z| of the normal of a floor or a ceiling.
UPRIGHT, FLAT = 1e-3, 0.5
# Largest ratio of a cell's sides in a grid with equal rows; if cells would be longer, rows are unequal.
MAX_ELONGATION = 3.0


@dataclass(frozen=True)
class Surface:
    """Rectangle that may carry landmarks, everywhere or only in an allowed region.

    The points of the rectangle are origin + a u + b v with 0 <= (a, b) <= extent; u and v are orthogonal unit vectors.
    """

    name: str
    """Name in configurations and messages."""
    origin: FloatArray
    """Point with a = b = 0, world frame, metres, `(3,)`."""
    u: FloatArray
    """Unit vector, horizontal on walls, along x on floor and ceiling, `(3,)`."""
    v: FloatArray
    """Unit vector, up on walls, along y on floor and ceiling, `(3,)`."""
    normal: FloatArray
    """Unit normal towards the side of the camera, `(3,)`."""
    extent: tuple[float, float]
    """Lengths along u and v, metres."""
    allowed: Any = None
    """Allowed region, a shapely polygon in coordinates (a, b), see `lmd.space.allowed`; None for the whole rectangle.
    """

    @cached_property
    def pieces(self) -> FloatArray:
        """Allowed region cut into T trapezoids, `(T, 6)`; `lmd.space.allowed` defines the columns."""
        length, height = self.extent
        whole = np.array([[0.0, length, 0.0, 0.0, height, height]])
        return whole if self.allowed is None else trapezoids(self.allowed)

    @cached_property
    def parts(self) -> FloatArray:
        """Corners (a, b) of the trapezoids `pieces`, counter-clockwise, metres, `(T, 4, 2)`."""
        return np.stack([self.pieces[:, [0, 1, 1, 0]], self.pieces[:, [2, 3, 5, 4]]], axis=-1)

    @property
    def area(self) -> float:
        """Area of the allowed region, square metres."""
        return float(sizes(self.pieces).sum())

    def inset(self, margin: float) -> "Surface":
        """Surface without a strip of width `margin`, metres, along the edges of its allowed region.

        Raises:
            InputError: the allowed region becomes empty.
        """
        along, up = (length - 2.0 * margin for length in self.extent)
        if min(along, up) < 0.0:
            raise InputError(
                f"surface {self.name} is {min(self.extent):.4g} m wide, too narrow for footprints of "
                f"{2.0 * margin:.4g} m; leave it out of the surfaces, walls or faces of the room."
            )
        if self.allowed is None:
            return replace(self, origin=self.origin + margin * (self.u + self.v), extent=(along, up))
        left = eroded(self.allowed, margin)
        if left.is_empty:
            raise InputError(
                f"surface {self.name} has no place for footprints of {2.0 * margin:.4g} m where landmarks may hang."
            )
        return self.cropped(left)

    def cropped(self, region: Any) -> "Surface":
        """Surface cropped to the bounding rectangle of `region`, which becomes its allowed region."""
        import shapely

        a, b, a_end, b_end = region.bounds
        extent, whole = (a_end - a, b_end - b), shapely.box(a, b, a_end, b_end)
        allowed = None if region.equals(whole) else shapely.transform(region, lambda at: at - np.array([a, b]))
        return replace(self, origin=self.origin + a * self.u + b * self.v, extent=extent, allowed=allowed)

    def where(self, region: Any) -> "Surface":
        """Copy of the surface with `region` as its allowed region."""
        import shapely

        whole = shapely.box(0.0, 0.0, *self.extent)
        return replace(self, allowed=None if region.equals(whole) else region)

    def point(self, a: FloatArray | float, b: FloatArray | float) -> FloatArray:
        """Points in the world frame, `(..., 3)`, with the surface coordinates `a` and `b`, each `(...)`; metres."""
        a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        return np.asarray(self.origin + a[..., None] * self.u + b[..., None] * self.v)

    @property
    def is_upright(self) -> bool:
        """True if the surface is upright, as a wall is."""
        return bool(abs(self.normal[2]) < UPRIGHT)

    @property
    def is_mirrored(self) -> bool:
        """True if u points left for a viewer in front of the surface with `v` up."""
        return bool(np.cross(self.v, self.normal) @ self.u < 0.0)

    def from_left_and_below(self, at: FloatArray) -> FloatArray:
        """Convert (a, b) `(..., 2)` to distances from the left and the lower edge, seen from the front, metres.

        The function is its own inverse.
        """
        a, b = np.moveaxis(np.asarray(at, dtype=np.float64), -1, 0)
        return np.stack([self.extent[0] - a if self.is_mirrored else a, b], axis=-1)

    def coordinates(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Surface coordinates a, b `(...)` of the projections of world points `(..., 3)`, clipped to the rectangle."""
        offset = np.asarray(points) - self.origin
        return np.clip(offset @ self.u, 0.0, self.extent[0]), np.clip(offset @ self.v, 0.0, self.extent[1])

    def grid(self, count: int) -> list[tuple[float, float]]:
        """Surface coordinates (a, b), metres, of the centres of `count` cells of a grid with nearly square cells.

        For the paper's walls and `count` 15 the grid is 5 x 3. On a surface with an allowed region, the grid is refined
        until at least `count` centres are in the region; `count` evenly spaced centres among them are returned.
        """
        if count == 0:
            return []
        if self.allowed is None:
            return self._cell_centres(count)
        hanging, cells = SurfaceArrays.of([self]), count
        while True:
            at = np.array(self._cell_centres(cells))
            free = at[hanging.allow(np.zeros(len(at), dtype=np.int64), at)]
            if len(free) >= count:
                return [(a, b) for a, b in free[np.linspace(0, len(free) - 1, count).round().astype(int)].tolist()]
            cells = math.ceil(1.1 * cells + 1.0)

    def _cell_centres(self, count: int) -> list[tuple[float, float]]:
        """Coordinates (a, b), metres, of the centres of `count` cells that divide the whole rectangle."""
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
        """Distances of world points `(..., 3)` from the surface, metres, `(...)`."""
        with np.errstate(over="ignore"):  # very distant points have an infinite distance
            return np.asarray(np.linalg.norm(points - self.point(*self.coordinates(points)), axis=-1))


def surface_near(surfaces: Sequence[Surface], positions: FloatArray, normals: FloatArray) -> IntArray:
    """For each landmark `(K, 3)`, index of the surface to which the landmark belongs, `(K,)`; -1 if no surface is near.

    Candidates are surfaces within `NEAR_SURFACE` in front of or behind the landmark. The landmark belongs to the
    nearest candidate with a similar normal (`FACING_COSINE`), else to the nearest candidate.
    """
    distance = np.array([surface.distance(positions) for surface in surfaces])  # (W, K)
    facing = np.array([surface.normal for surface in surfaces]) @ normals.T >= FACING_COSINE
    rank = np.where(facing, distance, distance + NEAR_SURFACE)
    nearest = np.where(distance <= NEAR_SURFACE, rank, np.inf).argmin(axis=0)
    return np.where(distance.min(axis=0) <= NEAR_SURFACE, nearest, -1)


def free_of(face: Surface, region: Any, margin: float, band: Sequence[float] | None, taken: Sequence[Any]) -> Any:
    """Region of a surface in which landmarks are allowed, a shapely geometry, possibly empty.

    Regions have the coordinates (a, b) of the surface, metres.

    Args:
        face: surface.
        region: part of the bounding rectangle that belongs to the surface, a shapely polygon.
        margin: least distance from the edges of `region` and `taken`, measured along the surface's u and along its v,
            metres.
        band: lowest and highest z on an upright surface, metres.
        taken: regions that exclude landmarks.
    """
    import shapely

    out = shapely.union_all(taken)
    left = eroded(region.difference(out), margin) if margin else region
    if band is not None and face.is_upright:
        low, high = (z - float(face.origin[2]) for z in band)
        left = left.intersection(shapely.box(0.0, low, face.extent[0], high))
    return polygons(left.difference(out))


class SurfaceArrays(NamedTuple):
    """W surfaces as arrays, for vectorised and compiled code."""

    origin: np.ndarray
    """Corner of each surface at a = b = 0, metres, `(W, 3)`."""
    u: np.ndarray
    """Unit vectors u of the surfaces, see `Surface.u`, `(W, 3)`."""
    v: np.ndarray
    """Unit vectors v of the surfaces, see `Surface.v`, `(W, 3)`."""
    normal: np.ndarray
    """Unit normals, `(W, 3)`."""
    extent: np.ndarray
    """Lengths along u and v, metres, `(W, 2)`."""
    pieces: np.ndarray
    """Trapezoids of the allowed regions, see `lmd.space.allowed`, `(T, 6)`."""
    first: np.ndarray
    """Rows `first[w]` to `first[w + 1] - 1` of `pieces` are the trapezoids of surface w, `(W + 1,)`."""
    of_piece: np.ndarray
    """Index of the surface of each trapezoid, `(T,)`."""
    shares: np.ndarray
    """Cumulative areas of the trapezoids as fractions of the total area, for the random choice of a trapezoid, `(T,)`.
    """

    @classmethod
    def of(cls, surfaces: Sequence[Surface]) -> "SurfaceArrays":
        """Make the arrays of the given surfaces, in their order."""
        origin, u, v, normal, extent = (
            np.array([getattr(surface, name) for surface in surfaces])
            for name in ("origin", "u", "v", "normal", "extent")
        )
        pieces = [surface.pieces for surface in surfaces]
        counts, rows = [len(part) for part in pieces], np.concatenate(pieces)
        of_piece, area = np.repeat(np.arange(len(surfaces)), counts), sizes(rows)
        first = np.append(0, np.cumsum(counts))
        return cls(origin, u, v, normal, extent, rows, first, of_piece, np.cumsum(area / area.sum()))

    @property
    def area(self) -> FloatArray:
        """Area of each trapezoid, square metres, `(T,)`."""
        return sizes(self.pieces)

    def heights(self, points: FloatArray) -> FloatArray:
        """Height of points `(..., 3)` above the plane of each surface, `(..., W)`, metres."""
        return np.asarray(((points[..., None, :] - self.origin) * self.normal).sum(axis=-1))

    def points(self, surface: IntArray, at: FloatArray) -> FloatArray:
        """Allowed places that are nearest to given places: points in the world frame, metres, `(..., 3)`.

        Args:
            surface: index of the surface of each given place, `(...)`.
            at: coordinates (a, b) of each given place on its surface, metres, `(..., 2)`.
        """
        at, _ = self.nearest(surface, at)
        return np.asarray(self.origin[surface] + at[..., :1] * self.u[surface] + at[..., 1:] * self.v[surface])

    def nearest(self, surface: IntArray, at: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find the allowed places that are nearest to given places.

        Args:
            surface: index of the surface of each given place, `(...)`.
            at: coordinates (a, b) of each given place on its surface, metres, `(..., 2)`.

        Returns:
            coordinates (a, b) of the allowed places, metres, `(..., 2)`, and the index of the trapezoid of each,
            `(...)`.
        """
        at = np.asarray(at, dtype=np.float64)
        flat, out = at.reshape(-1, 2), np.empty((at.size // 2, 2))
        piece = np.empty(len(flat), dtype=np.int64)
        find_nearest(self.pieces, self.first, np.broadcast_to(surface, at.shape[:-1]).reshape(-1), flat, out, piece)
        return out.reshape(at.shape), piece.reshape(at.shape[:-1])

    def allow(self, surface: IntArray, at: FloatArray, tolerance: float = EDGE_TOLERANCE) -> BoolArray:
        """Mask of the places that are in the allowed region of their surface, `(...)`.

        Args:
            surface: index of the surface of each place, `(...)`.
            at: coordinates (a, b) of each place on its surface, metres, `(..., 2)`.
            tolerance: distance outside the region at which a place still counts, metres.
        """
        return np.asarray(np.abs(self.nearest(surface, at)[0] - at).max(axis=-1) <= tolerance)

    def spread(self, piece: IntArray, at: FloatArray) -> FloatArray:
        """Map points `at` `(..., 2)` of the unit square to points (a, b) of trapezoids.

        `piece` `(...)` has the index of the trapezoid of each point. Uniformly distributed points of the square give
        uniformly distributed points of the trapezoids.
        """
        return spread(self.pieces[piece], at)

    def gathered(self, piece: IntArray, places: FloatArray) -> FloatArray:
        """Map points (a, b) of trapezoids, `places` `(..., 2)`, to points of the unit square; inverse of `spread`.

        `piece` `(...)` has the index of the trapezoid of each point.
        """
        return gathered(self.pieces[piece], places)

    def coordinates(self, surface: IntArray, points: FloatArray) -> FloatArray:
        """Coordinates (a, b), metres, `(..., 2)`, of the projections of `points` `(..., 3)` onto surfaces.

        `surface` `(...)` has the indices of the surfaces. The coordinates are not clipped to the surfaces' rectangles.
        """
        offset = points - self.origin[surface]
        at = [(offset * self.u[surface]).sum(axis=-1), (offset * self.v[surface]).sum(axis=-1)]
        return np.stack(at, axis=-1)
