"""Estimators of GTSAM that know how uncertain landmarks and odometry are: a filter, and a smoother over a fixed lag."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from lmd.core.checks import FloatArray, check_fields, real
from lmd.core.optional import optional
from lmd.estimation.estimators import Errors, pose_errors
from lmd.estimation.pnp import images_of, likely
from lmd.estimation.recording import Recording
from lmd.geometry.pose import PointImage, body_solutions
from lmd.geometry.projection import project, to_camera
from lmd.geometry.se3 import skew


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
        check_fields(self, real, *self.__dataclass_fields__, above=0.0)
        optional("gtsam", "estimators")

    @property
    def initial(self) -> FloatArray:
        """Standard deviations of the initial estimate as a body twist, `(6,)`."""
        return np.repeat([self.attitude, self.position], 3)

    def drift(self, recording: Recording) -> FloatArray:
        """Standard deviations of the odometry as a body twist per root second, `(6,)`."""
        known = recording.odometry
        turn = max(known.turn_noise, self.least_turn_noise)
        return np.repeat([turn, max(known.motion_noise, self.least_motion_noise)], 3)


class Measurement(Protocol):
    """What a frame measures: d numbers that a pose predicts."""

    @property
    def value(self) -> FloatArray:
        """`(d,)`."""

    @property
    def covariance(self) -> FloatArray:
        """`(d, d)`."""

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The measurement predicted at a pose X, `(d,)`, and its derivative by a body twist (w, v), `(d, 6)`."""


class CameraPoints(NamedTuple):
    """The places of m landmarks in the camera's frame, y = X^-1 C, metres: a `Measurement` of 3 m numbers."""

    landmarks: FloatArray
    value: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, recording: Recording, s: int, t: int, uncertainty: Uncertainty) -> "CameraPoints":
        """Those of frame t of run s."""
        seen, these = recording.seen[s, t], recording.detections(s, t, t + 1)
        noise = np.maximum(recording.noise[these], uncertainty.least_pixel_noise)[:, None, None]
        covariance = _block_diagonal(noise**2 * recording.covariance[these])
        return cls(recording.landmarks[s, seen], recording.points[s, t, seen].reshape(-1), covariance)

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Measurement.predicted`."""
        y = to_camera(pose, self.landmarks)
        moved = np.concatenate([skew(y), np.broadcast_to(-np.eye(3), (len(y), 3, 3))], axis=-1)
        return y.reshape(-1), moved.reshape(-1, 6)


class CornerImages(NamedTuple):
    """The images of the m corners of tags, pixels: a `Measurement` of 2 m numbers."""

    images: Sequence[PointImage]
    value: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, recording: Recording, s: int, t: int, uncertainty: Uncertainty) -> "CornerImages":
        """Those of frame t of run s."""
        images = images_of(recording, s, t)
        noise = np.maximum(np.concatenate([image.noise for image in images]), uncertainty.least_pixel_noise).repeat(2)
        return cls(images, np.concatenate([image.pixels for image in images]).reshape(-1), np.diag(noise**2))

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Measurement.predicted`; what has no image counts as in the middle of it, and does not move."""
        pixels, slopes = [], []
        for image in self.images:
            y = to_camera(pose @ image.mounted, image.points)
            there = project(image.camera, np.eye(4), y)
            lost = np.asarray(np.isnan(there).any(axis=1))
            there[lost], y[lost] = image.camera.principal_point, [0.0, 0.0, 1.0]
            slopes.append(np.where(lost[:, None, None], 0.0, image.slope(y)))
            pixels.append(there)
        return np.concatenate(pixels).reshape(-1), np.concatenate(slopes).reshape(-1, 6)


@dataclass(frozen=True)
class InvariantKalmanFilter(Uncertainty):
    """The left-invariant extended Kalman filter of GTSAM with the observer's measurements y_i = X^-1 C_i."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        runs = [[pose for pose, _ in self.run(recording, s, start[s])] for s in range(len(start))]
        return pose_errors(recording.poses, np.array(runs))

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Follow run s: its estimates, `(4, 4)` each, and their covariances as body twists, `(6, 6)`."""
        gtsam = optional("gtsam", "estimators")
        ekf = gtsam.InvariantEKFPose3(gtsam.Pose3(start), np.diag(self.initial**2))
        density = np.diag(self.drift(recording) ** 2)  # the filter multiplies it by the step
        yield start, ekf.covariance()
        for t, step in enumerate(np.diff(recording.time), start=1):
            ekf.predict(recording.twists[s, t - 1], step, density)
            if recording.seen[s, t].any():
                places = CameraPoints.of(recording, s, t, self)
                ekf.updateWithVector(*places.predicted(ekf.state().matrix()), places.value, places.covariance)
            yield ekf.state().matrix(), ekf.covariance()


@dataclass(frozen=True)
class FixedLagSmoother(Uncertainty):
    """GTSAM's factor graph of the last moments (iSAM2): odometry between frames, and in each what it sees.

    Of tags it takes the image of their corners; it then begins with the first frame that fixes the pose beyond doubt by
    itself, and follows the odometry until then. Landmarks that are points it takes as the filter does. The estimate of
    a frame is that of the moment at which it is taken; later ones do not correct it.

    Args:
        lag: how much of the past stays in the graph, seconds; what is older is summed up in its linearisation.

    Raises:
        InputError: a value is not positive.
    """

    lag: float = field(default=1.0, kw_only=True)

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        runs = [list(self._run(recording, s, start[s])) for s in range(len(start))]
        return pose_errors(recording.poses, np.array(runs))

    def _run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[FloatArray]:
        """The estimates of run s, `(4, 4)` each."""
        gtsam = optional("gtsam", "estimators")
        diagonal, drift = gtsam.noiseModel.Diagonal.Sigmas, self.drift(recording)
        kind: type[CameraPoints | CornerImages] = CameraPoints if recording.corners is None else CornerImages
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")  # Cholesky gives up where the first estimate is vague and the odometry good
        smoother = gtsam.IncrementalFixedLagSmoother(self.lag, parameters)
        estimate, begun = gtsam.Pose3(start), False
        for t, time in enumerate(recording.time):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            if t > 0:
                step = time - recording.time[t - 1]
                motion = gtsam.Pose3.Expmap(step * recording.twists[s, t - 1])
                estimate = estimate.compose(motion)
                if begun:
                    graph.add(gtsam.BetweenFactorPose3(t - 1, t, motion, diagonal(drift * np.sqrt(step))))
                if recording.seen[s, t].any():
                    graph.add(_factor(gtsam, t, kind.of(recording, s, t, self)))
            if not begun and (first := _beginning(recording, s, t, estimate.matrix())) is not None:
                begun, estimate = True, gtsam.Pose3(first)
                graph.add(gtsam.PriorFactorPose3(t, estimate, diagonal(self.initial)))
            if begun:
                values.insert(t, estimate)
                smoother.update(graph, values, {t: time})
                estimate = smoother.calculateEstimatePose3(t)
            yield estimate.matrix()


def _beginning(recording: Recording, s: int, t: int, expected: FloatArray) -> FloatArray | None:
    """The pose at which a smoother begins with frame t of run s; None if it does not yet."""
    if recording.corners is None:
        return expected
    found = likely(body_solutions(images_of(recording, s, t)))
    return found[0] if t > 0 and len(found) == 1 else None


def _factor(gtsam: Any, key: int, measurement: Measurement) -> Any:
    """A factor on the pose `key`."""

    def error(_: Any, values: Any, jacobians: Any) -> FloatArray:
        predicted, jacobian = measurement.predicted(values.atPose3(key).matrix())
        if jacobians is not None:
            jacobians[0] = jacobian
        return predicted - measurement.value

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(measurement.covariance), [key], error)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """`(m, 3, 3)` blocks on the diagonal of a `(3 m, 3 m)` matrix."""
    m = len(blocks)
    matrix = np.zeros((m, 3, m, 3))
    matrix[np.arange(m), :, np.arange(m), :] = blocks
    return matrix.reshape(3 * m, 3 * m)
