"""Which landmarks a camera sees from a sequence of poses: the coverage of `kernels`, pose by pose.

The decisions are those of the fast path and hence of the reference, operation by operation: what an optimiser counts
is what a moving camera sees.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import for_kernels, kernel
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right
from lmd.scene.criteria import covers, sized
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import is_clear, no_ends, obstacles_at
from lmd.sight.reference import seen_from
from lmd.sight.viewpoint import is_shown, look, take, viewpoint_for


@kernel
def _see(positions, axes, landmarks, normals, sight, obstacles, seen):
    """Fill `seen` `(N, K)` of False; positions `(N, 3)`, axes `(6, N)`, the others as in `kernels.evaluate_range`."""
    count, clear = landmarks.shape[2], is_clear(obstacles)
    view, ends = viewpoint_for(count), no_ends(obstacles, count)
    take(0, landmarks, normals, sight, obstacles, clear, view.near, ends)
    x, y, z, low, reached, directions = view.x, view.y, view.z, view.low, view.reached, view.near[3:]
    for k in range(count):
        view.who[k] = k
    for i in range(len(positions)):
        look(view, count, positions[i, 0], positions[i, 1], positions[i, 2], sight, None)
        for k in range(count):
            nx, ny, nz = directions[0, k], directions[1, k], directions[2, k]
            mine = sized(sight, k)
            if reached[k] and covers(mine, x[k], y[k], z[k], nx, ny, nz, low[k], 0.0, axes, i):
                seen[i, k] = is_shown(k, view, directions, count, i, sight, obstacles, clear, ends)


def visible(evaluator: Evaluator, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """Whether each landmark is covered from each pose, `(N, K)`.

    Args:
        deployment: K landmarks.
        positions: of the camera, `(N, 3)`, world frame, metres; for a rig of its body, as the axes are.
        axes: its optical axes and the image's right, `(N, 6)`: two unit vectors in the world frame
            (`lmd.geometry.se3.axis_and_right`). Without the right, `(N, 3)`, for criteria that need no roll.
    """
    return np.asarray(visible_to_each(evaluator, deployment, positions, axes).any(axis=0))


def visible_to_each(evaluator: Evaluator, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """The same for each of the scene's cameras, `(C, N, K)`."""
    evaluator = evaluator.sized(deployment.edges)
    scene, axes = evaluator.scene, np.pad(axes, [(0, 0), (0, 6 - axes.shape[1])])
    if scene.rig is None:
        return _visible(scene, scene.cameras[0], deployment, positions, axes)[None]
    views = zip(scene.cameras, *scene.rig.views(axes), strict=True)
    return np.stack([
        _visible(scene, camera, deployment, positions + offsets, turned)
        for camera, offsets, turned in views
    ])  # fmt: skip


def visible_through(scene: Scene, camera: Camera, deployment: Deployment, poses: FloatArray) -> BoolArray:
    """The same for one of its cameras that is at `poses` `(N, 4, 4)`, see `lmd.geometry.se3.camera_pose`, `(N, K)`."""
    scene = scene.sized(deployment.edges)
    return _visible(scene, camera, deployment, poses[:, :3, 3], axis_and_right(poses))


def _visible(
    scene: Scene, camera: Camera, deployment: Deployment, positions: FloatArray, axes: FloatArray
) -> BoolArray:
    """`visible` for one camera, axes `(N, 6)`."""
    scene.check_count(len(deployment))
    sight = scene.visibility.sight(camera)
    if sight is None:
        return seen_from(scene, camera, deployment, positions, axes)
    seen = np.zeros((len(positions), len(deployment)), dtype=np.bool_)
    landmarks, normals = (for_kernels(v.T[None]) for v in (deployment.positions, deployment.normals))
    positions, axes = for_kernels(positions), for_kernels(axes.T)
    _see(positions, axes, landmarks, normals, sight, obstacles_at(scene.room.blockers(), positions), seen)
    return seen
