"""Covariance of the observer's errors, to first order.

The observer states no covariance, but its gains are known. With the error X = Xh exp(x), landmarks move by y_i = yh_i +
H_i x + n_i with H_i = [[yh_i]x  -I], and a correction is xi = sum G_i (yh_i - y_i) with

- left-invariant:   G_i = (k_i [yh_i]x / l^2, (k_i + k_0 / m) I),
- right-invariant:  G_i = Ad_Xh^-1 (k_i [C_i]x R / l^2, k_i R) + (0, k_0 / m I),

so that x <- (I + h sum G_i H_i) x + h sum G_i n_i. A step of odometry has x <- Ad_exp(-h U) x + n.
"""

from collections.abc import Iterator

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.estimation.fusion import CameraPoints, Uncertainty
from lmd.estimation.observer import Observer
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import act, adjoint_matrix, exp, inverse, skew


def run(
    observer: Observer, assumed: Uncertainty, recording: Recording, s: int, start: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Estimates of run s, `(4, 4)` each, and the covariances of their errors as body twists, `(6, 6)`.

    Args:
        observer: observer with its gains.
        assumed: uncertainty of the first estimate, and least noises.
        recording, s, start: as in `lmd.estimation.fusion.InvariantKalmanFilter.run`.
    """
    centroid = recording.landmarks[s].mean(axis=0)
    density, covariance = np.diag(assumed.drift(recording) ** 2), np.diag(assumed.initial**2)
    pose = start.copy()
    pose[:3, 3] -= centroid
    landmarks = recording.landmarks[s] - centroid
    for t, step in enumerate([0.0, *np.diff(recording.time)]):
        if t > 0:
            motion = exp(step * recording.twists[s, t - 1])
            pose, moved = pose @ motion, adjoint_matrix(inverse(motion))
            covariance = moved @ covariance @ moved.T + step * density
            seen = recording.seen[s, t]
            if seen.any():
                correction = observer.correction(pose, landmarks, recording.points[s, t], seen)
                gains = step * _gains(observer, pose, landmarks, recording.points[s, t], seen)
                places = CameraPoints.of(recording, s, t, assumed)
                kept = np.eye(6) + gains @ places._replace(landmarks=landmarks[seen]).predicted(pose)[1]
                covariance = kept @ covariance @ kept.T + gains @ places.covariance @ gains.T
                pose = pose @ exp(step * correction)
        there = pose.copy()
        there[:3, 3] += centroid
        yield there, covariance


def _gains(
    observer: Observer, pose: FloatArray, landmarks: FloatArray, measured: FloatArray, seen: BoolArray
) -> FloatArray:
    """Gains G_i of the m landmarks in view, `(6, 3 m)`."""
    k = float(observer.landmark_gain(landmarks, measured, seen))
    m, places = int(seen.sum()), landmarks[seen]
    if observer.form == "left":
        arms, turn, moved = act(inverse(pose), places), np.eye(3), np.eye(6)
    else:
        arms, turn, moved = places, pose[:3, :3], adjoint_matrix(inverse(pose))
    blocks = np.concatenate([k / observer.length**2 * skew(arms), np.broadcast_to(k * np.eye(3), (m, 3, 3))], axis=1)
    gains = moved @ blocks @ turn
    gains[:, 3:] += observer.damping / m * np.eye(3)
    return np.asarray(gains.transpose(1, 0, 2).reshape(6, 3 * m))
