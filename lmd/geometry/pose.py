"""Pose of a camera or a rig, estimated from an image of points with known positions (PnP) with OpenCV's solvers."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.optional import optional
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, project, slope, to_camera
from lmd.geometry.se3 import adjoint_matrix, angle_between, exp, inverse, pose_of, seen_by_twist

# Fewest points that determine a pose, such as the corners of a tag.
FEWEST_POINTS = 4
# Points are coplanar if their extent across the plane is at most this multiple of the extent along the plane.
FLATNESS = 1e-6
# Poses are equal if no matrix element differs by more than this.
SAME_POSE = 1e-3
# Largest angle of a ray from the axis of a distorting lens's virtual pinhole, rad; rays at larger angles are used in
# the refinement only.
NEAR_MIDDLE_RAD = np.radians(75.0)
# Gauss-Newton: maximum number of steps, and relative decrease of the sum of squares below which steps end.
ROUNDS, GAIN = 10, 1e-9


class Solution(NamedTuple):
    """Pose at which the reprojection error has a local minimum."""

    pose: FloatArray
    """Pose X, camera to world or body to world, `(4, 4)`."""
    square: float
    """Sum of the squares of the reprojection errors, where each error is divided by its standard deviation."""


class PointImage(NamedTuple):
    """Image, in one camera of a body, of points with known positions in the world."""

    camera: Camera
    """Intrinsics and lens of the camera."""
    mounted: FloatArray
    """Pose of the camera in the body frame, `(4, 4)`."""
    points: FloatArray
    """World points with known positions, metres, `(M, 3)`."""
    pixels: FloatArray
    """Image points of `points`, pixels from the top-left border of the image, `(M, 2)`."""
    noise: FloatArray
    """Standard deviation of each image point, pixels, `(M,)`."""

    def off(self, pose: FloatArray) -> FloatArray:
        """Reprojection errors at a pose X of the body, divided by their standard deviations, `(M, 2)`."""
        return np.asarray((project(self.camera, pose @ self.mounted, self.points) - self.pixels) / self.noise[:, None])

    def scaled_slope(self, pose: FloatArray) -> FloatArray:
        """Jacobian of `off` with respect to a twist (w, v) of the body, `(M, 2, 6)`."""
        slopes = image_slopes(self.camera, self.mounted, to_camera(pose @ self.mounted, self.points))
        return np.asarray(slopes / self.noise[:, None, None])


def image_slopes(camera: Camera, mounted: FloatArray, y: FloatArray) -> FloatArray:
    """Jacobian of the projection of points with respect to a twist (w, v) of the body, pixels, `(..., 2, 6)`.

    The mount M is the pose of the camera in the body frame. A twist (w, v) of the body moves the camera by the twist
    Ad_{M^-1} (w, v). A twist (w, v) of the camera moves a point y in the camera frame by y x w - v.

    Args:
        camera: intrinsics and lens.
        mounted: mount M, the pose of the camera in the body frame, `(4, 4)`.
        y: points in the camera frame, in front of the camera, metres, `(..., 3)`.
    """
    return np.asarray(slope(camera, y) @ seen_by_twist(y) @ adjoint_matrix(inverse(mounted)))


def body_solutions(images: Sequence[PointImage]) -> list[Solution]:
    """Candidate poses of a body from simultaneous images of its cameras, in ascending order of the reprojection error.

    Each camera with at least four points proposes poses (see `solutions`), which are refined by Gauss-Newton on the
    images of all cameras. The list is empty if no camera has four points.
    """
    images = [image for image in images if len(image.points)]
    own = [
        one.pose @ inverse(image.mounted)
        for image in images
        for one in solutions(image.camera, image.points, image.pixels, image.noise)
    ]
    return _best(images, own if len(images) == 1 else [_refined(images, pose) for pose in own])


def _best(images: Sequence[PointImage], poses: Iterable[FloatArray]) -> list[Solution]:
    """Solutions at the distinct poses among `poses`, in ascending order of their reprojection error. Poses without a
    finite error are left out.
    """
    found: list[Solution] = []
    for pose in poses:
        square = float(sum((image.off(pose) ** 2).sum() for image in images))
        if np.isfinite(square) and all(np.abs(pose - other.pose).max() > SAME_POSE for other in found):
            found.append(Solution(pose, square))
    return sorted(found, key=lambda solution: solution.square)


def solutions(camera: Camera, points: FloatArray, image: FloatArray, noise: ArrayLike = 1.0) -> list[Solution]:
    """Candidate poses of a camera from an image of points, in ascending order of the error; empty for fewer than four
    points.

    Candidates are the poses that SQPnP finds and, for coplanar points, the two poses of IPPE. For four points that are
    not coplanar, up to four poses of P3P for each triple of points are also candidates. Candidates are refined by
    Gauss-Newton on the errors in the image.

    Args:
        camera: intrinsics and lens.
        points: points with known positions, world frame, metres, `(M, 3)`.
        image: image points, pixels from the top-left border of the image, `(M, 2)`.
        noise: standard deviation of the image points, pixels, `()` or `(M,)`.
    """
    if len(points) < FEWEST_POINTS:
        return []
    world, pixels = (np.ascontiguousarray(part, dtype=np.float64) for part in (points, image))
    whole = PointImage(camera, np.eye(4), world, pixels, np.broadcast_to(np.asarray(noise, dtype=float), len(world)))
    return _best([whole], _refined_candidates(whole))


def _refined_candidates(image: PointImage) -> Iterator[FloatArray]:
    """Iterate over the poses that are local minima of the reprojection error, `(4, 4)` each. First the image points are
    mapped to the image of a virtual pinhole camera that is aimed at the points. Candidate poses (see `solutions`) are
    computed for the virtual camera. Then each candidate is refined with the real camera.
    """
    cv2 = optional("cv2", "estimators")
    turned, within, rays = straightened(bearings(image.camera, image.pixels))
    if np.count_nonzero(within) < FEWEST_POINTS:
        return
    world, seen = np.ascontiguousarray(image.points[within]), np.ascontiguousarray(rays[within])
    extents = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    flat = extents[2] <= FLATNESS * extents[0]
    candidates: list[tuple[FloatArray, FloatArray]] = []
    for method in (cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE) if flat else (cv2.SOLVEPNP_SQPNP,):
        _, turns, shifts, _ = cv2.solvePnPGeneric(world, seen, np.eye(3), None, flags=method)
        candidates += zip(turns, shifts, strict=True)
    if len(world) == FEWEST_POINTS and not flat:
        for three in map(list, combinations(range(FEWEST_POINTS), 3)):
            _, turns, shifts = cv2.solveP3P(world[three], seen[three], np.eye(3), None, cv2.SOLVEPNP_P3P)
            candidates += zip(turns, shifts, strict=True)
    for turn, shift in candidates:
        start = pose_of(turned.T @ cv2.Rodrigues(turn)[0], np.ravel(turned.T @ shift))
        yield _refined([image], inverse(start))


def straightened(seen: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Project rays to the image of a virtual pinhole camera whose optical axis is the mean ray.

    Args:
        seen: rays as unit vectors in the camera frame, `(M, 3)`; NaN for missing rays.

    Returns:
        rotation from the camera frame to the pinhole's frame, `(3, 3)`; mask of the rays within `NEAR_MIDDLE_RAD` of
        the pinhole's axis, `(M,)`; image points for a focal length of 1, `(M, 2)`.
    """
    middle = np.nansum(seen, axis=0)
    axis = middle / max(float(np.linalg.norm(middle)), np.finfo(float).tiny)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    right = across / np.linalg.norm(across)
    turn = np.stack([right, np.cross(axis, right), axis])
    ahead = seen @ turn.T
    with np.errstate(all="ignore"):
        return turn, ahead[:, 2] > np.cos(NEAR_MIDDLE_RAD), ahead[:, :2] / ahead[:, 2:]


def _refined(images: Sequence[PointImage], pose: FloatArray) -> FloatArray:
    """Pose of the body with the least reprojection error near `pose`, by Gauss-Newton."""
    least = np.inf
    for _ in range(ROUNDS):
        off = np.concatenate([image.off(pose) for image in images])
        if not (square := float((off**2).sum())) < least * (1.0 - GAIN):  # NaN if a point has no image
            break
        best, least = pose, square
        slopes = np.concatenate([image.scaled_slope(pose) for image in images])
        pose = pose @ exp(np.linalg.lstsq(slopes.reshape(-1, 6), -off.ravel())[0])
    return best if np.isfinite(least) else pose


def body_from_corners(
    cameras: Sequence[Camera], mounted: FloatArray, points: FloatArray, images: Sequence[FloatArray]
) -> FloatArray:
    """Pose of a body that minimises the reprojection error of tag corners in the images of its C cameras.

    Args:
        cameras: intrinsics.
        mounted: poses of the cameras in the body frame, `(C, 4, 4)`.
        points: tag corners, world frame, metres, `(..., 3)`.
        images: for each camera, image points of all these corners, pixels from the top-left border of the image,
            `(..., 2)`; NaN for corners that were not detected.

    Returns:
        pose X of the body, `(4, 4)`; NaN if no camera sees four points or there is no solution.
    """
    shots, world = [], np.reshape(points, (-1, 3))
    for camera, at, image in zip(cameras, mounted, images, strict=True):
        pixels = np.reshape(image, (-1, 2))
        known = np.isfinite(pixels).all(axis=1)
        shots.append(PointImage(camera, at, world[known], pixels[known], np.ones(np.count_nonzero(known))))
    found = body_solutions(shots)
    return found[0].pose if found else np.full((4, 4), np.nan)


def pose_error(true: FloatArray, estimated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and attitude errors of estimated poses `(..., 4, 4)`, metres and rad, `(...)` each."""
    distance = np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1)
    return np.asarray(distance), angle_between(true, estimated)
