"""A floor where nobody has seen one: what the walls enclose."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.checks import FloatArray, InputError

if TYPE_CHECKING:
    import shapely

JOINED = 0.15  # metres between the ends of walls that meet
LEAST_SHARE = 0.5  # of what all things extend over that walls must enclose
HULL = "it has no floor, and its walls do not close: the floor is the convex hull of all that was captured"


def floor_below(faces: Sequence[tuple[str, FloatArray]]) -> tuple[FloatArray, bool]:
    """The outline `(N, 3)` of a floor below faces `(n, 3)`, which have y up, and whether walls enclose it.

    Walls that do not close leave the convex hull of all faces.

    Args:
        faces: with the names of what they are of.

    Raises:
        InputError: there is nothing that extends over an area.
    """
    import shapely

    corners = np.concatenate([face for _, face in faces] or [np.zeros((0, 3))])
    hull = shapely.MultiPoint(corners[:, [0, 2]]).convex_hull
    if hull.geom_type != "Polygon":
        raise InputError("it has neither a floor nor walls.")
    walls = np.array([_ends(face) for name, face in faces if name.startswith("wall")]).reshape(-1, 2)
    closed = _enclosed(walls)
    if closed is None or closed.area < LEAST_SHARE * hull.area:
        closed, is_sure = hull, False
    else:
        is_sure = True
    ring = shapely.get_coordinates(closed.exterior)[:-1]
    return np.insert(ring, 1, corners[:, 1].min(), axis=1), is_sure


def _ends(face: FloatArray) -> FloatArray:
    """The ends of a wall as it is seen from above, `(2, 2)`: its two corners that are farthest apart there."""
    flat = face[:, [0, 2]]
    away = np.linalg.norm(flat[:, None] - flat, axis=-1)
    return np.asarray(flat[list(np.unravel_index(np.argmax(away), away.shape))])


def _enclosed(ends: FloatArray) -> "shapely.Polygon | None":
    """The largest polygon that walls with these ends, two of each `(2 n, 2)`, enclose; None for none."""
    import shapely

    if not len(ends):
        return None
    joined = np.linalg.norm(ends[:, None] - ends, axis=-1) < JOINED
    middles = (joined[..., None] * ends).sum(axis=1) / joined.sum(axis=1)[:, None]
    first = np.argmax(joined, axis=1)  # each end stands for those that meet there
    lines = shapely.linestrings(middles[first].reshape(-1, 2, 2))
    areas = shapely.get_parts(shapely.polygonize(shapely.get_parts(shapely.union_all(lines))))
    return max(areas, key=lambda polygon: polygon.area, default=None)
