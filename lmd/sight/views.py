"""Landmarks that a camera sees from each pose of a sequence.

The decisions repeat the operations of `kernels` and of the reference, so the coverage along a trajectory equals the
coverage that an optimiser counts.
"""

from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels, kernel
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right
from lmd.geometry.vectors import pair3, row3
from lmd.scene.criteria import covers, sized
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.crowd import obstacles_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import is_clear, new_ends
from lmd.sight.reference import Views, seen_from
from lmd.sight.viewpoint import fill_viewpoint, is_shown, load_deployment, viewpoint_for


@kernel
def _mark_visible(
    positions: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray, sight: Any, obstacles: Any,
    seen: Any,
) -> None:  # fmt: skip
    """Set the entries of `seen` `(N, K)` to True for the landmarks that are covered from each of N poses.

    Args:
        positions: positions of the camera, `(N, 3)`, metres.
        axes: optical axis and direction to the right in the image, unit vectors, for each pose, `(6, N)`.
        landmarks, normals: positions, metres, and unit normals, `(1, 3, K)`.
        sight: compiled model of sight.
        obstacles: obstacles prepared for the positions, see `obstacles_of`.
        seen: mask, False at first.
    """
    count, clear = landmarks.shape[2], is_clear(obstacles)
    view, room = viewpoint_for(count), (obstacles, clear, new_ends(obstacles, count))
    load_deployment(0, landmarks, normals, sight, room, view.near_poses)
    x, y, z, low, reached = view.x, view.y, view.z, view.low, view.reached
    for k in range(count):
        view.near_index[k] = k
    for i in range(len(positions)):
        fill_viewpoint(view, count, row3(positions, i), sight, None)
        for k in range(count):
            _, normal = pair3(view.near_poses, k)
            if reached[k] and covers(sized(sight, k), (x[k], y[k], z[k]), normal, low[k], 0.0, axes, i):
                seen[i, k] = is_shown(k, view, count, i, sight, room)


def visible(evaluator: Evaluator, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """Mask of the landmarks covered from each pose, `(N, K)`; for a rig, covered by at least one of its cameras.

    Args:
        deployment: K landmarks.
        positions: positions of the camera, or of the body of a rig, `(N, 3)`, world frame, metres.
        axes: optical axis and direction to the right in the image of the camera (or of the body), unit vectors in the
            world frame, `(N, 6)` (`lmd.geometry.se3.axis_and_right`). The optical axis alone, `(N, 3)`, suffices for
            criteria that need no roll.
    """
    return np.asarray(visible_to_each(evaluator, deployment, positions, axes).any(axis=0))


def visible_to_each(
    evaluator: Evaluator,
    deployment: Deployment,
    positions: FloatArray,
    axes: FloatArray,
    states: IntArray | None = None,
) -> BoolArray:
    """Mask of the landmarks that each of the C cameras of the scene covers from each pose, `(C, N, K)`.

    With a crowd, `states` `(N,)` has the index of the crowd state (arrangement of people) at each pose. Other arguments
    as in `visible`.
    """
    evaluator = evaluator.sized(deployment.edges)
    scene, axes = evaluator.scene, np.pad(axes, [(0, 0), (0, 6 - axes.shape[1])])
    if scene.rig is None:
        return _visible(scene, scene.cameras[0], deployment, (positions, axes), states)[None]
    views = zip(scene.cameras, *scene.rig.views(axes), strict=True)
    return np.stack([_visible(scene, camera, deployment, (positions + by, turned)) for camera, by, turned in views])


def visible_through(scene: Scene, camera: Camera, deployment: Deployment, poses: FloatArray) -> BoolArray:
    """Mask `(N, K)` of the landmarks covered by a camera at `poses` `(N, 4, 4)`, camera to world.

    The poses are as in `lmd.geometry.se3.camera_pose`.
    """
    scene = scene.sized(deployment.edges)
    return _visible(scene, camera, deployment, (poses[:, :3, 3], axis_and_right(poses)))


def _visible(
    scene: Scene, camera: Camera, deployment: Deployment, poses: Views, states: IntArray | None = None
) -> BoolArray:
    """Mask of the landmarks that one camera covers from each of N poses, `(N, K)`.

    `poses` is a pair: the positions, metres, `(N, 3)`; and the axes `(N, 6)`. The axes are the optical axis and the
    direction to the right in the image, unit vectors in the world frame. `states` `(N,)` has the index of the crowd
    state (arrangement of people) at each pose; None for a scene without a crowd.
    """
    scene.check_count(len(deployment))
    if states is None:
        scene.check_no_crowd("a view from single poses")
    sight = scene.visibility.sight(camera)
    if sight is None:
        return seen_from(scene, camera, deployment, poses, states)
    positions, axes = for_kernels(poses[0]), for_kernels(poses[1].T)
    seen = np.zeros((len(positions), len(deployment)), dtype=np.bool_)
    landmarks, normals = (for_kernels(v.T[None]) for v in (deployment.positions, deployment.normals))
    _mark_visible(positions, axes, landmarks, normals, sight, obstacles_of(scene, positions, states), seen)
    return seen
