"""Gains and coverage of many candidate poses of landmarks on the walls, each evaluated without other landmarks.

Each camera position and axis has a price (weight). For each pose, `gains` sums the prices of the positions and axes
from which a landmark at the pose is covered. Each pose has an amount, the number of landmarks at it, which may be a
fraction. For each position and axis, `covered_amounts` sums the amounts of the covered poses.

With a positive distance `slack`, a pose represents a cell of a wall: an axis counts if it may cover some landmark at
most `slack` from the cell's centre. A move by delta within the wall changes depth and distance by at most |delta|, and
leaves the product of unit normal and offset, n . d, unchanged. So conditions that are loosened by `slack` hold for the
whole cell. Obstacles of the room are then ignored, as a part of the cell may be visible beside them. Without slack the
decisions equal the decisions of `kernels`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, real
from lmd.core.compiled import for_kernels, kernel
from lmd.core.memory import check_memory
from lmd.core.threads import in_parts
from lmd.geometry.vectors import column3, minus3, row3
from lmd.scene.criteria import TOLERANCE, covers, from_position
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import band_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import find_ends, is_blocked, new_ends
from lmd.sight.viewpoint import see_alone
from lmd.space.space import Space
from lmd.space.surface import SurfaceArrays

# Number of chunks of poses or positions per thread. Several chunks balance the load, as the work differs between walls.
CHUNKS_PER_THREAD = 8
CELL_BYTES = 400  # memory of a cell while cells are made: vectors of the cell and of its pose, some vectors twice


@dataclass(frozen=True)
class Cells:
    """Rectangular cells of the walls, each with a flush landmark at its centre.

    Args:
        poses: N landmarks at the centres of the cells.
        half_u, half_v: vectors from each centre to the midpoints of two adjacent sides, `(N, 3)`, metres.
    """

    poses: Deployment
    half_u: FloatArray
    half_v: FloatArray

    @property
    def radius(self) -> FloatArray:
        """Distance from each centre to the corners, `(N,)`, metres, rounded up."""
        return np.asarray(np.linalg.norm(self.half_u + self.half_v, axis=1) * (1.0 + TOLERANCE))

    def picked(self, index: NDArray[Any]) -> "Cells":
        """Cells selected by `index`, integers or a mask `(N,)`."""
        return Cells(self.poses[index], self.half_u[index], self.half_v[index])

    def quarters(self) -> "Cells":
        """Cut each cell into four cells, half as long and half as wide, `4 N` cells in total."""
        u, v = self.half_u / 2.0, self.half_v / 2.0
        points = np.concatenate([self.poses.positions + i * u + j * v for i in (-1, 1) for j in (-1, 1)])
        normals, surfaces = np.tile(self.poses.normals, (4, 1)), np.tile(self.poses.surfaces, 4)
        return Cells(Deployment(points, normals, surfaces), np.tile(u, (4, 1)), np.tile(v, (4, 1)))


def wall_cells(room: Space, spacing: float) -> Cells:
    """Cut the pieces of the allowed regions of all walls (`Surface.pieces`) into cells at most `spacing` metres wide.

    Cells of a piece are congruent. A cell may extend beyond a border that is parallel to neither u nor v.

    Raises:
        InputError: the spacing is not positive, or the cells would not fit into memory.
    """
    real("spacing", spacing, above=0.0)
    parts = []
    pieces = [(number, wall, piece) for number, wall in enumerate(room.surfaces()) for piece in wall.pieces]
    for number, wall, piece in pieces:
        left, low = piece[0], piece[2:4].min()
        sides = piece[1] - left, piece[4:].max() - low
        # The allowance makes 7.5 / 0.25 = 30 cells regardless of rounding.
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
    """Mask `(N,)` of the cells that meet a trapezoid `piece` `(6,)`, see `lmd.space.allowed`.

    The cells have the centres (a, b), `(N,)` each, and the half sides `half_u` and `half_v`, metres.
    """
    left, right, *borders = piece
    ends = (np.clip((a + way * half_u - left) / max(right - left, 1e-300), 0.0, 1.0) for way in (-1.0, 1.0))
    low, high = zip(
        *((borders[0] + x * (borders[1] - borders[0]), borders[2] + x * (borders[3] - borders[2])) for x in ends),
        strict=True,
    )
    return np.asarray((np.maximum(*high) >= b - half_v) & (np.minimum(*low) <= b + half_v))


def candidate_poses(room: Space, spacing: float) -> Deployment:
    """Landmarks flush with the walls: at the centres of the cells of `wall_cells` where a landmark may hang."""
    poses, surfaces = wall_cells(room, spacing).poses, SurfaceArrays.of(room.surfaces())
    return poses[surfaces.allow(poses.surfaces, surfaces.coordinates(poses.surfaces, poses.positions))]


@kernel
def _gains(
    start: Integer, stop: Integer, points: FloatArray, normals: FloatArray, slack: FloatArray, prices: FloatArray,
    parts: Any, out: FloatArray,
) -> None:  # fmt: skip
    """Write into `out` `(N,)` the results of `gains` for the poses `start` to `stop - 1`.

    `points` and `normals` `(N, 3)` are the positions, metres, and unit normals of the poses. `parts` is a tuple of the
    camera positions, `(3, P)`, and the fields `sight`, `obstacles`, `axes` and `bands` of the `Evaluator`.
    """
    positions, sight, obstacles, axes, bands = parts
    size, row = positions.shape[1], np.empty(axes.shape[1])
    x, y, z, low = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    bottom, top, reached = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.bool_)
    ends = new_ends(obstacles, 1)
    for j in range(start, stop):
        place, normal, near = row3(points, j), row3(normals, j), slack[j]
        for p in range(size):
            offset = minus3(place, column3(positions, p))
            in_reach, least, _, _ = from_position(sight, offset, normal, near)
            bottom[p], top[p] = band_of(offset, least, near)
            (x[p], y[p], z[p]), reached[p], low[p] = offset, in_reach, least
        for a in range(len(row)):
            row[a] = 0.0
        find_ends(obstacles, sight, place, normal, ends, 0)
        for p in range(size):
            if not reached[p] or (near == 0.0 and is_blocked(obstacles, sight, p, ends, 0)):
                continue
            offset, least = (x[p], y[p], z[p]), low[p]
            start_axis, stop_axis = bands[bottom[p]] & -BLOCK, (bands[top[p]] + BLOCK - 1) & -BLOCK
            # One sum per axis: the loop vectorises, and no sum is reordered.
            for a in range(np.uint64(start_axis), np.uint64(stop_axis)):
                covered = covers(sight, offset, normal, least, near, axes, a)
                row[a] += prices[p, a] if covered else 0.0
        total = 0.0
        for a in range(len(row)):
            total += row[a]
        out[j] = total


@kernel
def _sum_covered(
    start: Integer, stop: Integer, points: FloatArray, normals: FloatArray, amounts: FloatArray, parts: Any, out: Any
) -> None:
    """Add the result of `covered_amounts` for the positions `start` to `stop - 1` to the rows of `out` `(P, D)`.

    `points` and `normals` `(N, 3)` are the positions, metres, and unit normals of the poses. `parts` is a tuple of the
    camera positions, `(P, 3)`, and the fields `sight`, `obstacles`, `axes` and `bands` of the `Evaluator`.
    """
    positions, sight, obstacles, axes, bands = parts
    ends = new_ends(obstacles, 1)
    for j in range(len(points)):
        if amounts[j] == 0.0:
            continue
        place, normal = row3(points, j), row3(normals, j)
        find_ends(obstacles, sight, place, normal, ends, 0)
        for p in range(start, stop):
            offset, low, first, last = see_alone((place, normal), positions, p, sight, obstacles, ends, bands)
            for a in range(np.uint64(first & -BLOCK), np.uint64((last + BLOCK - 1) & -BLOCK)):
                covered = covers(sight, offset, normal, low, 0.0, axes, a)
                out[p, a] += amounts[j] if covered else 0.0


def by_edge(evaluator: Evaluator, poses: Deployment) -> Iterator[tuple[Evaluator, NDArray[Any]]]:
    """Yield, for each size of the tags, an evaluator for this size and the indices of the poses with tags of this size.

    Raises:
        InputError: the scene has tags of several sizes, and `poses` does not give the size of each tag.
    """
    if evaluator.scene.tag.is_point or not poses.has_own_edges:
        evaluator.scene.check_one_size("what chooses among poses")
        yield evaluator, np.arange(len(poses))
        return
    edges = poses.edges_of(evaluator.scene.tag)
    for edge in np.unique(edges):
        yield evaluator.sized(np.array([edge])), np.flatnonzero(edges == edge)


def gains(evaluator: Evaluator, poses: Deployment, prices: FloatArray, slack: FloatArray | None = None) -> FloatArray:
    """For each pose, sum of the prices of the camera positions and axes from which a landmark at the pose is covered.

    Args:
        evaluator: evaluator with P positions and D axes (orientations of the camera, padded to whole words).
        poses: N poses.
        prices: price (weight) of each position and axis, `(P, D)`.
        slack: radius, on the wall, of the cell that each pose represents, `(N,)`, metres; 0 by default.

    Returns:
        sums, `(N,)`, which do not depend on the number of threads.
    """
    gained, slack = np.empty(len(poses)), np.zeros(len(poses)) if slack is None else slack
    positions = for_kernels(evaluator.positions.T)
    for e, index in by_edge(evaluator, poses):
        where, out = (poses.positions[index], poses.normals[index]), np.empty(len(index))
        if e.views is not None:
            out = e.views.gains(*where, prices, slack[index])
        else:
            fixed = (*where, slack[index], prices, (positions, e.sight, e.obstacles, e.axes, e.bands), out)
            shared(_gains, len(index), e.threads, fixed)
        gained[index] = out
    return gained


def covered_amounts(evaluator: Evaluator, poses: Deployment, amounts: FloatArray) -> FloatArray:
    """For each camera position and axis, number of covered landmarks if pose j has x_j landmarks, possibly a fraction.

    The number is c = sum_j x_j cover_j, where cover_j is 1 if a landmark at pose j is covered, else 0.

    Args:
        evaluator: evaluator with P positions and D axes (orientations of the camera, padded to whole words).
        poses: N poses.
        amounts: number x_j of landmarks at each pose, `(N,)`, not negative.

    Returns:
        c, `(P, D)`, which does not depend on the number of threads.
    """
    out = np.zeros((len(evaluator.positions), evaluator.axes.shape[1]))
    for e, index in by_edge(evaluator, poses):
        these = poses.positions[index], poses.normals[index], amounts[index]
        if e.views is not None:
            out += e.views.covered_amounts(*these)
        else:
            fixed = (*these, (e.positions, e.sight, e.obstacles, e.axes, e.bands), out)
            shared(_sum_covered, len(e.positions), e.threads, fixed)
    return out


def shared(kernel: Callable[..., None], size: int, threads: int, fixed: tuple[Any, ...]) -> None:
    """Divide `range(size)` into chunks among the threads; run `kernel(start, stop, *fixed)` for each chunk."""
    in_parts(threads, lambda first, last: kernel(first, last, *fixed), size, threads * CHUNKS_PER_THREAD)
