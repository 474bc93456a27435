"""The camera's pose from the image of known points (PnP), by OpenCV."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.optional import optional
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, intrinsics, project, slope, to_camera
from lmd.geometry.se3 import adjoint, angle_between, exp, inverse, skew

# The fewest points that fix a pose; four corners of one tag do.
FEWEST_POINTS = 4
# Points lie in a plane if they are this much less extended across it than along, relative.
FLATNESS = 1e-6
# Poses nearer to each other than this in their matrices are the same.
SAME_POSE = 1e-3
# Behind a lens that distorts, what is seen farther than this from the middle of all, rad, only refines a pose.
NEAR_MIDDLE_RAD = np.radians(75.0)
# Of Gauss and Newton: so many rounds at most, until the squared errors fall by less than this share.
ROUNDS, GAIN = 10, 1e-9


class Solution(NamedTuple):
    """A pose that fits the image of points at least locally.

    Args:
        pose: X, camera to world, `(4, 4)`.
        square: sum of the squared errors of the image, each in units of its standard deviation.
    """

    pose: FloatArray
    square: float


class PointImage(NamedTuple):
    """What one camera of a body has of known points at a moment.

    Args:
        camera: intrinsics, and the lens.
        mounted: from the camera's frame to the body's, `(4, 4)`.
        points: world frame, metres, `(M, 3)`.
        pixels: where they are, from the border, `(M, 2)`.
        noise: standard deviation of each, pixels, `(M,)`.
    """

    camera: Camera
    mounted: FloatArray
    points: FloatArray
    pixels: FloatArray
    noise: FloatArray

    def off(self, pose: FloatArray) -> FloatArray:
        """What the image is off for a pose X of the body, each in units of its standard deviation, `(M, 2)`."""
        return np.asarray((project(self.camera, pose @ self.mounted, self.points) - self.pixels) / self.noise[:, None])

    def slope(self, y: FloatArray) -> FloatArray:
        """Derivatives by a body twist (w, v), pixels, `(M, 2, 6)`, of the image of points y `(M, 3)` (camera frame)."""
        moved = np.concatenate([skew(y), np.broadcast_to(-np.eye(3), (len(y), 3, 3))], axis=-1)
        return np.asarray(slope(self.camera, y) @ moved @ adjoint(inverse(self.mounted), np.eye(6)).T)


def body_solutions(images: Sequence[PointImage]) -> list[Solution]:
    """The poses of a body that fit the images of all its cameras at a moment, best first.

    Each camera with four points or more has `solutions` of its own; those are refined by Gauss and Newton on the images
    of all. There is none where no camera has four.
    """
    images = [image for image in images if len(image.points)]
    found: list[Solution] = []
    for image in images:
        camera, mounted, *seen = image
        own = [one._replace(pose=one.pose @ inverse(mounted)) for one in solutions(camera, *seen)]
        if len(images) == 1:
            return own
        for pose in (_refined(images, one.pose) for one in own):
            _add(found, pose, float(sum((each.off(pose) ** 2).sum() for each in images)))
    return sorted(found, key=lambda solution: solution.square)


def _add(found: list[Solution], pose: FloatArray, square: float) -> None:
    """Add a pose unless it does not fit at all, or is there already."""
    if np.isfinite(square) and all(np.abs(pose - other.pose).max() > SAME_POSE for other in found):
        found.append(Solution(pose, square))


def solutions(camera: Camera, points: FloatArray, image: FloatArray, noise: ArrayLike = 1.0) -> list[Solution]:
    """The poses that fit the image of points, best first; none with fewer than four points.

    SQPnP finds the best pose for five points or more that are not all in one plane. Points in a plane have two poses
    that look alike (IPPE). Four others may have several; every three of them give up to four (P3P). All are refined by
    Levenberg-Marquardt, or for a lens that distorts by Gauss and Newton with the errors in its own image.

    Args:
        points: world frame, metres, `(M, 3)`.
        image: pixels from the border, `(M, 2)`.
        noise: standard deviation of each image, pixels, `()` or `(M,)`.
    """
    if len(points) < FEWEST_POINTS:
        return []
    world, pixels = (np.ascontiguousarray(part, dtype=np.float64) for part in (points, image))
    if camera.lens is None:
        candidates = _without_lens(camera, world, pixels)
    else:
        candidates = _through_lens(camera, world, pixels, noise)
    found: list[Solution] = []
    for pose in candidates:
        _add(found, pose, float((((project(camera, pose, world) - image) / np.reshape(noise, (-1, 1))) ** 2).sum()))
    return sorted(found, key=lambda solution: solution.square)


def _without_lens(camera: Camera, world: FloatArray, pixels: FloatArray) -> Iterator[FloatArray]:
    """Poses of a camera that does not distort, each a local optimum; arguments as in `solutions`."""
    cv2, matrix = optional("cv2", "estimators"), intrinsics(camera)
    for turn, shift in _candidates(world, pixels, matrix):
        turn, shift = cv2.solvePnPRefineLM(world, pixels, matrix, None, turn, shift)
        yield inverse(_motion(cv2.Rodrigues(turn)[0], shift))


def _through_lens(camera: Camera, world: FloatArray, pixels: FloatArray, noise: ArrayLike) -> Iterator[FloatArray]:
    """The same behind a lens, from those of a pinhole that looks where the points are."""
    cv2 = optional("cv2", "estimators")
    turned, within, rays = straightened(bearings(camera, pixels))
    if np.count_nonzero(within) < FEWEST_POINTS:
        return
    whole = PointImage(camera, np.eye(4), world, pixels, np.broadcast_to(np.asarray(noise, dtype=float), len(world)))
    near, seen = np.ascontiguousarray(world[within]), np.ascontiguousarray(rays[within])
    for turn, shift in _candidates(near, seen, np.eye(3)):
        start = _motion(turned.T @ cv2.Rodrigues(turn)[0], turned.T @ shift)
        yield _refined([whole], inverse(start))


def _motion(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """The rigid motion y = turn x + shift, `(4, 4)`."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, np.ravel(shift)
    return motion


def _candidates(world: FloatArray, pixels: FloatArray, matrix: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Turns and shifts from the world to a pinhole camera that may have taken an image, see `solutions`."""
    cv2 = optional("cv2", "estimators")
    extents = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    flat = extents[2] <= FLATNESS * extents[0]
    candidates: list[tuple[FloatArray, FloatArray]] = []
    for method in (cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE) if flat else (cv2.SOLVEPNP_SQPNP,):
        _, turns, shifts, _ = cv2.solvePnPGeneric(world, pixels, matrix, None, flags=method)
        candidates += zip(turns, shifts, strict=True)
    if len(world) == FEWEST_POINTS and not flat:
        for three in map(list, combinations(range(FEWEST_POINTS), 3)):
            _, turns, shifts = cv2.solveP3P(world[three], pixels[three], matrix, None, cv2.SOLVEPNP_P3P)
            candidates += zip(turns, shifts, strict=True)
    return candidates


def straightened(seen: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray]:
    """A pinhole's image of what is seen in directions, turned towards the middle of it.

    Args:
        seen: unit vectors in the camera's frame, `(M, 3)`; NaN where nothing is.

    Returns:
        the turn from the camera's frame to that of the pinhole, `(3, 3)`; which directions are near enough to its axis,
        `(M,)`; where it images them, at a focal length of 1, `(M, 2)`.
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
    """The pose of the body near this one that fits the images best, by Gauss and Newton."""
    least = np.inf
    for _ in range(ROUNDS):
        off = np.concatenate([image.off(pose) for image in images])
        if not (square := float((off**2).sum())) < least * (1.0 - GAIN):  # NaN where a point has no image
            break
        best, least = pose, square
        slopes = [
            image.slope(to_camera(pose @ image.mounted, image.points)) / image.noise[:, None, None] for image in images
        ]
        pose = pose @ exp(np.linalg.lstsq(np.concatenate(slopes).reshape(-1, 6), -off.ravel())[0])
    return best if np.isfinite(least) else pose


def body_from_corners(
    cameras: Sequence[Camera], mounted: FloatArray, points: FloatArray, images: Sequence[FloatArray]
) -> FloatArray:
    """The pose of a body that fits the corners in the images of all its cameras best.

    Args:
        cameras: C of them.
        mounted: where they are on the body, `(C, 4, 4)`.
        points: of the tags' corners, world frame, metres, `(M, ..., 3)`.
        images: the corners each camera found, `(M, ..., 2)`; points with a NaN are left out.

    Returns:
        X of the body, `(4, 4)`; NaN where no camera has four points, or if there is no solution.
    """
    shots, world = [], np.reshape(points, (-1, 3))
    for camera, at, image in zip(cameras, mounted, images, strict=True):
        pixels = np.reshape(image, (-1, 2))
        known = np.isfinite(pixels).all(axis=1)
        shots.append(PointImage(camera, at, world[known], pixels[known], np.ones(np.count_nonzero(known))))
    found = body_solutions(shots)
    return found[0].pose if found else np.full((4, 4), np.nan)


def pose_from_corners(camera: Camera, points: FloatArray, image: FloatArray) -> FloatArray:
    """The pose that fits best.

    Args:
        points: of the tags' corners, world frame, metres, `(M, ..., 3)`.
        image: the corners found, pixels from the border, `(M, ..., 2)`; points with a NaN are left out.

    Returns:
        X, camera to world, `(4, 4)`; NaN with fewer than four points or if there is no solution.
    """
    return body_from_corners([camera], np.eye(4)[None], points, [image])


def pose_error(true: FloatArray, estimated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far an estimated pose `(..., 4, 4)` is off: metres and rad, `(...)` each; NaN if there is no estimate."""
    distance = np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1)
    return np.asarray(distance), angle_between(true, estimated)
