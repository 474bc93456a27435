"""Views that are worked on together: those of one position with some orientations of a word of bits.

The source is one for a camera and for a rig, and is compiled for each. A camera looks from one point with all
orientations, so a landmark has one set of moments for all views of a position, and is added to a row of numbers for
each view. A camera of a rig is elsewhere for each orientation: the moments are found for each pair of a landmark and a
view, in a loop over listed pairs (`pairs`) that vectorises; for a single camera that would be up to 64 times as often.
So `rows` has the numbers of one view side by side for a camera, and `BITS` apart for a rig: `start_of`, `step_of`.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, Integer, WordArray, add_digit, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.core.dispatch import dispatched
from lmd.geometry.squares import upright_sides
from lmd.objectives.localisation.ambiguity import (
    MIRRORED,
    MIRRORED_WIDTH,
    asks_apart,
    body_has_one_pose,
    camera_residual,
    has_one_pose,
)
from lmd.objectives.localisation.body import BODY_NUMBERS, body_meets
from lmd.objectives.localisation.information import NUMBERS, WIDTH, Precision, half_of, meets, moments, share_of
from lmd.scene.criteria import pixel_density

GROUP = np.uint64(8)
VIEW = np.uint64(BITS)
WORK = 13 + BODY_NUMBERS + MIRRORED  # numbers of a pair, see `pairs.AT`

# Rows of `lists`.
ORIENTATION = 0  # orientation of each view in its word
NUMBER = 1  # view of each orientation
WHOSE = 2  # view of each pair; of a rig
TAKEN = 3  # two numbers: the orientations that are views, as bits, and the number of listed pairs

# Rows of `CameraViews.moments`.
LEFT, TRIED, OTHER = 0, 1, 2  # of the landmark that moves at both places, and of another one


class CameraViews(NamedTuple):
    """Views of a single camera."""

    lists: WordArray
    """`(4, BITS)`: `ORIENTATION`, `NUMBER`, `WHOSE`, `TAKEN`."""
    rows: FloatArray
    """`(WIDTH BITS,)` sums of the views."""
    met: np.ndarray
    """`(BITS,)` uint8, 1 for a view that has the precision."""
    moments: FloatArray
    """`(3, WIDTH)` moments of landmarks at the position: `LEFT`, `TRIED`, `OTHER`."""


class BodyViews(NamedTuple):
    """Views of a rig, with orientations of its body."""

    lists: WordArray
    """As in `CameraViews`."""
    rows: FloatArray
    """`(MIRRORED_WIDTH BITS,)` sums of the views."""
    met: np.ndarray
    """As in `CameraViews`."""
    work: FloatArray
    """`(WORK BITS,)` numbers of listed pairs of a landmark and a view, see `pairs.AT`."""


Views: TypeAlias = CameraViews | BodyViews


def camera_views() -> CameraViews:
    """Working memory for a single camera."""
    lists, met = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8)
    return CameraViews(lists, np.zeros(WIDTH * BITS), met, np.zeros((3, WIDTH)))


def body_views() -> BodyViews:
    """Working memory for a rig."""
    lists, met = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8)
    return BodyViews(lists, np.zeros(MIRRORED_WIDTH * BITS), met, np.zeros(WORK * BITS))


@dispatched
def numbers_of(views: Any, precision: Precision) -> Any:
    """Count of the numbers of a view that `precision` needs."""


@numbers_of.register(CameraViews)
def _camera_numbers(views: CameraViews, precision: Precision) -> np.uint64:
    return np.uint64(views.moments.shape[1])  # unknown to the compiler, which would unroll loops and not vectorise them


@numbers_of.register(BodyViews)
def _body_numbers(views: BodyViews, precision: Precision) -> np.uint64:
    return np.uint64(BODY_NUMBERS + MIRRORED if asks_apart(precision) else BODY_NUMBERS)


@dispatched
def start_of(views: Any, v: Integer) -> Any:
    """Index in `rows` of the first number of view v."""


@start_of.register(CameraViews)
def _camera_start(views: CameraViews, v: Integer) -> Any:
    return v * np.uint64(WIDTH)


@start_of.register(BodyViews)
def _body_start(views: BodyViews, v: Integer) -> Any:
    return v


@dispatched
def step_of(views: Any) -> Any:
    """Distance in `rows` of two numbers of a view."""


@step_of.register(CameraViews)
def _camera_step(views: CameraViews) -> np.uint64:
    return ONE


@step_of.register(BodyViews)
def _body_step(views: BodyViews) -> np.uint64:
    return VIEW


@dispatched
def is_met(views: Any, precision: Precision, v: Integer, several: Any) -> Any:
    """True if view v has the precision; `several` if it shows two landmarks or more."""


@is_met.register(CameraViews)
def _camera_is_met(views: CameraViews, precision: Precision, v: Integer, several: Any) -> Any:
    rows, start = views.rows, v * np.uint64(WIDTH)
    return meets(precision, rows, start, ONE) & (several | has_one_pose(precision.residual, rows, start, ONE))


@is_met.register(BodyViews)
def _body_is_met(views: BodyViews, precision: Precision, v: Integer, several: Any) -> Any:
    rows = views.rows
    return body_meets(precision, rows, v, VIEW) & (several | body_has_one_pose(precision.residual, rows, v, VIEW))


@inlined
def whole(count: Integer) -> np.uint64:
    """`count` rounded up to whole groups: LLVM would add a loop for the rest that does not vectorise."""
    return (count + GROUP - ONE) & ~(GROUP - ONE)


@inner
def fill_views(left: np.uint64, precision: Precision, views: Views) -> np.uint64:
    """Take the orientations `left` of a word, with sums of zero; returns their number."""
    bits, number, rows, count = views.lists[ORIENTATION], views.lists[NUMBER], views.rows, ZERO
    views.lists[TAKEN, 0], views.lists[TAKEN, 1] = left, ZERO
    while left:
        bit = lowest(left)
        bits[count], number[bit] = bit, count
        left &= left - ONE
        count += ONE
    for v in range(whole(count)):
        for j in range(numbers_of(views, precision)):
            rows[start_of(views, v) + j * step_of(views)] = 0.0
    return count


@inner
def fetch_sums(sums: FloatArray, first: Integer, views: Views, count: Integer) -> None:
    """Prefetch the rows of `sums` `(V, width)` that `take_sums` reads."""
    width, bits = np.uint64(sums.shape[1]), views.lists[ORIENTATION]
    for v in range(count):
        at = (first + bits[v]) * width
        prefetch(sums, at)
        if width > np.uint64(WIDTH):
            prefetch(sums, at + width // np.uint64(2))


@inner
def take_sums(sums: FloatArray, first: Integer, precision: Precision, views: Views, count: Integer) -> None:
    """Add to the views their rows of `sums` `(V, width)`; the first orientation of the word has row `first`."""
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(numbers_of(views, precision)):
            rows[start_of(views, v) + j * step_of(views)] += sums[first + bits[v], j]


@inner
def give_sums(sums: FloatArray, first: Integer, precision: Precision, views: Views, count: Integer) -> None:
    """Add the views to their rows of `sums`."""
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(numbers_of(views, precision)):
            sums[first + bits[v], j] += rows[start_of(views, v) + j * step_of(views)]


@inner
def met_views(precision: Precision, views: Views, count: Integer, several: np.uint64) -> np.uint64:
    """Orientations whose view has the precision, as bits; `several` those that show two landmarks or more."""
    bits, met, good = views.lists[ORIENTATION], views.met, ZERO
    for v in range(whole(count)):
        met[v] = is_met(views, precision, v, several >> bits[v] & ONE != ZERO)
    for v in range(count):
        good |= np.uint64(met[v]) << bits[v]
    return good


@inlined
def seen_twice(was: np.uint64, now: np.uint64, digits: WordArray) -> np.uint64:
    """Orientations with which two landmarks or more are seen.

    The counts `digits` `(J,)` contain a landmark where it `was` seen; it is seen `now`.
    """
    found, change = ZERO, was ^ now
    for j in range(np.uint64(len(digits))):
        digit, change = add_digit(digits[j], change, was)
        found |= digit if j else ZERO
    return found


@inlined
def landmark_moments(
    x: float, y: float, z: float, nx: float, ny: float, nz: float, precision: Precision, k: Integer, row: FloatArray
) -> None:
    """Write the numbers of landmark k at an offset, upright with the unit normal (nx, ny, nz), to `row` `(WIDTH,)`."""
    rx, ry, rz, ux, uy, uz = upright_sides(half_of(precision, k), nx, ny, nz)
    (
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14],
    ) = moments(x, y, z, rx, ry, rz, ux, uy, uz, precision.share)  # fmt: skip
    row[NUMBERS] = camera_residual(precision.residual, x, y, z, rx, ry, rz, ux, uy, uz)


@inner
def add_to_camera(
    which: int, seen: np.uint64, x: float, y: float, z: float, sight: Any, axes: FloatArray, w: Integer, sign: float,
    views: CameraViews,
) -> None:  # fmt: skip
    """Add a landmark to the views in which it is `seen`, times `sign`.

    Args:
        which: row of its `moments`.
        seen: orientations of word w.
        x, y, z: its offset from the camera, metres.
        sight, axes: of the camera.
        w: the word.
        sign: 1 or -1.
        views: the views.
    """
    left, number, rows, moment = seen & views.lists[TAKEN, 0], views.lists[NUMBER], views.rows, views.moments[which]
    while left:
        bit = lowest(left)
        left &= left - ONE
        weight, start = pixel_density(sight, x, y, z, axes, w * VIEW + bit), number[bit] * np.uint64(WIDTH)
        for j in range(np.uint64(len(moment))):
            rows[start + j] += sign * share_of(moment[j], weight)
