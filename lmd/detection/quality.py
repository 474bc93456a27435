"""Quality of the image of a tag: pitch, apparent edge and incidence angle, which determine its detection.

Let c = (x, y, z) be the tag's centre and n its unit normal in the camera's frame, z > 0. The Jacobian of a pinhole
image is P = d(u, v)/dc = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)]. The Jacobian J = P E maps metres in the
tag's plane to pixels, with E (3, 2) any orthonormal basis of the plane. The singular values of J follow from
|J|_F^2 = |P|_F^2 - |P n|^2 and |det J| = f_u f_v |n . c| / z^3 without a basis.

For a distorting lens P is the Jacobian of the image through the lens, and |det J| = |(P_1 x P_2) . n| with the rows
P_1, P_2 of P.

Poses are `(..., 4, 4)`, centres and normals of K tags `(K, 3)`, results `(..., K)`.
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
    """Pitch of tags: pixels per module along the most foreshortened direction.

    The pitch is the smaller singular value of J times edge / N. With s = |J|_F^2 and d = |det J| the singular value is
    d / sqrt((s + sqrt(s^2 - 4 d^2)) / 2).

    Args:
        camera: intrinsics and lens.
        pose: X, camera to world, `(..., 4, 4)`.
        centres: world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.
        tag: number of modules, and edge unless `edges` are given.
        edges: edge of each tag, metres, `(K,)`.

    Returns:
        `(..., K)`, pixels, also for tags seen from behind; NaN for tags behind the camera or outside the view of its
        lens.
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
    """Edge of a square with the area of the tag's image, sqrt(|det J|) times the edge, pixels; arguments as for
    `pitch`.
    """
    _, determinant = _stretch(camera, pose, centres, normals)
    return np.asarray(np.sqrt(determinant) * (tag.size if edges is None else edges))


def incidence(pose: FloatArray, centres: FloatArray, normals: FloatArray) -> FloatArray:
    """Incidence angle, between a tag's normal and the direction from its centre to the camera; arguments as in `pitch`.

    Returns:
        `(..., K)`, rad in [0, pi]; the front is visible below pi / 2.
    """
    towards = pose[..., None, :3, 3] - centres
    along = (towards * normals).sum(axis=-1)
    across = np.linalg.norm(np.cross(towards, normals), axis=-1)
    return np.asarray(np.arctan2(across, along))


def _stretch(
    camera: Camera, pose: FloatArray, centres: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """|J|_F^2 and |det J| of each tag, pixels^2 / metre^2, `(..., K)` each; NaN for tags that are not imaged."""
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
    moved = n[..., :2] - ray * n[..., 2:]  # P n without the factors f / z
    determinant = focal.prod() * np.abs((n * y).sum(axis=-1)) / depth**3
    return np.asarray((scale * (1.0 + ray**2 - moved**2)).sum(axis=-1)), np.asarray(determinant)
