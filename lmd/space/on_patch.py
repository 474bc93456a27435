"""What lies on a planar patch of a mesh, or stands on it, in the coordinates of its surface."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.keep_out import KeepOut
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface

# A door or a window as it was captured is so near to its wall, metres.
ON_WALL = 0.15


def lying_on(surface: Surface, name: str, corners: FloatArray) -> KeepOut | None:
    """The keep-out of a surface that a thing with corners `(N, 3)` makes; None if it does not lie on that surface."""
    import shapely

    if np.abs((corners - surface.origin) @ surface.normal).max() > ON_WALL:
        return None
    at = surface.seen(
        np.stack([(corners - surface.origin) @ surface.u, (corners - surface.origin) @ surface.v], axis=-1)
    )
    whole = shapely.Polygon(at)
    inside = whole.intersection(shapely.box(0.0, 0.0, *surface.extent))
    if inside.geom_type != "Polygon" or inside.area < whole.area / 2.0:
        return None
    ring = shapely.get_coordinates(shapely.orient_polygons(inside))[:-1]
    return KeepOut(surface.name, corners=[tuple(corner) for corner in ring.tolist()], name=name)


def grown(shapes: Any, width: float) -> Any:
    """Shapes with a strip around them, less one where it is negative; corners stay corners."""
    import shapely

    with np.errstate(divide="ignore", invalid="ignore"):  # of trials that GEOS discards
        return shapely.buffer(shapes, width, cap_style="square", join_style="mitre")


def standing_on(surface: Surface, triangles: FloatArray, height: float) -> list[Any]:
    """What triangles `(T, 3, 3)` that lie on a patch, or within `height` metres of it, cover of it.

    Those that cross it at a right angle cover a line.
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
