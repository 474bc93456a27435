"""Every landmark pose of a wall grid at once: what each would gain, and what fractions of them cover.

Both functions see a landmark on its own, hidden by no other. With a `slack` they describe all landmarks of a piece of
wall instead of one: an axis is within reach of the piece if some landmark at most `slack` from its centre may cover it.
Moving by delta within the wall changes depth and distance by at most |delta| and leaves n . d as it is, so every
condition loosened by `slack` holds for the whole piece; without slack the decisions are those of `kernels`. What of the
room blocks a piece is not asked: some of it may be seen past it.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import FloatArray, real
from lmd.core.compiled import for_kernels, kernel
from lmd.core.memory import check_memory
from lmd.core.threads import in_parts
from lmd.scene.criteria import TOLERANCE, covers, from_position
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import band_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import find_ends, is_blocked, no_ends
from lmd.sight.viewpoint import see_alone
from lmd.space.space import Space
from lmd.space.surface import SurfaceArrays

# Poses, or positions, that a thread works on at a time: the work differs much between walls.
CHUNKS_PER_THREAD = 8
CELL_BYTES = 400  # what a cell takes while they are made: its vectors, and those of the pose, some of them twice


@dataclass(frozen=True)
class Cells:
    """Rectangular pieces of the walls, each with a flush landmark at its centre.

    Args:
        poses: the N landmarks.
        half_u, half_v: from each centre to the middle of two neighbouring sides, `(N, 3)`, metres.
    """

    poses: Deployment
    half_u: FloatArray
    half_v: FloatArray

    @property
    def radius(self) -> FloatArray:
        """From each centre to the corners, `(N,)`, metres, rounded up."""
        return np.asarray(np.linalg.norm(self.half_u + self.half_v, axis=1) * (1.0 + TOLERANCE))

    def picked(self, index: NDArray[Any]) -> "Cells":
        """The cells that `index` selects, numbers or `(N,)` bool."""
        return Cells(self.poses[index], self.half_u[index], self.half_v[index])

    def quarters(self) -> "Cells":
        """Each cell cut into four, `4 N` cells."""
        u, v = self.half_u / 2.0, self.half_v / 2.0
        points = np.concatenate([self.poses.positions + i * u + j * v for i in (-1, 1) for j in (-1, 1)])
        normals, surfaces = np.tile(self.poses.normals, (4, 1)), np.tile(self.poses.surfaces, 4)
        return Cells(Deployment(points, normals, surfaces), np.tile(u, (4, 1)), np.tile(v, (4, 1)))


def wall_cells(room: Space, spacing: float) -> Cells:
    """Where landmarks may hang cut into cells at most `spacing` metres wide, wall by wall and piece by piece.

    Cells of one piece are equal. Those at borders that run neither along u nor v may stick out.

    Raises:
        InputError: the spacing is not positive, or so many cells would not fit into memory.
    """
    real("spacing", spacing, above=0.0)
    parts = []
    pieces = [(number, wall, piece) for number, wall in enumerate(room.surfaces()) for piece in wall.pieces]
    for number, wall, piece in pieces:
        left, low = piece[0], piece[2:4].min()
        sides = piece[1] - left, piece[4:].max() - low
        # The small allowance keeps 7.5 / 0.25 at 30 cells however the division rounds.
        counts = [max(int(np.ceil(length / spacing - 1e-9)), 1) for length in sides]
        made = f"spacing = {spacing:g} makes {math.prod(counts):.4g} poses, which"
        check_memory(CELL_BYTES * math.prod(counts), made, "spacing")
        half_u, half_v = (length / n / 2.0 for length, n in zip(sides, counts, strict=True))
        i, j = (index.reshape(-1) for index in np.indices(counts))
        a, b = left + (2 * i + 1) * half_u, low + (2 * j + 1) * half_v
        meets = _meets(piece, a, b, half_u, half_v)
        points = wall.point(a[meets], b[meets])
        repeated = (np.tile(v, (len(points), 1)) for v in (wall.normal, half_u * wall.u, half_v * wall.v))
        parts.append((points, *repeated, np.full(len(points), number)))
    points, normals, us, vs, surfaces = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Cells(Deployment(points, normals, surfaces), us, vs)


def _meets(piece: FloatArray, a: FloatArray, b: FloatArray, half_u: float, half_v: float) -> NDArray[np.bool_]:
    """Whether cells with the centres `a`, `b` `(N,)` meet a trapezoid `(6,)`, see `lmd.space.allowed`."""
    left, right, *borders = piece
    ends = (np.clip((a + way * half_u - left) / max(right - left, 1e-300), 0.0, 1.0) for way in (-1.0, 1.0))
    low, high = zip(
        *((borders[0] + x * (borders[1] - borders[0]), borders[2] + x * (borders[3] - borders[2])) for x in ends),
        strict=True,
    )
    return np.asarray((np.maximum(*high) >= b - half_v) & (np.minimum(*low) <= b + half_v))


def candidate_poses(room: Space, spacing: float) -> Deployment:
    """A flush landmark at the centre of every cell of `wall_cells` where one may hang."""
    poses, surfaces = wall_cells(room, spacing).poses, SurfaceArrays.of(room.surfaces())
    return poses[surfaces.allow(poses.surfaces, surfaces.coordinates(poses.surfaces, poses.positions))]


@kernel
def _gains(start, stop, points, normals, slack, prices, positions, sight, obstacles, axes, bands, out):
    """Write the gains of poses `start` to `stop` into `out` `(N,)`; args as in `gains`, positions `(3, P)`."""
    size, row = positions.shape[1], np.empty(axes.shape[1])
    x, y, z, low = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    bottom, top, reached = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.bool_)
    ends = no_ends(obstacles, 1)
    for j in range(start, stop):
        px, py, pz = points[j, 0], points[j, 1], points[j, 2]
        nx, ny, nz = normals[j, 0], normals[j, 1], normals[j, 2]
        near = slack[j]
        for p in range(size):
            xp, yp, zp = px - positions[0, p], py - positions[1, p], pz - positions[2, p]
            in_reach, least, _, _ = from_position(sight, xp, yp, zp, nx, ny, nz, near)
            bottom[p], top[p] = band_of(xp, yp, zp, least, near)
            x[p], y[p], z[p], reached[p], low[p] = xp, yp, zp, in_reach, least
        for a in range(len(row)):
            row[a] = 0.0
        find_ends(obstacles, sight, px, py, pz, nx, ny, nz, ends, 0)
        for p in range(size):
            if not reached[p] or (near == 0.0 and is_blocked(obstacles, sight, p, ends, 0)):
                continue
            xp, yp, zp, least = x[p], y[p], z[p], low[p]
            start_axis, stop_axis = bands[bottom[p]] & -BLOCK, (bands[top[p]] + BLOCK - 1) & -BLOCK
            # One sum per axis, so that the loop vectorises without re-association.
            for a in range(np.uint64(start_axis), np.uint64(stop_axis)):
                covered = covers(sight, xp, yp, zp, nx, ny, nz, least, near, axes, a)
                row[a] += prices[p, a] if covered else 0.0
        total = 0.0
        for a in range(len(row)):
            total += row[a]
        out[j] = total


@kernel
def _cover(start, stop, points, normals, amounts, positions, sight, obstacles, axes, bands, out):
    """Write what covers positions `start` to `stop` into `out` `(P, D)` of zeros; args as in `covered_amounts`."""
    ends = no_ends(obstacles, 1)
    for j in range(len(points)):
        if amounts[j] == 0.0:
            continue
        px, py, pz, nx, ny, nz = points[j, 0], points[j, 1], points[j, 2], normals[j, 0], normals[j, 1], normals[j, 2]
        find_ends(obstacles, sight, px, py, pz, nx, ny, nz, ends, 0)
        for p in range(start, stop):
            pose = px, py, pz, nx, ny, nz
            x, y, z, low, first, last = see_alone(pose, positions, p, sight, obstacles, ends, bands)
            for a in range(np.uint64(first & -BLOCK), np.uint64((last + BLOCK - 1) & -BLOCK)):
                covered = covers(sight, x, y, z, nx, ny, nz, low, 0.0, axes, a)
                out[p, a] += amounts[j] if covered else 0.0


def by_edge(evaluator: Evaluator, poses: Deployment) -> Iterator[tuple[Evaluator, NDArray[Any]]]:
    """The poses whose tags have one size each, as indices, and the evaluator for it.

    Raises:
        InputError: the evaluator is for tags of several sizes, and the poses do not say which they have.
    """
    if evaluator.scene.tag.is_point or not poses.has_own_edges:
        evaluator.scene.check_one_size("what chooses among poses")
        yield evaluator, np.arange(len(poses))
        return
    edges = poses.edges_of(evaluator.scene.tag)
    for edge in np.unique(edges):
        yield evaluator.sized(np.array([edge])), np.flatnonzero(edges == edge)


def gains(evaluator: Evaluator, poses: Deployment, prices: FloatArray, slack: FloatArray | None = None) -> FloatArray:
    """What each pose earns: the sum of the prices of the positions and axes it covers.

    Args:
        poses: N poses.
        prices: `(P, D)` per position and axis of `evaluator`.
        slack: count what flush landmarks within this distance of each pose on its wall cover, `(N,)`, metres.

    Returns:
        `(N,)`, the same for any number of threads.
    """
    gained, slack = np.empty(len(poses)), np.zeros(len(poses)) if slack is None else slack
    positions = for_kernels(evaluator.positions.T)
    for e, index in by_edge(evaluator, poses):
        where, out = (poses.positions[index], poses.normals[index]), np.empty(len(index))
        if e.views is not None:
            out = e.views.gains(*where, prices, slack[index])
        else:
            fixed = (*where, slack[index], prices, positions, e.sight, e.obstacles, e.axes, e.bands, out)
            shared(_gains, len(index), e.threads, fixed)
        gained[index] = out
    return gained


def covered_amounts(evaluator: Evaluator, poses: Deployment, amounts: FloatArray) -> FloatArray:
    """How much of the poses covers each position and axis, c = sum_j x_j cover_j.

    Args:
        poses: N poses.
        amounts: x, `(N,)`, not negative.

    Returns:
        `(P, D)`, the same for any number of threads.
    """
    out = np.zeros((len(evaluator.positions), evaluator.axes.shape[1]))
    for e, index in by_edge(evaluator, poses):
        these = poses.positions[index], poses.normals[index], amounts[index]
        if e.views is not None:
            out += e.views.covered_amounts(*these)
        else:
            fixed = (*these, e.positions, e.sight, e.obstacles, e.axes, e.bands, out)
            shared(_cover, len(e.positions), e.threads, fixed)
    return out


def shared(kernel: Callable[..., None], size: int, threads: int, fixed: tuple[Any, ...]) -> None:
    """Run `kernel(start, stop, *fixed)` over `range(size)` on several threads."""
    in_parts(threads, lambda first, last: kernel(first, last, *fixed), size, threads * CHUNKS_PER_THREAD)
