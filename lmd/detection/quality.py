"""How good a tag looks from a pose: what decides whether a detector finds it.

Let y be the tag's centre and n its unit normal in the camera's frame, z > 0 the depth of y, and P = d(u, v)/dy of the
pinhole camera, P = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)]. Metres in the tag's plane become pixels by
J = P E with E (3, 2) any orthonormal basis of the plane. Its singular values need no basis, only
|J|_F^2 = |P|_F^2 - |P n|^2 and |det J| = f_u f_v |n . y| / z^3.

A lens that distorts puts its Jacobian D between the focal lengths F = diag(f_u, f_v) and the rest of J, J = F D E' / z:
then |J|_F^2 is the trace of F D E' E'^T D F / z^2, and |det J| grows by |det D|.

Everything is a function of arrays: poses `(..., 4, 4)`, K centres and normals `(K, 3)`, results `(..., K)`.
"""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.distortion import jacobian
from lmd.render.optics import intrinsics, to_camera
from lmd.scene.camera import Camera
from lmd.scene.tag import Tag


def pitch(camera: Camera, pose: FloatArray, centres: FloatArray, normals: FloatArray, tag: Tag) -> FloatArray:
    """Pixels a module where it is shortest: the smaller singular value of J times the edge over N.

    With s = |J|_F^2 and d = |det J| it is d / sqrt((s + sqrt(s^2 - 4 d^2)) / 2).

    Args:
        camera: its focal lengths and distortion.
        pose: X, camera to world, `(..., 4, 4)`.
        centres: world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.
        tag: its edge and modules.

    Returns:
        `(..., K)`, pixels; NaN for tags that are not in front of the camera. It does not ask which side is seen.
    """
    square, determinant = _stretch(camera, pose, centres, normals)
    root = np.sqrt(np.maximum(square**2 - 4.0 * determinant**2, 0.0))
    return np.asarray(determinant / np.sqrt((square + root) / 2.0) * tag.module)


def apparent_edge(camera: Camera, pose: FloatArray, centres: FloatArray, normals: FloatArray, tag: Tag) -> FloatArray:
    """Edge of the square of the same area in the image, sqrt(|det J|) times the edge; arguments as for `pitch`.

    Returns:
        `(..., K)`, pixels; NaN for tags that are not in front of the camera.
    """
    _, determinant = _stretch(camera, pose, centres, normals)
    return np.asarray(np.sqrt(determinant) * tag.size)


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
    """|J|_F^2 and |det J|, pixels^2 / metre^2, `(..., K)`; NaN behind the camera."""
    focal = np.diag(intrinsics(camera))[:2]
    y = to_camera(pose, centres)
    n = np.asarray(normals @ pose[..., :3, :3])
    depth = np.where(y[..., 2] > 0.0, y[..., 2], np.nan)
    ray = y[..., :2] / depth[..., None]
    scale = (focal / depth[..., None]) ** 2
    moved = n[..., :2] - ray * n[..., 2:]  # P n without its factors f / z
    determinant = focal.prod() * np.abs((n * y).sum(axis=-1)) / depth**3
    if not camera.distortion:
        return np.asarray((scale * (1.0 + ray**2 - moved**2)).sum(axis=-1)), np.asarray(determinant)
    bend = jacobian(ray, camera.distortion)
    stretch = bend[..., 0, 0] * bend[..., 1, 1] - bend[..., 0, 1] ** 2
    gram = np.eye(2) + ray[..., None] * ray[..., None, :] - moved[..., None] * moved[..., None, :]
    along = np.diagonal(bend @ gram @ bend, axis1=-2, axis2=-1)
    return np.asarray((scale * along).sum(axis=-1)), np.asarray(determinant * np.abs(stretch))
