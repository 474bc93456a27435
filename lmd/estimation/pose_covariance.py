"""Covariance of the pose that a least-squares solver estimates from the simultaneous images of one or several cameras.

The errors are those of the corners in the images and of the tags in the map. The index t stands for one tag in the
image of one camera; a tag in view of two cameras has two such indices. J_t (8, 6) is the Jacobian of the image corners
of t with respect to the body twist (w, v). The solver gives these corners the weight w_t. Let H = sum w_t J_t^T J_t.
The error of the pose is to first order

    e = H^-1 sum w_t J_t^T r_t,    r_t = n_t + (b + mu_t) s_t + M_t m_t.

- n_t: noise of corners, with the covariance sigma_t^2 Q, independent between tags. Q is the identity, or has the modes
  of `lmd.detection.corner_errors.MeasuredCorners`.
- b: shift of all edges in the image of a camera, inward or outward, with the variance beta^2. s_t is the displacement
  of the corners by a shift of one pixel (`lmd.detection.corner_errors.inward`). Solvers do not correct the mean shift
  mu_t of the detector, so its square is added.
- m_t: error in the position and rotation of the tag in the map. M_t (8, 6) is the Jacobian of the corners with respect
  to this error. The errors of tags t and u have the covariance P_tu, which is 0 for t != u unless a survey states the
  covariance of all tags together.

The mean of e e^T, called covariance here, is H^-1 N H^-1. The matrix in the middle is

    N = sum w_t^2 sigma_t^2 J_t^T Q J_t + g g^T + beta^2 sum h_c h_c^T + sum B_t P_tu B_u^T.

Here g = sum w_t mu_t J_t^T s_t, and h_c is the sum of w_t J_t^T s_t over the tags in the image of camera c. In the last
sum, t and u stand for tags of the map. B_t is the sum of w_t J_t^T M_t over the images of tag t in all cameras.

With w_t = 1 / sigma_t^2, Q = I, and without shifts and P this is the Cramer-Rao bound. Solvers such as OpenCV's
`solvePnP` have w_t = 1; a tag with a large sigma_t or P_tt may then raise the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_array

from lmd.adjust.corners import sums_by
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import MODES, CornerErrors, MeasuredCorners, incidence, inward, pitch
from lmd.estimation.cramer_rao import determines_pose
from lmd.geometry.camera import Camera
from lmd.geometry.pose import image_slopes
from lmd.geometry.projection import project, slope, to_camera
from lmd.geometry.se3 import seen_by_twist
from lmd.geometry.squares import corners
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

WEIGHTS = ("equal", "noise")
FRAMES_AT_ONCE = 1000  # frames processed together, with sums over tags of 288 bytes times the number of tags each


@dataclass(frozen=True)
class TagErrors:
    """Errors of K tags (image corners, and poses in the map), and the weights that a PnP solver gives to corners."""

    noise: CornerErrors | MeasuredCorners | float
    """Errors of corners as functions of the pitch (pixels per module); or the standard deviation of each coordinate of
    a corner, pixels.
    """
    shift: float
    """Standard deviation beta of the shift of edges that all tags in the image of a camera share, pixels."""
    places: FloatArray
    """Covariance P_tt of the position (metres) and rotation (rad) of each tag in the world frame, `(K, 6, 6)`."""
    weights: str = "equal"
    """Weights of corners: `equal`, or `noise` for 1 / sigma^2."""
    joint: FloatArray | None = None
    """Additional joint covariance P_tu of the errors in position and rotation of all tags, tag by tag, `(6 K, 6 K)`;
    None for independent tags.
    """

    def at(self, pitches: FloatArray, incidences: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Standard deviation of a coordinate of a corner, and mean shift of the edges towards the tag's centre, pixels,
        `(...)` each.

        Args:
            pitches: pitches of the tags, pixels per module, `(...)`.
            incidences: incidence angles, rad, `(...)`.
        """
        if isinstance(self.noise, float):
            return np.full(pitches.shape, self.noise), np.zeros(pitches.shape)
        where = (pitches, incidences) if isinstance(self.noise, MeasuredCorners) else (pitches,)
        return self.noise.independent_sigma(*where), self.noise.inward_at(pitches)

    @property
    def modes(self) -> FloatArray:
        """Covariance Q of the noise of a tag's eight corner coordinates, `(8, 8)`, divided by the variance of a
        coordinate.
        """
        if not isinstance(self.noise, MeasuredCorners):
            return np.eye(8)
        return np.asarray(np.kron(np.tensordot(self.noise.modes, MODES, axes=1), np.eye(2)))


def pose_covariances(
    cameras: Sequence[Camera],
    extrinsics: FloatArray,
    poses: FloatArray,
    deployment: Deployment,
    tag: Tag,
    seen: BoolArray,
    errors: TagErrors,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance of the body's pose as estimated from the images of C cameras in each of F frames.

    Args:
        cameras: intrinsics and distortion of the cameras.
        extrinsics: poses of the cameras in the frame of the body, `(C, 4, 4)`.
        poses: poses X of the body, `(F, 4, 4)`.
        deployment: K tags with their poses in the map.
        tag: family of the tags, and edge length of the tags for which `deployment` has none.
        seen: mask of the tags in view of each camera, `(C, F, K)`; the corners of these tags must be in front of the
            camera.
        errors: errors of the K tags.

    Returns:
        covariances: covariance of the body twist (w, v), `(F, 6, 6)`; infinite if the pose is undetermined.
        sigmas: standard deviation of a corner coordinate of each tag, pixels, `(F, K)`, the largest over the cameras; 0
            for tags not in view.
        jacobians: for each of the P pairs of a frame and a tag in view, the Jacobian H^-1 B_t of the module's
            docstring, `(P, 6, 6)`; 0 if the pose is undetermined. The Jacobian is that of the estimated body twist with
            respect to the tag's error in the map, in position (m) and rotation (rad), world frame.
    """
    edges, frames, shown = deployment.edges_of(tag), len(poses), np.asarray(seen.any(axis=0))
    number = np.cumsum(shown).reshape(shown.shape) - 1  # of each pair of a frame and a tag in view
    information, noise = np.zeros((2, frames, 6, 6))
    shifts, sigmas = np.zeros((frames, 1 + len(cameras), 6)), np.zeros(shown.shape)
    by_map = np.zeros((shown.sum(), 6, 6))
    for c, (camera, mounted, mask) in enumerate(zip(cameras, extrinsics, seen, strict=True)):
        frame, which = np.nonzero(mask)
        summed = sums_by(frame, frames)
        at, centres, normals = poses[frame] @ mounted, deployment.places[which], deployment.normals[which]
        turned = (normals[:, None, :] @ at[:, :3, :3])[:, 0]
        where = np.eye(4), to_camera(at, centres[:, None])[:, 0], turned
        angles = np.asarray(pitch(camera, *where, tag, edges[which])), np.asarray(incidence(*where))
        sigma, mean_shift = errors.at(*angles)
        weight = 1.0 / sigma**2 if errors.weights == "noise" else np.ones_like(sigma)
        points = corners(centres, normals, deployment.ups[which], edges[which])
        y = to_camera(at, points)
        jacobian = image_slopes(camera, mounted, y).reshape(-1, 8, 6)
        # A corner at the offset q from the centre moves by p - [q]x r if the tag moves by (p, r) in the world.
        moved_corners = -seen_by_twist(points - centres[:, None])[..., [3, 4, 5, 0, 1, 2]]
        by_place = (slope(camera, y) @ np.swapaxes(at[:, None, :3, :3], -1, -2) @ moved_corners).reshape(-1, 8, 6)
        weighted = np.swapaxes(jacobian, 1, 2) * weight[:, None, None]
        information += summed(weighted @ jacobian)
        spread = weighted * sigma[:, None, None]
        noise += summed(spread @ errors.modes @ np.swapaxes(spread, 1, 2))
        moved = (weighted @ inward(project(camera, np.eye(4), y)).reshape(-1, 8, 1))[..., 0]
        shifts[:, 0] += summed(mean_shift[:, None] * moved)
        shifts[:, 1 + c] = errors.shift * summed(moved)
        by_map[number[frame, which]] += weighted @ by_place
        sigmas[frame, which] = np.maximum(sigmas[frame, which], sigma)
    fixed, solved = determines_pose(information), np.zeros(information.shape)
    solved[fixed] = np.linalg.inv(information[fixed])
    total = noise + _by_map(by_map, shown, errors) + np.swapaxes(shifts, 1, 2) @ shifts
    found, pulls = solved @ total @ solved, solved[np.nonzero(shown)[0]] @ by_map
    return np.where(fixed[:, None, None], found, np.inf), sigmas, pulls


def _by_map(by_map: FloatArray, shown: BoolArray, errors: TagErrors) -> FloatArray:
    """Part of the matrix N that is due to the map's errors: the sum of B_t P_tu B_u^T in each frame, `(F, 6, 6)`.

    The module's docstring defines the symbols. The mask `shown` `(F, K)` marks the P pairs of a frame and a tag in
    view; `by_map` `(P, 6, 6)` has the matrix B_t of each pair.
    """
    frames, (frame, which) = len(shown), np.nonzero(shown)
    back = np.swapaxes(by_map, 1, 2)
    found = by_map @ errors.places[which] @ back
    if errors.joint is not None:
        count, ends = len(errors.places), np.searchsorted(frame, np.arange(frames + 1))
        for first in range(0, frames, FRAMES_AT_ONCE):
            at = ends[first : first + FRAMES_AT_ONCE + 1]
            some = slice(at[0], at[-1])
            rows = bsr_array((by_map[some], which[some], at - at[0]), shape=(6 * (len(at) - 1), 6 * count))
            shared = (rows @ errors.joint).reshape(-1, 6, count, 6)  # sum_t B_t P_tu
            found[some] += shared[frame[some] - first, :, which[some]] @ back[some]
    return sums_by(frame, frames)(found)
