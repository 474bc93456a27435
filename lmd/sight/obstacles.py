"""Obstacles of the room between a camera and a landmark.

A landmark is blocked if a convex body of the room (`lmd.space.blockers`) intersects the line of sight to a required
point: the centre, and for tags the corners of the tag's picture. The heights (signed distances) of the camera's
positions above the planes of the bodies are precomputed; the heights of a landmark's points above these planes are
computed once for all positions. A few comparisons then exclude most bodies: if the camera and all required points lie
in front of one plane of a body, this body does not block the landmark.

A room from a mesh has triangles in place of bodies (`lmd.space.triangles`). A table of their heights would be too
large: `MeshObstacles` has the positions, and each line of sight traverses the tree of the triangles.

An empty room has `Obstacles` without a body, so kernels need not be compiled separately for it.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.core.memory import check_memory
from lmd.geometry.squares import VERTICAL_TOLERANCE, upright, upright_axes
from lmd.geometry.vectors import Vector, dot3, plus3, row3, times3
from lmd.space.blockers import Blockers
from lmd.space.space import Space
from lmd.space.triangles import Triangles, is_crossed

POINTS = 5  # number of required points of a tag: centre and corners


class Obstacles(NamedTuple):
    """Convex bodies with J planes in total, and P camera positions."""

    normals: np.ndarray
    """`(J, 3)` outward unit normals of the planes, see `Blockers`."""
    offsets: np.ndarray
    """`(J,)` distances of the planes from the origin, metres, see `Blockers`."""
    first: np.ndarray
    """Index of the first plane of each body, followed by J, `(M + 1,)` for M bodies, see `Blockers`."""
    heights: np.ndarray
    """`(P, J)` signed height of each camera position above each plane, metres."""


class MeshObstacles(NamedTuple):
    """The triangles of a mesh, and P camera positions."""

    triangles: Triangles
    """Triangles with their search tree."""
    positions: np.ndarray
    """`(P, 3)` positions of the camera, metres."""


def obstacles_at(blockers: Blockers | Triangles | None, positions: FloatArray) -> Obstacles | MeshObstacles:
    """Obstacles prepared for cameras at `positions` `(P, 3)`, metres; no obstacles if `blockers` is None."""
    if blockers is None:
        return Obstacles(np.empty((0, 3)), np.empty(0), np.zeros(1, dtype=np.int64), np.empty((0, 0)))
    if isinstance(blockers, Triangles):
        return MeshObstacles(blockers, np.ascontiguousarray(positions))
    check_memory(8 * len(positions) * len(blockers.offsets), f"{len(positions)} positions beside obstacles")
    return Obstacles(blockers.normals, blockers.offsets, blockers.first, blockers.heights(positions))


@overridable
def half_edge(sight: Any) -> Any:
    """Half the edge length of the square whose corners must be seen, metres; 0.0 for a point landmark.

    The result is an array `(K,)` if the model of sight is for K landmarks of several sizes, else a number.
    """
    return 0.0


def required_points(half: float | FloatArray, landmarks: FloatArray, normals: FloatArray) -> FloatArray:
    """Points of the landmarks `(K, 3)` that must be seen: centres `(1, K, 3)`, or centres and corners `(5, K, 3)`.

    `half` is half the edge length, metres, a number or `(K,)`; 0 for point landmarks.
    """
    if not np.any(half):
        return landmarks[None]
    right, up = (np.reshape(half, (-1, 1)) * side for side in upright(normals))
    ways = (right + up, -(right + up), right - up, -(right - up))
    return np.stack([landmarks, *(landmarks + way for way in ways)])


def unobstructed(
    space: Space, sight: Any, position: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> BoolArray:
    """Mask `(K,)` of the landmarks that the room does not block from a position. Reference for the compiled kernels.

    Args:
        space: the room.
        sight: compiled model of sight, which defines the size of the tags.
        position: p, `(3,)`, world frame, metres.
        landmarks, normals: `(K, 3)` positions, metres, and unit normals.
    """
    points = required_points(half_edge(sight), landmarks, normals)
    return np.asarray(space.clear(np.broadcast_to(position, points.shape), points).all(axis=0))


@overridable
def is_clear(obstacles: Any) -> Any:
    """True if the room has no obstacles."""
    return False


@is_clear.register(Obstacles)
def _has_no_body(obstacles: Any) -> Any:
    return len(obstacles.first) == 1


@dispatched
def new_ends(obstacles: Any, count: Integer) -> Any:
    """Return an empty array in which `find_ends` stores the required points of `count` landmarks."""


@new_ends.register(Obstacles)
def _new_ends(obstacles: Any, count: Integer) -> Any:
    return np.empty((count, POINTS + 1, len(obstacles.offsets)))


@new_ends.register(MeshObstacles)
def _no_end_points(obstacles: Any, count: Integer) -> Any:
    return np.empty((count, POINTS, 3))


@dispatched
def find_ends(obstacles: Any, sight: Any, place: Vector, normal: Vector, ends: Any, k: Integer) -> None:
    """Write the required points of landmark k, at the position `place` with the unit normal `normal`, into `ends`.

    The required points are the centre and, for a tag, four corners. For `Obstacles` with J planes, `ends` is
    `(K, 6, J)`: `ends[k]` has the heights of the points above the planes in rows 0 to 4, and the least of these heights
    in row 5. For `MeshObstacles`, `ends` `(K, 5, 3)` has the points, metres.
    """


@find_ends.register(Obstacles)
def _find_ends(obstacles: Any, sight: Any, place: Vector, normal: Vector, ends: Any, k: Integer) -> None:
    half, normals, offsets = half_edge(sight), obstacles.normals, obstacles.offsets
    sides = upright_axes(normal, VERTICAL_TOLERANCE)
    for i in range(POINTS if half > 0.0 else 1):
        point = point_of(i, half, place, sides)
        for j in range(len(offsets)):
            height = dot3(row3(normals, j), point) - offsets[j]
            ends[k, i, j] = height
            ends[k, POINTS, j] = height if i == 0 else min(height, ends[k, POINTS, j])


@find_ends.register(MeshObstacles)
def _find_end_points(obstacles: Any, sight: Any, place: Vector, normal: Vector, ends: Any, k: Integer) -> None:
    write_points(sight, place, normal, ends, k)


@inlined
def write_points(sight: Any, place: Vector, normal: Vector, points: FloatArray, k: Integer) -> None:
    """Write the points of landmark k that must be seen into `points` `(K, POINTS, 3)`, metres.

    The points are the centre `place` and, for a tag, its corners.
    """
    half, sides = half_edge(sight), upright_axes(normal, VERTICAL_TOLERANCE)
    for i in range(POINTS if half > 0.0 else 1):
        points[k, i, 0], points[k, i, 1], points[k, i, 2] = point_of(i, half, place, sides)


@inlined
def point_of(i: Integer, half: float, place: Vector, sides: tuple[Vector, Vector]) -> Vector:
    """Point i of a landmark: its centre c = `place` for i = 0, otherwise a corner of the tag.

    The corners are `c + h (r + u)`, `c - h (r + u)`, `c + h (r - u)` and `c - h (r - u)`. Here h = `half` is half the
    edge length, metres; `sides` are the unit vectors r to the right and u up.
    """
    way, up = half * (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), 1.0 if i < 3 else -1.0
    return plus3(place, times3(way, plus3(sides[0], times3(up, sides[1]))))


@dispatched
def is_blocked(obstacles: Any, sight: Any, p: Integer, ends: Any, k: Integer) -> Any:
    """True if an obstacle blocks landmark k from position p.

    `ends` has the required points of the landmark, as written by `find_ends`.
    """


@is_blocked.register(Obstacles)
def _is_blocked(obstacles: Any, sight: Any, p: Integer, ends: Any, k: Integer) -> Any:
    # The loops are nested here: passing arrays to a function would take longer than the work.
    first, heights = obstacles.first, obstacles.heights
    points = POINTS if half_edge(sight) > 0.0 else 1
    for m in range(len(first) - 1):
        for turn in range(points + 1):
            # The minima are tested first: a line with these heights enters each half-space no later, and leaves it no
            # earlier, than the line to any required point.
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


@is_blocked.register(MeshObstacles)
def _is_shadowed(obstacles: Any, sight: Any, p: Integer, ends: Any, k: Integer) -> Any:
    at, triangles = obstacles.positions, obstacles.triangles
    for i in range(POINTS if half_edge(sight) > 0.0 else 1):
        if is_crossed(triangles, *row3(at, p), *row3(ends[k], i)):
            return True
    return False
