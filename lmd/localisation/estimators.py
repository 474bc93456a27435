"""Other ways to localise the same camera from the same recording, behind one interface with the observer."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.checks import FloatArray, real
from lmd.geometry.se3 import act, inverse, skew
from lmd.localisation.cramer_rao import cramer_rao_bound, pose_information
from lmd.localisation.errors import Errors, pose_errors
from lmd.localisation.recording import Recording
from lmd.optional import optional

# The fewest points of one frame from which OpenCV's general solvers take a pose.
PNP_POINTS = 4


class Estimator(Protocol):
    """Something that localises a camera."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """Its errors in every frame of every run, NaN where it has no estimate.

        Args:
            recording: S runs.
            start: initial estimate of the pose, `(S, 4, 4)`; what needs none ignores it.

        Raises:
            InputError: it cannot work with this recording, or a package it needs is missing.
        """


@dataclass(frozen=True)
class CramerRaoBound:
    """The least root-mean-square error of any unbiased estimate from a single frame, given the pixel noise.

    An estimator that remembers earlier frames may do better. Er is the expected one, tr S_vv + 2 tr S_ww.
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `Estimator.errors`."""
        largest = float(recording.noise.max(initial=0.0))
        relative = recording.noise / largest if largest > 0.0 else np.ones_like(recording.noise)
        runs, corners = [], 1 if recording.tags is None else 4
        for s, poses in enumerate(recording.poses):
            points = recording.landmarks[s] if recording.tags is None else recording.tags[s].reshape(-1, 3)
            seen = recording.seen[s].repeat(corners, axis=1)
            noise = relative[recording.detections(s)].repeat(corners)
            bounds = cramer_rao_bound(pose_information(poses, points, seen, recording.camera, noise))
            runs.append([np.where(np.isfinite(bound), bound, np.nan) for bound in bounds])
        position, attitude = largest * np.array(runs).transpose(1, 0, 2)
        return Errors(position**2 + 2.0 * attitude**2, position, attitude)


@dataclass(frozen=True)
class PerspectiveNPoint:
    """The pose of each frame on its own (PnP): SQPnP of OpenCV, refined by Levenberg-Marquardt.

    It takes the image coordinates of the landmarks' centres, not their apparent size, and needs four of them.
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `Estimator.errors`."""
        cv2 = optional("cv2", "estimators")
        focal = np.append(recording.camera.focal_pixels, 1.0)
        matrix = np.diag(focal)
        estimates = np.full_like(recording.poses, np.nan)
        enough = recording.visible_counts >= PNP_POINTS
        for s, t in zip(*np.nonzero(enough), strict=True):
            seen = recording.seen[s, t]
            points = recording.points[s, t, seen]
            image, world = focal[:2] * points[:, :2] / points[:, 2:], recording.landmarks[s, seen]
            found, turn, shift = cv2.solvePnP(world, image, matrix, None, flags=cv2.SOLVEPNP_SQPNP)
            if not found:
                continue
            turn, shift = cv2.solvePnPRefineLM(world, image, matrix, None, turn, shift)
            back = np.eye(4)
            back[:3, :3], back[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
            estimates[s, t] = inverse(back)
        return pose_errors(recording.poses, estimates)


@dataclass(frozen=True)
class InvariantKalmanFilter:
    """The left-invariant extended Kalman filter of GTSAM with the observer's measurements y_i = X^-1 C_i.

    Args:
        attitude: standard deviation of the initial estimate about each axis, rad.
        position: the same along each axis, metres.
        turn_noise: of the known twist, about each axis, rad per root second.
        motion_noise: the same along each axis, metres per root second.
        least_pixel_noise: assumed where the detector's noise is less, pixels.

    Raises:
        InputError: a value is not positive.
    """

    attitude: float
    position: float
    turn_noise: float = 1e-3
    motion_noise: float = 1e-3
    least_pixel_noise: float = 0.1

    def __post_init__(self) -> None:
        for name in ("attitude", "position", "turn_noise", "motion_noise", "least_pixel_noise"):
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `Estimator.errors`."""
        estimates = np.stack([np.stack(list(self._run(recording, s, start[s]))) for s in range(len(start))])
        return pose_errors(recording.poses, estimates)

    def _run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[FloatArray]:
        """The estimates of run s, `(4, 4)` each."""
        gtsam = optional("gtsam", "estimators")
        spread = np.repeat([self.attitude, self.position], 3)
        drift = np.repeat([self.turn_noise, self.motion_noise], 3)
        ekf = gtsam.InvariantEKFPose3(gtsam.Pose3(start), np.diag(spread**2))
        yield start
        for t, step in enumerate(np.diff(recording.time), start=1):
            ekf.predict(recording.twists[s, t - 1], step, np.diag(drift**2 * step))
            seen = recording.seen[s, t]
            if seen.any():
                predicted = act(inverse(ekf.state().matrix()), recording.landmarks[s, seen])
                measured = recording.points[s, t, seen]
                minus_one = np.broadcast_to(-np.eye(3), (len(measured), 3, 3))
                jacobian = np.concatenate([skew(predicted), minus_one], axis=-1).reshape(-1, 6)
                these = recording.detections(s, t, t + 1)
                noise = np.maximum(recording.noise[these], self.least_pixel_noise)[:, None, None]
                covariance = _block_diagonal(noise**2 * recording.covariance[these])
                ekf.updateWithVector(predicted.reshape(-1), jacobian, measured.reshape(-1), covariance)
            yield ekf.state().matrix()


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """`(m, 3, 3)` blocks on the diagonal of a `(3 m, 3 m)` matrix."""
    m = len(blocks)
    matrix = np.zeros((m, 3, m, 3))
    matrix[np.arange(m), :, np.arange(m), :] = blocks
    return matrix.reshape(3 * m, 3 * m)
