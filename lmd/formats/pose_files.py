"""Files of poses: tables, and two formats without times, KITTI's matrices and COLMAP's images."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, real
from lmd.core.tables import COMMENT, Table, is_number, radians, seconds
from lmd.formats.columns import EULER, OWN_ANGLES, POSES, POSITION, QUATERNION, TIME, Lines, Named, named
from lmd.formats.registry import read
from lmd.formats.trees import File
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import are_rotations, camera_pose, inverse, nearest_rotations, pose_of, poses_from_rows
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
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Line of a COLMAP image: IMAGE_ID, quaternion with w first, translation, CAMERA_ID, NAME. A line of 2-D points has
# only numbers.
_IMAGE = re.compile(rf"\s*(\d+)((?:\s+{_NUMBER}){{7}})\s+(\d+)\s+(?!{_NUMBER}(?:\s|$))(\S(?:.*\S)?)\s*")


@dataclass(frozen=True)
class Rows:
    """Rows of a pose file.

    Args:
        path: the file, for messages.
        lines: line of each row in the file, from 1.
        time: times, seconds, `(T,)`; increasing after `read_rows`.
        poses: poses of the recorded body, in the frame of the recording, `(T, 4, 4)`.
        frame: frame of the orientations, `optical` or `body`; None if the file does not define it.
        angles: True if orientations are given by angles of a camera; with a mount, they are the angles of the body's x
            axis.
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
        """Rows selected by `chosen`, with a note about the omitted rows; the object itself if all rows are selected."""
        if chosen.all():
            return self
        lines = [line for line, keep in zip(self.lines, chosen, strict=True) if keep]
        note = f"{np.count_nonzero(~chosen)} of {len(chosen)} rows of {self.path} {reason}, and are left out"
        return replace(self, lines=lines, time=self.time[chosen], poses=self.poses[chosen], notes=(*self.notes, note))


def read_rows(path: str, **asked: Any) -> Rows:
    """Read poses in any known format; rows with the time of the previous row, as a coarse clock gives them, are left
    out.

    Args:
        asked: `times`, `rate`, `frame` and `columns` of `lmd.formats.trajectories.TrajectoryFile`.

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
                "column time_ms, time_us or time_ns (in a line above the values such as '# time_us x y z qx qy qz "
                "qw')."
            )
    else:
        time = time * unit
        step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 1.0
        if 0.0 < step < FASTEST:
            raise InputError(f"its times contradict the unit in their column name: poses would be {step:.2g} s apart.")
    seconds(source, time, positions)
    return time


def given_times(count: int, what: str, times: str | None, rate: float | None) -> FloatArray | None:
    """Times `(count,)`, seconds, for poses from a file without times; None if a `rate` is given, from which the caller
    derives the times.

    Args:
        what: name of the format without times, for messages.
        times: file with the time of each pose, one per line.
        rate: poses per second, instead of `times`.

    Raises:
        InputError: neither or both of `times` and `rate` are given, or the number of times is not `count`.
    """
    if (times is None) == (rate is None):
        if times is None:
            raise InputError(f"rate (poses a second) or times (a file) must be given: {what} no times.", "rate")
        raise InputError("rate must be left out if times is given.", "rate")
    if rate is not None:
        real("rate", rate, above=0.0)
        return None
    rows = Lines.of(times, File(times, "times").text, "times").rows
    if not rows or len(rows[0][1]) != 1 or not is_number(rows[0][1][0]):
        raise InputError(f"times: {times} must have one number per line, in seconds.", "times")
    time = Table.of(times, [TIME], rows).numbers([TIME])[:, 0]
    if len(time) != count:
        raise InputError(f"times: {times} has {len(time)} times for {count} poses.", "times")
    try:
        return checked_seconds(str(times), time, None, None)
    except InputError as error:
        raise InputError(f"times: {times}: {str(error).removeprefix(f'{times}: ')}", "times") from None


def steep(sines: FloatArray, path: object) -> str:
    """Question to the user if nearly all views look up or down, as happens if body poses are read as camera poses; else
    an empty text.

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
    """Rows of poses from a table with a time in each line, or from KITTI's matrices."""
    found = named(file.path, file.text, POSES, file.asked["columns"], file.argument)
    table, unit = found.table, found.time_unit
    if found.layout.name == "kitti":
        return _of_matrices(file, table)
    if name := next((name for name in ("times", "rate") if file.asked[name] is not None), ""):
        raise InputError(f"{name} must be left out: {file.path} has a time in each line.", name)
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
    """Poses from the columns of a table; the frame of their orientations; True if the orientations are given by angles;
    and a note.
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
            "counter-clockwise from x). If they are a camera's (yaw clockwise from y, pitch up), call them "
            f"{', '.join(OWN_ANGLES[: len(given)])}.",
            "frame",
        )
    angles = dict(zip(given, table.numbers(given, None).T, strict=True))
    radians("the trajectory", **angles)
    turn = roll_pitch_yaw(np.stack([angles.get(name, np.zeros(len(place))) for name in EULER], axis=1))
    taken = "are read as ROS's, of a body: x ahead, y left, z up, yaw counter-clockwise from x"
    return pose_of(turn, place), "body", False, f"{', '.join(given)} of {path} {taken}"


def _frame_of_ros(table: Table, frame: str) -> tuple[str | None, str]:
    """Frame of the orientations by ROS's `child_frame_id` (REP 103, REP 105), or None; and a note."""
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


def _of_matrices(file: File, table: Table) -> Rows:
    """Poses from matrices [R p], row by row; rotations are made orthonormal.

    Raises:
        InputError: a matrix is not a rigid motion, or the times are missing.
    """
    numbers, rate = table.numbers(list(table.texts)).reshape(-1, 3, 4), file.asked["rate"]
    turns = numbers[:, :, :3]
    if (bad := np.flatnonzero(~are_rotations(turns))).size:
        raise InputError(f"line {table.lines[bad[0]]}: the first three columns of its 3 x 4 matrix are not a rotation.")
    time = given_times(len(numbers), f"{file.path} has 12 numbers a line, as KITTI, and", file.asked["times"], rate)
    if time is None:
        time = np.arange(len(numbers)) / float(rate)
    return Rows(table.path, table.lines, time, pose_of(nearest_rotations(turns), numbers[:, :, 3]))


class Image(NamedTuple):
    """Image in COLMAP's `images.txt`."""

    number: int
    """Number of the image, COLMAP's IMAGE_ID."""
    line: int
    """Line in the file, from 1."""
    numbers: list[float]
    """Quaternion, w first, and translation: world to camera."""
    camera: str
    """COLMAP's CAMERA_ID, and the folder of the image, which together identify the camera."""
    name: str
    """Name of the image's file."""


def images_of(file: File) -> list[Image]:
    """Images in COLMAP's `images.txt`, in the order of their numbers; empty for any other file.

    Raises:
        InputError: a line is not an image.
    """
    lines = [(i, line) for i, line in enumerate(file.text.splitlines(), 1) if not line.lstrip().startswith(COMMENT)]
    first = next((i for i, (_, line) in enumerate(lines) if line.strip()), None)
    if first is None or _IMAGE.fullmatch(lines[first][1]) is None:
        return []
    images, after_image = [], False
    for line, said in lines[first:]:
        if (found := _IMAGE.fullmatch(said)) is not None:
            camera = f"{found[3]} {found[4].rpartition('/')[0]}".strip()
            images.append(Image(int(found[1]), line, [float(text) for text in found[2].split()], camera, found[4]))
        elif said.strip() and not after_image:  # the line after an image lists its points, or is empty
            raise InputError(f"line {line} is not an image of COLMAP: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME.")
        after_image = found is not None
    return sorted(images)


def of_images(file: File) -> Rows:
    """Poses of COLMAP's images, camera to world, in the order of their numbers.

    With a rate, the time of an image follows from its number, so that an image that was not registered leaves a gap.

    Raises:
        InputError: the times are missing, or numbers and names have different orders.
    """
    images, rate = images_of(file), file.asked["rate"]
    for one, other in pairwise(images):
        if one.number == other.number:
            raise InputError(f"line {other.line}: the image {other.number} occurs twice.")
        if one.camera != other.camera:
            told = f"{one.camera} and {other.camera} (CAMERA_ID and folder)"
            raise InputError(f"its images are of several cameras, {told}: keep the images of one camera.")
        if _in_words(one.name) > _in_words(other.name):
            raise InputError(
                f"the order of its images is not clear: {one.name} has the number {one.number}, and {other.name} "
                f"has {other.number}. Renumber them in the order in which they were taken."
            )
    lines = [image.line for image in images]
    world_to_camera = poses_from_rows(np.array([image.numbers for image in images])[:, [4, 5, 6, 1, 2, 3, 0]], lines)
    time = given_times(len(images), f"{file.path} has images of COLMAP, and", file.asked["times"], rate)
    by = "by their times" if time is not None else f"at {rate:g} image numbers per second"
    if time is None:
        numbers = np.array([float(image.number) for image in images])
        time = (numbers - numbers[0]) / float(rate)
    note = (
        f"{file.path} has the poses of {len(images)} images of COLMAP, world to camera, which are inverted, in the "
        f"order of their numbers, from {images[0].name} to {images[-1].name}, {by}"
    )
    return Rows(str(file.path), lines, time, inverse(world_to_camera), "optical", notes=(note,))


def _in_words(name: str) -> list[tuple[int, str]]:
    """Sort key for names with numbers, by which img9 comes before img10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name)]
