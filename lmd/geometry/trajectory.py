"""Trajectories: where the camera is and where it looks, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError, choice, radians, seconds
from lmd.core.tables import read_headless, read_table
from lmd.geometry.se3 import camera_pose, inverse, log, poses_from_rows

ANGLES = ("time", "x", "y", "z", "yaw", "pitch")
QUATERNIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")  # the order of TUM's trajectories, too
# From the camera's axes (x right, y down, z the optical axis) to those that a quaternion is about.
FRAMES = {"optical": np.eye(3), "body": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])}


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


def _check_order(time: FloatArray, lines: Sequence[int] | None = None) -> None:
    """Raise `InputError` if a time `(T,)` is not later than the one before, with its line in the file if known."""
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        before, after = time[late[0] : late[0] + 2].tolist()
        where = "" if lines is None else f"line {lines[late[0] + 1]}: "
        raise InputError(f"{where}the times of a trajectory must increase, but {after:.16g} s follows {before:.16g} s.")
