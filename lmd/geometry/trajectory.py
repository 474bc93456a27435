"""Trajectories: poses of a camera over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, log, pose_of


@dataclass(frozen=True)
class Trajectory:
    """Poses of a camera at the times of T frames.

    Raises:
        InputError: there are fewer than two frames, or the times do not increase.
    """

    time: FloatArray
    """Times of the frames, seconds, increasing, `(T,)`, T >= 2."""
    poses: FloatArray
    """Poses X of the camera, camera to world, `(T, 4, 4)`."""

    def __post_init__(self) -> None:
        if len(self.time) < 2:
            raise InputError(f"a trajectory must have at least 2 frames, got {len(self.time)}.")
        check_order(self.time)

    def at(self, seconds: FloatArray) -> FloatArray:
        """Poses, `(n, 4, 4)`, at the times `seconds` `(n,)`, which lie between the first and the last frame. Between
        two frames, the poses are interpolated at a constant velocity and turn rate.
        """
        from scipy.spatial.transform import Rotation, Slerp

        (first, share), places = self.steps_at(seconds), self.poses[:, :3, 3]
        turns = Slerp(self.time, Rotation.from_matrix(self.poses[:, :3, :3]))(seconds)
        way = (1.0 - share)[:, None] * places[first] + share[:, None] * places[first + 1]
        return pose_of(turns.as_matrix(), way)

    def steps_at(self, seconds: FloatArray) -> tuple[IntArray, FloatArray]:
        """Locate the times `seconds` `(n,)` between frames. Returns the index of the frame before each time, `(n,)`,
        and the fraction of the time step to the next frame that has passed, `(n,)`.
        """
        first = np.clip(np.searchsorted(self.time, seconds, side="right") - 1, 0, len(self.time) - 2)
        return first, (seconds - self.time[first]) / (self.time[first + 1] - self.time[first])

    @property
    def twists(self) -> FloatArray:
        """Body twists U between successive frames, `(T - 1, 6)`, rad/s and m/s. The twists are defined by
        X_t+1 = X_t exp(h U) for the time step h.
        """
        return log(inverse(self.poses[:-1]) @ self.poses[1:]) / np.diff(self.time)[:, None]


def check_order(time: FloatArray, lines: Sequence[int] | None = None) -> None:
    """Raise `InputError` if the times `(T,)` do not increase; `lines` has the number of each time's line in a file, for
    the error message.
    """
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        before, after = time[late[0] : late[0] + 2].tolist()
        where = "" if lines is None else f"line {lines[late[0] + 1]}: "
        raise InputError(f"{where}the times of a trajectory must increase, but {after:.16g} s follows {before:.16g} s.")
