"""Recorded camera poses, which replace the position grid and the orientation PDF.

The recording is cut into blocks of time. Every `held_out`-th block is held out for validation:
`lmd.evaluation.validation` scores a deployment at the exact poses of these blocks. For optimisation, the other blocks
give the positions (`lmd.space.changed`) and the position-dependent orientation PDF (`pdf_by_position`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

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
from lmd.core.memory import check_memory
from lmd.geometry.frames import angles_of, rotation
from lmd.geometry.trajectory import Trajectory
from lmd.scene.pdf import OrientationPdf
from lmd.space.changed import RecordedRoom
from lmd.space.space import Space, check_file_inside

CUT_AT = 5.0  # distance at which kernels are cut off, bandwidths
CUT = math.exp(-(CUT_AT**2) / 2.0)
# Least probability of an orientation over the whole recording. Rarer orientations are dropped to save time.
NEGLIGIBLE = 1e-6
CHUNK = 1 << 20  # maximum number of record-orientation or position-record pairs per batch
ENTRY_BYTES = 20  # memory of a nonzero K_t(a): two copies of a probability and an index


def pdf_by_position(
    poses: FloatArray, seconds: FloatArray, bandwidth: float, direction_bandwidth: float, divisions: int
) -> OrientationPdf:
    """Estimate w_a(p), the probability of orientation a at position p, from recorded poses by kernel smoothing.

    Args:
        poses: pose matrix of each of T records, from the camera frame to the world, `(T, 4, 4)`.
        seconds: duration tau_t of each record, `(T,)`.
        bandwidth: bandwidth h of the kernel in position, metres.
        direction_bandwidth: bandwidth g of the kernel in direction, radians.
        divisions: the step of the grid of orientations is pi / divisions.

    Returns:
        PDF with `by_position`; its `weight` is the mean over the recording.

    Raises:
        InputError: the records and orientations would not fit into memory.
    """
    yaw, pitch, roll, solid_angle = _grid(poses, divisions)
    spread = _spread(poses, rotation(yaw, pitch, roll), solid_angle, direction_bandwidth)
    total = seconds @ spread / seconds.sum()
    kept = np.flatnonzero(total > NEGLIGIBLE)
    spread, total = spread[:, kept], total[kept]
    kernels = _Kernels(poses[:, :3, 3], seconds, spread, total / total.sum(), bandwidth)
    name = f"pdf recorded (bandwidths {bandwidth:g} m, {math.degrees(direction_bandwidth):g} degrees)"
    return OrientationPdf(
        yaw[kept], pitch[kept], total / total.sum(), name, roll=roll[kept], by_position=kernels.probabilities
    )


def _grid(poses: FloatArray, divisions: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Grid of orientations: yaw, pitch and roll, radians, and relative solid angle of each cell, `(A,)` each.

    The pitches include the poles. The rolls are the recorded rolls, rounded to the grid.
    """
    step = np.pi / divisions
    *_, rolled = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
    rolls = np.unique(np.rint(rolled / step) % (2 * divisions)) * step
    yaws, pitches = np.arange(2 * divisions) * step - np.pi, np.linspace(-np.pi / 2, np.pi / 2, divisions + 1)
    yaw, pitch, roll = (angle.reshape(-1) for angle in np.meshgrid(yaws, pitches, rolls, indexing="ij"))
    low, high = np.maximum(pitch - step / 2, -np.pi / 2), np.minimum(pitch + step / 2, np.pi / 2)
    return yaw, pitch, roll, np.sin(high) - np.sin(low)


def _spread(poses: FloatArray, orientations: FloatArray, solid_angle: FloatArray, width: float) -> csr_array:
    """Kernels K_t(a), `(T, A)`: the probability of each grid orientation a, given the orientation of record t.

    K_t(a) falls with the angle between both orientations.

    Args:
        poses: pose matrix of each record, from the camera frame to the world, `(T, 4, 4)`.
        orientations: rotations from the world to the camera, `(A, 3, 3)`.
        solid_angle: relative solid angle of each orientation's cell, `(A,)`.
        width: bandwidth g in direction, radians.
    """
    nodes = Rotation.from_matrix(np.swapaxes(orientations, 1, 2)).as_quat()
    recorded = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = max(CHUNK // len(nodes), 1)
    parts = []
    for start in range(0, len(recorded), rows):
        # cos theta = 2 (q . q')^2 - 1 for the unit quaternions q and q'.
        cosine = 2.0 * np.einsum("ti,ai->ta", recorded[start : start + rows], nodes) ** 2 - 1.0
        behind = np.exp((cosine - cosine.max(axis=1, keepdims=True)) / width**2)
        kernel = np.where(behind >= CUT, solid_angle * behind, 0.0)
        parts.append(csr_array(kernel / kernel.sum(axis=1, keepdims=True)))
        stored = sum(part.nnz for part in parts) / len(parts) * math.ceil(len(recorded) / rows)
        made = f"{len(recorded)} records spread over {len(nodes)} orientations, which"
        check_memory(ENTRY_BYTES * stored, made, "divisions")
    return csr_array(vstack(parts))


class _Kernels:
    """Estimator of w_a(p), the probability of orientation a at position p, with kernels around the records.

    Args:
        positions: position x_t of each record, `(T, 3)`, metres.
        seconds: duration tau_t of each record, `(T,)`.
        spread: kernels K_t(a), see `_spread`, `(T, A)`.
        everywhere: mean PDF of the recording, for positions beyond all kernels, `(A,)`.
        bandwidth: bandwidth h in position, metres.
    """

    def __init__(
        self, positions: FloatArray, seconds: FloatArray, spread: csr_array, everywhere: FloatArray, bandwidth: float
    ) -> None:
        self._records, self._seconds, self._spread = cKDTree(positions), seconds, spread
        self._everywhere, self._bandwidth = everywhere, bandwidth

    def probabilities(self, positions: FloatArray) -> FloatArray:
        """Probability w_a(p) of each orientation a at each position p, `(Q, A)`.

        `positions` has the Q positions p, `(Q, 3)`, metres.
        """
        rows = max(CHUNK // self._records.n, 1)
        parts = [self._near(positions[start : start + rows]) for start in range(0, len(positions), rows)]
        found = np.concatenate(parts)
        total = found.sum(axis=1, keepdims=True)
        return np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), self._everywhere)

    def _near(self, positions: FloatArray) -> FloatArray:
        """Unnormalised probability of each orientation a at each position p, `(Q, A)`.

        This is sum_t tau_t G(p - x_t) K_t(a), with the Gaussian kernel G in position. `positions` has the Q positions
        p, `(Q, 3)`, metres.
        """
        pairs = cKDTree(positions).sparse_distance_matrix(
            self._records, CUT_AT * self._bandwidth, output_type="ndarray"
        )
        weight = self._seconds[pairs["j"]] * np.exp(-((pairs["v"] / self._bandwidth) ** 2) / 2.0)
        shape = len(positions), self._records.n
        near = csr_array((weight, (pairs["i"], pairs["j"])), shape=shape)
        near.sort_indices()  # so that sums are in order of time
        return np.asarray((near @ self._spread).toarray())


@dataclass(frozen=True)
class Records:
    """R recorded poses, each valid until the next pose.

    Args:
        poses: pose matrix of each record, from the camera frame to the world, `(R, 4, 4)`.
        seconds: duration of each pose, seconds, `(R,)`.
        block: index of each pose's block of time, `(R,)`.
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
    """Recording of camera poses, and settings for what is derived from it: positions, orientation PDF and validation.

    Args:
        trajectory: trajectory of the camera in the room.
        spacing: edge length, metres, of the cells into which space is divided: one number or one per axis. Each visited
            cell gives one position.
        bandwidth: bandwidth in position, metres, of the kernel that smooths the orientation PDF.
        direction_bandwidth: bandwidth of this kernel in direction, degrees.
        divisions: the step of the orientation grid is 180 degrees / divisions.
        held_out: a number n of at least 2: every n-th block is held out for validation. None to hold out none.
        block: length of a block of time, seconds.
        path: file of the recording, for messages.
        note: sentence about an ambiguity in the file; empty if nothing is ambiguous.

    Raises:
        InputError: a value is out of range, or the recording is too short to hold out a block.
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
                f"held_out = {self.held_out}: no pose of {self.path} is held out, as the first block to be held out "
                f"begins after {(self.held_out - 1) * self.block:g} s.",
                "held_out",
            )

    @cached_property
    def records(self) -> Records:
        """All records of the trajectory; the last pose is not a record, but marks the end of the last record."""
        time = self.trajectory.time
        block = np.floor((time[:-1] - time[0]) / self.block).astype(np.int64)
        return Records(self.trajectory.poses[:-1], np.diff(time), block)

    @cached_property
    def _is_kept_back(self) -> BoolArray:
        every = self.held_out or math.inf
        return np.asarray(self.records.block % every == every - 1)

    @property
    def training(self) -> Records:
        """Records used for the optimisation of a deployment."""
        return self.records[~self._is_kept_back]

    @property
    def kept_back(self) -> Records:
        """Records that are held out."""
        return self.records[self._is_kept_back]

    def visited(self, room: Space) -> RecordedRoom:
        """Room whose camera positions are those of the recording, without the blocks that are held out.

        Raises:
            InputError: a pose, held out or not, is outside the room or in an obstacle, or the spacing is out of range.
        """
        check_file_inside(self.path, self.trajectory, room)
        training = self.training
        return RecordedRoom(room, training.poses[:, :3, 3], training.seconds, self.spacing)

    @cached_property
    def pdf(self) -> OrientationPdf:
        """Position-dependent orientation PDF, estimated from the blocks that are not held out.

        Raises:
            InputError: the records and orientations do not fit into memory.
        """
        training, width = self.training, math.radians(self.direction_bandwidth)
        return pdf_by_position(training.poses, training.seconds, self.bandwidth, width, self.divisions)
