"""Which landmarks a camera sees from a sequence of poses: the coverage of `kernels`, pose by pose.

The decisions are those of the fast path and hence of the reference, operation by operation: what an optimiser counts
is what a moving camera sees.
"""

from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import for_kernels, kernel
from lmd.scene.criteria import covers, from_position
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import is_hidden
from lmd.sight.obstacles import find_ends, is_blocked, no_ends, obstacles_at


@kernel
def _see(positions, axes, landmarks, normals, sight, obstacles, seen):
    """Fill `seen` `(N, K)` of False; positions `(N, 3)`, axes `(6, N)`, the others as in `kernels.evaluate_range`."""
    count = landmarks.shape[1]
    x, y, z, squared = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    ends = no_ends(obstacles, count)
    for k in range(count):
        mx, my, mz = landmarks[0, k], landmarks[1, k], landmarks[2, k]
        find_ends(obstacles, sight, mx, my, mz, normals[0, k], normals[1, k], normals[2, k], ends, k)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        for k in range(count):
            x[k], y[k], z[k] = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
            squared[k] = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
        for k in range(count):
            xk, yk, zk, nx, ny, nz = x[k], y[k], z[k], normals[0, k], normals[1, k], normals[2, k]
            reached, low, _, _ = from_position(sight, xk, yk, zk, nx, ny, nz, 0.0)
            if reached and covers(sight, xk, yk, zk, nx, ny, nz, low, 0.0, axes, i):
                clear = not is_blocked(obstacles, sight, i, ends, k)
                seen[i, k] = clear and (sight.reach < 0.0 or not is_hidden(k, count, x, y, z, squared, normals, sight))


def visible(evaluator: Evaluator, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """Whether each landmark is covered from each pose, `(N, K)`.

    Args:
        evaluator: the scene.
        deployment: K landmarks.
        positions: of the camera, `(N, 3)`, world frame, metres; for a rig of its body, as the axes are.
        axes: its optical axes and the image's right, `(N, 6)`: two unit vectors in the world frame
            (`lmd.geometry.se3.axis_and_right`). Without the right, `(N, 3)`, for criteria that need no roll.
    """
    scene, axes = evaluator.scene, np.pad(axes, [(0, 0), (0, 6 - axes.shape[1])])
    if not isinstance(scene.camera, Rig):
        return _visible(scene, evaluator.sight, deployment, positions, axes)
    seen = [
        _visible(scene, scene.visibility.sight(camera), deployment, positions + offsets, turned)
        for camera, offsets, turned in zip(scene.camera.cameras, *scene.camera.views(axes), strict=True)
    ]
    return np.asarray(np.logical_or.reduce(seen))


def _visible(scene: Scene, sight: Any, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """`visible` for a camera with a compiled model of sight, axes `(N, 6)`."""
    seen = np.zeros((len(positions), len(deployment)), dtype=np.bool_)
    landmarks, normals = (for_kernels(v.T) for v in (deployment.positions, deployment.normals))
    positions, axes = for_kernels(positions), for_kernels(axes.T)
    _see(positions, axes, landmarks, normals, sight, obstacles_at(scene.room.blockers(), positions), seen)
    return seen
