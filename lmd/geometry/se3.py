"""Rigid motions: exponential, logarithm and other maps on SE(3) and se(3).

A pose X = [R p; 0 1] maps camera coordinates to world coordinates. The columns of R are the camera's axes (x right, y
down, z the optical axis) in the world frame, p is the camera's position in metres. A twist (w, v) in body coordinates
has the angular part w first, rad (or rad/s), then the linear part v, m (or m/s). Arrays may have any leading shape
`(...)`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.geometry.frames import rotation

# Angle below which coefficients are computed by their Taylor series, rad.
SMALL_ANGLE = 1e-4
# Angle below which the left Jacobian is computed by its Taylor series to the fourth order, rad.
SERIES_ANGLE = 0.02
# Tolerances for files with few decimals: error of the length of a quaternion, and of the elements of R^T R.
QUATERNION_TOLERANCE = 1e-2
MATRIX_TOLERANCE = 1e-2
MEDIAN_STEPS = 10
# Columns of a table of poses: position in metres, unit quaternion of R.
ROW = ("x", "y", "z", "qx", "qy", "qz", "qw")


def camera_pose(position: ArrayLike, yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike = 0.0) -> FloatArray:
    """Pose X of a camera at `position` `(..., 3)`, metres. Yaw, pitch and roll `(...)`, rad, have the meaning that they
    have in `frames.rotation`.

    Returns:
        poses `(..., 4, 4)`.
    """
    return pose_of(np.swapaxes(rotation(yaw, pitch, roll), -1, -2), np.asarray(position, dtype=np.float64))


def pose_of(orientation: FloatArray, position: FloatArray) -> FloatArray:
    """Pose [R p; 0 1], `(..., 4, 4)`, of a rotation R `(..., 3, 3)` and a position p `(..., 3)`, which broadcast."""
    pose = np.zeros((*np.broadcast_shapes(orientation.shape[:-2], position.shape[:-1]), 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = orientation, position, 1.0
    return pose


def poses_from_rows(rows: FloatArray, lines: Sequence[int] | None = None) -> FloatArray:
    """Poses `(T, 4, 4)` from T rows of a file, `(T, 7)`. The columns are a position and a quaternion, in the order of
    `ROW`.

    Args:
        lines: number of each row's line in the file, from 1, for error messages.

    Raises:
        InputError: a quaternion does not have the norm 1.
    """
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(rows[:, 3:], axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > QUATERNION_TOLERANCE:
        where = f"frame {worst}" if lines is None else f"line {lines[worst]}"
        raise InputError(f"{where}: the quaternion must have length 1, it has {length[worst]:g}.")
    return pose_of(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])


def pose_rows(poses: FloatArray) -> FloatArray:
    """Position and quaternion of each pose, in the order of `ROW`, `(n, 7)`; NaN for poses of NaN."""
    from scipy.spatial.transform import Rotation

    rows, known = np.full((len(poses), len(ROW)), np.nan), np.isfinite(poses[:, 0, 0])
    rows[known, :3] = poses[known, :3, 3]
    if known.any():
        rows[known, 3:] = Rotation.from_matrix(poses[known, :3, :3]).as_quat(canonical=True)
    return rows


def are_rotations(matrices: FloatArray) -> BoolArray:
    """Mask `(...)` of those matrices `(..., 3, 3)` that are rotations within `MATRIX_TOLERANCE`."""
    error = np.abs(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3)).max(axis=(-1, -2))
    return np.asarray((error <= MATRIX_TOLERANCE) & (np.linalg.det(matrices) > 0.0))


def nearest_rotations(matrices: FloatArray) -> FloatArray:
    """Rotations nearest, in the Frobenius norm, to matrices `(..., 3, 3)` with a positive determinant."""
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(left @ right)


def rigid_alignment(points: FloatArray, others: FloatArray) -> FloatArray:
    """Rigid motion `(4, 4)` that maps points `(N, 3)`, which must not be collinear, to `others` `(N, 3)` with the least
    sum of squared distances.
    """
    from scipy.spatial.transform import Rotation

    here, there = points.mean(axis=0), others.mean(axis=0)
    turn = Rotation.align_vectors(others - there, points - here)[0].as_matrix()
    return pose_of(turn, there - turn @ here)


def inverse(pose: FloatArray) -> FloatArray:
    """Inverse pose X^-1 = [R^T -R^T p; 0 1], `(..., 4, 4)`."""
    transposed = np.swapaxes(pose[..., :3, :3], -1, -2)
    return pose_of(transposed, -(transposed @ pose[..., :3, 3:])[..., 0])


def act(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points s by poses: R s + p.

    Args:
        pose: X, `(..., 4, 4)`.
        points: `(..., K, 3)`, metres.

    Returns:
        transformed points, `(..., K, 3)`.
    """
    return np.asarray(points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3])


def axis_and_right(pose: FloatArray) -> FloatArray:
    """Optical axis of each camera pose, followed by the direction to the right in the image, `(..., 6)`. Both are unit
    vectors in the world frame. `pose` has the camera poses X `(..., 4, 4)`.
    """
    return np.concatenate([pose[..., :3, 2], pose[..., :3, 0]], axis=-1)


def skew(vector: FloatArray) -> FloatArray:
    """Skew-symmetric matrix [a]x of a vector a, with [a]x b = a x b for any b, `(..., 3)` -> `(..., 3, 3)`."""
    matrix = np.zeros((*vector.shape, 3))
    x, y, z = (vector[..., i] for i in range(3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def seen_by_twist(points: FloatArray) -> FloatArray:
    """Derivative [[y]x -I] of a point y with respect to a twist (w, v). The point has the coordinates y in the frame of
    a pose X, and the twist changes X to X exp(w, v). `points` `(..., 3)` has the points y.

    Returns:
        matrices `(..., 3, 6)`.
    """
    return np.concatenate([skew(points), np.broadcast_to(-np.eye(3), (*points.shape, 3))], axis=-1)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product a x b, `(..., 3)`; several times faster than `np.cross` for a few vectors."""
    (ax, ay, az), (bx, by, bz) = ((each[..., 0], each[..., 1], each[..., 2]) for each in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def adjoint(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Adjoint map Ad_X (w, v) = (R w, p x R w + R v), which converts a twist from body coordinates to world
    coordinates, `(..., 6)`.
    """
    orientation = pose[..., :3, :3]
    angular = (orientation @ twist[..., :3, None])[..., 0]
    linear = (orientation @ twist[..., 3:, None])[..., 0] + cross(pose[..., :3, 3], angular)
    return np.concatenate([angular, linear], axis=-1)


def adjoint_matrix(pose: FloatArray) -> FloatArray:
    """Matrix Ad_X = [R 0; [p]x R  R] of the adjoint map, `(..., 6, 6)`, for poses X `(..., 4, 4)`."""
    return np.swapaxes(adjoint(pose[..., None, :, :], np.eye(6)), -1, -2)


def bracket_matrix(twist: FloatArray) -> FloatArray:
    """Matrix ad_u = [[w]x 0; [v]x [w]x] of the Lie bracket for a twist u = (w, v): exp(ad_u) = Ad_exp(u). Twists
    `(..., 6)` give matrices `(..., 6, 6)`.
    """
    matrix = np.zeros((*twist.shape, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = skew(twist[..., :3])
    matrix[..., 3:, :3] = skew(twist[..., 3:])
    return matrix


def left_jacobian(twist: FloatArray) -> FloatArray:
    """Left Jacobian of a twist u, J(u) = integral of Ad_exp(s u) over s from 0 to 1. Twists `(..., 6)` give matrices
    `(..., 6, 6)`.

    exp(u + d) = exp(J(u) d) exp(u) to first order in d; the right Jacobian is J(-u). The powers of ad_u above the
    fourth follow from ad_u^5 = -2 t^2 ad_u^3 - t^4 ad_u with t = |w|.
    """
    angle = np.linalg.norm(twist[..., :3], axis=-1)
    small = angle < SERIES_ANGLE
    t = np.where(small, 1.0, angle)
    sin, cos = np.sin(t), np.cos(t)
    factors = (
        np.where(small, 1.0 / 2.0, (4.0 - t * sin - 4.0 * cos) / (2.0 * t**2)),
        np.where(small, 1.0 / 6.0, (4.0 * t - 5.0 * sin + t * cos) / (2.0 * t**3)),
        np.where(small, 1.0 / 24.0, (2.0 - t * sin - 2.0 * cos) / (2.0 * t**4)),
        np.where(small, 1.0 / 120.0, (2.0 * t - 3.0 * sin + t * cos) / (2.0 * t**5)),
    )
    result, bracket, power = np.eye(6), bracket_matrix(twist), np.eye(6)
    for factor in factors:
        power = power @ bracket
        result = result + factor[..., None, None] * power
    return result


def exp(twist: FloatArray) -> FloatArray:
    """Exponential map se(3) -> SE(3): poses `(..., 4, 4)` from twists (w, v) `(..., 6)`.

    The pose [R p; 0 1] has R = I + a [w]x + b [w]x^2 and p = (I + b [w]x + c [w]x^2) v with t = |w|. The factors are
    a = sin t / t, b = (1 - cos t) / t^2 and c = (t - sin t) / t^3.
    """
    squared = (twist[..., :3] ** 2).sum(axis=-1)
    small = squared < SMALL_ANGLE**2
    angle = np.sqrt(np.where(small, 1.0, squared))
    a = np.where(small, 1.0 - squared / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - squared / 24.0, 2.0 * (np.sin(angle / 2.0) / angle) ** 2)
    c = np.where(small, 1.0 / 6.0 - squared / 120.0, (angle - np.sin(angle)) / angle**3)
    w = skew(twist[..., :3])
    a, b, c, once, twice = a[..., None, None], b[..., None, None], c[..., None, None], w, w @ w
    translation = (np.eye(3) + b * once + c * twice) @ twist[..., 3:, None]
    return pose_of(np.eye(3) + a * once + b * twice, translation[..., 0])


def log(pose: FloatArray) -> FloatArray:
    """Twist `(..., 6)` of least angle whose exponential is `pose` `(..., 4, 4)`."""
    from scipy.spatial.transform import Rotation

    leading = pose.shape[:-2]
    angular = Rotation.from_matrix(pose[..., :3, :3].reshape(-1, 3, 3)).as_rotvec().reshape(*leading, 3)
    squared = (angular**2).sum(axis=-1)
    small = squared < SMALL_ANGLE**2
    angle = np.sqrt(np.where(small, 1.0, squared))
    half = angle / 2.0
    factor = np.where(small, 1.0 / 12.0 + squared / 720.0, (1.0 - half / np.tan(half)) / angle**2)
    w = skew(angular)
    linear = (np.eye(3) - w / 2.0 + factor[..., None, None] * (w @ w)) @ pose[..., :3, 3:]
    return np.concatenate([angular, linear[..., 0]], axis=-1)


def median_pose(poses: FloatArray) -> FloatArray:
    """Robust mean of poses `(n, 4, 4)`: the componentwise median of their twists relative to the current estimate,
    iterated.
    """
    result = poses[len(poses) // 2]
    for _ in range(MEDIAN_STEPS):
        result = result @ exp(np.median(log(inverse(result) @ poses), axis=0))
    return np.asarray(result)


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle of the rotation from pose `a` to pose `b`, `(...)`, rad in [0, pi].

    The angle t follows from |R_a - R_b|_F = 2 sqrt(2) sin(t / 2), which is accurate for small angles.
    """
    chord = np.linalg.norm(a[..., :3, :3] - b[..., :3, :3], axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.clip(chord / np.sqrt(8.0), 0.0, 1.0)))
