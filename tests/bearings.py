"""The information of views from the Jacobian of each corner's direction, apart from the formulas of the library."""

import numpy as np

from lmd.geometry.squares import corners, upright
from lmd.sight.reference import coverage_caps


def view_matrices(scene, deployment, position, axes):
    """Information on position and rotation of each landmark, zero in views that do not cover it, `(A, K, 6, 6)`."""
    points = corners(deployment.positions, deployment.normals, upright(deployment.normals)[1], scene.tag.edge or 0.0)
    offset = points - position
    distance = np.linalg.norm(offset, axis=-1)[..., None]
    b = offset / distance
    cross = np.cross(np.eye(3), b[..., None, :])  # -[b]x
    towards = np.eye(3) - b[..., :, None] * b[..., None, :]
    jacobian = np.concatenate([-towards / distance[..., None], -cross], axis=-1)  # (K, 4, 3, 6)
    information = np.einsum("kcia,kcib->kab", jacobian, jacobian)
    centre = deployment.positions - position
    with np.errstate(all="ignore"):  # of a landmark that is not covered the depth may be anything
        weight = (np.linalg.norm(centre, axis=1) / (axes[:, :3] @ centre.T)) ** 3
    covered = np.where(coverage_caps(scene, deployment, position, axes), weight, 0.0)
    return covered[..., None, None] * information
