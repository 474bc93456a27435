"""Covariances that do not depend on the choice of the world frame."""

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import adjoint_matrix, inverse

AXES = ("x", "y", "z", "rx", "ry", "rz")  # of positions and rotations in the world
TWISTS = ("tilt_x", "tilt_y", "turn", "right", "up", "out")  # components of a twist in the frame of a tag
# Columns of the standard deviations of a tag beside the other tags, along its own axes, rad and metres.
SIGMA_COLUMNS = tuple(f"sigma_{name}" for name in TWISTS)


def rows_of(tags: IntArray) -> IntArray:
    """Rows of some tags in matrices with six rows for each tag."""
    return np.asarray((6 * tags[:, None] + np.arange(6)).ravel())


def diagonal_blocks(covariance: FloatArray, count: int) -> FloatArray:
    """The `count` equal blocks on the diagonal of a matrix, `(count, m, m)`."""
    size = len(covariance) // count
    return np.stack([covariance[size * k : size * (k + 1), size * k : size * (k + 1)] for k in range(count)])


def gauge_free(tags: FloatArray) -> FloatArray:
    """Matrix L `(6 n, 6 n)` that removes the best-fitting motion of the whole map from the twists of n tags.

    Let T `(6 n, 6)` be the twists of all tags due to a motion of the world, T_p and x_p the rows of T and of the twists
    x that belong to the centres. The motion that fits x best is g = T_p^+ x_p, so L x = x - T g. If P is the covariance
    of the twists, L P L^T is the covariance of the tags relative to each other.

    Args:
        tags: poses of the tags, `(n, 4, 4)`.
    """
    motion = adjoint_matrix(inverse(tags)).reshape(-1, 6)
    centres = np.tile(np.arange(6) >= 3, len(tags))
    fit = np.zeros((6, len(motion)))
    fit[:, centres] = np.linalg.pinv(motion[centres])
    return np.asarray(np.eye(len(motion)) - motion @ fit)


def in_world(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances of position and rotation about the axes of the world, m^2 and rad^2, `(n, 6, 6)`.

    Args:
        poses: poses, `(n, 4, 4)`.
        covariances: covariances of their right-hand twists, `(n, 6, 6)`.
    """
    turned = poses[:, :3, :3]
    whole = np.zeros((len(poses), 6, 6))
    whole[:, :3, 3:] = whole[:, 3:, :3] = turned
    return np.asarray(whole @ covariances @ np.swapaxes(whole, 1, 2))


def covariance_columns(covariances: FloatArray) -> dict[str, FloatArray]:
    """Columns of the upper triangles of covariances in the world `(n, 6, 6)`, row by row."""
    return {f"cov_{AXES[i]}_{AXES[j]}": covariances[:, i, j] for i in range(6) for j in range(i, 6)}


def quantiles(name: str, values: FloatArray) -> dict[str, float]:
    """Median and 90 % quantile; empty without values."""
    if not values.size:
        return {}
    return {f"{name}/{share}": float(np.quantile(values, share / 100.0)) for share in (50, 90)}
