"""Tables of the axes that can cover a landmark, by the direction of the landmark from the camera.

An axis is an orientation of the camera. The sphere of directions is projected onto an octahedron, which is unfolded
into a square of `SIDE` x `SIDE` cells. Two tables have a set of axes for each cell:

- `CERTAIN`: axes that have *every* direction of the cell in view, at least `SightModel.inset` inside the border.
- `POSSIBLE`: axes that may have *some* direction of the cell in view.

The border is that of the field of view. Only axes that are possible but not certain need the exact test. A certain axis
is sure to cover the landmark only if the landmark's depth is in the range `low` to `sure`, which
`criteria.from_position` returns.

The tables are too large for functions that pass over many landmarks only once. Such functions use a list of the axes,
sorted by height (their z coordinate). The axes that cover a landmark lie in a cone around its direction. Only axes with
heights between the lowest and the highest point of the cone need the exact test. These axes form one contiguous band of
the list.

A cell is the projection of a parallelogram or of two triangles, so a spherical cap that contains its corners contains
the cell. Let rho be the greatest angle between the cell's centre and a corner. If the centre is at least rho inside the
field of view of an axis, the axis has every direction of the cell in view. If the centre is more than rho outside, the
axis has no direction of the cell in view.
"""

import math
from functools import cache
from typing import Any

import numpy as np

from lmd.core.bits import BITS, LANES, ZERO
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import PYTHON, inlined, inner, kernel
from lmd.geometry.vectors import Vector, column3, dot3, minus3, pair3, times3
from lmd.scene.criteria import SightModel, in_view, sized

SIDE = 16 if PYTHON else 64  # cells per side; plain Python takes seconds to fill larger tables
EMPTY_ROW = SIDE * SIDE  # row of the tables after the rows of the cells: the empty set
CERTAIN, POSSIBLE = 0, 1  # index of the table of certain and of possible axes
# Margin added to rho, rad; it exceeds the rounding of directions, corners and angles.
_SLACK = 1e-6
# Number of equal bins of the heights [-1, 1] for which the first axis is tabulated.
HEIGHT_BINS = 512
# Margin of the heights beyond the ends of the cone; rounding moves the end of a narrow cone by 2e-8.
HEIGHT_MARGIN = 1e-6


@inner
def cell_of(way: Vector) -> Any:
    """Index of the cell of directions that contains the direction of the vector `way`; arbitrary for a zero vector."""
    x, y, z = way
    scale = 1.0 / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, y * scale
    below_u, below_v = math.copysign(1.0 - abs(v), u), math.copysign(1.0 - abs(u), v)
    u, v = (below_u if z < 0.0 else u), (below_v if z < 0.0 else v)
    row: Any
    column: Any
    row, column = np.int32((u + 1.0) * (SIDE / 2.0)), np.int32((v + 1.0) * (SIDE / 2.0))
    return max(0, min(row, SIDE - 1)) * SIDE + max(0, min(column, SIDE - 1))


@cache
def _cells() -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the centres of the cells of directions, `(3, SIDE * SIDE)`, and their radii, `(SIDE * SIDE,)`.

    The radius rho of a cell is the greatest angle between its centre and a corner, plus a margin, rad.
    """
    edge = np.linspace(-1.0, 1.0, SIDE + 1)
    u, v = np.meshgrid(edge, edge, indexing="ij")
    z = 1.0 - abs(u) - abs(v)
    below_u, below_v = np.copysign(1.0 - abs(v), u), np.copysign(1.0 - abs(u), v)
    points = np.stack([np.where(z < 0.0, below_u, u), np.where(z < 0.0, below_v, v), z], axis=-1)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    corners = np.stack([points[:-1, :-1], points[1:, :-1], points[:-1, 1:], points[1:, 1:]], axis=2).reshape(-1, 4, 3)
    centres = corners.sum(axis=1)
    centres /= np.linalg.norm(centres, axis=-1, keepdims=True)
    cosine = np.einsum("cik,ck->ci", corners, centres)
    return np.ascontiguousarray(centres.T), _SLACK + np.arccos(np.clip(cosine, -1.0, 1.0)).max(axis=1)


@kernel
def _fill(
    sight: Any, centres: FloatArray, angles: FloatArray, axes: FloatArray, shifts: FloatArray, table: np.ndarray
) -> None:
    """For each cell of directions, write the set of axes that have the cell's centre in view.

    A positive angle shrinks the field of view for a cell, a negative angle enlarges it.

    Args:
        sight: compiled model of sight.
        centres: unit directions of the centres of the cells, `(3, cells)`.
        angles: for each cell, angle by which the border of the field of view is moved inwards, rad, `(cells,)`;
            negative to move the border outwards.
        axes: optical axis and direction to the right in the image, unit vectors, for each axis, `(6, 64 W)`.
        shifts: displacement of the camera for each axis, divided by the distance of the landmark, `(3, 64 W)`; the
            quotient is subtracted from the centre.
        table: receives the sets of axes, bit sets of W words of 64 bits, `(cells, W)`.
    """
    for c in range(len(angles)):
        centre, sine, cosine = column3(centres, c), math.sin(angles[c]), math.cos(angles[c])
        for w in range(np.uint64(table.shape[1])):
            word = ZERO
            for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
                half = np.uint32(0)
                for lane in range(np.uint64(LANES)):
                    a = w * np.uint64(BITS) + first + lane
                    (axis, right), u = pair3(axes, a), minus3(centre, column3(shifts, a))
                    way = times3(1.0 / np.sqrt(dot3(u, u)), u)
                    seen = in_view(sight, way, sine, cosine, axis, right) & (dot3(axis, axis) > 0.0)
                    half |= np.uint32(seen) << np.uint32(lane)
                word |= np.uint64(half) << first
            table[c, w] = word


def tables(sight: SightModel, axes: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Make two tables, by direction of a landmark: axes that certainly, and axes that possibly, have it in view.

    An axis is an orientation of the camera. Row i of a table belongs to cell i of directions, and row `EMPTY_ROW` is
    empty. A row is a bit set of axes, W words of 64 bits.

    Args:
        sight: model of sight.
        axes: optical axis and direction to the right in the image, unit vectors, `(6, 64 W)`, padded with zeros to
            whole words.

    Returns:
        `CERTAIN`: axes that have every direction of the cell in view, at least `SightModel.inset` inside the border of
            the field of view, `(EMPTY_ROW + 1, W)`.
        `POSSIBLE`: axes that may have some direction of the cell in view, `(EMPTY_ROW + 1, W)`.
    """
    certain, possible = np.zeros((2, EMPTY_ROW + 1, axes.shape[1] // BITS), dtype=np.uint64)
    fill_tables(sight, axes, (np.zeros((3, axes.shape[1])), 0.0, 0.0), certain, possible)
    return certain, possible


def fill_tables(
    sight: SightModel, axes: FloatArray, shift: tuple[FloatArray, float, float], certain: IntArray, possible: IntArray
) -> None:
    """Fill two tables of axes, as made by `tables`, for cameras that are displaced from a common centre.

    Let u be the unit direction of a landmark from the centre. Let s be the displacement of a camera, divided by the
    distance of the landmark from the centre. The camera sees the landmark in the direction of u - s. The tables are
    made for c - s' in place of u - s, where c is the middle of the cell that contains u, and s' approximates s. With
    the angular radius rho of the cell, both vectors differ by at most 2 sin(rho / 2) + `error`. Both are at least
    1 - `longest` long.

    Args:
        sight: model of sight.
        axes: optical axis and direction to the right in the image, unit vectors, `(6, 64 W)`, padded with zeros to
            whole words.
        shift: tuple of three values: s' for each axis, `(3, 64 W)`; `longest`, an upper bound on |s|; and `error`, an
            upper bound on |s - s'|.
        certain, possible: receive the axes that certainly and that possibly have a landmark in view, in the first
            `SIDE * SIDE` rows, one row per cell, `(>= SIDE * SIDE, W)`.
    """
    (centres, rho), (shifts, longest, error) = _cells(), shift
    chord = (2.0 * np.sin(rho / 2.0) + error) / (2.0 * (1.0 - longest))
    angles = rho if error == longest == 0.0 else _SLACK + 2.0 * np.arcsin(np.minimum(chord, 1.0))
    sight = sized(sight, 0)  # the field of view does not depend on the size
    wide = angles + sight.inset < np.pi / 2.0
    _fill(sight, centres, np.where(wide, angles + sight.inset, 0.0), axes, shifts, certain)
    _fill(sight, centres, -angles, axes, shifts, possible)
    certain[: len(rho)][~wide] = ZERO


def height_index(heights: FloatArray) -> np.ndarray:
    """For each of `HEIGHT_BINS` equal ranges (bins) of heights, index of the first axis in the bin.

    The height of an axis is its z coordinate, from -1 to 1. The first axis is the lowest axis whose height is at least
    the lower limit of the bin, less a margin. The result is `(HEIGHT_BINS + 2,)`; its last two entries are the index
    for the height 1, and the number D of axes.

    Args:
        heights: z coordinates of the axes in ascending order, `(D,)`.
    """
    edges = np.linspace(-1.0, 1.0, HEIGHT_BINS + 1)
    return np.append(np.searchsorted(heights, edges - HEIGHT_MARGIN), len(heights)).astype(np.int64)


@inlined
def band_of(offset: Vector, low: Any, slack: Any) -> Any:
    """Range of bins of height (z coordinate) that contain all axes along which a landmark has at least the depth `low`.

    These axes lie in a cone around the direction of the landmark. With a positive `slack` (metres), the bins are valid
    for all landmarks that are at most `slack` away from the landmark at `offset`. The function has no branches, so that
    loops over it vectorise.

    Args:
        offset: offset of the landmark from the camera, metres.
        low: depth along the optical axis, metres.
        slack: greatest displacement of the landmark, metres.

    Returns:
        the first and the last bin, as indices into the result of `height_index`.
    """
    distance = np.sqrt(dot3(offset, offset))
    height, cosine = offset[2] / distance, min(max(low / distance, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    across = math.sqrt(max(0.0, 1.0 - height * height))
    wide = distance - slack <= 0.0  # the slack reaches the camera, so any axis is possible
    bottom = -1.0 if wide | (-height >= cosine) else height * cosine - across * sine
    top = 1.0 if wide | (height >= cosine) else height * cosine + across * sine
    scale = HEIGHT_BINS / 2.0
    first = math.floor((bottom - HEIGHT_MARGIN + 1.0) * scale)
    # Twice the margin, as `height_index` starts each bin one margin early.
    last = math.floor((top + 2.0 * HEIGHT_MARGIN + 1.0) * scale) + 1
    return max(first, 0), min(last, HEIGHT_BINS + 1)
