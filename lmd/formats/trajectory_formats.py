"""Formats of trajectories, in the order in which they are tried, and readers of formats without times.

Formats without times are matrices, as in KITTI, and images of COLMAP, whose poses are world to camera.
"""

import re
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import InputError
from lmd.core.tables import COMMENT, Headless, read_headless
from lmd.formats.registry import File, Format, anything, begins, read
from lmd.formats.trajectory_rows import Rows, cleaned, given_times
from lmd.formats.trajectory_tables import comment_header, headed, of_lines, of_ros, of_table, ros_lines
from lmd.geometry.se3 import are_rotations, inverse, nearest_rotations, pose_of, poses_from_rows

KITTI = tuple(f"m{row}{column}" for row in range(3) for column in range(4))  # [R p], row by row
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Line of an image: IMAGE_ID, quaternion with w first, translation, CAMERA_ID, NAME; a line of 2-D points has only
# numbers.
_IMAGE = re.compile(rf"\s*(\d+)((?:\s+{_NUMBER}){{7}})\s+(\d+)\s+(?!{_NUMBER}(?:\s|$))(\S(?:.*\S)?)\s*")
AS_TEXT = "write a line per pose, time x y z qx qy qz qw, seconds and metres, from the camera to the world"
# Refused formats: pattern in the first lines, and the reason.
UNREAD = (
    (
        r"^#\s*kapture format|^#?\s*timestamp,\s*device_id,\s*qw",
        "it is a trajectory of kapture, whose poses are world to camera, of several devices, and in data sets of "
        "different clocks: export it to COLMAP (kapture_export_colmap.py), whose images.txt is read, or " + AS_TEXT,
    ),
    (r"\A\s*(VERTEX|EDGE)_", "it is a pose graph of g2o, which has no times: " + AS_TEXT),
    (
        r"^header:\s*$",
        "it is a message that ROS prints as YAML: record it as CSV, by ros2 topic echo --csv TOPIC or rostopic echo -p "
        "TOPIC",
    ),
    (
        r"^VehicleName\s",
        "it is a recording of AirSim, in milliseconds, whose axes point north, east and down: write a table with "
        "time_ms,x,y,z,qw,qx,qy,qz from TimeStamp, POS_X, -POS_Y, -POS_Z, Q_W, Q_X, -Q_Y, -Q_Z, of a body",
    ),
    (r"\A\s*NVM_V3", "it is a model of VisualSFM: COLMAP's images.txt is read, or " + AS_TEXT),
    (r"\A\s*[{\[]", "it is JSON, and trajectories are read as text or CSV: " + AS_TEXT),
    (r"\A\s*<", "it is XML, and trajectories are read as text or CSV: " + AS_TEXT),
)


class PoseFile(File):
    """File of poses; `asked` has `times`, `rate` and `frame` of `lmd.formats.trajectories.TrajectoryFile`."""

    @cached_property
    def images(self) -> "list[Image] | None":
        """Images of COLMAP; None for another file."""
        return colmap_images(self.text)

    @cached_property
    def headless(self) -> Headless | None:
        """Values of a text whose first line begins with a number; None for another text."""
        return read_headless(self.path, name=self.argument)

    @cached_property
    def header(self) -> list[str] | None:
        """Names of the columns from a comment above the values, if there are any."""
        return None if self.headless is None else comment_header(self.headless)


def read_rows(path: str, times: str | None, rate: float | None, frame: str) -> Rows:
    """Read a trajectory in any known format.

    Args:
        times: file with the time of each pose, one per line, for a format without times (KITTI, COLMAP).
        rate: poses per second from time 0, instead of `times`.
        frame: frame of the orientations, `optical` or `body`, on which the meaning of yaw and pitch depends.

    Raises:
        InputError: the file cannot be read, or holds no trajectory; the message names the file.
    """
    try:
        return cleaned(read("trajectory", PoseFile(path, asked={"times": times, "rate": rate, "frame": frame})))
    except InputError as error:
        if error.argument is not None or str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None


class Image(NamedTuple):
    """Image of COLMAP."""

    line: int
    """Line in the file, from 1."""
    number: int
    """IMAGE_ID."""
    numbers: list[float]
    """Quaternion, w first, and translation: world to camera."""
    name: str
    """Name of the image's file."""
    camera: str
    """CAMERA_ID."""


def matrices(text: Headless, times: str | None, rate: float | None) -> Rows:
    """Poses from matrices [R p], row by row; rotations are made orthonormal.

    Raises:
        InputError: a matrix is no rigid motion, or the times are missing.
    """
    table = text.table(KITTI)
    numbers = table.numbers(KITTI).reshape(-1, 3, 4)
    time = given_times(len(numbers), f"{table.path} has 12 numbers a line, as KITTI, and", times, rate)
    if time is None:
        time = np.arange(len(numbers)) / float(rate or 1.0)
    turns = numbers[:, :, :3]
    bad = np.flatnonzero(~are_rotations(turns))
    if bad.size:
        raise InputError(f"line {table.lines[bad[0]]}: the first three columns of its 3 x 4 matrix are no rotation.")
    return Rows(table.path, table.lines, time, pose_of(nearest_rotations(turns), numbers[:, :, 3]))


def colmap_images(text: str) -> list[Image] | None:
    """Images of COLMAP's `images.txt`, in the order of the file; None for another file.

    Raises:
        InputError: a line is no image.
    """
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if not line.lstrip().startswith(COMMENT)]
    first = next((i for i, (_, line) in enumerate(lines) if line.strip()), None)
    if first is None or _IMAGE.fullmatch(lines[first][1]) is None:
        return None
    images, after_image = [], False
    for line, said in lines[first:]:
        if (found := _IMAGE.fullmatch(said)) is not None:
            images.append(
                Image(line, int(found[1]), [float(number) for number in found[2].split()], found[4], found[3])
            )
        elif said.strip() and not after_image:  # the line after an image has its points, or is empty
            raise InputError(f"line {line} is no image of COLMAP: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME.")
        after_image = found is not None
    return images


def images_in_order(path: str, images: Sequence[Image], times: str | None, rate: float | None) -> Rows:
    """Poses of COLMAP's images, camera to world, in the order of their numbers.

    With a rate, the time of an image follows from its number, so that an image that was not registered leaves a gap.

    Raises:
        InputError: the times are missing, or numbers and names have different orders.
    """
    images = sorted(images, key=lambda image: image.number)
    for one, other in pairwise(images):
        if one.number == other.number:
            raise InputError(f"line {other.line}: the image {other.number} is there twice.")
        if one.camera != other.camera:
            raise InputError(
                f"its images are of the cameras {one.camera} and {other.camera} (CAMERA_ID): leave those of one."
            )
        if _folder(one.name) != _folder(other.name):
            raise InputError(
                f"its images are of several folders, such as {one.name} and {other.name}: keep those of one camera."
            )
        if _in_words(one.name) > _in_words(other.name):
            raise InputError(
                f"the order of its images is not clear: {one.name} has the number {one.number}, and {other.name} "
                f"has {other.number}. Renumber them in the order in which they were taken."
            )
    rows = np.array([image.numbers for image in images])
    lines = [image.line for image in images]
    world_to_camera = poses_from_rows(rows[:, [4, 5, 6, 1, 2, 3, 0]], lines)
    time = given_times(len(images), f"{path} has images of COLMAP, and", times, rate)
    by = "by their times"
    if time is None:
        numbers = np.array([float(image.number) for image in images])
        time = (numbers - numbers[0]) / float(rate or 1.0)
        by = f"at {rate:g} numbers a second"
    note = (
        f"{path} has the poses of {len(images)} images of COLMAP, world to camera, which are inverted, in the order of "
        f"their numbers, from {images[0].name} to {images[-1].name}, {by}"
    )
    return Rows(path, lines, time, inverse(world_to_camera), "optical", notes=(note,))


def _folder(name: str) -> str:
    return name.rpartition("/")[0]


def _in_words(name: str) -> list[tuple[int, str]]:
    """Sort key for names with numbers: img9 before img10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name)]


def _timed(reader: Callable[[Any], Rows]) -> Callable[[PoseFile], Rows]:
    """Make a reader of a format with a time in each line, which refuses other times."""

    def read_timed(file: PoseFile) -> Rows:
        if name := next((name for name in ("times", "rate") if file.asked[name] is not None), ""):
            raise InputError(f"{name} must be left out: {file.path} has a time in each line.", name)
        return reader(file)

    return read_timed


def _is_kitti(file: PoseFile) -> bool:
    return file.headless is not None and file.header is None and file.headless.width == len(KITTI)


FORMATS = (
    *(Format("trajectory", "of another program", begins(mark), why_not=sentence) for mark, sentence in UNREAD),
    Format(
        "trajectory",
        "COLMAP",
        lambda file: file.images is not None,
        lambda file: images_in_order(str(file.path), file.images, file.asked["times"], file.asked["rate"]),
        row=(
            "COLMAP's `images.txt` | world to camera, which is inverted; in the order of the image numbers, with "
            "`times` or `rate` (numbers a second, so that an image that is missing leaves a gap)"
        ),
    ),
    Format(
        "trajectory",
        "KITTI",
        _is_kitti,
        lambda file: matrices(file.headless, file.asked["times"], file.asked["rate"]),
        row=(
            "KITTI's poses | 12 numbers, a 3 x 4 matrix by rows; `times=times.txt` has the time of each line, or "
            "`rate=10` a second"
        ),
    ),
    Format(
        "trajectory",
        "table",
        lambda file: file.headless is None,
        _timed(lambda file: of_table(headed(file.path, file.text), file.asked["frame"])),
        row=(
            "table with quaternions | a header with `time,x,y,z,qx,qy,qz,qw` in any order, or what others call them: "
            "ROS (`%time`, `field.pose.pose.position.x`, ...), NavVis, AdvantageScope\n"
            "table with ROS's angles | `time,x,y,z,roll,pitch,yaw` of a body: x ahead, y left, z up, yaw "
            "counter-clockwise from x; with `frame=body` in any order, and without `roll`\n"
            "table with a camera's angles | `time,x,y,z,yaw_from_y,pitch_up`, and `roll_left` if you like: yaw "
            "clockwise from the y axis of the room, a positive pitch looks up. `time,x,y,z,yaw,pitch` is read like it\n"
            "RTAB-Map's, with `id` | rows with a negative `id` or a stamp of 0 are landmarks and left out\n"
            "OKVIS's CSV | `timestamp, p_WS_W_x, ..., q_WS_x, ...`"
        ),
    ),
    Format(
        "trajectory",
        "ROS",
        lambda file: ros_lines(file.headless) is not None,
        _timed(lambda file: of_ros(file.headless, file.asked["frame"])),
        row="`ros2 topic echo --csv` | of `Odometry`, `PoseStamped`, `PoseWithCovarianceStamped`, `TransformStamped`",
    ),
    Format(
        "trajectory",
        "TUM",
        anything,
        _timed(lambda file: of_lines(file.headless, file.header, file.asked["frame"])),
        row=(
            "TUM's format | no header; `time tx ty tz qx qy qz qw` with spaces between, and covariances or not\n"
            "EuRoC's CSV | `#timestamp [ns],p_RS_R_x [m],...`: nanoseconds, commas, `qw` first; so, without the "
            "header, VINS's"
        ),
    ),
)
