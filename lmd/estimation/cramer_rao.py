"""Cramer-Rao bound on the pose of a camera from the images of landmarks.

Let the pose X change to X exp(w, v), with a rotation w and a displacement v. A landmark at y_i = (x, y, z) in the
camera's frame then moves by y_i x w - v, where y_i x w is a cross product. The image of the landmark moves by J_i (w,
v) with `J_i = [(f_u / z) (1, 0, -x / z); (f_v / z) (0, 1, -y / z)] [[y_i]x  -I]`. Here f_u and f_v are the focal
lengths in pixels, [y_i]x is the matrix of the cross product with y_i, and I the unit matrix. For a distorting lens, the
Jacobian of the lens (`lmd.geometry.lens`) replaces the factors with focal lengths. With pixel noise sigma the Fisher
information about the pose is sum J_i^T J_i / sigma^2. No unbiased estimate from this one frame has a smaller covariance
than the inverse of the information. Fewer than three landmarks, or collinear landmarks, do not determine the pose: the
bound is infinite.

Let M be the pose of a camera on the body of a rig (`lmd.scene.rig.Rig.extrinsics`). If the body moves by (w, v), the
camera moves by A (w, v), where A = Ad_{M^-1} is the adjoint matrix (`lmd.geometry.se3`). The Fisher information of all
images at one time is the sum of A^T F A over the cameras, where F is the information of one camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.adjust.corners import sums_by
from lmd.core.checks import BoolArray, FloatArray
from lmd.estimation.estimators import Errors
from lmd.estimation.recording import Recording
from lmd.geometry.camera import Camera
from lmd.geometry.pose import image_slopes
from lmd.geometry.projection import to_camera
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator, averaged
from lmd.sight.views import visible_to_each

# Minimum eigenvalue of the scaled information for a pose to be determined; smaller eigenvalues are rounding errors.
SINGULAR_EIGENVALUE = 1e-9
# Number of poses processed together.
POSE_CHUNK = 1 << 14


def pose_information(
    cameras: Sequence[Camera],
    extrinsics: FloatArray,
    poses: FloatArray,
    landmarks: FloatArray,
    seen: BoolArray,
    noise: Sequence[FloatArray] | None = None,
) -> FloatArray:
    """Fisher information about the pose of a body in each of F frames, from the images of its C cameras, `(F, 6, 6)`.
    The parameters of the pose are body twists (w, v): rotation w and displacement v.

    Args:
        cameras: intrinsics and distortion of the cameras.
        extrinsics: poses of the cameras in the frame of the body, `(C, 4, 4)`.
        poses: poses X of the body, `(F, 4, 4)`.
        landmarks: positions C_i of the landmarks, world frame, metres, `(K, 3)`.
        seen: mask of the landmarks in view of each camera, `(C, F, K)`; these landmarks must be in front of the camera.
        noise: for each camera, standard deviation of the image points of the landmarks in view, pixels, `(M,)`, in the
            order of `np.nonzero` of the camera's mask `seen`; None for one pixel.
    """
    total = np.zeros((len(poses), 6, 6))
    for c, (camera, mounted, mask) in enumerate(zip(cameras, extrinsics, seen, strict=True)):
        frame, landmark = np.nonzero(mask)
        y = to_camera((poses @ mounted)[frame], landmarks[landmark, None])[:, 0]
        jacobian = image_slopes(camera, mounted, y) / (1.0 if noise is None else noise[c][:, None, None])
        total += sums_by(frame, len(poses))(np.swapaxes(jacobian, 1, 2) @ jacobian)
    return total


def determines_pose(information: FloatArray) -> BoolArray:
    """Mask of the Fisher information matrices `information` `(..., 6, 6)` that are invertible, and therefore determine
    a pose, `(...)`. The matrices are scaled to a unit diagonal first, so that the result does not depend on units.
    """
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, np.inf))
    scaled = scale[..., :, None] * information * scale[..., None, :]
    return np.asarray(np.linalg.eigvalsh(scaled)[..., 0] > SINGULAR_EIGENVALUE)


def cramer_rao_bound(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest standard deviations of position (metres) and attitude (rad) of an estimated pose, `(...)` each.

    The two numbers are the square roots of the traces of the position block and the attitude block of the inverse
    information. Both are infinite if the information does not determine the pose, see `determines_pose`.

    Args:
        information: Fisher information about poses, `(..., 6, 6)`.
    """
    fixed = determines_pose(information)
    variance = np.full((*information.shape[:-2], 6), np.inf)
    variance[fixed] = np.diagonal(np.linalg.inv(information[fixed]), axis1=-2, axis2=-1)
    return np.sqrt(variance[..., 3:].sum(axis=-1)), np.sqrt(variance[..., :3].sum(axis=-1))


@dataclass(frozen=True)
class CramerRaoMap:
    """Cramer-Rao bounds on the camera pose at each position, for image noise of one pixel.

    Each bound is the median over the orientations of the orientation PDF.
    """

    positions: FloatArray
    """Positions, world frame, metres, `(P, 3)`."""
    share: FloatArray
    """Probability under the orientation PDF that a single frame determines the pose, `(P,)`."""
    position: FloatArray
    """Median bound on the position over the orientations that determine the pose, metres, `(P,)`; infinite without such
    an orientation.
    """
    attitude: FloatArray
    """Median bound on the attitude over the orientations that determine the pose, rad, `(P,)`; infinite without such an
    orientation.
    """

    def metrics(self) -> dict[str, float]:
        """Metrics: probability that a single frame determines the pose, and medians of the bounds over the positions
        with a finite bound.
        """
        metrics = {"pose_fixed_share": float(self.share.mean())}
        some = self.share > 0.0
        if some.any():
            metrics["position_bound_mm_per_pixel"] = float(1e3 * np.median(self.position[some]))
            metrics["attitude_bound_mrad_per_pixel"] = float(1e3 * np.median(self.attitude[some]))
        return metrics

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV with one row per position; cells of infinite bounds are empty.

        The columns are `x,y,z` (m); `share`, the probability that a frame determines the pose; and the median bounds
        `position` (m) and `attitude` (rad).
        """
        bounds = {"share": self.share, "position": self.position, "attitude": self.attitude}
        columns = dict(zip("xyz", self.positions.T, strict=True)) | bounds
        pd.DataFrame(columns).replace(np.inf, np.nan).to_csv(path, index=False)


def cramer_rao_map(scene: Scene, evaluator: Evaluator, deployment: Deployment) -> CramerRaoMap:
    """Compute the Cramer-Rao bounds on the pose at every position of `evaluator`, over all orientations of the PDF and
    all crowd states.
    """
    pdf, positions, weight = scene.pdf, evaluator.positions, scene.probability(evaluator.positions)
    _, first = np.unique(scene.orientations.index_of, return_index=True)
    turns = camera_pose(np.zeros(3), pdf.yaw[first], pdf.pitch[first], np.asarray(pdf.roll)[first])
    per_chunk, parts = max(POSE_CHUNK // len(turns), 1), []
    for start in range(0, len(positions), per_chunk):
        here = positions[start : start + per_chunk]
        poses = np.tile(turns, (len(here), 1, 1))
        poses[:, :3, 3] = np.repeat(here, len(turns), axis=0)
        states = None if evaluator.states is None else evaluator.states[start : start + per_chunk].repeat(len(turns))
        seen = visible_to_each(evaluator, deployment, poses[:, :3, 3], axis_and_right(poses), states)
        told = pose_information(scene.cameras, scene.extrinsics, poses, deployment.positions, seen)
        parts.append(cramer_rao_bound(told))
    position, attitude = (np.concatenate(part).reshape(len(positions), -1) for part in zip(*parts, strict=True))
    weight, position, attitude = evaluator.by_place(weight, position, attitude)
    positions, share = positions[: len(position)], averaged(np.isfinite(position), weight)
    return CramerRaoMap(positions, share, _finite_median(position, weight), _finite_median(attitude, weight))


def _finite_median(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted median of the finite numbers in each row, `(P,)`; infinite for rows without a finite number.

    `values` has the shape `(P, D)`.
    """
    known = np.isfinite(values)
    weights = np.where(known | ~known.any(axis=1, keepdims=True), weight, 0.0)
    return np.asarray(np.quantile(values, 0.5, axis=1, weights=weights, method="inverted_cdf"))


@dataclass(frozen=True)
class CramerRaoBound:
    """Least RMS pose error that an unbiased estimate from a single frame can have, given the pixel noise.

    The class has the interface `Estimator`, so that tables can show the bound beside real estimators. A tag is measured
    by the images of its corners, a point by the image of its centre. An estimator that uses earlier frames may have
    smaller errors. The bound on the mean of the squared error Er (see `Errors.frobenius`) is tr S_vv + 2 tr S_ww. Here
    S is the bound on the covariance of the pose, with the blocks S_vv of the position and S_ww of the attitude.
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `Estimator.errors`."""
        largest = float(recording.noise.max(initial=0.0))
        relative = recording.noise / largest if largest > 0.0 else np.ones_like(recording.noise)
        runs, corners = [], 1 if recording.tags is None else 4
        cameras, count = recording.seen_by.shape[2:]
        body = recording.camera.cameras, recording.camera.extrinsics
        for s, poses in enumerate(recording.poses):
            points = (recording.landmarks if recording.tags is None else recording.tags)[s, :count].reshape(-1, 3)
            seen = np.moveaxis(recording.seen_by[s], 1, 0).repeat(corners, axis=-1)
            camera = np.nonzero(recording.seen[s])[1] // count  # camera of each detection
            its = relative[recording.detections(s)]
            noise = [its[camera == c].repeat(corners) for c in range(cameras)]
            runs.append(cramer_rao_bound(pose_information(*body, poses, points, seen, noise)))
        bounds = np.array(runs).transpose(1, 0, 2)
        position, attitude = largest * np.where(np.isfinite(bounds), bounds, np.nan)
        return Errors(position**2 + 2.0 * attitude**2, position, attitude)
