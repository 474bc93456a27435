"""Projection: world points to image points, pixels to rays, and the defocus blur at a depth.

Image coordinates are pixels from the top-left *border* of the image, u to the right and v down. The centre of the first
pixel is at (0.5, 0.5) and a `w` x `h` image ends at (w, h). The camera's principal point and AprilTag's corners follow
this convention; OpenCV's coordinates, from the centre of the first pixel, are smaller by 0.5.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import FloatArray
from lmd.geometry.camera import MM_PER_M, Camera
from lmd.geometry.lens_models import depth_of


def intrinsics(camera: Camera) -> FloatArray:
    """Intrinsic matrix K, `(3, 3)`, which maps camera coordinates to homogeneous image coordinates, pixels from the
    top-left border.
    """
    matrix = np.diag([*camera.focal_pixels, 1.0])
    matrix[:2, 2] = camera.principal_point
    return matrix


def image_size(camera: Camera) -> tuple[int, int]:
    """Width and height of the image, whole pixels."""
    return round(camera.image_width), round(camera.image_height)


def to_camera(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Transform world points s `(..., K, 3)`, metres, to the frames of cameras with the poses X = [R p; 0 1]: y = R^T
    (s - p).
    """
    return np.asarray((points - pose[..., None, :3, 3]) @ pose[..., :3, :3])


def project(camera: Camera, pose: FloatArray, points: FloatArray) -> FloatArray:
    """Project world points to image points.

    Args:
        camera: intrinsics and distortion.
        pose: X, camera to world, `(..., 4, 4)`.
        points: world frame, metres, `(..., K, 3)`.

    Returns:
        image coordinates `(..., K, 2)`, pixels from the top-left border, also for points outside the image. NaN for
        points behind the camera, or, for a distorting lens, beyond the camera's `widest_angle`.
    """
    seen, matrix = to_camera(pose, points), intrinsics(camera)
    if camera.lens is None:
        rays = seen[..., :2] / np.where(seen[..., 2:] > 0.0, seen[..., 2:], np.nan)
    else:
        angle = np.arctan2(np.hypot(seen[..., :1], seen[..., 1:2]), seen[..., 2:])
        rays = np.where(angle <= camera.widest_angle, camera.lens.project(seen), np.nan)
    return np.asarray(rays * np.diag(matrix)[:2] + matrix[:2, 2])


def slope(camera: Camera, points: FloatArray) -> FloatArray:
    """Jacobian of the projection with respect to points y `(..., 3)` in the camera frame, pixels per metre, `(..., 2,
    3)`.

    For a pinhole, d(u, v)/dy = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)]. For a distorting lens, the result
    is the Jacobian of the lens multiplied by the focal lengths in pixels.
    """
    if camera.lens is not None:
        return np.asarray(camera.focal_pixels[:, None] * camera.lens.jacobian(points))
    depth = points[..., 2:, None]
    moved = np.zeros((*points.shape[:-1], 2, 3))
    moved[..., [0, 1], [0, 1]] = 1.0
    moved[..., 2] = -points[..., :2] / depth[..., 0]
    moved *= camera.focal_pixels[:, None] / depth
    return moved


def bearings(camera: Camera, image: FloatArray) -> FloatArray:
    """Unproject image points `image` `(..., 2)`, pixels from the top-left border, to rays.

    Returns:
        unit vectors in the camera frame, `(..., 3)`; NaN for image points that the lens does not reach.
    """
    rays = (image - np.array(camera.principal_point)) / camera.focal_pixels
    if camera.lens is not None:
        seen = camera.lens.directions(rays)
        # Without an image circle only the fold limits the lens; `directions` is NaN beyond it.
        ended = seen[..., 2:] < math.cos(camera.widest_angle) if camera.image_circle < math.inf else False
        return np.where(ended, np.nan, seen)
    ahead = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    return np.asarray(ahead / np.linalg.norm(ahead, axis=-1, keepdims=True))


def depth_in_focus(camera: Camera, points: FloatArray) -> FloatArray:
    """Depth that determines focus and apparent size of points `(..., 3)` in the camera frame, metres, `(...)`.

    The depth is the coordinate z; for a fisheye it is the distance of the point, see
    `lmd.geometry.lens_models.depth_of`.
    """
    if camera.lens is None:
        return points[..., 2]
    return np.asarray(depth_of(camera.lens.model_numbers, *np.moveaxis(points, -1, 0)))


def blur_disc(camera: Camera, depth: ArrayLike) -> FloatArray:
    """Diameter c of the blur disc of a point at `depth` (metres, any shape) for a thin lens, pixels.

    c = d_a f |z - d_s| / (z (d_s - f) min(s_u, s_v)), or d_a f / (z min(s_u, s_v)) when focused at infinity. Here d_a
    is the aperture, f the focal length, d_s the focus distance, and s_u x s_v the pixel size. At the limits of
    `Camera.depth_of_field`, c is the circle of confusion.
    """
    z = np.asarray(depth, dtype=np.float64) * MM_PER_M
    defocus = 1.0 / z
    if np.isfinite(camera.focus_distance):
        defocus = np.abs(z - camera.focus_distance) / (z * (camera.focus_distance - camera.focal_length))
    return np.asarray(camera.aperture * camera.focal_length * defocus / min(camera.pixel_width, camera.pixel_height))


def blur_sigma(camera: Camera, depth: ArrayLike, psf_sigma: float) -> FloatArray:
    """Standard deviation of the total blur at `depth` (metres, any shape), sqrt(psf_sigma^2 + (c / 4)^2), pixels.

    `psf_sigma` is the standard deviation of the point spread function in focus, pixels, and c is the diameter of
    `blur_disc`. A disc of diameter c has the standard deviation c / 4 along each axis.
    """
    return np.asarray(np.hypot(psf_sigma, blur_disc(camera, depth) / 4.0))
