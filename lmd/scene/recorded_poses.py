"""Recorded camera poses, which replace the position grid and the orientation PDF.

The recording is cut into blocks of time. Every `held_out`-th block is held out for validation:
`lmd.evaluation.validation` scores a deployment at its exact poses. The other blocks give the positions
(`lmd.space.changed`) and the position-dependent orientation PDF (`lmd.scene.by_position`) for optimisation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from lmd.core.checks import (
    BoolArray,
    Checked,
    Count,
    FloatArray,
    InputError,
    IntArray,
    Positive,
    integer,
)
from lmd.geometry.trajectory import Trajectory
from lmd.scene.by_position import pdf_by_position
from lmd.scene.pdf import OrientationPdf
from lmd.space.changed import RecordedRoom
from lmd.space.space import Space, check_file_inside


@dataclass(frozen=True)
class Records:
    """R recorded poses, each valid until the next pose.

    Args:
        poses: X, camera to world, `(R, 4, 4)`.
        seconds: duration of each pose, seconds, `(R,)`.
        block: index of the block of time of each pose, `(R,)`.
    """

    poses: FloatArray
    seconds: FloatArray
    block: IntArray

    def __len__(self) -> int:
        return len(self.seconds)

    def __getitem__(self, chosen: slice | BoolArray) -> "Records":
        return Records(self.poses[chosen], self.seconds[chosen], self.block[chosen])


@dataclass(frozen=True)
class RecordedPoses(Checked):
    """Recording with the settings of its positions, its orientation PDF and its validation.

    Args:
        trajectory: trajectory of the camera in the room.
        spacing: edge of the cells with one position each, metres: one number or one per axis.
        bandwidth: bandwidth of the kernel in position, metres.
        direction_bandwidth: bandwidth of the kernel in direction, degrees.
        divisions: the step of the orientation grid is 180 degrees / divisions.
        held_out: every `held_out`-th block is held out, at least 2; None to hold out none.
        block: length of a block, seconds.
        path: file of the recording, for messages.
        note: remark on an ambiguous file.

    Raises:
        InputError: a value is out of range, or the recording is too short for a block to be held out.
    """

    trajectory: Trajectory
    spacing: float | Sequence[float]
    bandwidth: Positive
    direction_bandwidth: Positive
    divisions: Count
    held_out: Annotated[int, partial(integer, low=2)] | None
    block: Positive
    path: str | None = None
    note: str = ""

    def _validate(self) -> None:
        if self.held_out is not None and not len(self.kept_back):
            raise InputError(
                f"held_out = {self.held_out}: no pose of {self.path} lies in a block to be held out, the first of "
                f"which begins after {(self.held_out - 1) * self.block:g} s.",
                "held_out",
            )

    @cached_property
    def _records(self) -> Records:
        """All records; the last pose of the trajectory is no record, as it only ends the record before it."""
        time = self.trajectory.time
        block = np.floor((time[:-1] - time[0]) / self.block).astype(np.int64)
        return Records(self.trajectory.poses[:-1], np.diff(time), block)

    @cached_property
    def _is_kept_back(self) -> BoolArray:
        every = self.held_out or math.inf
        return np.asarray(self._records.block % every == every - 1)

    @property
    def training(self) -> Records:
        """Records that a deployment is optimised on."""
        return self._records[~self._is_kept_back]

    @property
    def kept_back(self) -> Records:
        """Records that are held out."""
        return self._records[self._is_kept_back]

    def visited(self, room: Space) -> RecordedRoom:
        """Room with the positions of the recording.

        Raises:
            InputError: a pose, held out or not, is outside the room or in an obstacle, or the spacing is out of range.
        """
        check_file_inside(self.path, self.trajectory, room)
        training = self.training
        return RecordedRoom(room, training.poses[:, :3, 3], training.seconds, self.spacing)

    @cached_property
    def pdf(self) -> OrientationPdf:
        """Position-dependent orientation PDF.

        Raises:
            InputError: the records and orientations do not fit into memory.
        """
        training, width = self.training, math.radians(self.direction_bandwidth)
        return pdf_by_position(training.poses, training.seconds, self.bandwidth, width, self.divisions)
