"""What a camera records along its trajectories: which landmarks, and where they are in its own frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from lmd.camera import Camera
from lmd.checks import BoolArray, FloatArray, InputError, real
from lmd.deployment import Deployment
from lmd.geometry.distortion import distort, undistort
from lmd.geometry.se3 import act, axis_and_right, inverse, log
from lmd.localisation.trajectory import Trajectory
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible


class Sensor(Protocol):
    """What becomes of landmarks in the images of a camera."""

    @property
    def pixel_noise(self) -> float:
        """Standard deviation of image coordinates, pixels; 0 for exact measurements."""

    @property
    def edge(self) -> float:
        """Edge length of a landmark, metres."""

    def observed(
        self,
        evaluator: Evaluator,
        camera: Camera,
        deployment: Deployment,
        poses: FloatArray,
        rng: np.random.Generator,
        all_visible: bool,
    ) -> tuple[BoolArray, FloatArray]:
        """Which of K landmarks each of T frames has, `(T, K)`, and where in the camera's frame, metres, `(T, K, 3)`.

        Args:
            evaluator: the scene.
            camera: its intrinsics.
            deployment: K landmarks.
            poses: the true X, `(T, 4, 4)`.
            rng: source of everything random.
            all_visible: the camera sees every landmark, wherever it looks.
        """


@dataclass(frozen=True)
class Detector:
    """What becomes of a visible landmark in an image.

    Noise has three independent parts for each landmark and frame, all normal with the same standard deviation: the two
    image coordinates of its centre, and the apparent length of its edge, f a / z, that gives the depth z.

    Args:
        pixel_noise: standard deviation sigma, pixels; 0 for exact measurements.
        missed: probability that a visible landmark is not detected.
        edge: edge length a of a landmark, metres.

    Raises:
        InputError: a value is out of range.
    """

    pixel_noise: float = 0.0
    missed: float = 0.0
    edge: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixel_noise", real("pixel_noise", self.pixel_noise, low=0.0))
        object.__setattr__(self, "missed", real("missed", self.missed, low=0.0, high=1.0))
        object.__setattr__(self, "edge", real("edge", self.edge, above=0.0))

    def observed(
        self,
        evaluator: Evaluator,
        camera: Camera,
        deployment: Deployment,
        poses: FloatArray,
        rng: np.random.Generator,
        all_visible: bool,
    ) -> tuple[BoolArray, FloatArray]:
        """See `Sensor.observed`; a landmark is visible as the scene's visibility model says."""
        if all_visible:
            sight = np.ones((len(poses), len(deployment)), dtype=np.bool_)
        else:
            sight = visible(evaluator, deployment, poses[:, :3, 3], axis_and_right(poses))
        seen = self.detected(sight, rng)
        return seen, self.measured(act(inverse(poses), deployment.positions), camera, rng)

    def detected(self, seen: BoolArray, rng: np.random.Generator) -> BoolArray:
        """Those of the visible landmarks that are detected, same shape as `seen`."""
        return seen & (rng.random(seen.shape) >= self.missed)

    def measured(self, points: FloatArray, camera: Camera, rng: np.random.Generator) -> FloatArray:
        """Measurements of landmarks at y = (x, y, z) in the camera's frame.

        (x / z, y / z) carries the pixel noise over the focal length, z = f a / w that of the edge w >= 1 pixel. Where
        the lens distorts, the noise is added to the distorted image, and the sum undistorted.

        Args:
            points: `(..., 3)`, metres; meaningful where the depth z is positive.
            camera: its focal length in pixels, and its distortion.
            rng: source of the noise.

        Returns:
            `(..., 3)`, metres.
        """
        if self.pixel_noise == 0.0:
            return points
        focal, noise = camera.focal_pixels, rng.normal(scale=self.pixel_noise, size=points.shape)
        depth = np.where(points[..., 2:] > 0.0, points[..., 2:], 1.0)
        image = points[..., :2] / depth
        if camera.distortion:
            image = undistort(distort(image, camera.distortion) + noise[..., :2] / focal, camera.distortion)
        else:
            image = image + noise[..., :2] / focal
        ray = np.concatenate([image, np.ones_like(depth)], axis=-1)
        width = np.maximum(focal[0] * self.edge / depth + noise[..., 2:], 1.0)
        return np.asarray(focal[0] * self.edge / width * ray)


@dataclass(frozen=True)
class Recording:
    """S runs of T frames, each over K landmarks.

    Args:
        time: of the frames, seconds, `(T,)`.
        poses: the true X, `(S, T, 4, 4)`.
        landmarks: C_i in the world frame, metres, `(S, K, 3)`.
        seen: which landmarks each frame detects, `(S, T, K)`.
        points: measured y_i in the camera's frame, metres, `(S, T, K, 3)`; meaningful where seen.
        camera: that recorded them.
        detector: that found them.
    """

    time: FloatArray
    poses: FloatArray
    landmarks: FloatArray
    seen: BoolArray
    points: FloatArray
    camera: Camera
    detector: Sensor

    @cached_property
    def twists(self) -> FloatArray:
        """U between each frame and the next, X_t+1 = X_t exp(h U), `(S, T - 1, 6)`, rad/s and m/s in the body frame."""
        return log(inverse(self.poses[:, :-1]) @ self.poses[:, 1:]) / np.diff(self.time)[:, None]

    @property
    def visible_counts(self) -> FloatArray:
        """Landmarks in each frame, `(S, T)`."""
        return np.asarray(self.seen.sum(axis=-1))

    def share_visible(self, n: int) -> FloatArray:
        """Share of time with at least n landmarks, `(S,)`; each frame stands for the time until the next."""
        enough, steps = self.visible_counts[:, :-1] >= n, np.diff(self.time)
        return np.asarray(enough @ steps / steps.sum())


def record(
    evaluator: Evaluator,
    camera: Camera,
    detector: Sensor,
    deployments: Sequence[Deployment],
    trajectories: Sequence[Trajectory],
    rngs: Sequence[np.random.Generator],
    all_visible: bool = False,
) -> Recording:
    """Record S trajectories, each over a deployment of its own.

    Args:
        evaluator: the scene, whose visibility model decides what is seen.
        camera: its focal length in pixels.
        detector: noise and missed detections.
        deployments, trajectories, rngs: S of each; the trajectories share their times.
        all_visible: the camera sees every landmark at all times, as an observer without a camera model assumes.

    Raises:
        InputError: noise is asked for where all landmarks are visible: what is behind the camera has no image.
    """
    if all_visible and detector.pixel_noise > 0.0:
        raise InputError(
            f"pixel_noise must be 0 when all landmarks are visible, got {detector.pixel_noise:g}: "
            "a landmark behind the camera has no image.",
            "pixel_noise",
        ).within("detector")
    seen, points = [], []
    for deployment, trajectory, rng in zip(deployments, trajectories, rngs, strict=True):
        frames = detector.observed(evaluator, camera, deployment, trajectory.poses, rng, all_visible)
        seen.append(frames[0])
        points.append(frames[1])
    return Recording(
        trajectories[0].time,
        np.stack([trajectory.poses for trajectory in trajectories]),
        np.stack([deployment.positions for deployment in deployments]),
        np.stack(seen),
        np.stack(points),
        camera,
        detector,
    )
