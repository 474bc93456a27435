"""Squares in space: their corners, and the right and up vectors of upright tags."""

import math
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.geometry.vectors import Vector, times3

# Offsets (right, up) of the corners from the centre, in half edges: top-left, top-right, bottom-right, bottom-left as
# seen from the front, as in cv2.aruco.
CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])

# Largest length of the horizontal part of a unit normal that counts as vertical, as for tags on a floor or a ceiling.
VERTICAL_TOLERANCE = 0.1


def corners(centres: FloatArray, normals: FloatArray, ups: FloatArray, edge: float | FloatArray) -> FloatArray:
    """Corners of squares, in the order of `CORNERS`.

    Args:
        centres: centres of the squares, `(..., 3)`, world frame, metres.
        normals: unit normals of the front faces, `(..., 3)`.
        ups: unit vectors in the squares' planes that point to their upper edges, `(..., 3)`; the right vector is up x
            normal.
        edge: edge length, metres, one number or `(...)`.

    Returns:
        corners `(..., 4, 3)`, world frame, metres.
    """
    axes = np.stack([np.cross(ups, normals), np.broadcast_to(ups, np.shape(normals))], axis=-2)
    return np.asarray(centres[..., None, :] + np.asarray(edge)[..., None, None] / 2.0 * (CORNERS @ axes))


def upright(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right and up vectors of upright tags, as seen from the front: unit vectors `(..., 3)` each, world frame.

    The up vector is the direction in the tag's plane nearest to +z, or nearest to +y if the normal is within
    `VERTICAL_TOLERANCE` of vertical. Placed tags are upright, as upright tags can be mounted with a spirit level. Other
    rotations of a tag in its plane would gain little, as a square is symmetric under quarter turns.

    Args:
        normals: unit normals of the front faces, `(..., 3)`.
    """
    nx, ny, nz = np.moveaxis(np.asarray(normals, dtype=np.float64), -1, 0)
    across, zero = nx * nx + ny * ny, np.zeros(nx.shape)
    on_wall = across > VERTICAL_TOLERANCE * VERTICAL_TOLERANCE
    square = np.where(on_wall, across, nx * nx + nz * nz)
    length = np.sqrt(square)
    right = np.where(on_wall, [-ny, nx, zero], [nz, zero, -nx]) / length
    up = np.where(on_wall, [-(nx * nz), -(ny * nz), square], [-(nx * ny), square, -(ny * nz)]) / length
    return np.moveaxis(right, 0, -1), np.moveaxis(up, 0, -1)


@inlined
def upright_axes(normal: Vector, level: float) -> tuple[Vector, Vector]:
    """Right and up vectors of an upright tag with one unit normal, in compiled code, see `upright`. `level` is
    `VERTICAL_TOLERANCE`. A normal counts as vertical if the length of its horizontal part is at most `level`.
    """
    nx, ny, nz = normal
    across = nx * nx + ny * ny
    on_wall = across > level * level
    square = across if on_wall else nx * nx + nz * nz
    length = math.sqrt(square)
    tx, ty, tz = -ny if on_wall else nz, nx if on_wall else 0.0, 0.0 if on_wall else -nx
    ux, uy = -(nx * (nz if on_wall else ny)) / length, (-(ny * nz) if on_wall else square) / length
    return (tx / length, ty / length, tz / length), (ux, uy, (square if on_wall else -(ny * nz)) / length)


@inlined
def upright_sides(half: Any, normal: Vector) -> tuple[Vector, Vector]:
    """Vectors of length `half` from the centre of an upright tag to the midpoints of its right and upper edges."""
    right, up = upright_axes(normal, VERTICAL_TOLERANCE)
    return times3(half, right), times3(half, up)
