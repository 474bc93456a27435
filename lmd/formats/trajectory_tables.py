"""Trajectories with a time in each line: formats of TUM, EuRoC and ROS, and tables with a header."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmd.core.checks import FloatArray, InputError, radians
from lmd.core.tables import COMMENT, Headless, Table, is_number, read_table
from lmd.formats.trajectory_columns import (
    EULER,
    OWN_ANGLES,
    OWN_HEADER,
    POSITION,
    QUATERNION,
    Column,
    check_quaternion_order,
    is_header,
    known_columns,
    lacking,
    values,
)
from lmd.formats.trajectory_rows import NANOSECONDS, Rows, checked_seconds
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import ROW, camera_pose, pose_of, poses_from_rows

TUM = ("time", *ROW)
EUROC = ("time", *POSITION, "qw", "qx", "qy", "qz")
VELOCITIES = ("vx", "vy", "vz")  # columns that VINS writes after a pose in EuRoC's order
# Numbers of values after a pose of TUM's format: covariances of rotation and position, or of all six coordinates, half
# or full.
COVARIANCES = (12, 21, 36)
# Stamps of 0 are missing values if other stamps exceed this, seconds since 1970.
EPOCH = 1e8
# `ros2 topic echo --csv`: number of names of frames after the time, which has two parts, and number of values of a
# line.
ROS_LINES = {(1, 10), (1, 46), (2, 11), (2, 89)}  # PoseStamped, with covariance; TransformStamped, Odometry
ROS_BODIES = re.compile(r"/?(.*/)?(base_link|base_footprint|base|body|robot)")
ROS_OPTICAL = re.compile(r".*optical(_frame|_link)?")


def headed(path: str, text: str) -> Table:
    """Table whose first line names its columns, separated by commas or spaces."""
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(i, line) for i, line in lines if line.lstrip()[0] != COMMENT]
    if lines:
        at, first = lines[0]
        words = _words(first)
        if sum(is_number(word) for word in words) >= 3:
            raise InputError(
                f"line {at} begins with {words[0][:80]!r}, which is neither a number nor the name of a column: lines "
                "of a trajectory begin with the time in seconds."
            )
        if not any(mark in first for mark in ",;") and len(words) > 1:
            split = "\t" if "\t" in first.strip() else None
            body = [(i, [value.strip() for value in line.split(split)]) for i, line in lines[1:]]
            return Headless(str(path), [first], False, body).table([word.strip() for word in first.split(split)])
    return read_table(path, name="path")


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[,\s]+", line.strip()) if word]


def comment_header(text: Headless) -> list[str] | None:
    """Names of the columns, from the last comment with names above the values."""
    for comment in reversed(text.comments):
        names = [name.strip() for name in comment.split(",")] if "," in comment else []
        certain = text.commas and len(names) == text.width
        # In some files units are separated from the names: p_x [m].
        words = re.split(r"\s+", re.sub(r"(?<!\s)\s+([\[(])", r"\1", comment).strip())
        for found in (names, [word.strip(",") for word in words]):
            if found and found[-1] in ("...", ""):
                found = found[:-1]
            fits = len(found) == text.width
            known = {"x", *QUATERNION} <= known_columns(found).keys() or {"x", *EULER} <= known_columns(found).keys()
            if known and len(found) > text.width:
                raise InputError(
                    f"a comment names {len(found)} columns, {', '.join(found)[:200]}, and line {text.rows[0][0]} has "
                    f"{text.width} values."
                )
            if known or (fits and len(found) > 1 and (certain or is_header(found))):
                return found
    return None


def of_lines(text: Headless, header: Sequence[str] | None, frame: str) -> Rows:
    """Rows of a text whose columns are named by a comment above the values, or follow from the number of values."""
    if header is not None:
        return of_table(text.table(_named(text, header)), frame)
    check_quaternion_order(text.comments)
    names = _by_count(text)
    rows = of_table(text.table(names), frame)
    if tuple(names[: len(EUROC)]) == EUROC:
        said = f"{text.path} does not name its columns, and is read as EuRoC's: {' '.join(EUROC)}"
        rows = replace(rows, notes=(*rows.notes, said))
    return rows


def _named(text: Headless, header: Sequence[str]) -> list[str]:
    """Names of all columns of a text, the first of which have the names of a header."""
    names = [*header, *(f"column {i + 1}" for i in range(len(header), text.width))]
    if len(set(names)) < len(names):
        raise InputError(f"a comment names a column twice: {', '.join(names)[:200]}.")
    return names


def _by_count(text: Headless) -> list[str]:
    """Names of the columns of a text without a header, from the number of values."""
    first = text.rows[0][1][0]
    nanoseconds = abs(float(first)) > NANOSECONDS
    if text.commas and not nanoseconds and text.width == len(TUM):
        raise InputError(
            "it has commas and no names of its columns, so that qx or qw may be first: write a first line such as "
            "time,x,y,z,qx,qy,qz,qw."
        )
    order = EUROC if text.commas and nanoseconds else TUM
    more = text.width - len(order)
    if order == EUROC and more == len(VELOCITIES):
        return [*order, *VELOCITIES]
    if more in (0, *COVARIANCES):
        return [*order, *(f"column {len(order) + i + 1}" for i in range(more))]
    raise InputError(
        f"line {text.rows[0][0]} has {text.width} values, not 8: {' '.join(order)}. Name other columns in a line above "
        "them, such as '# time x y z roll pitch yaw' (ROS's angles of a body: x ahead, y left, z up, radians)."
    )


def of_table(table: Table, frame: str) -> Rows:
    """Rows of a table with a time in each line."""
    if not table.texts:
        raise InputError(f"{table.path} is empty; expected the columns {','.join(TUM)}.")
    columns = known_columns(list(table.texts))
    if "time" not in columns or not set(POSITION) <= columns.keys():
        raise lacking(table, columns)
    scale = columns["time"].scale if columns["time"].unit else None
    time = values(table, {"time": replace(columns["time"], unit="")}, ["time"])[:, 0]
    if (rest := _nanoseconds_beside(table, columns["time"])) is not None:
        time, scale = time + 1e-9 * rest, 1.0
    place = values(table, columns, POSITION)
    poses, about, angles, note = _oriented(table, columns, place, frame)
    known = np.ones(len(time), dtype=np.bool_)
    notes = [note] if note else []
    if "id" in table and not any(not is_number(text) for text in table.texts["id"]):
        known &= table.numbers(["id"], None)[:, 0] >= 0.0
        if not known.all():
            left_out = f"{np.count_nonzero(~known)} of {len(known)} rows of {table.path}"
            notes.append(f"{left_out} have a negative id, as landmarks of RTAB-Map, and are left out")
    stamps = np.abs(time[known & (time != 0.0)])
    if stamps.size and (stamps * (scale or 1.0)).min() > EPOCH and (unstamped := known & (time == 0.0)).any():
        known &= ~unstamped
        left_out = f"{np.count_nonzero(unstamped)} of {len(known)} rows of {table.path}"
        notes.append(f"{left_out} have the time 0 among times since 1970, and are left out")
    if not known.any():
        raise InputError("it has no pose: all its rows have a negative id.")
    rows = Rows(table.path, table.lines, time, poses, about, angles).kept(known, *notes)
    return replace(rows, time=checked_seconds(table.path, rows.time, scale, place[known]))


def _nanoseconds_beside(table: Table, time: Column) -> FloatArray | None:
    """Nanoseconds of times whose whole seconds are in another column; None without such a column."""
    found = re.fullmatch(r"(.*?)(secs?|seconds)", time.name)
    if found is None:
        return None
    for unit in ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"):
        if f"{found[1]}{unit}" in table:
            rest = table.numbers([f"{found[1]}{unit}"], None)[:, 0]
            return rest if ((rest >= 0.0) & (rest < 1e9)).all() else None
    return None


def _oriented(
    table: Table, columns: dict[str, Column], place: FloatArray, frame: str
) -> tuple[FloatArray, str | None, bool, str]:
    """Make poses from the columns; return the poses, the frame of the orientations, True for angles of a camera, and a
    note.
    """
    if set(QUATERNION) <= columns.keys():
        about, note = _frame_of_ros(table, frame)
        numbers = np.hstack([place, values(table, columns, QUATERNION)])
        return poses_from_rows(numbers, table.lines), about, False, note
    header, given = tuple(table.texts), [name for name in EULER if name in columns]
    own = set(OWN_ANGLES[:2]) <= columns.keys()
    if own or (header == OWN_HEADER and frame == "optical"):
        names = [name for name in (OWN_ANGLES if own else ("yaw", "pitch")) if name in columns]
        turns = dict(zip(("yaw", "pitch", "roll"), values(table, columns, names).T, strict=False))
        radians("the trajectory", **turns)
        return camera_pose(place, **turns), "optical", True, ""
    if not {"yaw", "pitch"} <= set(given):
        raise lacking(table, columns)
    order = list(columns)
    if frame != "body" and ("roll" not in given or order.index("roll") > order.index("yaw")):
        raise InputError(
            f"frame must be body if {', '.join(given)} of {table.path} are ROS's (x ahead, y left, z up, yaw "
            f"counter-clockwise from x). If they are a camera's (yaw clockwise from y, pitch up), call them "
            f"{', '.join(OWN_ANGLES[: len(given)])}.",
            "frame",
        )
    angles = dict(zip(given, values(table, columns, given).T, strict=True))
    radians("the trajectory", **angles)
    turn = roll_pitch_yaw(np.stack([angles.get(name, np.zeros(len(place))) for name in EULER], axis=1))
    note = (
        f"{', '.join(given)} of {table.path} are taken as ROS has them, of a body: x ahead, y left, z up, yaw "
        "counter-clockwise from x"
    )
    return pose_of(turn, place), "body", False, note


def _frame_of_ros(table: Table, frame: str) -> tuple[str | None, str]:
    """Frame that the column `child_frame_id` of ROS names by REP 103 and REP 105, if any, and a note."""
    found = {text for name in table.texts if name.lower().endswith("child_frame_id") for text in table.texts[name]}
    if len(found) != 1:
        return None, ""
    name = found.pop()
    if ROS_OPTICAL.fullmatch(name):
        if frame == "body":
            raise InputError(f"frame must be optical: the poses of {table.path} are those of {name!r}.", "frame")
        return "optical", ""
    if ROS_BODIES.fullmatch(name):
        return "body", f"poses of {table.path} are those of {name!r}, taken for a body's: x ahead, y left, z up"
    return None, ""


def ros_lines(text: Headless) -> int | None:
    """Number of names of frames in a line of `ros2 topic echo --csv`; None for another text."""
    row = text.rows[0][1]
    if not text.commas or len(row) < 4 or not (row[0].isdigit() and row[1].isdigit() and len(row[1]) < 10):
        return None
    frames = 2 if not is_number(row[3]) else 1
    return frames if not is_number(row[2]) and (frames, len(row)) in ROS_LINES else None


def of_ros(text: Headless, frame: str) -> Rows:
    """Rows that `ros2 topic echo --csv` printed: seconds, nanoseconds, names of frames, position, quaternion."""
    names = ["sec", "nanosec", *("frame_id", "child_frame_id")[: ros_lines(text)], *ROW]
    table = text.table([*names, *(f"column {i + 1}" for i in range(len(names), text.width))])
    return of_table(table, frame)
