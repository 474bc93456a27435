"""Convex bodies that block lines of sight, each the intersection of half-spaces.

Functions for polygons make the upright bodies that fill the space outside a floor plan.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, vector
from lmd.space.surface import PLACEMENT_TOLERANCE

# Overlap of adjacent bodies, metres: more than rounding errors, and too little to protrude at a corner.
OVERLAP_M = 1e-9


class Body(NamedTuple):
    """Convex body, the intersection of m half-spaces bounded by planes."""

    normals: FloatArray
    """Outward unit normals, `(m, 3)`."""
    offsets: FloatArray
    """Offset n . x of each plane, where n is its normal, metres, `(m,)`."""
    solid: BoolArray
    """True for planes that are faces of the body, False for planes between the body and an adjacent body, `(m,)`."""


class Blockers(NamedTuple):
    """M convex bodies that block lines of sight, as arrays of all their planes.

    There are J planes in total, in the order of the bodies.
    """

    normals: np.ndarray
    """Outward unit normals, `(J, 3)`."""
    offsets: np.ndarray
    """Offset n . x of each plane with the normal n, metres, `(J,)`; faces have been moved inwards, see `of`."""
    solid: np.ndarray
    """True for planes that are faces of a body, False for planes between two adjacent bodies, `(J,)`."""
    first: np.ndarray
    """Rows `first[m]` to `first[m + 1] - 1` of the other arrays are the planes of body m, `(M + 1,)`."""

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Blockers":
        """Collect the planes of one or more bodies in arrays, and move the planes slightly.

        Planes that are faces of a body are moved inwards by `PLACEMENT_TOLERANCE`, so that points on a face are outside
        the body. Planes between adjacent bodies are moved outwards by `OVERLAP_M`, so that the bodies overlap.
        """
        normals, offsets, solid = (np.concatenate(parts) for parts in zip(*bodies, strict=True))
        offsets = offsets + np.where(solid, -PLACEMENT_TOLERANCE, OVERLAP_M)
        first = np.append(0, np.cumsum([len(body.offsets) for body in bodies]))
        return cls(np.ascontiguousarray(normals), offsets, solid, first)

    def grown(self, by: float) -> "Blockers":
        """Copy of the bodies with all faces moved outwards by the distance `by`, metres."""
        return self._replace(offsets=self.offsets + by * self.solid)

    def heights(self, points: FloatArray) -> FloatArray:
        """Heights of points `(..., 3)` above the J planes of the bodies, metres, `(..., J)`.

        A height is the signed distance from the plane, positive on the outer side.
        """
        x, y, z = points[..., :1], points[..., 1:2], points[..., 2:]
        nx, ny, nz = self.normals.T
        return np.asarray(nx * x + ny * y + nz * z - self.offsets)

    def inside(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` inside a body, `(...)`."""
        return np.asarray((np.maximum.reduceat(self.heights(points), self.first[:-1], axis=-1) < 0.0).any(axis=-1))

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the straight lines between pairs of points `(..., 3)` that no body blocks, `(...)`."""
        start, end = self.heights(starts), self.heights(ends)
        with np.errstate(all="ignore"):  # t is unused for lines that do not cross the plane
            t = start / (start - end)
        apart = (start >= 0.0) & (end >= 0.0)
        enters = np.where(start >= 0.0, np.where(apart, np.inf, t), 0.0)
        leaves = np.where((start < 0.0) & (end >= 0.0), t, 1.0)
        bodies = self.first[:-1]
        entered = np.maximum.reduceat(enters, bodies, axis=-1)
        return np.asarray((entered >= np.minimum.reduceat(leaves, bodies, axis=-1)).all(axis=-1))


# Edges closer than this coincide, metres.
SAME_EDGE = 1e-9

Ring = tuple[tuple[float, ...], ...]


def checked_ring(name: str, value: Any, either_way: bool = False) -> Ring:
    """Check the vertices [x, y], metres, of a simple polygon, and return them as a tuple.

    The vertices must run counter-clockwise, unless `either_way` is True.

    Raises:
        InputError: the value is not a polygon, the polygon crosses or touches itself, or its direction is wrong.
    """
    import shapely

    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) < 3:
        raise InputError(f"{name} must list at least 3 vertices [x, y], got {value!r}.", name)
    ring = tuple(vector(f"{name}[{i}]", vertex, 2) for i, vertex in enumerate(value))
    for i, vertex in enumerate(ring):
        if vertex == ring[i - 1]:
            raise InputError(f"{name}[{i}] repeats the vertex before it, {list(vertex)}.", name)
    polygon = shapely.Polygon(ring)
    if not polygon.is_valid:
        place = shapely.is_valid_reason(polygon).partition("[")[2].rstrip("]")
        raise InputError(f"{name} crosses or touches itself at ({', '.join(place.split())}).", name)
    if not either_way and not polygon.exterior.is_ccw:
        raise InputError(f"{name} must run counter-clockwise, seen from above, but it runs clockwise.", name)
    return ring


def edges(ring: Sequence[Sequence[float]] | FloatArray) -> FloatArray:
    """Edges of a polygon with the N vertices `ring`, each from one vertex to the next, `(N, 2, 2)`.

    The axes of the result are edge, end of the edge, and coordinate (x, y).
    """
    vertices = np.asarray(ring, dtype=np.float64)
    return np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)


def planes(edge: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lines n . x = d through the edges that `edges` returns, `(N, 2, 2)`; x is a point of the line.

    Return the unit normals n, `(N, 2)`, and the offsets d, metres, `(N,)`. The normals point to the right of the edges,
    so they point outwards if the edges run counter-clockwise.
    """
    way = edge[:, 1] - edge[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    normals = np.stack([way[:, 1], 0.0 - way[:, 0]], axis=1)
    return normals, np.asarray((normals * edge[:, 0]).sum(axis=1))


def on_hull(polygon: Any) -> Any:
    """Mask of the edges of a polygon's outer ring that lie on the polygon's convex hull, `(N,)`."""
    import shapely

    middles = shapely.points(edges(polygon.exterior.coords[:-1]).mean(axis=1))
    return shapely.distance(polygon.convex_hull.exterior, middles) <= SAME_EDGE


def upright_bodies(polygon: Any) -> list[Body]:
    """Make upright bodies of unlimited height that fill the space outside a floor plan, given as a shapely polygon.

    The bodies fill the polygon's holes, and the parts of its convex hull that lie outside the polygon. If a side of a
    body lies on the border of the hull, the body has no plane there, as no line between two points of the polygon
    crosses this side.
    """
    import shapely

    hull, walls = polygon.convex_hull, polygon.boundary
    bodies = []
    for part in shapely.get_parts(hull.difference(polygon)):
        for piece in [] if part.is_empty else _convex_pieces(part):
            edge = edges(shapely.orient_polygons(piece).exterior.coords[:-1])
            middles = shapely.points(edge.mean(axis=1))
            solid = shapely.distance(walls, middles) <= SAME_EDGE
            crossed = solid | (shapely.distance(hull.exterior, middles) > SAME_EDGE)
            normals, offsets = (
                np.concatenate([sides, tips])
                for sides, tips in zip(planes(edge[crossed]), _tips(edge, solid), strict=True)
            )
            faces = np.append(solid[crossed], np.full(len(offsets) - crossed.sum(), True))
            bodies.append(Body(np.pad(normals, [(0, 0), (0, 1)]), offsets, faces))
    return bodies


def _tips(edge: FloatArray, solid: Any) -> tuple[FloatArray, FloatArray]:
    """Lines that cut off the tips of a convex body in the space outside a room.

    Adjacent bodies overlap. So a corner between two edges that are not part of a wall would be a tip that protrudes
    into the room.

    Args:
        edge: edges of the body, counter-clockwise, metres, `(N, 2, 2)`.
        solid: mask of the edges that are part of a wall, `(N,)`.

    Returns:
        unit normals n, `(T, 2)`, and offsets d, metres, `(T,)`, of the lines n . x = d.
    """
    bare = ~solid & ~np.roll(solid, 1)  # tips at the start of an edge
    way = edge[:, 1] - edge[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    outwards = (np.roll(way, 1, axis=0) - way)[bare]
    normals = outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    return normals, np.asarray((normals * edge[bare, 0]).sum(axis=1))


def _convex_pieces(polygon: Any) -> list[Any]:
    import shapely

    if polygon.convex_hull.area - polygon.area <= SAME_EDGE * polygon.length:
        return [polygon]
    return list(shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)))
