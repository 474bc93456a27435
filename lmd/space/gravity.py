"""Test of the up axis of a mesh, as most built surfaces are level or upright to a fraction of a degree."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.mesh import Mesh
from lmd.space.patches import areas_of
from lmd.space.triangles import unit_normals

# Largest tilt of a triangle that counts as level or upright, rad. The noise of a scan tilts triangles by more, and few
# walls are aligned with an axis by chance.
BUILT_TOLERANCE_RAD = 3.5e-3
# The up axis with the larger level or upright area is the better one if the ratio of the areas is below this.
DECIDING_SHARE = 0.8
# Least |n_z| of the unit normal of a level triangle, and largest distance of floor and ceiling from the lowest or
# highest point, metres.
LEVEL_NORMAL_Z, STOREY = 0.999, 0.1


def doubt_of(mesh: Mesh, undecided: bool) -> str | None:
    """Evidence that the assumed up axis of a mesh's file, z or y, is the wrong one of the two; None without evidence.

    Args:
        mesh: mesh, rotated to z up from the assumed axis `Mesh.up`.
        undecided: True to resolve a tie of the areas in favour of the axis with the lower room.
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
    """Share of the area of triangles `(T, 3, 3)` that is level or upright with respect to `up` `(3,)`."""
    vertical, area = np.abs(unit_normals(corners) @ up), areas_of(corners)
    return float(
        area[(vertical < np.sin(BUILT_TOLERANCE_RAD)) | (vertical > np.cos(BUILT_TOLERANCE_RAD))].sum() / area.sum()
    )


def _floor_area(corners: FloatArray, up: FloatArray) -> float:
    """Area of the level triangles near the lowest point of triangles `(T, 3, 3)`, square metres."""
    height, is_level = corners @ up, np.abs(unit_normals(corners) @ up) > LEVEL_NORMAL_Z
    return float(areas_of(corners)[is_level & (height.max(axis=1) < height.min() + STOREY)].sum())
