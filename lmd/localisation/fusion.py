"""Estimators of GTSAM that know how uncertain landmarks and odometry are: a filter, and a smoother over a fixed lag."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from lmd.checks import FloatArray, real
from lmd.geometry.se3 import act, inverse, skew
from lmd.localisation.errors import Errors, pose_errors
from lmd.localisation.recording import Recording
from lmd.optional import optional


@dataclass(frozen=True)
class Uncertainty:
    """How far an estimator trusts what it is given.

    Args:
        attitude: standard deviation of the initial estimate about each axis, rad.
        position: the same along each axis, metres.
        least_turn_noise: assumed where that of the odometry is less, rad per root second.
        least_motion_noise: the same along each axis, metres per root second.
        least_pixel_noise: assumed where that of the detector is less, pixels.

    Raises:
        InputError: a value is not positive.
    """

    attitude: float
    position: float
    least_turn_noise: float = 1e-3
    least_motion_noise: float = 1e-3
    least_pixel_noise: float = 0.1

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))

    @property
    def initial(self) -> FloatArray:
        """Standard deviations of the initial estimate as a body twist, `(6,)`."""
        return np.repeat([self.attitude, self.position], 3)

    def drift(self, recording: Recording) -> FloatArray:
        """Standard deviations of the odometry as a body twist per root second, `(6,)`."""
        known = recording.odometry
        turn = max(known.turn_noise, self.least_turn_noise)
        return np.repeat([turn, max(known.motion_noise, self.least_motion_noise)], 3)


class Frame(NamedTuple):
    """What a frame measures of m landmarks, y = X^-1 C."""

    landmarks: FloatArray
    measured: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, recording: Recording, s: int, t: int, uncertainty: Uncertainty) -> "Frame":
        """Frame t of run s: C and y `(m, 3)`, and the covariance of y `(3 m, 3 m)`."""
        seen, these = recording.seen[s, t], recording.detections(s, t, t + 1)
        noise = np.maximum(recording.noise[these], uncertainty.least_pixel_noise)[:, None, None]
        covariance = _block_diagonal(noise**2 * recording.covariance[these])
        return cls(recording.landmarks[s, seen], recording.points[s, t, seen], covariance)

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """y at a pose X, `(3 m,)`, and how it changes with a body twist (w, v), `(3 m, 6)`."""
        y = act(inverse(pose), self.landmarks)
        minus_one = np.broadcast_to(-np.eye(3), (len(y), 3, 3))
        return y.reshape(-1), np.concatenate([skew(y), minus_one], axis=-1).reshape(-1, 6)


@dataclass(frozen=True)
class InvariantKalmanFilter(Uncertainty):
    """The left-invariant extended Kalman filter of GTSAM with the observer's measurements y_i = X^-1 C_i."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.localisation.estimators.Estimator.errors`."""
        runs = [[pose for pose, _ in self.run(recording, s, start[s])] for s in range(len(start))]
        return pose_errors(recording.poses, np.array(runs))

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """The estimates of run s, `(4, 4)` each, and their covariances as body twists, `(6, 6)`."""
        gtsam = optional("gtsam", "estimators")
        ekf = gtsam.InvariantEKFPose3(gtsam.Pose3(start), np.diag(self.initial**2))
        density = np.diag(self.drift(recording) ** 2)  # the filter multiplies it by the step
        yield start, ekf.covariance()
        for t, step in enumerate(np.diff(recording.time), start=1):
            ekf.predict(recording.twists[s, t - 1], step, density)
            if recording.seen[s, t].any():
                frame = Frame.of(recording, s, t, self)
                predicted, jacobian = frame.predicted(ekf.state().matrix())
                ekf.updateWithVector(predicted, jacobian, frame.measured.reshape(-1), frame.covariance)
            yield ekf.state().matrix(), ekf.covariance()


@dataclass(frozen=True)
class FixedLagSmoother(Uncertainty):
    """GTSAM's factor graph of the last moments: odometry between frames, landmarks in each, all of it linearised anew.

    The estimate of a frame is that of the moment at which it is taken; later ones do not correct it.

    Args:
        lag: how much of the past stays in the graph, seconds; what is older is summed up in its linearisation.
    """

    lag: float = field(default=1.0, kw_only=True)

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.localisation.estimators.Estimator.errors`."""
        runs = [list(self._run(recording, s, start[s])) for s in range(len(start))]
        return pose_errors(recording.poses, np.array(runs))

    def _run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[FloatArray]:
        """The estimates of run s, `(4, 4)` each."""
        gtsam = optional("gtsam", "estimators")
        smoother, drift, estimate = gtsam.BatchFixedLagSmoother(self.lag), self.drift(recording), gtsam.Pose3(start)
        for t, time in enumerate(recording.time):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            if t == 0:
                graph.add(gtsam.PriorFactorPose3(t, estimate, gtsam.noiseModel.Diagonal.Sigmas(self.initial)))
            else:
                step = time - recording.time[t - 1]
                motion = gtsam.Pose3.Expmap(step * recording.twists[s, t - 1])
                noise = gtsam.noiseModel.Diagonal.Sigmas(drift * np.sqrt(step))
                graph.add(gtsam.BetweenFactorPose3(t - 1, t, motion, noise))
                estimate = estimate.compose(motion)
                if recording.seen[s, t].any():
                    graph.add(_landmark_factor(gtsam, t, Frame.of(recording, s, t, self)))
            values.insert(t, estimate)
            smoother.update(graph, values, {t: time})
            estimate = smoother.calculateEstimatePose3(t)
            yield estimate.matrix()


def _landmark_factor(gtsam: Any, key: int, frame: Frame) -> Any:
    """A factor on the pose `key`: what the frame measures of its landmarks."""

    def error(_: Any, values: Any, jacobians: Any) -> FloatArray:
        predicted, jacobian = frame.predicted(values.atPose3(key).matrix())
        if jacobians is not None:
            jacobians[0] = jacobian
        return predicted - frame.measured.reshape(-1)

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(frame.covariance), [key], error)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """`(m, 3, 3)` blocks on the diagonal of a `(3 m, 3 m)` matrix."""
    m = len(blocks)
    matrix = np.zeros((m, 3, m, 3))
    matrix[np.arange(m), :, np.arange(m), :] = blocks
    return matrix.reshape(3 * m, 3 * m)
