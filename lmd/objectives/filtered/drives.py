"""Drives of a camera or of a rig's body, and the odometry along the drives, as plain arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, IntArray, real
from lmd.geometry.se3 import axis_and_right
from lmd.geometry.trajectory import Trajectory

DECIMALS = 9  # of the duration of a frame, seconds: regular frames last equally long
LARGEST = 1e6  # greatest standard deviation, in its unit
Noise = Annotated[float, partial(real, low=0.0, high=LARGEST)]
Deviation = Annotated[float, partial(real, low=1.0 / LARGEST, high=LARGEST)]
# Standard deviations of a camera whose pose in a building is unknown: of its position along an axis, metres, and of its
# rotation about an axis, rad: an error of rotation is at most half a turn. Greater deviations are cut to these.
UNKNOWN_POSITION, UNKNOWN_ATTITUDE = 1e3, np.pi


@dataclass(frozen=True)
class Drives(Checked):
    """D drives of a camera or of a rig's body, with F frames (images) in total, and the noise of the odometry.

    Raises:
        InputError: a value is out of range, or there is no drive.
    """

    trajectories: Sequence[Trajectory]
    """Poses of the camera, or of the rig's body, at the images of each drive."""
    turn_noise: Noise
    """Noise of the odometry about each axis, rad per root second."""
    motion_noise: Noise
    """Noise of the odometry along each axis, metres per root second."""
    start_position: Deviation = 1.0
    """Standard deviation of the initial position along each axis, metres."""
    start_attitude: Deviation = 0.5
    """Standard deviation of the initial attitude about each axis, rad."""

    def _validate(self) -> None:
        if not self.trajectories:
            raise InputError("drives must have at least one drive, got none.", "drives")

    def __len__(self) -> int:
        return len(self.trajectories)

    @cached_property
    def first(self) -> IntArray:
        """Index of the first frame of each drive, followed by F, `(D + 1,)`."""
        return np.concatenate([[0], np.cumsum([len(drive.time) for drive in self.trajectories])]).astype(np.int64)

    @cached_property
    def poses(self) -> FloatArray:
        """Poses of the camera, or of the rig's body, in all frames, `(F, 4, 4)`: matrices from the axes of the camera
        or body to the axes of the world.
        """
        return np.concatenate([drive.poses for drive in self.trajectories])

    @cached_property
    def positions(self) -> FloatArray:
        """Positions of all frames, metres, `(F, 3)`."""
        return np.ascontiguousarray(self.poses[:, :3, 3])

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors along the optical axis and to the right in the image, in all frames, `(F, 6)`."""
        return axis_and_right(self.poses)

    @cached_property
    def seconds(self) -> FloatArray:
        """Time until the next frame of the drive, seconds, `(F,)`. The last frame of a drive lasts as long as the frame
        before it.
        """
        steps = [np.round(np.diff(drive.time), DECIMALS) for drive in self.trajectories]
        return np.concatenate([np.append(step, step[-1]) for step in steps])

    @cached_property
    def moves(self) -> FloatArray:
        """Motion from the previous frame to each frame, `(F, 5)`. The columns are the displacement in the world frame,
        metres (three numbers), and the variance of the odometry along each axis, m^2, and about each axis, rad^2. The
        first frame of a drive has zeros.
        """
        moves = np.zeros((len(self.poses), 5))
        for first, drive in zip(self.first, self.trajectories, strict=False):
            rows, step = moves[first + 1 : first + len(drive.time)], np.diff(drive.time)
            rows[:, :3] = np.diff(drive.poses[:, :3, 3], axis=0)
            rows[:, 3] = np.minimum(self.motion_noise**2 * step, UNKNOWN_POSITION**2)
            rows[:, 4] = np.minimum(self.turn_noise**2 * step, UNKNOWN_ATTITUDE**2)
        return moves

    @property
    def start(self) -> FloatArray:
        """Covariance of the initial pose, `(21,)`: the different entries of a symmetric 6 x 6 matrix.

        The first 6 numbers are the block of the position, the next 9 the covariances of position and rotation, and the
        last 6 the block of the rotation, see `lmd.objectives.filtered.lanes`.
        """
        start = np.zeros(21)
        start[[0, 3, 5]] = min(self.start_position, UNKNOWN_POSITION) ** 2
        start[[15, 18, 20]] = min(self.start_attitude, UNKNOWN_ATTITUDE) ** 2
        return start

    @property
    def vaguest(self) -> float:
        """Greatest variance that a pose reaches along or about an axis if no tag is seen.

        The variance is the sum of the initial variance and the variance of the odometry along a whole drive. The result
        is the larger of two numbers, m^2 for the position and rad^2 for the rotation. Errors of the position that
        follow from errors of the rotation are ignored.
        """
        drift = np.add.reduceat(self.moves[:, 3:], self.first[:-1]).max(axis=0)
        return float((self.start[[0, 15]] + drift).max())

    @cached_property
    def of_frame(self) -> IntArray:
        """Index of the drive to which each frame belongs, `(F,)`."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    def relative(self, relevance: FloatArray) -> FloatArray:
        """Relevance of each frame divided by the total relevance of its drive, `(F,)`.

        Raises:
            InputError: the total relevance of a drive is zero.
        """
        whole = np.add.reduceat(relevance, self.first[:-1])
        if not whole.all():
            drive = int(np.flatnonzero(whole == 0.0)[0])
            raise InputError(f"the relevance is 0 along the whole of drive {drive}.", "drives")
        return np.asarray(relevance / whole[self.of_frame])

    def share_of(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """Mean over each drive, `(..., D)`, of the `values` of the frames, `(..., F)`, weighted by the relevance
        `(F,)`.

        Raises:
            InputError: the total relevance of a drive is zero.
        """
        return np.asarray(np.add.reduceat(values * self.relative(relevance), self.first[:-1], axis=-1))
