"""World and local frames: rotations, the optical axis, the landmark normal.

The world frame has its origin at a floor corner of the room and z up, in metres. A local frame is given by its origin
and by yaw (alpha), pitch (beta) and roll (gamma) in radians. Angles may have any shape `(...)`; vectors then have the
shape `(..., 3)`.

Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. II.
"""

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import FloatArray

# Rotation from the world to a local frame with zero angles: x right, y down, z (the optical axis) along world y.
ZERO_ANGLES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def rotation(yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike = 0.0) -> FloatArray:
    """Rotation matrix from the world frame to the local frame, R = R^gamma R^beta R^alpha R_0 (frame equation). R_0 is
    the rotation at zero angles; alpha is yaw, beta is pitch and gamma is roll.

    Args:
        yaw, pitch, roll: angles in radians, shapes that broadcast to `(...)`.

    Returns:
        matrices `(..., 3, 3)`; their rows are the local x, y, z axes expressed in the world frame.
    """
    a, b, g = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (yaw, pitch, roll)))
    zero, one = np.zeros_like(a), np.ones_like(a)

    def matrix(*rows: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    r_yaw = matrix((np.cos(a), zero, -np.sin(a)), (zero, one, zero), (np.sin(a), zero, np.cos(a)))
    r_pitch = matrix((one, zero, zero), (zero, np.cos(b), np.sin(b)), (zero, -np.sin(b), np.cos(b)))
    r_roll = matrix((np.cos(g), -np.sin(g), zero), (np.sin(g), np.cos(g), zero), (zero, zero, one))
    return np.asarray(r_roll @ r_pitch @ r_yaw @ ZERO_ANGLES)


def roll_pitch_yaw(angles: ArrayLike) -> FloatArray:
    """Rotation matrix Rz(yaw) Ry(pitch) Rx(roll), as in ROS's `setRPY`.

    Args:
        angles: roll, pitch and yaw, radians, `(3,)` or `(T, 3)`.

    Returns:
        matrices `(3, 3)` or `(T, 3, 3)`.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    return np.asarray(Rotation.from_euler("xyz", angles).as_matrix())


def angles_of(world_to_local_rotation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Yaw in [-pi, pi], pitch in [-pi/2, pi/2] and roll in [-pi, pi] of a rotation matrix; the inverse of `rotation`.

    Args:
        world_to_local_rotation: `(..., 3, 3)`.

    Returns:
        the three angles, radians, shape `(...)` each; the yaw of a vertical optical axis is 0.
    """
    right, axis = world_to_local_rotation[..., 0, :], world_to_local_rotation[..., 2, :]
    yaw, pitch = (-angle for angle in normal_angles(axis))  # `normal_angles` uses the opposite signs for both angles
    level = rotation(yaw, pitch)
    across, down = ((right * level[..., i, :]).sum(axis=-1) for i in (0, 1))
    return yaw, pitch, np.asarray(np.arctan2(-down, across))


def optical_axis(yaw: ArrayLike, pitch: ArrayLike) -> FloatArray:
    """Unit optical axis Z^c in the world frame, (sin a cos b, cos a cos b, sin b), for yaw a and pitch b.

    The axis is the third row of `rotation`, and does not depend on roll. Positive pitch looks up.

    Args:
        yaw, pitch: radians, shape `(...)`.

    Returns:
        `(..., 3)` unit vectors.
    """
    a, b = np.asarray(yaw, dtype=np.float64), np.asarray(pitch, dtype=np.float64)
    return np.stack([np.sin(a) * np.cos(b), np.cos(a) * np.cos(b), np.sin(b) * np.ones_like(a)], axis=-1)


def landmark_normal(yaw: ArrayLike, pitch: ArrayLike) -> FloatArray:
    """Unit normal of a landmark's front face, n = (-sin r cos e, cos r cos e, -sin e) (Eq. n_k).

    Both angles have the opposite sign to those of `optical_axis`, as in the paper.

    Args:
        yaw: angle rho (r in the formula), radians, shape `(...)`.
        pitch: angle eta (e in the formula), radians, shape `(...)`.

    Returns:
        `(..., 3)` unit vectors in the world frame.
    """
    return optical_axis(-np.asarray(yaw, dtype=np.float64), -np.asarray(pitch, dtype=np.float64))


def normal_angles(normal: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Yaw in [-pi, pi] and pitch in [-pi/2, pi/2] of a unit normal, the inverse of `landmark_normal`.

    Args:
        normal: `(..., 3)` unit vectors in the world frame.

    Returns:
        yaw and pitch in radians, shape `(...)`; the yaw of a vertical normal is 0.
    """
    n = np.asarray(normal, dtype=np.float64)
    level = np.hypot(n[..., 0], n[..., 1])
    yaw = np.where(level < 1e-12, 0.0, np.arctan2(-n[..., 0], n[..., 1]))
    return yaw, -np.arctan2(n[..., 2], level)
