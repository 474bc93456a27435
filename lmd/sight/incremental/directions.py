"""What is seen of a landmark from all positions, and which axes can cover it, looked up by direction.

The sphere of directions is cut into cells: it is projected onto an octahedron, which is unfolded into a square of
`SIDE` x `SIDE` cells. For each cell, one table holds the axes whose cone contains *every* direction of the cell,
another those whose cone contains *some*. Only axes in the second and not in the first need the exact test. Where more
than the cone decides (`limited`), the first table does not apply.

A cell is the projection of a parallelogram or of two triangles, so a cap that holds its corners holds all of it. With
an axis at an angle alpha from the centre of a cell and the corners at most rho from it, the angles between the axis and
the directions of the cell are between alpha - rho and alpha + rho.
"""

import math

import numpy as np

from lmd.checks import FloatArray
from lmd.compiled import kernel
from lmd.sight.criteria import from_position
from lmd.sight.incremental.bits import packed

SIDE = 64
NOWHERE = SIDE * SIDE  # one row more than there are cells: no axis at all
# Added to rho, rad: far more than rounding moves a direction, a corner or an angle.
_SLACK = 1e-6


@kernel
def cell_of(x, y, z):
    """The cell of the direction of (x, y, z), anything if that is zero."""
    scale = 1.0 / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, y * scale
    below_u, below_v = math.copysign(1.0 - abs(v), u), math.copysign(1.0 - abs(u), v)
    u, v = (below_u if z < 0.0 else u), (below_v if z < 0.0 else v)
    row, column = np.int32((u + 1.0) * (SIDE / 2.0)), np.int32((v + 1.0) * (SIDE / 2.0))
    return max(0, min(row, SIDE - 1)) * SIDE + max(0, min(column, SIDE - 1))


@kernel
def see(ax, ay, az, nx, ny, nz, positions, sight, sighting):
    """Fill `sighting` with what is seen of a landmark at (ax, ay, az) with normal (nx, ny, nz)."""
    x, y, z, low, cell, limited, reached = sighting
    for p in range(positions.shape[1]):
        x[p], y[p], z[p] = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        reached[p], low[p], limited[p] = from_position(sight, x[p], y[p], z[p], nx, ny, nz, 0.0)
        cell[p] = cell_of(x[p], y[p], z[p])


def cones(axes: FloatArray, inner_cosine: float, outer_cosine: float) -> np.ndarray:
    """Sets `(2, NOWHERE + 1, W)` of the axes `(3, D)` whose cone contains every, and some, direction of each cell.

    The first are about the cone with `inner_cosine`, which contains nothing above 1, the second about `outer_cosine`.
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
    rho = _SLACK + np.arccos(np.clip(cosine, -1.0, 1.0)).max(axis=1, keepdims=True)
    # The angle alpha at which every, and some, direction is still in the cone, by its cosine.
    angle = np.arccos(np.clip([inner_cosine, outer_cosine], -1.0, 1.0)) + rho * [-1.0, 1.0]
    least = np.where(angle < 0.0, np.inf, np.where(angle > np.pi, -np.inf, np.cos(angle))).T[..., None]
    table = np.zeros((2, NOWHERE + 1, packed(axes[0] > 0.0).size), dtype=np.uint64)
    for row in range(0, NOWHERE, SIDE):  # all angles at once would take much memory
        part = slice(row, row + SIDE)
        table[:, part] = packed(centres[part] @ axes >= least[:, part])
    return table
