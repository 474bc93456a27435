"""Triangle meshes of rooms: search for planar patches, test of the up axis, and search for the interior."""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.optional import optional
from lmd.geometry.squares import upright
from lmd.space.allowed import polygons
from lmd.space.gridded import combined, grid_axes, grid_counts
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface
from lmd.space.triangles import Triangles, unit_normals


@dataclass(frozen=True, eq=False)
class Mesh:
    """Mesh of V vertices and T triangles of named objects; world frame, z up, metres."""

    vertices: FloatArray
    """Vertices, `(V, 3)`."""
    faces: IntArray
    """Indices of the vertices of each triangle, `(T, 3)`."""
    of: IntArray
    """Index in `names` of the object of each triangle, `(T,)`."""
    names: tuple[str, ...]
    """Names of the objects; an object without a name has the empty text."""
    path: str = "the mesh"
    """Path of the file, for messages."""
    up: str = "z"
    """Axis of the file that points up, `z` or `y`."""
    up_is_sure: bool = True
    """True if the user or the file format defines the up axis."""


# Largest angle between adjacent triangles of a patch, rad, and largest distance of its vertices from its plane, metres.
BENT, UNEVEN = 1e-3, 1e-3
# Tolerance of the simplification of borders, metres.
STRAIGHT_M = 1e-6


def flat_parts(mesh: Mesh) -> list[IntArray]:
    """Indices of the triangles in each planar patch, largest area first; a patch belongs to one object."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    body = optional("trimesh", "mesh").Trimesh(mesh.vertices, mesh.faces, process=False)
    one, other = body.face_adjacency.T
    joined = (body.face_adjacency_angles < BENT) & (mesh.of[one] == mesh.of[other])
    pairs, count = (one[joined], other[joined]), len(mesh.faces)
    _, label = connected_components(coo_array((np.ones(joined.sum()), pairs), shape=(count, count)), False)
    area = np.bincount(label, body.area_faces)
    parts = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])
    return [parts[i] for i in np.argsort(-np.round(area, 9), kind="stable")]


def areas_of(corners: FloatArray) -> FloatArray:
    """Areas of triangles, square metres, `(T,)`; the axes of `corners` `(T, 3, 3)` are triangle, corner, coordinate."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(np.linalg.norm(np.cross(one, other), axis=1) / 2.0)


def plane_of(corners: FloatArray) -> tuple[FloatArray, float]:
    """Fit a plane to triangles; the axes of `corners` `(T, 3, 3)` are triangle, corner and coordinate.

    Returns:
        unit normal of the plane (mean weighted by area), `(3,)`, and largest distance of a corner from the plane,
        metres.
    """
    total = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal = total / np.linalg.norm(total) + 0.0
    return normal, float(np.ptp(corners @ normal)) / 2.0


def surface_of(name: str, corners: FloatArray, normal: FloatArray) -> Surface:
    """Make a surface from coplanar triangles; landmarks are allowed on the union of the triangles.

    The axes of `corners` `(T, 3, 3)` are triangle, corner and coordinate. The unit vectors u and v along the surface
    point right and up for a viewer on the side to which `normal` `(3,)` points.
    """
    import shapely

    u, v = (way + 0.0 for way in upright(normal))
    depth = corners @ normal
    at = np.stack([corners @ u, corners @ v], axis=-1)
    low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
    shape = polygons(shapely.simplify(shapely.union_all(shapely.polygons(at - low)), STRAIGHT_M))
    origin = (depth.min() + depth.max()) / 2.0 * normal + low[0] * u + low[1] * v
    length, width = (high - low).tolist()
    return Surface(name, origin + 0.0, u, v, normal, (length, width)).where(shape)


def grown(shapes: Any, width: float) -> Any:
    """Enlarge shapely geometries by `width`, metres, on all sides, with mitred corners; a negative width shrinks."""
    import shapely

    with np.errstate(divide="ignore", invalid="ignore"):  # warnings about intermediate results that GEOS discards
        return shapely.buffer(shapes, width, cap_style="square", join_style="mitre")


def standing_on(surface: Surface, triangles: FloatArray, height: float) -> list[Any]:
    """Project onto a surface the parts of triangles `(T, 3, 3)` that are at most `height`, metres, in front of it.

    The results are shapely shapes in the coordinates of the surface. A triangle perpendicular to the surface gives a
    line.
    """
    import shapely

    offset = triangles - surface.origin
    depth = offset @ surface.normal
    near = (depth.min(axis=1) <= height) & (depth.max(axis=1) >= -PLACEMENT_TOLERANCE)
    shapes = []
    for corners, above in zip(offset[near], depth[near], strict=True):
        part = _between(corners, above, -PLACEMENT_TOLERANCE, height)
        shapes.append(shapely.MultiPoint(np.stack([part @ surface.u, part @ surface.v], axis=1)).convex_hull)
    return shapes


def _between(corners: FloatArray, height: FloatArray, low: float, high: float) -> FloatArray:
    """Corners, in any order, `(m, 3)`, of the part of a triangle between the heights `low` and `high`, metres.

    `corners` `(3, 3)` are the corners of the whole triangle, and `height` `(3,)` are their heights above some plane.
    """
    found = [corners[(height >= low) & (height <= high)]]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        for limit in (low, high):
            if (height[i] - limit) * (height[j] - limit) < 0.0:
                share = (limit - height[i]) / (height[j] - height[i])
                found.append((corners[i] + share * (corners[j] - corners[i]))[None])
    return np.concatenate(found)


# Largest tilt of a triangle that counts as level or upright, rad. A scan's noise tilts triangles more, and few walls
# are aligned with a wrong axis by chance.
BUILT_TOLERANCE_RAD = 3.5e-3
# Largest ratio of level or upright areas, smaller over larger, at which the axis with the larger area is preferred.
DECIDING_SHARE = 0.8
# Least |n_z| of the unit normal of a level triangle, and largest distance of floor and ceiling from the lowest or
# highest point, metres.
LEVEL_NORMAL_Z, STOREY = 0.999, 0.1


def doubt_of(mesh: Mesh, undecided: bool) -> str | None:
    """Sentence with the evidence that the assumed up axis of a mesh's file (z or y) is wrong; None without evidence.

    Args:
        mesh: mesh, rotated to z up from the assumed axis `Mesh.up`.
        undecided: True to prefer the axis along which the room is lower, if both axes make about as much of the mesh
            upright or level.
    """
    corners = mesh.vertices[mesh.faces]
    other = "y" if mesh.up == "z" else "z"
    ways = {mesh.up: np.array([0.0, 0.0, 1.0]), other: np.array([0.0, 1.0 if other == "y" else -1.0, 0.0])}
    built = {axis: _built_along(corners, way) for axis, way in ways.items()}
    height = {axis: float(np.ptp(corners @ way)) for axis, way in ways.items()}
    against = built[mesh.up] < DECIDING_SHARE * built[other]
    tie = not against and built[other] >= DECIDING_SHARE * built[mesh.up]
    if not against and not (undecided and tie and height[mesh.up] > height[other]):
        return None
    told = [
        f"with {axis} up it is {height[axis]:.3g} m high, with {_floor_area(corners, way):.3g} m2 of floor, and "
        f"{100.0 * built[axis]:.0f} % of its triangles are upright or level"
        for axis, way in ways.items()
    ]
    return f"{'; '.join(told)}."


def _built_along(corners: FloatArray, up: FloatArray) -> float:
    """Fraction of the area of triangles `(T, 3, 3)` that is horizontal or vertical, if `up` `(3,)` points up."""
    vertical, area = np.abs(unit_normals(corners) @ up), areas_of(corners)
    return float(
        area[(vertical < np.sin(BUILT_TOLERANCE_RAD)) | (vertical > np.cos(BUILT_TOLERANCE_RAD))].sum() / area.sum()
    )


def _floor_area(corners: FloatArray, up: FloatArray) -> float:
    """Area of those of the triangles `(T, 3, 3)` that are level and near the lowest point, square metres.

    `up` `(3,)` is the unit vector that is assumed to point up.
    """
    height, is_level = corners @ up, np.abs(unit_normals(corners) @ up) > LEVEL_NORMAL_Z
    return float(areas_of(corners)[is_level & (height.max(axis=1) < height.min() + STOREY)].sum())


# Spacing of nodes, metres, and maximum number of nodes. If there would be more nodes, the spacing is increased.
STEP, MOST_NODES = 0.2, 400_000
# Least distance of a node from a triangle, metres: a node in the plane of a triangle would connect both sides.
NODE_CLEARANCE_M = 1e-3
# Largest distance along an axis between a point and the nodes tested for a clear line, node spacings.
STEPS_TO_NODES = 2


@dataclass(frozen=True)
class Interior:
    """Free space of a mesh as a graph, whose nodes are points of a grid.

    An edge joins two neighbouring nodes if no triangle crosses the line between them. Only points of the grid above a
    triangle are nodes, as there usually is no floor outside the walls. The room is the connected component with the
    largest volume; the insides of furniture and walls are other components.
    """

    triangles: Triangles
    """Triangles of the mesh."""
    low: FloatArray
    """Lower corner of the box around the mesh, metres, `(3,)`."""
    high: FloatArray
    """Upper corner of the box around the mesh, metres, `(3,)`."""

    @cached_property
    def _step(self) -> float:
        return max(STEP, float(np.cbrt(np.prod(self.high - self.low) / MOST_NODES)))

    @cached_property
    def _shape(self) -> tuple[int, int, int]:
        return grid_counts(self.high - self.low, self._step, "cells")

    @cached_property
    def _axes(self) -> list[FloatArray]:
        return grid_axes(self.low, self.high, self._shape, "cells")

    @cached_property
    def nodes(self) -> tuple[FloatArray, BoolArray]:
        """All points of the grid, metres, `(N, 3)`, and the mask of the points that are nodes in the room, `(N,)`."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        at, clear = combined(self._axes), self.triangles.clear
        below = at.copy()
        below[:, 2] = self.low[2] - 1.0
        free = (self.triangles.distance(at, NODE_CLEARANCE_M) >= NODE_CLEARANCE_M) & ~clear(at, below)
        index = np.arange(len(at)).reshape(self._shape)
        pairs = np.concatenate(
            [
                np.stack([index.take(range(n - 1), axis).ravel(), index.take(range(1, n), axis).ravel()])
                for axis, n in enumerate(self._shape)
            ],
            axis=1,
        )
        pairs = pairs[:, free[pairs].all(axis=0)]
        pairs = pairs[:, clear(at[pairs[0]], at[pairs[1]])]
        links = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(at), len(at)))
        _, piece = connected_components(links, directed=False)
        return at, free & (piece == np.bincount(piece[free], minlength=1).argmax()) if free.any() else free

    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` that are in the room or on its walls, `(...)`.

        All points must be in the box around the mesh, from `low` to `high`.
        """
        nodes, inside = self.nodes
        flat = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        found, left = np.zeros(len(flat), dtype=np.bool_), np.arange(len(flat))
        # Points in units of the node spacing, relative to the first node.
        pitch = np.maximum((self.high - self.low) / self._shape, 1e-12)
        at = (flat - [axis[0] for axis in self._axes]) / pitch
        for offset in _nearest_first():
            node = np.floor(at[left]).astype(int) + offset
            here = ((node >= 0) & (node < self._shape)).all(axis=1)
            number = np.ravel_multi_index(tuple(np.where(here[:, None], node, 0).T), self._shape)
            here &= inside[number]
            asked = left[here]
            found[asked] = self.triangles.clear(flat[asked], nodes[number[here]])
            left = left[~found[left]]
            if not len(left):
                break
        return found.reshape(points.shape[:-1])


def _nearest_first() -> IntArray:
    """Offsets to the grid nodes from which a clear line to a point is searched, nearest node first, `(M, 3)`.

    The offsets are integers, counted from the lowest corner of the grid cell that contains the point.
    """
    offsets = np.array(list(itertools.product(range(1 - STEPS_TO_NODES, 1 + STEPS_TO_NODES), repeat=3)))
    return offsets[np.argsort(np.abs(offsets - 0.5).sum(axis=1), kind="stable")]
