"""Where a camera images a point, and how sharply.

Image coordinates are pixels from the top-left *border* of the image, u to the right and v down: the centre of the
first pixel is at (0.5, 0.5) and a `w` x `h` image ends at (w, h). The camera's principal point and AprilTag's
corners count this way; OpenCV counts from the first pixel's centre, 0.5 less.
"""

import numpy as np
from numpy.typing import ArrayLike

from lmd.camera import MM_PER_M, Camera
from lmd.checks import FloatArray

# Newton's method has found a ray when its last step was smaller.
CONVERGED = 1e-9


def intrinsics(camera: Camera) -> FloatArray:
    """K, which maps camera coordinates to homogeneous image coordinates from the border, `(3, 3)`."""
    matrix = np.diag([*camera.focal_pixels, 1.0])
    matrix[:2, 2] = camera.principal_point
    return matrix


def image_size(camera: Camera) -> tuple[int, int]:
    """Width and height, whole pixels."""
    return round(camera.image_width), round(camera.image_height)


def to_camera(pose: FloatArray, points: FloatArray) -> FloatArray:
    """y = R^T (s - p) of world points `(..., K, 3)`, metres, for camera poses X `(..., 4, 4)`."""
    return np.asarray((points - pose[..., None, :3, 3]) @ pose[..., :3, :3])


def distort(rays: FloatArray, distortion: ArrayLike) -> FloatArray:
    """Distorted (x / z, y / z): OpenCV's radial and tangential model with (k1, k2, p1, p2, k3).

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2) and
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y with r^2 = x^2 + y^2.

    Args:
        rays: (x / z, y / z), `(..., 2)`.
        distortion: the five coefficients.

    Returns:
        `(..., 2)`.
    """
    k1, k2, p1, p2, k3 = np.asarray(distortion, dtype=np.float64)
    x, y = rays[..., 0], rays[..., 1]
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )


def undistort(rays: FloatArray, distortion: ArrayLike, steps: int = 20) -> FloatArray:
    """The inverse of `distort` near the optical axis by Newton's method, `(..., 2)`.

    NaN where it does not converge in `steps`: the distortion has no such ray there, or the image folds.
    """
    k1, k2, p1, p2, k3 = np.asarray(distortion, dtype=np.float64)
    found = np.array(rays, dtype=np.float64)
    for _ in range(steps):
        x, y = found[..., 0], found[..., 1]
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        slope = 2.0 * (k1 + square * (2.0 * k2 + 3.0 * square * k3))  # d(radial) / d(r^2), twice
        xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        a, b = np.moveaxis(rays - distort(found, distortion), -1, 0)
        with np.errstate(all="ignore"):
            step = np.stack([yy * a - xy * b, xx * b - xy * a], axis=-1) / (xx * yy - xy * xy)[..., None]
            found += step
        if np.nanmax(np.abs(step), initial=0.0) < CONVERGED:
            break
    return np.where((np.abs(step) < CONVERGED).all(axis=-1, keepdims=True), found, np.nan)


def project(camera: Camera, pose: FloatArray, points: FloatArray, distortion: ArrayLike = ()) -> FloatArray:
    """Image coordinates of points, from the border (see above).

    Args:
        camera: its focal lengths f / s_u, f / s_v and principal point.
        pose: X, camera to world, `(..., 4, 4)`.
        points: world frame, metres, `(..., K, 3)`.
        distortion: none, or the coefficients of `distort`.

    Returns:
        `(..., K, 2)`, pixels, also of points outside the image; NaN for points that are not in front of the camera.
    """
    seen = to_camera(pose, points)
    depth = np.where(seen[..., 2:] > 0.0, seen[..., 2:], np.nan)
    rays = seen[..., :2] / depth
    if np.size(distortion):
        rays = distort(rays, distortion)
    matrix = intrinsics(camera)
    return np.asarray(rays * np.diag(matrix)[:2] + matrix[:2, 2])


def slope(camera: Camera, points: FloatArray) -> FloatArray:
    """How the pinhole image of points y `(..., 3)` in the camera's frame moves with them, pixels/m, `(..., 2, 3)`.

    d(u, v)/dy = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)].
    """
    depth = points[..., 2:, None]
    moved = np.zeros((*points.shape[:-1], 2, 3))
    moved[..., [0, 1], [0, 1]] = 1.0
    moved[..., 2] = -points[..., :2] / depth[..., 0]
    moved *= camera.focal_pixels[:, None] / depth
    return moved


def blur_disc(camera: Camera, depth: ArrayLike) -> FloatArray:
    """Diameter c of the disc that a thin lens makes of a point at `depth` (metres, any shape), pixels.

    c = d_a f |z - d_s| / (z (d_s - f) min(s_u, s_v)), and d_a f / (z min(s_u, s_v)) when focused at infinity: the
    blur that bounds `Camera.depth_of_field`.
    """
    z = np.asarray(depth, dtype=np.float64) * MM_PER_M
    defocus = 1.0 / z
    if np.isfinite(camera.focus_distance):
        defocus = np.abs(z - camera.focus_distance) / (z * (camera.focus_distance - camera.focal_length))
    return np.asarray(camera.aperture * camera.focal_length * defocus / min(camera.pixel_width, camera.pixel_height))


def blur_sigma(camera: Camera, depth: ArrayLike, psf_sigma: float) -> FloatArray:
    """Standard deviation of the whole blur at `depth` (metres, any shape), sqrt(psf^2 + (c / 4)^2), pixels.

    A disc of diameter c has the standard deviation c / 4 along each axis.
    """
    return np.asarray(np.hypot(psf_sigma, blur_disc(camera, depth) / 4.0))
