"""Recordings of flights: odometry, and in each frame the positions of the detected landmarks in the camera's frame.

A rig with C cameras is recorded as one camera, in the frame of the body, with C K landmarks. These are the K landmarks
as detected by the first camera, then by the second camera, and so on.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, IntArray, NotNegative
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import act, axis_and_right
from lmd.geometry.trajectory import Trajectory
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each


@dataclass(frozen=True)
class Odometry(Checked):
    """Model of odometry: it measures twists between frames with independent normal errors and a biased gyro, so that
    poses that are integrated from the twists drift.

    The bias of the gyro adds to the measured turn rates. The bias at the first frame is normally distributed, and then
    follows a random walk.

    Raises:
        InputError: a value is negative.
    """

    turn_noise: NotNegative = 0.0
    """Standard deviation of the turn errors about each axis, rad per root second."""
    motion_noise: NotNegative = 0.0
    """Standard deviation of the motion errors along each axis, metres per root second."""
    gyro_bias: NotNegative = 0.0
    """Standard deviation of the gyro's bias about each axis at the first frame, rad/s."""
    gyro_walk: NotNegative = 0.0
    """Standard deviation of the bias's random walk about each axis, rad/s per root second."""

    def measured(self, twists: FloatArray, steps: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Measured twists: true twists plus random errors and the bias of the gyro, `(T - 1, 6)`, rad/s and m/s.

        The error of a twist is the mean of white noise over the step. For noise of density q, the variance of the error
        is q^2 / h in a step of h seconds.

        Args:
            twists: true twists, `(T - 1, 6)`.
            steps: duration of each twist, seconds, `(T - 1,)`.
            rng: random generator for the errors.
        """
        density = np.repeat([self.turn_noise, self.motion_noise], 3)
        measured = twists + rng.standard_normal(twists.shape) * density / np.sqrt(steps)[:, None]
        return np.asarray(measured + np.pad(self.biases(steps, rng), ((0, 0), (0, 3))))

    def biases(self, steps: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw the bias of the gyro in each step, rad/s, `(T - 1, 3)`, constant within a step.

        Args:
            steps: duration of each step, seconds, `(T - 1,)`.
            rng: random generator for the bias.
        """
        drawn = rng.standard_normal((len(steps), 3))
        spread = np.append(self.gyro_bias, self.gyro_walk * np.sqrt(steps[:-1]))
        return np.asarray(np.cumsum(spread[:, None] * drawn, axis=0))


# Function like the built-in `map`, which keeps the order of jobs; may use processes.
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True)
class Flight:
    """Flight of a camera or a rig in a room with a deployment; the pose of a rig is the pose of its body."""

    evaluator: Evaluator
    """Evaluator with the scene and the visibility model."""
    deployment: Deployment
    """Deployment of the K landmarks."""
    trajectory: Trajectory
    """Trajectory of the camera or of the rig's body, with T frames."""
    rng: np.random.Generator
    """Random generator for the measurements."""
    all_visible: bool = False
    """True if every landmark is in view in all frames, as assumed for an observer without a camera model."""

    @property
    def camera(self) -> Camera | Rig:
        """Camera or rig that takes the frames."""
        return self.evaluator.scene.camera

    @property
    def poses(self) -> FloatArray:
        """True poses X, `(T, 4, 4)`."""
        return self.trajectory.poses

    def looks(self) -> "list[Look]":
        """One `Look` for each camera: the flight as this camera sees it."""
        scene = self.evaluator.scene
        if self.all_visible:
            seen = np.ones((len(scene.cameras), len(self.poses), len(self.deployment)), dtype=np.bool_)
        else:
            axes = axis_and_right(self.poses)
            seen = visible_to_each(self.evaluator, self.deployment, self.poses[:, :3, 3], axes)
        return [Look(*look, self) for look in zip(scene.cameras, scene.extrinsics, seen, strict=True)]


class Look(NamedTuple):
    """A flight as seen by one camera."""

    camera: Camera
    """Camera, with its intrinsics."""
    mounted: FloatArray
    """Pose of the camera in the frame of the body, `(4, 4)`."""
    in_view: BoolArray
    """Mask of the landmarks in view, `(T, K)`."""
    flight: Flight
    """Flight of the body."""

    @property
    def poses(self) -> FloatArray:
        """True poses X of the camera, `(T, 4, 4)`."""
        return self.flight.poses @ self.mounted


class Observation(NamedTuple):
    """M detections of K landmarks in the T frames of a flight.

    The order of the detections is that of `np.nonzero(seen)`: frame by frame, and by landmark in each frame.
    """

    seen: BoolArray
    """Mask of the detected landmarks, `(T, K)`."""
    points: FloatArray
    """Measured positions of the landmarks in the camera's frame, metres, `(T, K, 3)`; arbitrary for landmarks that are
    not seen.
    """
    noise: FloatArray
    """Standard deviation of the image coordinates of each detection, as estimators assume it, pixels, `(M,)`."""
    covariance: FloatArray
    """Covariance of the measured position of each detection for one pixel of noise, camera's frame, m^2,
    `(M, 3, 3)`.
    """
    corners: FloatArray | None = None
    """Detected corners of tags, pixels from the outer corner of the image's top left pixel, in the order of
    `lmd.geometry.squares.CORNERS`, `(M, 4, 2)`; None for points.
    """


def merged(parts: Sequence[Observation], mounted: FloatArray) -> Observation:
    """Merge the observations of all cameras of a body into one observation in the body's frame. The merged observation
    has C K landmarks: the K landmarks as detected by the first camera, then by the second camera, and so on.

    Args:
        parts: observation of each camera in its own frame.
        mounted: poses of the cameras in the frame of the body, `(C, 4, 4)`.
    """
    order = np.argsort(np.concatenate([np.nonzero(part.seen)[0] for part in parts]), kind="stable")

    def together(arrays: Iterable[FloatArray]) -> FloatArray:
        return np.concatenate(list(arrays))[order]

    turns = mounted[:, :3, :3]
    corners = [part.corners for part in parts if part.corners is not None]
    return Observation(
        np.concatenate([part.seen for part in parts], axis=1),
        np.concatenate([act(at, part.points) for at, part in zip(mounted, parts, strict=True)], axis=1),
        together(part.noise for part in parts),
        together(turn @ part.covariance @ turn.T for turn, part in zip(turns, parts, strict=True)),
        together(corners) if corners else None,
    )


class Sensor(Protocol):
    """Interface of sensors that detect landmarks in the images of a camera."""

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """Observe the landmarks of S flights; return one observation for each flight.

        Args:
            flights: S flights.
            each: function that maps a slow function over jobs, possibly in parallel, see `Each`.

        Raises:
            InputError: a flight assumes all landmarks in view (`all_visible`), but the sensor measures in images, where
                a landmark behind the camera is missing.
        """

    def tags(self, deployment: Deployment) -> FloatArray | None:
        """Corners of the tags at the landmarks, world frame, metres, `(K, 4, 3)`; None for points."""


@dataclass(frozen=True)
class Recording:
    """M detections of landmarks in S runs of T frames.

    The order of the detections is that of `np.nonzero(seen)`: run by run, frame by frame, and by landmark in each
    frame. For a rig, every landmark is listed once for each camera, so K is the number of landmarks times the number of
    cameras.
    """

    time: FloatArray
    """Times of the frames, seconds, `(T,)`."""
    poses: FloatArray
    """True poses X, `(S, T, 4, 4)`."""
    twists: FloatArray
    """Measured twists U between frames, `(S, T - 1, 6)`, see `Trajectory.twists`."""
    odometry: Odometry
    """Errors of the measured twists."""
    landmarks: FloatArray
    """Positions C_i of the landmarks, world frame, metres, `(S, K, 3)`."""
    camera: Camera | Rig
    """Camera or rig of the frames."""
    seen: BoolArray
    """Mask of the detected landmarks, `(S, T, K)`."""
    points: FloatArray
    """Measured positions of the landmarks in the camera's frame, metres, `(S, T, K, 3)`."""
    noise: FloatArray
    """Standard deviation of the image coordinates of each detection, as estimators assume it, pixels, `(M,)`."""
    covariance: FloatArray
    """Covariance of the measured position of each detection for one pixel of noise, m^2, `(M, 3, 3)`."""
    tags: FloatArray | None = None
    """Corners of the tags, world frame, metres, `(S, K, 4, 3)`; None for points."""
    corners: FloatArray | None = None
    """Detected corners of tags, pixels from the outer corner of the image's top left pixel, `(M, 4, 2)`; None for
    points.
    """

    @property
    def seen_by(self) -> BoolArray:
        """Mask of the landmarks detected by each camera, `(S, T, C, K / C)`."""
        return self.seen.reshape(*self.seen.shape[:2], len(self.camera.cameras), -1)

    @property
    def visible_counts(self) -> IntArray:
        """Number of landmarks that at least one camera detects in each frame, `(S, T)`."""
        return np.asarray(self.seen_by.any(axis=2).sum(axis=-1))

    @cached_property
    def _first(self) -> IntArray:
        """For each frame of each run, index of its first detection among the M detections; the last entry is M,
        `(S T + 1,)`.
        """
        return np.concatenate([[0], np.cumsum(self.seen.sum(axis=-1))])

    def detections(self, s: int, first: int = 0, last: int | None = None) -> slice:
        """Slice that selects, from arrays over the M detections, those in frames `first` to `last` of run s; `last` is
        excluded, None stands for the end of the run.
        """
        frames = len(self.time)
        return slice(self._first[s * frames + first], self._first[s * frames + (frames if last is None else last)])

    def share_visible(self, n: int) -> FloatArray:
        """Fraction of each run's duration in which at least n landmarks are detected, `(S,)`. The number in a frame is
        taken to hold until the next frame.
        """
        enough, steps = self.visible_counts[:, :-1] >= n, np.diff(self.time)
        return np.asarray(enough @ steps / steps.sum())


def record(
    detector: Sensor, flights: Sequence[Flight], odometry: Odometry | None = None, each: Each = map
) -> Recording:
    """Record S flights whose frames have equal times.

    Args:
        detector: sensor of the landmarks.
        flights: S flights of one camera or rig.
        odometry: errors of the twists; None for exact twists.
        each: function that maps a slow function over jobs, possibly in parallel, see `Each`.

    Raises:
        InputError: a flight assumes all landmarks in view (`all_visible`), but the detector measures in images, where a
            landmark behind the camera is missing.
    """
    odometry, time = odometry or Odometry(), flights[0].trajectory.time
    observations = detector.observed(flights, each)
    twists = [odometry.measured(f.trajectory.twists, np.diff(time), f.rng.spawn(1)[0]) for f in flights]
    tags = [detector.tags(flight.deployment) for flight in flights]
    cameras = len(flights[0].camera.cameras)
    seen, points, noise, covariance, corners = zip(*observations, strict=True)
    poses, landmarks = [f.poses for f in flights], [np.tile(f.deployment.positions, (cameras, 1)) for f in flights]
    truth = time, np.stack(poses), np.stack(twists), odometry, np.stack(landmarks), flights[0].camera
    squares = None if tags[0] is None else np.stack([np.tile(tag, (cameras, 1, 1)) for tag in tags])  # type: ignore[arg-type] # all of them or none
    detected = np.stack(seen), np.stack(points), np.concatenate(noise), np.concatenate(covariance)
    return Recording(*truth, *detected, squares, None if corners[0] is None else np.concatenate(corners))


def check_images(flights: Sequence[Flight]) -> None:
    """Raise `InputError` if a flight assumes all landmarks in view (`all_visible`).

    Sensors that measure in images call this function, as a landmark behind the camera has no image.
    """
    if any(flight.all_visible for flight in flights):
        raise InputError(
            "all_visible must be false if measurements are not exact: a landmark behind the camera has no image.",
            "all_visible",
        )
