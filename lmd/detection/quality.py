"""How good a tag looks from a pose: what decides whether a detector finds it.

Let y be the tag's centre and n its unit normal in the camera's frame, z > 0 the depth of y, and P = d(u, v)/dy of the
pinhole camera, P = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)]. Metres in the tag's plane become pixels by
J = P E with E (3, 2) any orthonormal basis of the plane. Its singular values need no basis, only
|J|_F^2 = |P|_F^2 - |P n|^2 and |det J| = f_u f_v |n . y| / z^3.

For a lens that distorts P is the slope of its image, and |det J| = |(P_1 x P_2) . n| with the rows of P.

Everything is a function of arrays: poses `(..., 4, 4)`, K centres and normals `(K, 3)`, results `(..., K)`.
"""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.camera import Camera
from lmd.geometry.projection import intrinsics, slope, to_camera
from lmd.scene.tag import Tag


def pitch(
    camera: Camera,
    pose: FloatArray,
    centres: FloatArray,
    normals: FloatArray,
    tag: Tag,
    edges: FloatArray | None = None,
) -> FloatArray:
    """Pixels a module where it is shortest: the smaller singular value of J times the edge over N.

    With s = |J|_F^2 and d = |det J| it is d / sqrt((s + sqrt(s^2 - 4 d^2)) / 2).

    Args:
        camera: its focal lengths and its lens.
        pose: X, camera to world, `(..., 4, 4)`.
        centres: world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.
        tag: its edge and modules.
        edges: of tags of several sizes, metres, `(K,)`.

    Returns:
        `(..., K)`, pixels; NaN for tags that are not in front of the camera, or farther from its axis than its lens
        images. It does not ask which side is seen.
    """
    square, determinant = _stretch(camera, pose, centres, normals)
    root = np.sqrt(np.maximum(square**2 - 4.0 * determinant**2, 0.0))
    module = (tag.size if edges is None else edges) / tag.modules
    return np.asarray(determinant / np.sqrt((square + root) / 2.0) * module)


def apparent_edge(
    camera: Camera,
    pose: FloatArray,
    centres: FloatArray,
    normals: FloatArray,
    tag: Tag,
    edges: FloatArray | None = None,
) -> FloatArray:
    """Edge of the square of the same area in the image, sqrt(|det J|) times the edge; arguments as for `pitch`.

    Returns:
        `(..., K)`, pixels; NaN for tags that are not in front of the camera.
    """
    _, determinant = _stretch(camera, pose, centres, normals)
    return np.asarray(np.sqrt(determinant) * (tag.size if edges is None else edges))


def incidence(pose: FloatArray, centres: FloatArray, normals: FloatArray) -> FloatArray:
    """Angle between a tag's normal and the direction from its centre to the camera, arguments as for `pitch`.

    Returns:
        `(..., K)`, rad in [0, pi]; the camera sees the front below pi / 2.
    """
    towards = pose[..., None, :3, 3] - centres
    along = (towards * normals).sum(axis=-1)
    across = np.linalg.norm(np.cross(towards, normals), axis=-1)
    return np.asarray(np.arctan2(across, along))


def _stretch(
    camera: Camera, pose: FloatArray, centres: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of the image of each tag |J|_F^2 and |det J|, pixels^2 / metre^2, `(..., K)`; NaN for what is not imaged."""
    y, n = to_camera(pose, centres), np.asarray(normals @ pose[..., :3, :3])
    if camera.lens is not None:
        angle = np.arctan2(np.hypot(y[..., 0], y[..., 1]), y[..., 2])
        moves = slope(camera, np.where((angle <= camera.widest_angle)[..., None], y, np.nan))
        along = (moves * n[..., None, :]).sum(axis=-1)
        area = np.abs((np.cross(moves[..., 0, :], moves[..., 1, :]) * n).sum(axis=-1))
        return np.asarray((moves**2).sum(axis=(-2, -1)) - (along**2).sum(axis=-1)), np.asarray(area)
    focal = np.diag(intrinsics(camera))[:2]
    depth = np.where(y[..., 2] > 0.0, y[..., 2], np.nan)
    ray = y[..., :2] / depth[..., None]
    scale = (focal / depth[..., None]) ** 2
    moved = n[..., :2] - ray * n[..., 2:]  # P n without its factors f / z
    determinant = focal.prod() * np.abs((n * y).sum(axis=-1)) / depth**3
    return np.asarray((scale * (1.0 + ray**2 - moved**2)).sum(axis=-1)), np.asarray(determinant)
