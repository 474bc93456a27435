"""Trajectories without times: matrices, as KITTI has them, and images of COLMAP, whose poses are world to camera."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import InputError
from lmd.core.tables import COMMENT, Headless
from lmd.formats.trajectory_rows import Rows, given_times
from lmd.geometry.se3 import are_rotations, inverse, nearest_rotations, pose_of, poses_from_rows

KITTI = tuple(f"m{row}{column}" for row in range(3) for column in range(4))  # [R p], row by row
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# IMAGE_ID, the quaternion with w first, the translation, CAMERA_ID, NAME; a line of 2-D points holds numbers only.
_IMAGE = re.compile(rf"\s*(\d+)((?:\s+{_NUMBER}){{7}})\s+(\d+)\s+(?!{_NUMBER}(?:\s|$))(\S.*?)\s*")


class Image(NamedTuple):
    """An image of COLMAP."""

    line: int
    """In the file, from 1."""
    number: int
    """IMAGE_ID."""
    numbers: list[float]
    """The quaternion, w first, and the translation: world to camera."""
    name: str
    """Of its file."""
    camera: str
    """CAMERA_ID."""


def matrices(text: Headless, times: str | None, rate: float | None) -> Rows:
    """Poses whose matrices [R p] are written row by row, with the nearest rotations.

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
    """The images of COLMAP's `images.txt`, in its order; None where it is another file.

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
        elif said.strip() and not after_image:  # the line after an image holds its points, or nothing
            raise InputError(f"line {line} is no image of COLMAP: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME.")
        after_image = found is not None
    return images


def images_in_order(path: str, images: Sequence[Image], times: str | None, rate: float | None) -> Rows:
    """Poses of COLMAP's images, camera to world, in the order of their numbers.

    At a rate an image has the time of its number, so that an image that was not registered leaves a gap.

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
                f"its images are of several folders, such as {one.name} and {other.name}: leave those of one camera."
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
    """A key that sorts names as people do: img9 before img10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name)]
