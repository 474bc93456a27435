"""The camera's pose from the image of known points (PnP), by OpenCV."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import FloatArray
from lmd.core.optional import optional
from lmd.geometry.se3 import angle_between, inverse
from lmd.render.optics import intrinsics, project, rectified
from lmd.scene.camera import Camera

# The fewest points that fix a pose; four corners of one tag do.
FEWEST = 4
# Points lie in a plane if they are this much less extended across it than along, relative.
FLAT = 1e-6
# Poses nearer to each other than this in their matrices are the same.
SAME = 1e-3


class Solution(NamedTuple):
    """A pose that fits the image of points at least locally.

    Args:
        pose: X, camera to world, `(4, 4)`.
        square: sum of the squared errors of the image, each in units of its standard deviation.
    """

    pose: FloatArray
    square: float


def solutions(camera: Camera, points: FloatArray, image: FloatArray, noise: ArrayLike = 1.0) -> list[Solution]:
    """The poses that fit the image of points, best first; none with fewer than four points.

    SQPnP finds the best pose for five points or more that are not all in one plane. Points in a plane have two poses
    that look alike (IPPE). Four others may have several; every three of them give up to four (P3P). All are refined by
    Levenberg-Marquardt.

    Args:
        camera: intrinsics, and the lens's distortion.
        points: world frame, metres, `(M, 3)`.
        image: pixels from the border, `(M, 2)`.
        noise: standard deviation of each image, pixels, `()` or `(M,)`.
    """
    if len(points) < FEWEST:
        return []
    cv2, matrix = optional("cv2", "estimators"), intrinsics(camera)
    world = np.ascontiguousarray(points, dtype=np.float64)
    pixels = np.ascontiguousarray(rectified(camera, np.asarray(image, dtype=np.float64)))
    given = world, pixels, matrix, None
    extents = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    flat = extents[2] <= FLAT * extents[0]
    candidates: list[tuple[FloatArray, FloatArray]] = []
    for method in (cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE) if flat else (cv2.SOLVEPNP_SQPNP,):
        _, turns, shifts, _ = cv2.solvePnPGeneric(*given, flags=method)
        candidates += zip(turns, shifts, strict=True)
    if len(world) == FEWEST and not flat:
        for three in map(list, combinations(range(FEWEST), 3)):
            _, turns, shifts = cv2.solveP3P(world[three], pixels[three], matrix, None, cv2.SOLVEPNP_P3P)
            candidates += zip(turns, shifts, strict=True)
    found: list[Solution] = []
    for turn, shift in candidates:
        turn, shift = cv2.solvePnPRefineLM(*given, turn, shift)
        back = np.eye(4)
        back[:3, :3], back[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
        pose = inverse(back)
        square = float((((project(camera, pose, world) - image) / np.reshape(noise, (-1, 1))) ** 2).sum())
        if np.isfinite(square) and all(np.abs(pose - other.pose).max() > SAME for other in found):
            found.append(Solution(pose, square))
    return sorted(found, key=lambda solution: solution.square)


def pose_from_corners(camera: Camera, points: FloatArray, image: FloatArray) -> FloatArray:
    """The pose that fits best.

    Args:
        camera: intrinsics, and the lens's distortion.
        points: of the tags' corners, world frame, metres, `(M, ..., 3)`.
        image: the corners found, pixels from the border, `(M, ..., 2)`; points with a NaN are left out.

    Returns:
        X, camera to world, `(4, 4)`; NaN with fewer than four points or if there is no solution.
    """
    world, pixels = np.reshape(points, (-1, 3)), np.reshape(image, (-1, 2))
    known = np.isfinite(pixels).all(axis=1)
    found = solutions(camera, world[known], pixels[known])
    return found[0].pose if found else np.full((4, 4), np.nan)


def pose_error(true: FloatArray, estimated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (metres) and angle (rad) between poses `(..., 4, 4)`, `(...)` each; NaN where there is no estimate."""
    distance = np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1)
    return np.asarray(distance), angle_between(true, estimated)
