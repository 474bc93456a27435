"""Trajectories: where the camera is and where it looks, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.checks import FloatArray, InputError, choice, radians, real, seconds, vector
from lmd.geometry.se3 import camera_pose, inverse, log, poses_from_rows
from lmd.memory import check_memory
from lmd.scene import Scene
from lmd.space.space import Space
from lmd.tables import read_headless, read_table

ANGLES = ("time", "x", "y", "z", "yaw", "pitch")
QUATERNIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")  # the order of TUM's trajectories, too
# From the camera's axes (x right, y down, z the optical axis) to those that a quaternion is about.
FRAMES = {"optical": np.eye(3), "body": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])}
# Greatest slope of the minimum-jerk profile, at its middle.
PEAK = 1.875
MOST_WAYPOINTS = 100  # between two frames
MOST_DRAWS = 1000  # of a waypoint, until a straight way leads there
FRAME_BYTES = 1000  # what a frame of random motion takes at the least: its pose, and those of the way there


@dataclass(frozen=True)
class Trajectory:
    """The poses of a camera at the instants of its T frames.

    Args:
        time: seconds, increasing, `(T,)`, T >= 2.
        poses: X at each instant, camera to world, `(T, 4, 4)`.

    Raises:
        InputError: fewer than two frames, or a time that is not later than the one before.
    """

    time: FloatArray
    poses: FloatArray

    def __post_init__(self) -> None:
        if len(self.time) < 2:
            raise InputError(f"a trajectory must have at least 2 frames, got {len(self.time)}.")
        _check_order(self.time)

    @property
    def twists(self) -> FloatArray:
        """U between each frame and the next, X_t+1 = X_t exp(h U), `(T - 1, 6)`, rad/s and m/s in the body frame."""
        return log(inverse(self.poses[:-1]) @ self.poses[1:]) / np.diff(self.time)[:, None]

    @classmethod
    def from_file(cls, path: str, frame: str = "optical") -> "Trajectory":
        """Read a CSV with the columns time,x,y,z,yaw,pitch, if you like roll, or time,x,y,z,qx,qy,qz,qw; or TUM's text.

        Seconds, metres and radians, the angles as in `lmd.geometry.frames.rotation`. The unit quaternion turns a frame
        of the camera to the world's. TUM's format, which ROS tools write, has no header:
        `time tx ty tz qx qy qz qw` in each line.

        Args:
            path: the file.
            frame: of quaternions: `optical` (x right, y down, z the optical axis) or `body` (x along the optical axis,
                y left, z up).

        Raises:
            InputError: the file cannot be read, or what it holds is no trajectory; the message names the file.
        """
        choice("frame", frame, list(FRAMES))
        table = read_headless(path, QUATERNIONS, name="path") or read_table(path, name="path")
        try:
            if "qw" in table:
                rows = table.numbers(QUATERNIONS)
                seconds(str(path), rows[:, 0], rows[:, 1:4])
                _check_order(rows[:, 0], table.lines)
                poses = poses_from_rows(rows[:, 1:])
                poses[:, :3, :3] = poses[:, :3, :3] @ FRAMES[frame]
                return cls(rows[:, 0], poses)
            rows = table.numbers((*ANGLES, "roll") if "roll" in table else ANGLES)
            seconds(str(path), rows[:, 0], rows[:, 1:4])
            _check_order(rows[:, 0], table.lines)
            angles = dict(zip(("yaw", "pitch", "roll"), rows[:, 4:].T, strict=False))
            radians("the trajectory", **angles)
            return cls(rows[:, 0], camera_pose(rows[:, 1:4], **angles))
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None

    def check_positions(self, room: Space) -> None:
        """Raise `InputError` if the camera leaves the closed room, or is inside something that stands in it."""
        positions = self.poses[:, :3, 3]
        outside = np.flatnonzero(~room.contains(positions))
        if outside.size:
            x, y, z = positions[outside[0]]
            raise InputError(
                f"the camera at {self.time[outside[0]]:.16g} s, ({x:.9g}, {y:.9g}, {z:.9g}), is outside the "
                f"{room.describe()}."
            )

    def check_inside(self, room: Space) -> None:
        """Raise `InputError` as `check_positions`, or if it goes through something that stands in the room."""
        self.check_positions(room)
        positions = self.poses[:, :3, 3]
        through = np.flatnonzero(~room.clear(positions[:-1], positions[1:]))
        if through.size:
            x, y, z = positions[through[0]]
            raise InputError(
                f"the camera goes straight on from ({x:.9g}, {y:.9g}, {z:.9g}) at {self.time[through[0]]:.16g} s, "
                f"through something that stands in the {room.describe()}."
            )


class TrajectorySource(Protocol):
    """Something that provides trajectories."""

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """A trajectory inside the room of `scene`.

        Raises:
            InputError: there is none.
        """


def _check_order(time: FloatArray, lines: Sequence[int] | None = None) -> None:
    """Raise `InputError` if a time `(T,)` is not later than the one before, with its line in the file if known."""
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        before, after = time[late[0] : late[0] + 2].tolist()
        where = "" if lines is None else f"line {lines[late[0] + 1]}: "
        raise InputError(f"{where}the times of a trajectory must increase, but {after:.16g} s follows {before:.16g} s.")


@dataclass(frozen=True)
class Pace:
    """How fast a camera goes from one waypoint to the next, and how often it takes a frame.

    Between two waypoints position, yaw and pitch follow the minimum-jerk profile 10 t^3 - 15 t^4 + 6 t^5, as slowly as
    both limits ask for; at a waypoint the camera is at rest.

    Args:
        speed: limit of |v|, m/s.
        turn_rate: limit of |w|, rad/s; yaw and pitch turn about perpendicular axes.
        frame_rate: frames per second.

    Raises:
        InputError: a value is not positive.
    """

    speed: float
    turn_rate: float
    frame_rate: float

    def __post_init__(self) -> None:
        for name in ("speed", "turn_rate", "frame_rate"):
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))

    def seconds(self, steps: FloatArray) -> FloatArray:
        """Time that each change (x, y, z, yaw, pitch) `(..., 5)` takes, `(...)`."""
        way, turn = np.linalg.norm(steps[..., :3], axis=-1), np.linalg.norm(steps[..., 3:], axis=-1)
        return np.asarray(PEAK * np.maximum(way / self.speed, turn / self.turn_rate))

    def through(self, waypoints: FloatArray, duration: float | None = None) -> Trajectory:
        """The trajectory through waypoints (x, y, z, yaw, pitch).

        Args:
            waypoints: `(N, 5)`, metres and radians; the yaw turns the shorter way.
            duration: seconds after which it ends; None for the last waypoint.

        Raises:
            InputError: two consecutive waypoints are the same.
        """
        path = waypoints.copy()
        path[:, 3] = np.unwrap(path[:, 3])
        steps = np.diff(path, axis=0)
        seconds = self.seconds(steps)
        if (still := np.flatnonzero(seconds == 0.0)).size:
            raise InputError(f"waypoints {still[0]} and {still[0] + 1} are the same, {waypoints[still[0]].tolist()}.")
        arrival = np.concatenate([[0.0], np.cumsum(seconds)])
        end = arrival[-1] if duration is None else duration
        # The small allowance keeps 0.3 s at 10 frames per second at 3 steps however the product rounds.
        time = np.arange(int(end * self.frame_rate + 1e-9) + 1) / self.frame_rate
        leg = np.clip(np.searchsorted(arrival, time, side="right") - 1, 0, len(steps) - 1)
        t = (time - arrival[leg]) / seconds[leg]
        x, y, z, yaw, pitch = (path[leg] + (t**3 * (10.0 - 15.0 * t + 6.0 * t**2))[:, None] * steps[leg]).T
        return Trajectory(time, camera_pose(np.stack([x, y, z], axis=1), yaw, pitch))


@dataclass(frozen=True)
class RandomMotion:
    """Random movement in the reachable area: from one random waypoint straight to the next.

    Waypoints are uniform in the reachable area, or in what of it can be reached on a straight way from the one before;
    their orientations follow the orientation PDF of the scene.

    Args:
        duration: seconds.
        pace: limits and frame rate.

    Raises:
        InputError: the duration is not positive.
    """

    duration: float
    pace: Pace

    def __post_init__(self) -> None:
        object.__setattr__(self, "duration", real("duration", self.duration, above=0.0))
        frames = self.duration * self.pace.frame_rate
        made = f"duration = {self.duration:g} s makes {frames:.4g} frames, which"
        check_memory(FRAME_BYTES * frames, made, "duration")

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """See `TrajectorySource.draw`."""
        room, left, waypoints = scene.room, self.duration, [_random_waypoint(scene, rng)]
        while left > 0.0:
            frames = (self.duration - left) * self.pace.frame_rate
            if len(waypoints) > max(1000.0, MOST_WAYPOINTS * frames):
                speeds = f"pace.speed = {self.pace.speed:g} m/s with pace.turn_rate = {self.pace.turn_rate:g} rad/s"
                raise InputError(f"{speeds} is {MOST_WAYPOINTS} waypoints and more between two frames.", "pace.speed")
            waypoints.append(_next_waypoint(scene, waypoints[-1], rng))
            left -= float(self.pace.seconds(_shortest(waypoints[-1] - waypoints[-2])))
        trajectory = self.pace.through(np.array(waypoints), self.duration)
        trajectory.check_inside(room)
        return trajectory


def _random_waypoint(scene: Scene, rng: np.random.Generator) -> FloatArray:
    position = scene.room.sample(1, rng)
    return np.concatenate([position[0], *scene.pdf.draw_at(position, rng)[:2]])


def _next_waypoint(scene: Scene, before: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Another waypoint, to which a straight way leads from the one `before`; drawn anew until there is one."""
    for _ in range(MOST_DRAWS):
        waypoint = _random_waypoint(scene, rng)
        if not np.array_equal(waypoint, before) and scene.room.passable(before[:3], waypoint[:3]):
            return waypoint
    x, y, z = before[:3]
    raise InputError(f"no straight way leads on from ({x:.9g}, {y:.9g}, {z:.9g}): none of {MOST_DRAWS} is free.")


def _shortest(step: FloatArray) -> FloatArray:
    """A change of (x, y, z, yaw, pitch) `(5,)` with the yaw brought into [-pi, pi)."""
    yaw = (step[3] + np.pi) % (2.0 * np.pi) - np.pi
    return np.array([*step[:3], yaw, step[4]])


@dataclass(frozen=True)
class Waypoints:
    """Through given waypoints.

    Args:
        points: [x, y, z, yaw, pitch] each, metres and radians, at least two.
        pace: limits and frame rate.

    Raises:
        InputError: fewer than two waypoints, no pace, or a waypoint that is not five finite numbers with a pitch in
            [-pi/2, pi/2].
    """

    points: Sequence[Sequence[float]]
    pace: Pace

    def __post_init__(self) -> None:
        if isinstance(self.points, str) or not isinstance(self.points, Sequence) or len(self.points) < 2:
            raise InputError(
                f"points must list at least 2 waypoints [x, y, z, yaw, pitch], got {self.points!r}.", "points"
            )
        if not isinstance(self.pace, Pace):
            raise InputError(f"pace must say speed, turn_rate and frame_rate, got {self.pace!r}.", "pace")
        for i, point in enumerate(self.points):
            *_, pitch = vector(f"points[{i}]", point, 5)
            real(f"points[{i}] pitch", pitch, low=-np.pi / 2, high=np.pi / 2)

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """See `TrajectorySource.draw`; nothing here is random."""
        trajectory = self.pace.through(np.array(self.points, dtype=np.float64))
        try:
            trajectory.check_inside(scene.room)
        except InputError as error:
            raise InputError(f"points: {error}", "points") from None
        return trajectory


@dataclass(frozen=True)
class FileTrajectory:
    """A recorded or planned trajectory from a file, one row for each frame, see `Trajectory.from_file`."""

    path: str | None

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """See `TrajectorySource.draw`; nothing here is random."""
        if self.path is None:
            raise InputError("path is missing: a CSV of poses is needed.", "path")
        trajectory = Trajectory.from_file(self.path)
        try:
            trajectory.check_inside(scene.room)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        return trajectory
