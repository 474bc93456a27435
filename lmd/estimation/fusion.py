"""Estimators that use GTSAM: a Kalman filter and a fixed-lag smoother, with models of the measurement noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np

from lmd.core.checks import Checked, FloatArray, Positive, choice
from lmd.core.optional import optional
from lmd.estimation.estimators import Errors, errors_of
from lmd.estimation.pnp import images_of, likely
from lmd.estimation.recording import Recording
from lmd.geometry.pose import PointImage, body_solutions, image_slopes
from lmd.geometry.projection import project, to_camera
from lmd.geometry.se3 import seen_by_twist


@dataclass(frozen=True)
class Uncertainty(Checked):
    """Uncertainties that an estimator assumes for its initial estimate and for the measurements.

    Raises:
        InputError: a value is not positive.
    """

    attitude: Positive
    """Standard deviation of the initial estimate about each axis, rad."""
    position: Positive
    """Standard deviation of the initial estimate along each axis, metres."""
    least_turn_noise: Positive = 1e-3
    """Lower bound on the noise of the odometry about each axis, rad per root second."""
    least_motion_noise: Positive = 1e-3
    """Lower bound on the noise of the odometry along each axis, metres per root second."""
    least_pixel_noise: Positive = 0.1
    """Lower bound on the noise of the detector, pixels."""

    def _validate(self) -> None:
        optional("gtsam", "estimators")

    @property
    def initial(self) -> FloatArray:
        """Standard deviations of the initial estimate's error as a body twist (w, v), rad and metres, `(6,)`."""
        return np.repeat([self.attitude, self.position], 3)

    def drift(self, recording: Recording) -> FloatArray:
        """Standard deviations of the odometry's error as a body twist (w, v), rad and metres per root second,
        `(6,)`.
        """
        known = recording.odometry
        turn = max(known.turn_noise, self.least_turn_noise)
        return np.repeat([turn, max(known.motion_noise, self.least_motion_noise)], 3)


class Measurement(Protocol):
    """Interface of an estimator's measurement in one frame: d numbers that can be predicted from the pose."""

    @property
    def value(self) -> FloatArray:
        """Measured numbers, `(d,)`."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the measured numbers, `(d, d)`."""

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured numbers as predicted for the pose X, `(d,)`, and their Jacobian with respect to a body twist (w, v),
        `(d, 6)`.

        `pose` is the pose X, `(4, 4)`.
        """


class CameraPoints(NamedTuple):
    """Measured positions of m landmarks in the camera's frame, metres; a `Measurement` of `3 * m` numbers.

    For the camera pose X, a landmark at C in the world has the position y = X^-1 C in the camera's frame.
    """

    landmarks: FloatArray
    value: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, recording: Recording, s: int, t: int, uncertainty: Uncertainty) -> "CameraPoints":
        """Make the measurement of the landmarks that are detected in frame t of run s.

        The pixel noise is that of the recording, but at least the lower bound in `uncertainty`.
        """
        seen, these = recording.seen[s, t], recording.detections(s, t, t + 1)
        noise = np.maximum(recording.noise[these], uncertainty.least_pixel_noise)[:, None, None]
        covariance = _block_diagonal(noise**2 * recording.covariance[these])
        return cls(recording.landmarks[s, seen], recording.points[s, t, seen].reshape(-1), covariance)

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Measurement.predicted`."""
        y = to_camera(pose, self.landmarks)
        return y.reshape(-1), seen_by_twist(y).reshape(-1, 6)


class CornerImages(NamedTuple):
    """Image points of m corners of tags, in pixels. A `Measurement` of `2 * m` numbers."""

    images: Sequence[PointImage]
    value: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, recording: Recording, s: int, t: int, uncertainty: Uncertainty) -> "CornerImages":
        """Make the measurement of the tag corners that are detected in frame t of run s.

        The pixel noise is that of the recording, but at least the lower bound in `uncertainty`.
        """
        images = images_of(recording, s, t)
        noise = np.maximum(np.concatenate([image.noise for image in images]), uncertainty.least_pixel_noise).repeat(2)
        return cls(images, np.concatenate([image.pixels for image in images]).reshape(-1), np.diag(noise**2))

    def predicted(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Measurement.predicted`; a point that the camera cannot image is predicted at the principal point, with a
        zero Jacobian.
        """
        pixels, slopes = [], []
        for image in self.images:
            y = to_camera(pose @ image.mounted, image.points)
            there = project(image.camera, np.eye(4), y)
            lost = np.asarray(np.isnan(there).any(axis=1))
            there[lost], y[lost] = image.camera.principal_point, [0.0, 0.0, 1.0]
            slopes.append(np.where(lost[:, None, None], 0.0, image_slopes(image.camera, image.mounted, y)))
            pixels.append(there)
        return np.concatenate(pixels).reshape(-1), np.concatenate(slopes).reshape(-1, 6)


@dataclass(frozen=True)
class InvariantKalmanFilter(Uncertainty):
    """Left-invariant extended Kalman filter of GTSAM.

    By default the filter uses the positions of landmarks in the camera's frame, y_i = X^-1 C_i, as
    `lmd.estimation.observer` does.

    Raises:
        InputError: a value is not positive, or `measured` is neither `points` nor `corners`.
    """

    measured: Annotated[str, partial(choice, options=("points", "corners"))] = field(default="points", kw_only=True)
    """Measurements: `points`, the position of each tag from its own image, or `corners`, the image points of all
    corners. Recordings of points always use `points`.
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        return errors_of(recording, start, self.run)

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Iterate over the frames of run s. Yields the estimated pose, `(4, 4)`, and the covariance of its error as a
        body twist, `(6, 6)`.
        """
        gtsam = optional("gtsam", "estimators")
        corners = self.measured == "corners" and recording.corners is not None
        kind: type[CameraPoints | CornerImages] = CornerImages if corners else CameraPoints
        ekf = gtsam.InvariantEKFPose3(gtsam.Pose3(start), np.diag(self.initial**2))
        density = np.diag(self.drift(recording) ** 2)  # GTSAM's filter multiplies the density by the time step
        yield start, ekf.covariance().copy()  # GTSAM returns a view of its own memory
        for t, step in enumerate(np.diff(recording.time), start=1):
            ekf.predict(recording.twists[s, t - 1], step, density)
            if recording.seen[s, t].any():
                seen = kind.of(recording, s, t, self)
                ekf.updateWithVector(*seen.predicted(ekf.state().matrix()), seen.value, seen.covariance)
            yield ekf.state().matrix(), ekf.covariance().copy()


@dataclass(frozen=True)
class FixedLagSmoother(Uncertainty):
    """Fixed-lag smoother of GTSAM (iSAM2): a factor graph of the odometry and the measurements of recent frames.

    Tags are measured by the images of their corners. The smoother starts with the first frame, other than frame 0,
    whose images determine the pose uniquely; the estimates for earlier frames are integrated from the odometry.
    Landmarks that are points are measured by their positions in the camera's frame, and the smoother then starts with
    frame 0. The estimate of a frame is not corrected by later frames.

    Raises:
        InputError: a value is not positive.
    """

    lag: Positive = field(default=1.0, kw_only=True)
    """Time span of the factor graph, seconds; older frames are marginalised."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        return errors_of(recording, start, self.run)

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Iterate over the frames of run s. Yields the estimated pose, `(4, 4)`, and the covariance of its error as a
        body twist, `(6, 6)`, which is NaN before the frame with which the smoother starts. `start` is the initial
        estimate, `(4, 4)`.
        """
        gtsam = optional("gtsam", "estimators")
        diagonal, drift = gtsam.noiseModel.Diagonal.Sigmas, self.drift(recording)
        kind: type[CameraPoints | CornerImages] = CameraPoints if recording.corners is None else CornerImages
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")  # Cholesky fails if the first estimate is vague and the odometry precise
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
            covariance = np.full((6, 6), np.nan)
            if begun:
                values.insert(t, estimate)
                smoother.update(graph, values, {t: time})
                estimate = smoother.calculateEstimatePose3(t)
                covariance = smoother.marginalCovariance(t)
            yield estimate.matrix(), covariance


def _beginning(recording: Recording, s: int, t: int, expected: FloatArray) -> FloatArray | None:
    """Pose with which the smoother starts at frame t of run s; None if the smoother must start later.

    For point landmarks the result is the pose `expected`. For tags it is the pose that the images of the frame
    determine; None for frame 0, and for images that fit no pose or several poses.
    """
    if recording.corners is None:
        return expected
    found = likely(body_solutions(images_of(recording, s, t)))
    return found[0] if t > 0 and len(found) == 1 else None


def _factor(gtsam: Any, key: int, measurement: Measurement) -> Any:
    """GTSAM factor that compares a measurement with its prediction from the pose whose key is `key`."""

    def error(_: Any, values: Any, jacobians: Any) -> FloatArray:
        predicted, jacobian = measurement.predicted(values.atPose3(key).matrix())
        if jacobians is not None:
            jacobians[0] = jacobian
        return predicted - measurement.value

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(measurement.covariance), [key], error)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """Block diagonal matrix `(3 m, 3 m)` of blocks `(m, 3, 3)`."""
    m = len(blocks)
    matrix = np.zeros((m, 3, m, 3))
    matrix[np.arange(m), :, np.arange(m), :] = blocks
    return matrix.reshape(3 * m, 3 * m)
