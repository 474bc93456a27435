"""What of the room stands between a camera and a landmark: the last criterion that the position alone decides.

A landmark is blocked if a body of the room (`lmd.space.blockers`) blocks the line of sight to any point of it that must
be seen: its centre, and for tags the corners of their black squares, too. The heights of the camera's positions above
the planes of the bodies are known beforehand, those of a landmark's points are found once for all positions. So a body
is mostly out of the way after a few comparisons: if all are in front of one of its planes.

A room from a mesh has triangles in place of bodies (`lmd.space.triangles`). They are too many for heights above each:
`Shadows` has the positions themselves, and each line is sent through the tree of the triangles.

A room with nothing in the way has `Obstacles` without a body: kernels are not compiled for it by itself.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.core.memory import check_memory
from lmd.geometry.squares import VERTICAL_TOLERANCE, upright, upright_axes
from lmd.space.blockers import Blockers
from lmd.space.space import Space
from lmd.space.triangles import Triangles, is_crossed

POINTS = 5  # of a tag: centre and corners


class Obstacles(NamedTuple):
    """The arrays of `Blockers`, and the heights of P positions above their planes, `(P, J)`, metres."""

    normals: np.ndarray
    offsets: np.ndarray
    first: np.ndarray
    heights: np.ndarray


class Shadows(NamedTuple):
    """The triangles of a mesh, and P positions, `(P, 3)`, metres."""

    triangles: Triangles
    positions: np.ndarray


def obstacles_at(blockers: Blockers | Triangles | None, positions: FloatArray) -> Obstacles | Shadows:
    """What stands in the way of cameras at `positions` `(P, 3)`."""
    if blockers is None:
        return Obstacles(np.empty((0, 3)), np.empty(0), np.zeros(1, dtype=np.int64), np.empty((0, 0)))
    if isinstance(blockers, Triangles):
        return Shadows(blockers, np.ascontiguousarray(positions))
    check_memory(8 * len(positions) * len(blockers.offsets), f"{len(positions)} positions beside obstacles")
    return Obstacles(blockers.normals, blockers.offsets, blockers.first, blockers.heights(positions))


@overridable
def half_edge(sight):  # type: ignore[no-untyped-def]
    """Half the edge of the square whose corners must be seen, too, metres; 0.0 for a point, a column for several sizes.

    Of the sight of one landmark a number, see `lmd.scene.criteria.sized`.
    """
    return 0.0


def seen_points(half: float | FloatArray, landmarks: FloatArray, normals: FloatArray) -> FloatArray:
    """The points of landmarks `(K, 3)` that must be seen, `(1, K, 3)` or, given half an edge, `(5, K, 3)`."""
    if not np.any(half):
        return landmarks[None]
    right, up = (np.reshape(half, (-1, 1)) * side for side in upright(normals))
    ways = (right + up, -(right + up), right - up, -(right - up))
    return np.stack([landmarks, *(landmarks + way for way in ways)])


def unobstructed(
    space: Space, sight: Any, position: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> BoolArray:
    """Which landmarks nothing of the room blocks from a position, `(K,)`: the reference.

    Args:
        space: the room.
        position: p, `(3,)`, world frame, metres.
        landmarks, normals: `(K, 3)` positions, metres, and unit normals.
    """
    points = seen_points(half_edge(sight), landmarks, normals)
    return np.asarray(space.clear(np.broadcast_to(position, points.shape), points).all(axis=0))


@dispatched
def is_clear(obstacles):  # type: ignore[no-untyped-def]
    """Whether there is nothing that could block anything."""


@is_clear.register(Obstacles)
def _has_no_body(obstacles):  # type: ignore[no-untyped-def]
    return len(obstacles.first) == 1


@is_clear.register(Shadows)
def _has_no_triangle(obstacles):  # type: ignore[no-untyped-def]
    return False


@dispatched
def no_ends(obstacles, count):  # type: ignore[no-untyped-def]
    """Room for the heights of so many landmarks, see `find_ends`."""


@no_ends.register(Obstacles)
def _no_ends(obstacles, count):  # type: ignore[no-untyped-def]
    return np.empty((count, POINTS + 1, len(obstacles.offsets)))


@no_ends.register(Shadows)
def _no_end_points(obstacles, count):  # type: ignore[no-untyped-def]
    return np.empty((count, POINTS, 3))


@dispatched
def find_ends(obstacles, sight, x, y, z, nx, ny, nz, ends, k):  # type: ignore[no-untyped-def]
    """Write the points of landmark k at (x, y, z) into `ends`.

    Before bodies these are heights above their planes, `(K, 6, J)`, of which the last row are the least; before
    triangles the points themselves, `(K, 5, 3)`.
    """


@find_ends.register(Obstacles)
def _find_ends(obstacles, sight, x, y, z, nx, ny, nz, ends, k):  # type: ignore[no-untyped-def]
    half, normals, offsets = half_edge(sight), obstacles.normals, obstacles.offsets
    rx, ry, rz, ux, uy, uz = upright_axes(nx, ny, nz, VERTICAL_TOLERANCE)
    for i in range(POINTS if half > 0.0 else 1):
        px, py, pz = _point(i, half, x, y, z, rx, ry, rz, ux, uy, uz)
        for j in range(len(offsets)):
            height = normals[j, 0] * px + normals[j, 1] * py + normals[j, 2] * pz - offsets[j]
            ends[k, i, j] = height
            ends[k, POINTS, j] = height if i == 0 else min(height, ends[k, POINTS, j])


@find_ends.register(Shadows)
def _find_end_points(obstacles, sight, x, y, z, nx, ny, nz, ends, k):  # type: ignore[no-untyped-def]
    half = half_edge(sight)
    rx, ry, rz, ux, uy, uz = upright_axes(nx, ny, nz, VERTICAL_TOLERANCE)
    for i in range(POINTS if half > 0.0 else 1):
        ends[k, i, 0], ends[k, i, 1], ends[k, i, 2] = _point(i, half, x, y, z, rx, ry, rz, ux, uy, uz)


@inlined
def _point(i, half, x, y, z, rx, ry, rz, ux, uy, uz):  # type: ignore[no-untyped-def]
    """Point i of a landmark at (x, y, z) with right r and up u: the centre, then r + u, -(r + u), r - u, -(r - u)."""
    way, up = half * (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), 1.0 if i < 3 else -1.0
    return x + way * (rx + up * ux), y + way * (ry + up * uy), z + way * (rz + up * uz)


@dispatched
def is_blocked(obstacles, sight, p, ends, k):  # type: ignore[no-untyped-def]
    """Whether something blocks landmark k from position p; `ends` as in `find_ends`."""


@is_blocked.register(Obstacles)
def _is_blocked(obstacles, sight, p, ends, k):  # type: ignore[no-untyped-def]
    # One nest of loops: to hand arrays on to a function would cost more than the work.
    first, heights = obstacles.first, obstacles.heights
    points = POINTS if half_edge(sight) > 0.0 else 1
    for m in range(len(first) - 1):
        for turn in range(points + 1):
            # The least heights come first: with them the line enters no later and leaves no earlier than to any point.
            row = POINTS if turn == 0 else turn - 1
            entered, left = 0.0, 1.0
            for j in range(first[m], first[m + 1]):
                start, end = heights[p, j], ends[k, row, j]
                if start >= 0.0:
                    if end >= 0.0:
                        entered = np.inf
                        break
                    entered = max(entered, start / (start - end))
                elif end >= 0.0:
                    left = min(left, start / (start - end))
            if turn == 0 and entered >= left:
                break
            if turn > 0 and entered < left:
                return True
    return False


@is_blocked.register(Shadows)
def _is_shadowed(obstacles, sight, p, ends, k):  # type: ignore[no-untyped-def]
    at, triangles = obstacles.positions, obstacles.triangles
    for i in range(POINTS if half_edge(sight) > 0.0 else 1):
        if is_crossed(triangles, at[p, 0], at[p, 1], at[p, 2], ends[k, i, 0], ends[k, i, 1], ends[k, i, 2]):
            return True
    return False
