"""The camera's pose from the corners a detector found."""

import numpy as np

from lmd.camera import Camera
from lmd.checks import FloatArray
from lmd.geometry.se3 import angle_between, inverse
from lmd.optional import optional
from lmd.render.optics import intrinsics, rectified

# The fewest points that fix a pose; four corners of one tag do.
FEWEST = 4


def pose_from_corners(camera: Camera, points: FloatArray, image: FloatArray) -> FloatArray:
    """X by SQPnP of OpenCV, refined by Levenberg-Marquardt.

    Args:
        camera: intrinsics.
        points: of the tags' corners, world frame, metres, `(M, ..., 3)`.
        image: the corners found, pixels from the border, `(M, ..., 2)`; points with a NaN are left out.

    Returns:
        Camera to world, `(4, 4)`; NaN with fewer than four points or if there is no solution.
    """
    cv2 = optional("cv2", "detection")
    unknown = np.full((4, 4), np.nan)
    world, pixels = np.reshape(points, (-1, 3)), np.reshape(image, (-1, 2))
    found = np.isfinite(pixels).all(axis=1)
    if found.sum() < FEWEST:
        return unknown
    world, pixels = np.ascontiguousarray(world[found]), np.ascontiguousarray(pixels[found])
    matrix, pixels = intrinsics(camera), rectified(camera, pixels)
    solved, turn, shift = cv2.solvePnP(world, pixels, matrix, None, flags=cv2.SOLVEPNP_SQPNP)
    if not solved:
        return unknown
    turn, shift = cv2.solvePnPRefineLM(world, pixels, matrix, None, turn, shift)
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
    return inverse(back)


def pose_error(true: FloatArray, estimated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (metres) and angle (rad) between poses `(..., 4, 4)`, `(...)` each; NaN where there is no estimate."""
    distance = np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1)
    return np.asarray(distance), angle_between(true, estimated)
