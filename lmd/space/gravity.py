"""Which way is up in a mesh: most of what is built is level or upright to a fraction of a degree."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.mesh import Mesh
from lmd.space.patches import areas_of
from lmd.space.triangles import unit_normals

# A triangle so near to level or upright, rad, counts as built so. Walls hardly ever run so along an axis by chance, and
# a scan's noise turns its triangles by more.
BUILT_TOLERANCE_RAD = 3.5e-3
# It is decided which of two axes points up where with one of them less than this share of the other's area is built so.
DECIDING_SHARE = 0.8
# What is level: the vertical part of its normal is greater. Floor and ceiling are so near to the lowest or the highest
# point, metres.
LEVEL_NORMAL_Z, STOREY = 0.999, 0.1


def doubt_of(mesh: Mesh, undecided: bool) -> str | None:
    """Why the other one of the axes z and y of a mesh's file seems to point up; None where nothing speaks for that.

    Args:
        mesh: turned to z up by the axis that is taken to point up.
        undecided: whether it counts that the room would be less high than it is now, where that is all there is.
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
    """The share of the area of triangles `(T, 3, 3)` that is level or upright where `up` `(3,)` points up."""
    vertical, area = np.abs(unit_normals(corners) @ up), areas_of(corners)
    return float(
        area[(vertical < np.sin(BUILT_TOLERANCE_RAD)) | (vertical > np.cos(BUILT_TOLERANCE_RAD))].sum() / area.sum()
    )


def _floor_area(corners: FloatArray, up: FloatArray) -> float:
    """What is level at the lowest point of triangles `(T, 3, 3)`, square metres."""
    height, is_level = corners @ up, np.abs(unit_normals(corners) @ up) > LEVEL_NORMAL_Z
    return float(areas_of(corners)[is_level & (height.max(axis=1) < height.min() + STOREY)].sum())
