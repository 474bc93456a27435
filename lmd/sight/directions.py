"""Which axes can cover a landmark, looked up by the direction in which it is.

The sphere of directions is cut into cells: it is projected onto an octahedron, which is unfolded into a square of
`SIDE` x `SIDE` cells. For each cell, one table holds the axes that have *every* direction of the cell in view, far
enough from the border for a landmark to be covered (`Sight.inset`), another those that have *some*. Only axes in the
second and not in the first need the exact test. Where the depth decides, too, the first table alone does not do
(`sure` in `criteria.from_position`).

Tables are too large for work with many landmarks that is done once. There, axes are sorted by height (their z
coordinate): a cap lies in a cone around the direction of its landmark, and the cone's lowest and highest point bound
the axes that need the exact test to one contiguous band.

A cell is the projection of a parallelogram or of two triangles, so a cap that holds its corners holds all of it. If
they are at most rho from the centre of the cell, an axis has every direction of the cell in view that has the centre in
view by rho, and none that misses it by more.
"""

import math
from functools import cache

import numpy as np

from lmd.core.bits import BITS, LANES, ZERO
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import PYTHON, inlined, inner, kernel
from lmd.scene.criteria import Sight, in_view, sized

SIDE = 16 if PYTHON else 64  # plain Python would fill larger tables for seconds; what they settle is the same
NOWHERE = SIDE * SIDE  # one row more than there are cells: no axis at all
CERTAIN, POSSIBLE = 0, 1  # the tables: axes that have every direction of a cell in view, and some
# Added to rho, rad: far more than rounding moves a direction, a corner or an angle.
_SLACK = 1e-6
# Number of equal intervals of [-1, 1] in which the start of a band of axes is tabulated.
HEIGHT_BINS = 512
# Heights this far beyond the cone's ends are still tested; rounding moves the end of a narrow cone by 2e-8.
HEIGHT_MARGIN = 1e-6


@inner
def cell_of(x, y, z):
    """The cell of the direction of (x, y, z), anything if that is zero."""
    scale = 1.0 / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, y * scale
    below_u, below_v = math.copysign(1.0 - abs(v), u), math.copysign(1.0 - abs(u), v)
    u, v = (below_u if z < 0.0 else u), (below_v if z < 0.0 else v)
    row, column = np.int32((u + 1.0) * (SIDE / 2.0)), np.int32((v + 1.0) * (SIDE / 2.0))
    return max(0, min(row, SIDE - 1)) * SIDE + max(0, min(column, SIDE - 1))


@cache
def _cells() -> tuple[FloatArray, FloatArray]:
    """The directions of the centres of the cells, `(3, SIDE * SIDE)`, and the angle rho of each, rad."""
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
def _fill(sight, centres, angles, axes, shifts, table):
    """Set in `table` `(cells, W)` the axes that have the centre of a cell in view by its one of the `angles`.

    `shifts` `(3, 64 W)` are subtracted from the centre for each axis, which gives the direction seen from elsewhere.
    """
    for c in range(len(angles)):
        x, y, z, sine, cosine = centres[0, c], centres[1, c], centres[2, c], math.sin(angles[c]), math.cos(angles[c])
        for w in range(np.uint64(table.shape[1])):
            word = ZERO
            for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
                half = np.uint32(0)
                for lane in range(np.uint64(LANES)):
                    a = w * np.uint64(BITS) + first + lane
                    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
                    there = ax * ax + ay * ay + az * az > 0.0
                    ux, uy, uz = x - shifts[0, a], y - shifts[1, a], z - shifts[2, a]
                    scale = 1.0 / np.sqrt(ux * ux + uy * uy + uz * uz)
                    ux, uy, uz = scale * ux, scale * uy, scale * uz
                    seen = in_view(sight, ux, uy, uz, sine, cosine, ax, ay, az, rx, ry, rz) & there
                    half |= np.uint32(seen) << np.uint32(lane)
                word |= np.uint64(half) << first
            table[c, w] = word


def tables(sight: Sight, axes: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Sets `(NOWHERE + 1, W)` of the axes that have every, and some, direction of each cell in view.

    Args:
        axes: axis and right, `(6, 64 W)`, filled up with zeros to whole words.
    """
    certain, possible = np.zeros((2, NOWHERE + 1, axes.shape[1] // BITS), dtype=np.uint64)
    fill_tables(sight, axes, np.zeros((3, axes.shape[1])), 0.0, 0.0, certain=certain, possible=possible)
    return certain, possible


def fill_tables(
    sight: Sight,
    axes: FloatArray,
    shifts: FloatArray,
    most: float,
    off: float,
    *,
    certain: IntArray,
    possible: IntArray,
) -> None:
    """Fill the first rows of `certain` and `possible` `(>= SIDE * SIDE, W)` for cameras that are moved a little.

    A direction u from the point that they are moved about is the direction of u - s from one that is moved by s times
    the landmark's distance. If u is in a cell, and s differs from `shifts`, both differ from what the table is made for
    by a chord of at most 2 sin(rho / 2) + `off` between vectors no shorter than 1 - `most`.

    Args:
        sight, axes: as in `tables`.
        shifts: of each axis, `(3, 64 W)`.
        most: the length of the longest s.
        off: how far s may be from `shifts`.
        certain, possible: what is filled.
    """
    centres, rho = _cells()
    chord = (2.0 * np.sin(rho / 2.0) + off) / (2.0 * (1.0 - most))
    angles = rho if off == most == 0.0 else _SLACK + 2.0 * np.arcsin(np.minimum(chord, 1.0))
    sight = sized(sight, 0)  # landmarks of all sizes have one view
    wide = angles + sight.inset < np.pi / 2.0
    fill = (sight, centres)
    _fill(*fill, np.where(wide, angles + sight.inset, 0.0), axes, shifts, certain)
    _fill(*fill, -angles, axes, shifts, possible)
    certain[: len(rho)][~wide] = ZERO


def height_index(heights: FloatArray) -> np.ndarray:
    """`index[b]`: the first axis at or above the bottom of height bin b, less a margin, `(HEIGHT_BINS + 2,)`.

    Args:
        heights: z coordinates of the axes in ascending order, `(D,)`.
    """
    edges = np.linspace(-1.0, 1.0, HEIGHT_BINS + 1)
    return np.append(np.searchsorted(heights, edges - HEIGHT_MARGIN), len(heights)).astype(np.int64)


@inlined
def band_of(x, y, z, low, slack):
    """The heights of the axes whose depth of a landmark at offset (x, y, z) may reach `low`.

    They lie in a cone around the direction of the landmark. With a `slack`, in that of any landmark so far away.
    Scalars only and no branch: a loop over landmarks or positions vectorises with it.

    Returns:
        the first and last height bin, to be looked up in `height_index`.
    """
    distance = np.sqrt(x * x + y * y + z * z)
    height, cosine = z / distance, min(max(low / distance, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    across = math.sqrt(max(0.0, 1.0 - height * height))
    wide = distance - slack <= 0.0  # the slack reaches the camera: any axis
    bottom = -1.0 if wide | (-height >= cosine) else height * cosine - across * sine
    top = 1.0 if wide | (height >= cosine) else height * cosine + across * sine
    scale = HEIGHT_BINS / 2.0
    first = math.floor((bottom - HEIGHT_MARGIN + 1.0) * scale)
    # Twice the margin: the table starts each bin one margin early.
    last = math.floor((top + 2.0 * HEIGHT_MARGIN + 1.0) * scale) + 1
    return max(first, 0), min(last, HEIGHT_BINS + 1)
