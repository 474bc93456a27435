"""Views that are worked on together: those of one position with some orientations of a word of bits.

Number j of view v lies at `rows[j * BITS + v]`, so that loops over views vectorise. The source is one for a camera and
for a rig, and is compiled for each. A camera looks from one point with all orientations, so a landmark has one set of
moments for all views of a position. A camera of a rig is elsewhere for each orientation: the moments are found for each
pair of a landmark and a view, in a loop over listed pairs that vectorises (`pairs`); for a single camera that would be
up to 64 times as often.
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

# Rows of `CameraViews.weights`.
GOES, COMES = 0, 1  # of a landmark that disappears, and of one that appears

# Rows of `CameraViews.moments`.
LEFT, TRIED = 0, 1  # of the landmark that moves, at its old place and at the place tried


class CameraViews(NamedTuple):
    """Views of a single camera."""

    lists: WordArray
    """`(4, BITS)`: `ORIENTATION`, `NUMBER`, `WHOSE`, `TAKEN`."""
    rows: FloatArray
    """`(WIDTH BITS,)` sums of the views."""
    met: np.ndarray
    """`(BITS,)` uint8, 1 for a view that has the precision."""
    weights: FloatArray
    """`(2, BITS)` pixel density of landmarks in each view, 0 where they are not seen: `GOES`, `COMES`."""
    moments: FloatArray
    """`(2, P, WIDTH)` moments of the landmark that moves, from each position: `LEFT`, `TRIED`."""
    found: np.ndarray
    """`(P,)` uint8, 1 where `moments` are those of the move tried last."""
    other: FloatArray
    """`(WIDTH,)` moments of another landmark."""


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


def camera_views(size: int) -> CameraViews:
    """Working memory for a single camera at `size` positions."""
    lists, met, found = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8), np.zeros(size, np.uint8)
    rows, weights, moments = np.zeros(WIDTH * BITS), np.zeros((2, BITS)), np.zeros((2, size, WIDTH))
    return CameraViews(lists, rows, met, weights, moments, found, np.zeros(WIDTH))


def body_views() -> BodyViews:
    """Working memory for a rig."""
    lists, met = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8)
    return BodyViews(lists, np.zeros(MIRRORED_WIDTH * BITS), met, np.zeros(WORK * BITS))


@dispatched
def is_met(views: Any, precision: Precision, v: Integer, several: Any) -> Any:
    """True if view v has the precision; `several` if it shows two landmarks or more."""


@is_met.register(CameraViews)
def _camera_is_met(views: CameraViews, precision: Precision, v: Integer, several: Any) -> Any:
    return meets(precision, views.rows, v, VIEW) & (several | has_one_pose(precision.residual, views.rows, v, VIEW))


@is_met.register(BodyViews)
def _body_is_met(views: BodyViews, precision: Precision, v: Integer, several: Any) -> Any:
    rows = views.rows
    return body_meets(precision, rows, v, VIEW) & (several | body_has_one_pose(precision.residual, rows, v, VIEW))


@inlined
def whole(count: Integer) -> np.uint64:
    """`count` rounded up to whole groups: LLVM would add a loop for the rest that does not vectorise."""
    return (count + GROUP - ONE) & ~(GROUP - ONE)


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


@inlined
def weigh(
    which: int, seen: np.uint64, x: float, y: float, z: float, sight: Any, axes: FloatArray, w: Integer,
    views: CameraViews, count: Integer,
) -> None:  # fmt: skip
    """Find in row `which` of `weights` the pixel density of a landmark in the views of word w in which it is `seen`."""
    bits, weights = views.lists[ORIENTATION], views.weights[which]
    for v in range(count):
        bit = bits[v]
        weights[v] = pixel_density(sight, x, y, z, axes, w * VIEW + bit) if seen >> bit & ONE else 0.0
    for v in range(count, whole(count)):
        weights[v] = 0.0


@inner
def add_moments(rows: FloatArray, moments: FloatArray, weights: FloatArray, sign: float, count: Integer) -> None:
    """Add a landmark with `moments` `(WIDTH,)` to the rows of a camera's views, times `sign`."""
    for j in range(np.uint64(len(moments))):
        moment = moments[j]
        for v in range(whole(count)):
            rows[j * VIEW + v] += sign * share_of(moment, weights[v])


@inner
def replace_moments(rows: FloatArray, goes: FloatArray, comes: FloatArray, weights: FloatArray, count: Integer) -> None:
    """Subtract from the rows of a camera's views a landmark with the moments `goes`, and add one with `comes`."""
    for j in range(np.uint64(len(goes))):
        old, new = goes[j], comes[j]
        for v in range(whole(count)):
            number = rows[j * VIEW + v] - share_of(old, weights[GOES, v])
            rows[j * VIEW + v] = number + share_of(new, weights[COMES, v])


@inlined
def take_rows(left: np.uint64, first: Integer, sums: FloatArray, views: CameraViews) -> np.uint64:
    """Take the orientations `left` of a word with their rows of `sums`, of which the first is `first`.

    Returns:
        number of the views.
    """
    bits, count = views.lists[ORIENTATION], ZERO
    while left:
        bits[count] = lowest(left)
        prefetch(sums, (first + bits[count]) * np.uint64(WIDTH))
        left &= left - ONE
        count += ONE
    return count


@inlined
def read_rows(first: Integer, sums: FloatArray, views: CameraViews, count: Integer) -> None:
    """Read the rows of `sums` that `take_rows` has prefetched."""
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(np.uint64(WIDTH)):
            rows[j * VIEW + v] = sums[first + bits[v], j]


@inner
def add_to_sums(
    moments: FloatArray, seen: np.uint64, x: float, y: float, z: float, sight: Any, axes: FloatArray, w: Integer,
    sign: float, first: Integer, sums: FloatArray,
) -> None:  # fmt: skip
    """Add a landmark with `moments` `(WIDTH,)` to the rows of `sums` of the views of word w in which it is `seen`."""
    while seen:
        bit = lowest(seen)
        seen &= seen - ONE
        weight = pixel_density(sight, x, y, z, axes, w * VIEW + bit)
        for j in range(np.uint64(sums.shape[1])):
            sums[first + bit, j] += sign * share_of(moments[j], weight)
