"""Formats of trajectories, chosen by what a file holds: TUM's, EuRoC's, KITTI's, CSVs whose header names columns."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError, radians, real, seconds
from lmd.core.tables import Headless, Table, read_headless, read_table
from lmd.geometry.se3 import ROW, are_rotations, camera_pose, nearest_rotations, pose_of, poses_from_rows
from lmd.geometry.trajectory import check_order

POSITION = ("x", "y", "z")
ANGLES = ("time", *POSITION, "yaw", "pitch")
QUATERNIONS = ("time", *ROW)  # the order of TUM's trajectories
EUROC = ("time", *POSITION, "qw", "qx", "qy", "qz")
VELOCITIES = ("vx", "vy", "vz")  # which VINS writes behind a pose in EuRoC's order
KITTI = tuple(f"m{row}{column}" for row in range(3) for column in range(4))  # [R p], row by row
# Numbers after a pose of TUM's: covariances of rotation and position, or of all six, as halves or in full.
COVARIANCES = (12, 21, 36)
NANOSECONDS = 1e16  # a time beyond it counts them: seconds would be 300 million years
# The names of columns with units, prefixes and frames, as EuRoC's, TUM's and ROS's tools write them.
_UNIT = re.compile(r"[\[(].*?[\])]")
_TIME = re.compile(r"[%_]*(time(_?stamp)?s?|stamp|t)(_?n?s(ec)?)?", re.IGNORECASE)
# Between the letter and the axis EuRoC and OKVIS write their frames: of RS in R, or of WS in W.
_PLACE = re.compile(r"(?:(?:p|t|pos|(?:.*[._/])?position)[._/]?)?(?:(?:rs_r|ws_w)_)?([xyz])", re.IGNORECASE)
_TURN = re.compile(r"(?:q|quat|quaternion|(?:.*[._/])?orientation)[._/]?(?:rs_|ws_)?([wxyz])", re.IGNORECASE)


@dataclass(frozen=True)
class Rows:
    """What a file says, row by row.

    Args:
        time: seconds, increasing, `(T,)`.
        poses: of what moves, in the frame of the recording, `(T, 4, 4)`.
        angles: whether the orientations are the yaw, pitch and roll of a camera, not of a frame.
        note: what was left out, a sentence; empty if nothing.
    """

    time: FloatArray
    poses: FloatArray
    angles: bool
    note: str


def read_rows(path: str, times: str | None, rate: float | None) -> Rows:
    """Read a trajectory of any format that is known.

    Args:
        times: a file with the time of each pose, one a line, for a format that has none (KITTI).
        rate: poses a second in place of it, from time 0.

    Raises:
        InputError: the file cannot be read, or what it holds is no trajectory; the message names the file.
    """
    text = read_headless(path, name="path")
    try:
        if text is not None and text.width == len(KITTI):
            matrices = text.table(KITTI)
            return _rows(matrices, _given_times(len(matrices.lines), times, rate), _matrices(matrices))
        if times is not None or rate is not None:
            name = "rate" if times is None else "times"
            raise InputError(f"{name} must be left out: {path} has a time in each line.", name)
        table = _named(read_table(path, name="path")) if text is None else _without_header(text)
        return _with_times(table)
    except InputError as error:
        if error.argument is not None or str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None


def _canonical(name: str) -> str:
    """What a column is called here, if it is one of ours; else its own name."""
    plain = _UNIT.sub("", name).strip().lstrip("#").strip()
    if _TIME.fullmatch(plain):
        return "time"
    if (place := _PLACE.fullmatch(plain)) is not None:
        return place[1].lower()
    return "q" + turn[1].lower() if (turn := _TURN.fullmatch(plain)) is not None else plain


def _columns(names: Iterable[str]) -> list[str]:
    """What columns are called here; of several times the first is it."""
    columns: list[str] = []
    for name in names:
        column = _canonical(name)
        columns.append(name if column == "time" and column in columns else column)
    return columns


def _named(table: Table) -> Table:
    """A table with its columns by the names that they have here; those of EuRoC stand beside others."""
    names = dict(zip(table.texts, _columns(table.texts), strict=True))
    if len(set(names.values())) < len(names) or not set(QUATERNIONS) <= set(names.values()):
        return table
    return Table(table.path, table.lines, {names[column]: texts for column, texts in table.texts.items()})


def _without_header(text: Headless) -> Table:
    """The columns of a text, named by the comment above it or, without one, by how many there are."""
    for comment in text.comments:
        columns = _columns(re.split(r"[,\s]+", _UNIT.sub("", comment).strip()))
        if "time" not in columns and columns[0] not in ROW:  # whatever it is called
            columns[0] = "time"
        if len(columns) == text.width and set(QUATERNIONS) <= set(columns) and len(set(columns)) == len(columns):
            return text.table(columns)
    first = text.rows[0][1][0]
    order = EUROC if text.commas and abs(float(first)) > NANOSECONDS else QUATERNIONS
    more = text.width - len(order)
    if order == EUROC and more == len(VELOCITIES):
        return text.table([*order, *VELOCITIES])
    return text.table([*order, *(f"column {len(order) + i + 1}" for i in range(more if more in COVARIANCES else 0))])


def _with_times(table: Table) -> Rows:
    quaternions = "qw" in table
    angles = (*ANGLES, "roll") if "roll" in table else ANGLES
    # What a program writes beside a pose, such as covariances or velocities, has names of its own.
    rows = table.numbers(QUATERNIONS, None) if quaternions else table.numbers(angles)
    time = rows[:, 0]
    if np.abs(time).max() > NANOSECONDS:
        time = time / 1e9
    seconds(table.path, time, rows[:, 1:4])
    if quaternions:
        return _rows(table, time, poses_from_rows(rows[:, 1:]))
    turns = dict(zip(("yaw", "pitch", "roll"), rows[:, 4:].T, strict=False))
    radians("the trajectory", **turns)
    return _rows(table, time, camera_pose(rows[:, 1:4], **turns), angles=True)


def _matrices(table: Table) -> FloatArray:
    """Poses whose rows are written one after the other, `(T, 4, 4)`, with the nearest rotations."""
    matrices = table.numbers(KITTI).reshape(-1, 3, 4)
    turns = matrices[:, :, :3]
    bad = np.flatnonzero(~are_rotations(turns))
    if bad.size:
        raise InputError(
            f"{table.path} line {table.lines[bad[0]]}: the first three columns of its 3 x 4 matrix are no rotation."
        )
    return pose_of(nearest_rotations(turns), matrices[:, :, 3])


def _given_times(count: int, times: str | None, rate: float | None) -> FloatArray:
    """The times of `count` poses `(count,)`, seconds, which their own file does not have."""
    if (times is None) == (rate is None):
        needed = "needs one" if times is None else "takes only one"
        either = f"{needed} of times (a file) and rate (poses a second)"
        raise InputError(f"a trajectory of 12 numbers a line, as KITTI has them, {either}.")
    if rate is not None:
        return np.arange(count) / real("rate", rate, above=0.0)
    text = read_headless(times, name="times")
    if text is None or text.width != 1:
        raise InputError(f"times: {times} must have one number a line, seconds.", "times")
    time = text.table(["time"]).numbers(["time"])[:, 0]
    if len(time) != count:
        raise InputError(f"times: {times} has {len(time)} times for {count} poses.", "times")
    return time


def _rows(table: Table, time: FloatArray, poses: FloatArray, angles: bool = False) -> Rows:
    """The rows without those that have the time of the one before, as recorders write when a clock is coarse."""
    again = np.append(False, np.diff(time) == 0.0)
    note = ""
    if again.any():
        apart = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)[again[1:]].max()
        first = np.flatnonzero(again)[0]
        note = (
            f"{np.count_nonzero(again)} of {len(time)} poses of {table.path} have the time of the one before, at most "
            f"{1000.0 * apart:.3g} mm away, and are left out; the first is in line {table.lines[first]}"
        )
    lines = [line for line, repeated in zip(table.lines, again, strict=True) if not repeated]
    check_order(time[~again], lines)
    return Rows(time[~again], poses[~again], angles, note)
