"""Planar patches of a mesh: adjacent triangles in one plane, as surfaces."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.optional import optional
from lmd.geometry.squares import upright
from lmd.space.allowed import polygons
from lmd.space.mesh import Mesh
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface

# Largest angle between adjacent triangles of a patch, rad, and largest distance of its vertices from its plane, metres.
BENT, UNEVEN = 1e-3, 1e-3
# Tolerance of the simplification of borders, metres.
STRAIGHT_M = 1e-6


def flat_parts(mesh: Mesh) -> list[IntArray]:
    """Indices of the triangles of each planar patch, largest area first; a patch belongs to one object."""
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
    """Areas of triangles `(T, 3, 3)`, square metres, `(T,)`."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(np.linalg.norm(np.cross(one, other), axis=1) / 2.0)


def plane_of(corners: FloatArray) -> tuple[FloatArray, float]:
    """Plane fitted to triangles `(T, 3, 3)`: mean unit normal, `(3,)`, and largest distance of a vertex, metres."""
    total = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal = total / np.linalg.norm(total) + 0.0
    return normal, float(np.ptp(corners @ normal)) / 2.0


def surface_of(name: str, corners: FloatArray, normal: FloatArray) -> Surface:
    """Surface of coplanar triangles `(T, 3, 3)`; their union is the allowed region.

    u and v point right and up for a viewer on the side of `normal` `(3,)`.
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
    """Buffer shapes by `width`, metres, with mitred corners; a negative width shrinks them."""
    import shapely

    with np.errstate(divide="ignore", invalid="ignore"):  # of intermediate results that GEOS discards
        return shapely.buffer(shapes, width, cap_style="square", join_style="mitre")


def standing_on(surface: Surface, triangles: FloatArray, height: float) -> list[Any]:
    """Projections to a surface of the parts of triangles `(T, 3, 3)` up to `height`, metres, in front of it.

    The result is shapely shapes in the coordinates of the surface. A triangle perpendicular to the surface gives a
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
    """Corners, `(m, 3)` in any order, of the part of a triangle `(3, 3)` between the heights `low` and `high`."""
    found = [corners[(height >= low) & (height <= high)]]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        for limit in (low, high):
            if (height[i] - limit) * (height[j] - limit) < 0.0:
                share = (limit - height[i]) / (height[j] - height[i])
                found.append((corners[i] + share * (corners[j] - corners[i]))[None])
    return np.concatenate(found)
