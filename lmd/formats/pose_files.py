"""Files of poses: tables with a time in each row."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.core.tables import Table, is_number, radians, seconds
from lmd.formats.columns import EULER, OWN_ANGLES, POSES, POSITION, QUATERNION, TIME, Named, named
from lmd.formats.registry import read
from lmd.formats.trees import File
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import camera_pose, pose_of, pose_rows, poses_from_rows
from lmd.geometry.trajectory import check_order

NANOSECONDS = 1e16  # a larger time is in nanoseconds, as it would be 300 million years in seconds
# Times between `UNCLEAR` and `NANOSECONDS` are not seconds: milliseconds or microseconds since 1970, or nanoseconds
# since the machine started.
UNCLEAR = 1e11
FASTEST = 1e-6  # minimum time between poses, seconds; a shorter time implies a wrong unit
EPOCH = 1e8  # stamps of 0 are missing values if other stamps are later than this, seconds since 1970
# Minimum sine of the pitch of views that look up or down, and minimum share of such views for a question to the user.
STEEP, NEARLY_ALL = np.cos(np.radians(30.0)), 0.9
OWN_HEADER = (TIME, *POSITION, "yaw", "pitch")  # former header of a file with a camera's angles
ROS_BODIES = re.compile(r"/?(.*/)?(base_link|base_footprint|base|body|robot)")
ROS_OPTICAL = re.compile(r".*optical(_frame|_link)?")


@dataclass(frozen=True)
class Rows:
    """Rows of a pose file.

    Args:
        path: the file, for messages.
        lines: number of the line in the file from which each row comes, from 1.
        time: times, seconds, `(T,)`; increasing after `read_rows`.
        poses: poses of the recorded body, in the frame of the recording, `(T, 4, 4)`.
        frame: frame of the orientations, `optical` or `body`; None if the file does not define it.
        angles: True if the orientations are computed from yaw, pitch and roll of a camera. If the user states a mount,
            these angles are instead taken for those of the body's x axis.
        notes: sentences for the user on omitted rows and on assumptions, without full stops.
    """

    path: str
    lines: Sequence[int]
    time: FloatArray
    poses: FloatArray
    frame: str | None = None
    angles: bool = False
    notes: tuple[str, ...] = ()

    def kept(self, chosen: BoolArray, reason: str) -> "Rows":
        """Rows selected by the mask `chosen`, with a note that gives the `reason` why the others are omitted; the
        object itself if all rows are selected.
        """
        if chosen.all():
            return self
        lines = [line for line, keep in zip(self.lines, chosen, strict=True) if keep]
        note = f"{np.count_nonzero(~chosen)} of {len(chosen)} rows of {self.path} {reason}, and are left out"
        return replace(self, lines=lines, time=self.time[chosen], poses=self.poses[chosen], notes=(*self.notes, note))


def read_rows(path: str, **asked: Any) -> Rows:
    """Read poses in any known format.

    A row whose time equals that of the previous row, as from a coarse clock, is left out.

    Args:
        path: path of the file.
        asked: the settings `frame` (of the orientations) and `columns`, see `lmd.formats.trajectories.TrajectoryFile`.

    Raises:
        InputError: the file cannot be read, or holds no poses; the message names the file.
    """
    try:
        rows: Rows = read("trajectory", File(path, asked=asked))
        again = np.append(False, np.diff(rows.time) == 0.0)
        if again.any():
            apart = 1000.0 * np.linalg.norm(np.diff(rows.poses[:, :3, 3], axis=0), axis=1)[again[1:]].max()
            first = rows.lines[np.flatnonzero(again)[0]]
            rows = rows.kept(
                ~again, f"repeat the time of the row before, at most {apart:.3g} mm away (first in line {first})"
            )
        check_order(rows.time, rows.lines)
        return rows
    except InputError as error:
        raise error if error.argument or str(path) in str(error) else InputError(f"{path}: {error}") from None


def checked_seconds(source: str, time: FloatArray, unit: float | None, positions: FloatArray | None) -> FloatArray:
    """Convert times to seconds, after a check of their unit.

    Args:
        source: the file, for messages.
        time: times in the unit of the file, `(T,)`.
        unit: length of the time unit that the file names, seconds; None if the file names no unit.
        positions: positions at the times, metres, `(T, 3)`; None if unknown.

    Raises:
        InputError: the unit is unclear, or contradicts the unit that the file names.
    """
    latest = float(np.abs(time).max(initial=0.0))
    if unit in (None, 1.0):
        if latest > NANOSECONDS:
            return time / 1e9
        if latest > UNCLEAR:
            raise InputError(
                f"time = {latest:.15g} looks like milliseconds, microseconds or nanoseconds: give seconds, or name the "
                "column time_ms, time_us or time_ns above the values ('# time_us x y z qx qy qz qw')."
            )
    else:
        time = time * unit
        step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 1.0
        if 0.0 < step < FASTEST:
            raise InputError(f"its times contradict the unit in their column name: poses would be {step:.2g} s apart.")
    seconds(source, time, positions)
    return time


def tum_text(seconds: FloatArray, poses: FloatArray) -> str:
    """Text of a trajectory in TUM's format. Poses that have NaN, or have NaN as time, are left out.

    The poses are `(n, 4, 4)`; their times are `(n,)`, seconds.
    """
    rows = np.column_stack([seconds, pose_rows(poses)])
    lines = [f"{time:.7f} " + " ".join(f"{x:.9f}" for x in row) for time, *row in rows[np.isfinite(rows).all(axis=1)]]
    return "\n".join(["# timestamp tx ty tz qx qy qz qw", *lines, ""])


def steep(sines: FloatArray, path: object) -> str:
    """Question to the user if nearly all views look up or down; else an empty text.

    Such views are likely if the poses of a body are read as poses of a camera.

    Args:
        sines: sine of the pitch of each view, `(T,)`.
        path: the file, for the question.
    """
    up, down = (float((sign * sines > STEEP).mean()) for sign in (1.0, -1.0))
    if up + down < NEARLY_ALL:
        return ""
    way = "up" if up > down else "down"
    return f"{up + down:.0%} of the views of {path} look straight {way}, within 30 degrees: check that the camera does."


def of_table(file: File) -> Rows:
    """Read poses from a table with a time in each line.

    The attribute `asked` of the file has the settings `columns` and `frame` of `read_rows`.
    """
    found = named(file.path, file.text, POSES, file.asked["columns"], file.argument)
    table, unit = found.table, found.time_unit
    if not {TIME, *POSITION} <= found.columns.keys():
        raise _lacking(found)
    time, place = table.numbers([TIME], None)[:, 0], table.numbers(POSITION, None)
    if whole := re.fullmatch(r"(.*?)(secs?|seconds)", found.columns[TIME]):  # nanoseconds are in another column
        names = [f"{whole[1]}{name}" for name in ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")]
        rest = [table.numbers([name], None)[:, 0] for name in names if name in table]
        if rest and ((rest[0] >= 0.0) & (rest[0] < 1e9)).all():
            time, unit = time + 1e-9 * rest[0], 1.0
    poses, frame, angles, note = _oriented(found, place, file.asked["frame"])
    rows = Rows(table.path, table.lines, time, poses, frame, angles, (note,) if note else ())
    if "id" in table and all(map(is_number, table.texts["id"])):
        rows = rows.kept(table.numbers(["id"], None)[:, 0] >= 0.0, "have a negative id, as landmarks of RTAB-Map")
    stamps = np.abs(rows.time[rows.time != 0.0]) * (unit or 1.0)
    if stamps.size and stamps.min() > EPOCH:
        rows = rows.kept(rows.time != 0.0, "have the time 0 among times since 1970")
    if not rows.time.size:
        raise InputError("it has no pose: all its rows have a negative id.")
    return replace(rows, time=checked_seconds(table.path, rows.time, unit, rows.poses[:, :3, 3]))


def _oriented(found: Named, place: FloatArray, frame: str) -> tuple[FloatArray, str | None, bool, str]:
    """Poses of a table, and the meaning of their orientations.

    Args:
        found: the table, with standard names of columns.
        place: positions, metres, `(T, 3)`.
        frame: frame that the user states, `optical` or `body`.

    Returns:
        poses `(T, 4, 4)`; frame of the orientations, or None if the table does not tell it; True if orientations are
        given by angles of a camera; note for the user.
    """
    table, columns, path = found.table, found.columns, found.table.path
    if set(QUATERNION) <= columns.keys():
        about, note = _frame_of_ros(table, frame)
        return poses_from_rows(np.hstack([place, table.numbers(QUATERNION, None)]), table.lines), about, False, note
    given = [name for name in EULER if name in columns]
    own = set(OWN_ANGLES[:2]) <= columns.keys()
    if own or (tuple(columns.values()) == OWN_HEADER and frame == "optical"):
        names = [name for name in (OWN_ANGLES if own else ("yaw", "pitch")) if name in columns]
        turns = dict(zip(("yaw", "pitch", "roll"), table.numbers(names, None).T, strict=False))
        radians("the trajectory", **turns)
        return camera_pose(place, **turns), "optical", True, ""
    if not {"yaw", "pitch"} <= set(given):
        raise _lacking(found)
    order = list(columns)
    if frame != "body" and ("roll" not in given or order.index("roll") > order.index("yaw")):
        raise InputError(
            f"frame must be body if {', '.join(given)} of {path} are ROS's (x ahead, y left, z up, yaw "
            "counter-clockwise from x). If they are a camera's (yaw clockwise from y, pitch up), rename them to "
            f"{', '.join(OWN_ANGLES[: len(given)])}.",
            "frame",
        )
    angles = dict(zip(given, table.numbers(given, None).T, strict=True))
    radians("the trajectory", **angles)
    turn = roll_pitch_yaw(np.stack([angles.get(name, np.zeros(len(place))) for name in EULER], axis=1))
    taken = "are read as ROS's, of a body: x ahead, y left, z up, yaw counter-clockwise from x"
    return pose_of(turn, place), "body", False, f"{', '.join(given)} of {path} {taken}"


def _frame_of_ros(table: Table, frame: str) -> tuple[str | None, str]:
    """Frame of the orientations, `optical` or `body`, and a note for the user, from ROS's column `child_frame_id`.

    The column holds the name of a frame, such as `base_link`. The frame is None if the column is missing, holds
    different names, or holds a name that is neither an optical frame's nor a body's. `frame` is the frame that the user
    states. Source: REP 103, REP 105.

    Raises:
        InputError: the user states `body`, but the column names an optical frame.
    """
    found = {text for name in table.texts if name.lower().endswith("child_frame_id") for text in table.texts[name]}
    name = found.pop() if len(found) == 1 else ""
    if ROS_OPTICAL.fullmatch(name):
        if frame == "body":
            raise InputError(f"frame = body contradicts {table.path}, which is of the frame {name!r}.", "frame")
        return "optical", ""
    if ROS_BODIES.fullmatch(name):
        return "body", f"{table.path} has poses of the frame {name!r}, read as a body's: x ahead, y left, z up"
    return None, ""


def _lacking(found: Named) -> InputError:
    """Make an error about a table that is not a trajectory; the message names the missing columns."""
    turns = EULER if any(name in found.columns for name in EULER) and "qw" not in found.columns else QUATERNION
    missing = [name for name in (TIME, *POSITION, *turns) if name not in found.columns]
    hint = ""
    if any(name.endswith("q[0]") for name in found.table.texts):
        hint = (
            " The columns q[0] to q[3] do not name w: PX4 has w first, and axes that point north, east and down. "
            "Take time_us,x,y,z,qw,qx,qy,qz from timestamp, position[0], -position[1], -position[2], q[0], q[1], -q[2],"
            " -q[3], and frame=body."
        )
    elif {"x", "y"} <= found.columns.keys() and "z" not in found.columns:
        hint = " For a motion in the plane add z, the height, and roll = pitch = 0 beside the body's yaw, radians."
    said = ", ".join(found.columns.get(name, name) for name in found.table.texts)[:300]
    needed = "a pose has time, x, y, z and qx, qy, qz, qw (or roll, pitch, yaw)"
    return InputError(f"it lacks {', '.join(missing)}: {needed}, but its columns are {said}.{hint}")
