"""What a camera records along its trajectories: which landmarks, and where they are in its own frame.

A rig is recorded as if it saw C K landmarks: each of its C cameras has K of its own, camera after camera, in one frame,
that of the body.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.estimation.odometry import Odometry
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import act, axis_and_right
from lmd.geometry.trajectory import Trajectory
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each

# Applies a function to jobs and gives the results in their order: the built-in `map`, or one with processes to share.
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True)
class Flight:
    """A camera's flight over a deployment, or a rig's, whose poses are those of its body.

    Args:
        evaluator: the scene, whose visibility model decides what is in view.
        deployment: K landmarks.
        trajectory: T frames.
        rng: source of everything random.
        all_visible: the camera sees every landmark, wherever it looks, as an observer without a camera model assumes.
    """

    evaluator: Evaluator
    deployment: Deployment
    trajectory: Trajectory
    rng: np.random.Generator
    all_visible: bool = False

    @property
    def camera(self) -> Camera | Rig:
        """That takes the frames."""
        return self.evaluator.scene.camera

    @property
    def poses(self) -> FloatArray:
        """The true X, `(T, 4, 4)`."""
        return self.trajectory.poses

    def looks(self) -> "list[Look]":
        """The flight as each of its cameras sees it."""
        scene = self.evaluator.scene
        if self.all_visible:
            seen = np.ones((len(scene.cameras), len(self.poses), len(self.deployment)), dtype=np.bool_)
        else:
            axes = axis_and_right(self.poses)
            seen = visible_to_each(self.evaluator, self.deployment, self.poses[:, :3, 3], axes)
        return [Look(*look, self) for look in zip(scene.cameras, scene.extrinsics, seen, strict=True)]


class Look(NamedTuple):
    """A flight as one camera sees it.

    Args:
        camera: its intrinsics.
        mounted: where it is on the body, see `lmd.scene.rig.Rig.extrinsics`, `(4, 4)`.
        in_view: which landmarks each frame has in view, `(T, K)`.
        flight: of the body.
    """

    camera: Camera
    mounted: FloatArray
    in_view: BoolArray
    flight: Flight

    @property
    def poses(self) -> FloatArray:
        """The true X of the camera, `(T, 4, 4)`."""
        return self.flight.poses @ self.mounted


class Observation(NamedTuple):
    """What became of K landmarks in the T frames of a flight; M detections in all, in the order of `np.nonzero(seen)`.

    Args:
        seen: which landmarks each frame has, `(T, K)`.
        points: where they are in the camera's frame as measured, metres, `(T, K, 3)`; meaningful where seen.
        noise: standard deviation of each image coordinate as estimators are told it, pixels, `(M,)`.
        covariance: of a measured point for one pixel of noise, m^2, `(M, 3, 3)`.
        corners: where a tag's corners were found, pixels from the border, in the order of
            `lmd.geometry.squares.CORNERS`, `(M, 4, 2)`; None for landmarks that are points.
    """

    seen: BoolArray
    points: FloatArray
    noise: FloatArray
    covariance: FloatArray
    corners: FloatArray | None = None


def joined(parts: Sequence[Observation], mounted: FloatArray) -> Observation:
    """What all cameras of a body observe as of one, in its frame: T frames of C K landmarks.

    Args:
        parts: of each camera, in its own frame.
        mounted: where they are on the body, `(C, 4, 4)`.
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
    """What becomes of landmarks in the images of a camera."""

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """What each flight observes.

        Args:
            flights: S of them.
            each: does what takes long.

        Raises:
            InputError: it cannot do without images where all landmarks are visible.
        """

    def tags(self, deployment: Deployment) -> FloatArray | None:
        """The corners of the tags at the landmarks, world frame, metres, `(K, 4, 3)`; None for points."""


@dataclass(frozen=True)
class Recording:
    """S runs of T frames, each over K landmarks; M detections in all, in the order of `np.nonzero(seen)`.

    Of a rig with C cameras K is C times as many, see above.

    Args:
        time: of the frames, seconds, `(T,)`.
        poses: the true X, `(S, T, 4, 4)`.
        twists: U from each frame to the next as measured, `(S, T - 1, 6)`; see `Trajectory.twists`.
        odometry: that measured them.
        landmarks: C_i in the world frame, metres, `(S, K, 3)`.
        camera: that recorded them.
        seen, points, noise, covariance: as in `Observation`, with an axis S in front of T.
        tags: corners of the tags, world frame, metres, `(S, K, 4, 3)`; None for points.
        corners: as found, see `Observation`, `(M, 4, 2)`; None for points.
    """

    time: FloatArray
    poses: FloatArray
    twists: FloatArray
    odometry: Odometry
    landmarks: FloatArray
    camera: Camera | Rig
    seen: BoolArray
    points: FloatArray
    noise: FloatArray
    covariance: FloatArray
    tags: FloatArray | None = None
    corners: FloatArray | None = None

    @property
    def seen_by(self) -> BoolArray:
        """Which of the landmarks each camera has in each frame, `(S, T, C, K / C)`."""
        return self.seen.reshape(*self.seen.shape[:2], len(self.camera.cameras), -1)

    @property
    def visible_counts(self) -> IntArray:
        """Landmarks that any camera has in each frame, `(S, T)`."""
        return np.asarray(self.seen_by.any(axis=2).sum(axis=-1))

    @cached_property
    def _first(self) -> IntArray:
        """The first detection of each frame of each run, and M, `(S T + 1,)`."""
        return np.concatenate([[0], np.cumsum(self.seen.sum(axis=-1))])

    def detections(self, s: int, first: int = 0, last: int | None = None) -> slice:
        """Which of the M detections were made in frames `first` to `last` (left out; None for all) of run s."""
        frames = len(self.time)
        return slice(self._first[s * frames + first], self._first[s * frames + (frames if last is None else last)])

    def share_visible(self, n: int) -> FloatArray:
        """Share of time with at least n landmarks, `(S,)`; each frame stands for the time until the next."""
        enough, steps = self.visible_counts[:, :-1] >= n, np.diff(self.time)
        return np.asarray(enough @ steps / steps.sum())


def record(
    detector: Sensor, flights: Sequence[Flight], odometry: Odometry | None = None, each: Each = map
) -> Recording:
    """Record S flights whose trajectories share their times.

    Args:
        detector: noise and missed detections.
        flights: S of them, with one camera or rig.
        odometry: measures the twists; None for exact ones.
        each: does what takes long.

    Raises:
        InputError: all landmarks are visible, and the detector needs images.
    """
    odometry, time = odometry or Odometry(), flights[0].trajectory.time
    observations = detector.observed(flights, each)
    twists = [odometry.measured(f.trajectory.twists, np.diff(time), f.rng.spawn(1)[0]) for f in flights]
    tags = [detector.tags(flight.deployment) for flight in flights]
    cameras = len(flights[0].camera.cameras)
    corners = [observation.corners for observation in observations]
    return Recording(
        time,
        np.stack([flight.poses for flight in flights]),
        np.stack(twists),
        odometry,
        np.stack([np.tile(flight.deployment.positions, (cameras, 1)) for flight in flights]),
        flights[0].camera,
        np.stack([observation.seen for observation in observations]),
        np.stack([observation.points for observation in observations]),
        np.concatenate([observation.noise for observation in observations]),
        np.concatenate([observation.covariance for observation in observations]),
        None if tags[0] is None else np.stack([np.tile(tag, (cameras, 1, 1)) for tag in tags]),  # type: ignore[arg-type] # all of them or none
        None if corners[0] is None else np.concatenate(corners),  # type: ignore[arg-type]
    )


def check_images(flights: Sequence[Flight]) -> None:
    """Raise `InputError` where landmarks without an image are to be seen, for what measures in images."""
    if any(flight.all_visible for flight in flights):
        raise InputError(
            "all_visible must be false where measurements are not exact: a landmark behind the camera has no image.",
            "all_visible",
        )
