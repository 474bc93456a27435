"""Crowd between a camera and a landmark, in compiled code: the obstacles of a room and the cylinders of a crowd state.

A landmark is blocked if an obstacle of the room or a cylinder intersects the line of sight to a required point, a
point that must be visible (`lmd.sight.obstacles`). The operations and their order are those of `lmd.space.crowd`, so
both modules give equal results. Each camera position has one crowd state; with several states, a position is listed
once for each state.

Most cylinders are excluded by a test of the line to the landmark's centre. The lines to the corners of a tag are
nowhere farther from this line than half a diagonal of the tag.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.memory import check_memory
from lmd.geometry.camera import Camera
from lmd.geometry.vectors import Vector
from lmd.scene.scene import Scene
from lmd.sight.obstacles import (
    POINTS,
    MeshObstacles,
    Obstacles,
    find_ends,
    half_edge,
    is_blocked,
    new_ends,
    obstacles_at,
    required_points,
    unobstructed,
    write_points,
)
from lmd.space.crowd import BOTTOM, COLUMNS, RADIUS, TOP, X, Y

# Relative margin of the test that excludes cylinders, more than the rounding of its terms.
MARGIN = 1e-6
DIAGONAL = math.sqrt(2.0)  # half the diagonal of a square over half its edge


class CrowdObstacles(NamedTuple):
    """Obstacles of a room and cylinders of a crowd, as seen from P camera positions."""

    room: Obstacles | MeshObstacles
    """Obstacles of the room at the positions."""
    positions: np.ndarray
    """`(P, 3)` positions, metres."""
    people: np.ndarray
    """`(P, N, 5)` cylinders for each position, columns as in `lmd.space.crowd.CrowdStates.people`. Cylinders that are
    too close to the camera are ignored; they come last.
    """
    standing: np.ndarray
    """`(P,)` for each position, number of cylinders that are not ignored; these come first in `people`."""


class CrowdEnds(NamedTuple):
    """Required points of K landmarks: points that must be visible from the camera."""

    room: np.ndarray
    """Required points of the landmarks, prepared for the test of the room's obstacles: the array `ends` of
    `lmd.sight.obstacles.find_ends`.
    """
    points: np.ndarray
    """`(K, 5, 3)` centre and corners, metres."""


def obstacles_of(scene: Scene, positions: FloatArray, states: IntArray | None) -> Any:
    """Obstacles of a scene as arrays, for compiled tests of lines from cameras at `positions` `(P, 3)`, metres.

    `states` `(P,)` has the index of the crowd state (arrangement of people) at each position. The argument may be None
    for a scene without a crowd.
    """
    room = obstacles_at(scene.room.blockers(), positions)
    if scene.crowd is None:
        return room
    assert states is not None, "each position has a crowd state"
    count = scene.crowd.people.shape[1]
    check_memory(8.0 * COLUMNS * count * len(positions), f"a crowd of {count} at {len(positions)} positions")
    present = scene.crowd.present(positions, states)
    order = np.argsort(~present, axis=1, kind="stable")
    people = np.take_along_axis(scene.crowd.people[states], order[..., None], axis=1)
    return CrowdObstacles(room, np.ascontiguousarray(positions), np.ascontiguousarray(people), present.sum(axis=1))


def unhindered(
    scene: Scene, camera: Camera, position: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> BoolArray:
    """Mask `(K,)` of the landmarks that neither the room nor a crowd blocks from a camera position.

    Compiled kernels must give equal results.

    Args:
        scene: the scene, with at most one crowd state.
        camera: camera at the position.
        position: p, `(3,)`, world frame, metres.
        landmarks, normals: `(K, 3)` positions, metres, and unit normals.
    """
    sight = scene.visibility.sight(camera)
    clear = unobstructed(scene.room, sight, position, landmarks, normals)
    if scene.crowd is None:
        return clear
    points = required_points(half_edge(sight), landmarks, normals)
    return np.asarray(clear & scene.crowd.clear(position, points).all(axis=0))


@new_ends.register(CrowdObstacles)
def _new_ends(obstacles: Any, count: Integer) -> Any:
    return CrowdEnds(new_ends(obstacles.room, count), np.empty((count, POINTS, 3)))


@find_ends.register(CrowdObstacles)
def _find_ends(obstacles: Any, sight: Any, place: Vector, normal: Vector, ends: Any, k: Integer) -> None:
    find_ends(obstacles.room, sight, place, normal, ends.room, k)
    write_points(sight, place, normal, ends.points, k)


@is_blocked.register(CrowdObstacles)
def _is_blocked(obstacles: Any, sight: Any, p: Integer, ends: Any, k: Integer) -> Any:
    positions, people, points, half = obstacles.positions, obstacles.people, ends.points, half_edge(sight)
    px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
    mx, my = points[k, 0, 0] - px, points[k, 0, 1] - py
    size, spread = mx * mx + my * my, DIAGONAL * half
    for m in range(obstacles.standing[p]):
        ex, ey, radius = people[p, m, X] - px, people[p, m, Y] - py, people[p, m, RADIUS]
        across, reach = mx * ey - my * ex, (radius + spread) * (1.0 + MARGIN)
        if across * across > reach * reach * size:
            continue
        bottom, top = people[p, m, BOTTOM], people[p, m, TOP]
        c = ex * ex + ey * ey - radius * radius
        for i in range(POINTS if half > 0.0 else 1):
            dx, dy, dz = points[k, i, 0] - px, points[k, i, 1] - py, points[k, i, 2] - pz
            a, b = dx * dx + dy * dy, dx * ex + dy * ey
            square = b * b - a * c
            entered, left = 0.0, 1.0
            if a == 0.0:
                if c >= 0.0:
                    continue
            elif square <= 0.0:
                continue
            else:
                root = math.sqrt(square)
                entered, left = max((b - root) / a, 0.0), min((b + root) / a, 1.0)
            if dz == 0.0:
                if not (bottom < pz and pz < top):
                    continue
            else:
                below, above = (bottom - pz) / dz, (top - pz) / dz
                entered, left = max(entered, min(below, above)), min(left, max(below, above))
            if entered < left:
                return True
    return is_blocked(obstacles.room, sight, p, ends.room, k)
