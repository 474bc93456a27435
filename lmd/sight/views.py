"""Which landmarks a camera sees from a sequence of poses: the coverage of `kernels`, pose by pose.

The decisions are those of the fast path and hence of the reference, operation by operation: what an optimiser counts
is what a moving camera sees.
"""

import numpy as np
from numba import njit

from lmd.checks import FloatArray
from lmd.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import cap_of, is_hidden
from lmd.sight.reference import BoolArray


@njit(nogil=True, cache=True, error_model="numpy")
def _see(positions, axes, landmarks, normals, limits, reach, mode, seen):
    """Fill `seen` `(N, K)` of False; positions and axes `(N, 3)`, the others as in `kernels.evaluate_range`."""
    count = landmarks.shape[1]
    x, y, z, squared = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        for k in range(count):
            x[k], y[k], z[k] = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
            squared[k] = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
        for k in range(count):
            xk, yk, zk = x[k], y[k], z[k]
            reached, low, _, _ = cap_of(
                xk, yk, zk, normals[0, k], normals[1, k], normals[2, k], 0.0, limits[0], limits[1], limits[2]
            )
            depth = axes[i, 0] * xk + axes[i, 1] * yk + axes[i, 2] * zk
            if not reached or depth < low or depth > limits[2]:
                continue
            seen[i, k] = not mode or not is_hidden(k, x, y, z, squared, reach, mode)


def visible(evaluator: Evaluator, deployment: Deployment, positions: FloatArray, axes: FloatArray) -> BoolArray:
    """Whether each landmark is covered from each pose, `(N, K)`; roll does not matter.

    Args:
        evaluator: the scene.
        deployment: K landmarks.
        positions: of the camera, `(N, 3)`, world frame, metres.
        axes: its optical axes, `(N, 3)` unit vectors in the world frame.
    """
    seen = np.zeros((len(positions), len(deployment)), dtype=np.bool_)
    landmarks, normals = (np.ascontiguousarray(v.T) for v in (deployment.positions, deployment.normals))
    positions, axes = np.ascontiguousarray(positions), np.ascontiguousarray(axes)
    _see(positions, axes, landmarks, normals, evaluator.limits, evaluator.reach, evaluator.mode, seen)
    return seen
