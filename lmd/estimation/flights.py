"""Flights: motions of a camera through a room, along random waypoints or from a file."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, Positive
from lmd.core.memory import check_memory
from lmd.formats.trajectories import TrajectoryFile
from lmd.geometry.se3 import camera_pose
from lmd.geometry.trajectory import Trajectory
from lmd.scene.scene import Scene
from lmd.space.space import check_inside

# Largest slope of the minimum-jerk profile, at its middle.
PEAK_SLOPE = 1.875
# Maximum number of waypoints between two frames, and of draws until a waypoint has a free straight path.
MOST_WAYPOINTS, MOST_DRAWS = 100, 1000
# Lower bound on the memory of a frame of random motion, bytes.
FRAME_BYTES = 1000


class TrajectorySource(Protocol):
    """Interface of sources of camera trajectories."""

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """Make a trajectory inside the room of `scene`.

        Raises:
            InputError: no trajectory of this kind fits into the room.
        """


@dataclass(frozen=True)
class Pace(Checked):
    """Limits of the motion between waypoints, and the frame rate.

    Between two waypoints, position, yaw and pitch follow the minimum-jerk profile 10 t^3 - 15 t^4 + 6 t^5, with the
    time t from 0 to 1. The motion is as fast as `speed` and `turn_rate` allow. At a waypoint the camera is at rest.

    Raises:
        InputError: a value is not positive.
    """

    speed: Positive
    """Limit of the speed |v|, m/s."""
    turn_rate: Positive
    """Limit of the turn rate |w|, rad/s; yaw and pitch turn about perpendicular axes."""
    frame_rate: Positive
    """Frame rate, frames per second."""

    def seconds(self, steps: FloatArray) -> FloatArray:
        """Least time, seconds, `(...)`, in which the camera can make each of the changes `steps` of (x, y, z, yaw,
        pitch), metres and radians, `(..., 5)`, without exceeding the limits.
        """
        way, turn = np.linalg.norm(steps[..., :3], axis=-1), np.linalg.norm(steps[..., 3:], axis=-1)
        return np.asarray(PEAK_SLOPE * np.maximum(way / self.speed, turn / self.turn_rate))

    def through(self, waypoints: FloatArray, duration: float = np.inf) -> Trajectory:
        """Make a trajectory through waypoints (x, y, z, yaw, pitch).

        Args:
            waypoints: `(N, 5)`, metres and radians, each different from the previous one; yaw changes by the smaller
                angle.
            duration: time after which the trajectory is cut off, seconds.
        """
        path = waypoints.copy()
        path[:, 3] = np.unwrap(path[:, 3])
        steps = np.diff(path, axis=0)
        seconds = self.seconds(steps)
        arrival = np.concatenate([[0.0], np.cumsum(seconds)])
        end = min(arrival[-1], duration)
        # Tolerance for rounding, so that 0.3 s at 10 frames per second are 3 steps.
        time = np.arange(int(end * self.frame_rate + 1e-9) + 1) / self.frame_rate
        leg = np.clip(np.searchsorted(arrival, time, side="right") - 1, 0, len(steps) - 1)
        t = (time - arrival[leg]) / seconds[leg]
        x, y, z, yaw, pitch = (path[leg] + (t**3 * (10.0 - 15.0 * t + 6.0 * t**2))[:, None] * steps[leg]).T
        return Trajectory(time, camera_pose(np.stack([x, y, z], axis=1), yaw, pitch))


@dataclass(frozen=True)
class RandomMotion(Checked):
    """Random motion in the reachable volume, straight from one random waypoint to the next.

    Waypoints are uniform in the part of the reachable volume with a free straight path from the previous waypoint;
    their orientations follow the orientation PDF of the scene.

    Raises:
        InputError: the duration is not positive.
    """

    duration: Positive
    """Duration of the motion, seconds."""
    pace: Pace
    """Limits of speed and turn rate, and the frame rate."""

    def _validate(self) -> None:
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
                raise InputError(f"{speeds} is too fast: {MOST_WAYPOINTS} waypoints or more in a frame.", "pace.speed")
            waypoints.append(_next_waypoint(scene, waypoints[-1], rng))
            left -= float(self.pace.seconds(_shortest(waypoints[-1] - waypoints[-2])))
        trajectory = self.pace.through(np.array(waypoints), self.duration)
        check_inside(trajectory, room)
        return trajectory


def _random_waypoint(scene: Scene, rng: np.random.Generator) -> FloatArray:
    position = scene.room.sample(1, rng)
    return np.concatenate([position[0], *scene.pdf.draw_at(position, rng)[:2]])


def _next_waypoint(scene: Scene, before: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw random waypoints (x, y, z, yaw, pitch) until one has a free straight path from the waypoint `before`; return
    this waypoint, `(5,)`. Raises `InputError` if none of `MOST_DRAWS` waypoints has such a path.
    """
    for _ in range(MOST_DRAWS):
        waypoint = _random_waypoint(scene, rng)
        if not np.array_equal(waypoint, before) and scene.room.passable(before[:3], waypoint[:3]):
            return waypoint
    x, y, z = before[:3]
    raise InputError(f"none of {MOST_DRAWS} straight paths from ({x:.9g}, {y:.9g}, {z:.9g}) is free of obstacles.")


def _shortest(step: FloatArray) -> FloatArray:
    """Change of (x, y, z, yaw, pitch), `(5,)`, with the change of the yaw wrapped to [-pi, pi)."""
    yaw = (step[3] + np.pi) % (2.0 * np.pi) - np.pi
    return np.array([*step[:3], yaw, step[4]])


@dataclass(frozen=True)
class FileTrajectory(TrajectoryFile):
    """Recorded or planned trajectory from a file, with one pose for each frame, see `TrajectoryFile`."""

    def draw(self, scene: Scene, rng: np.random.Generator) -> Trajectory:
        """See `TrajectorySource.draw`; the trajectory is not random."""
        return self.check_inside(scene.room, check_inside)
