"""Working memory for up to 64 views: the views from one position with the 64 orientations of one word of a bit set.

The information of a view is a row of numbers. Number j of view v lies at `rows[j * BITS + v]`, so that loops over views
vectorise. Camera and rig share this source, which is compiled separately for each.

A single camera has one position for all orientations, so a landmark has one set of `information.moments` for all views
of a position. A camera of a rig has another position for each orientation. So moments are computed for each pair of a
landmark and a view (`pairs`). For a single camera, this would be up to 64 times the work.

The module also declares the functions called by `trial` that differ for camera and rig. These functions handle
landmarks that appear in views or disappear from views. For a single camera (`camera_changes`), a landmark is hidden at
a position for all orientations or for none. For a rig (`rig_changes`), occlusion depends on mount and orientation.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, Integer, WordArray, add_digit, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.core.dispatch import dispatched, dispatched_call, overridable
from lmd.geometry.squares import upright_sides
from lmd.geometry.vectors import Vector
from lmd.objectives.localisation.ambiguity import (
    MIRRORED,
    MIRRORED_WIDTH,
    body_has_one_pose,
    camera_residual,
    has_one_pose,
)
from lmd.objectives.localisation.information import (
    BODY_NUMBERS,
    NUMBERS,
    WIDTH,
    Precision,
    body_meets,
    half_of,
    meets,
    moments,
    share_of,
)
from lmd.scene.criteria import pixel_density

GROUP = np.uint64(8)
VIEW = np.uint64(BITS)
WORK = 13 + BODY_NUMBERS + MIRRORED  # numbers stored for a pair, see `pairs.AT`

# Rows of `lists`.
ORIENTATION = 0  # orientation of each view in its word
NUMBER = 1  # view of each orientation
WHOSE = 2  # view of each listed pair; rig only
TAKEN = 3  # two numbers: set of the orientations of the views, and number of listed pairs

# Rows of `CameraViews.weights`.
DISAPPEARS, APPEARS = 0, 1  # weights of a landmark that disappears, and of a landmark that appears

# Rows of `CameraViews.moments`.
LEFT, TRIED = 0, 1  # moments of the moving landmark at its old place and at the place tried


class CameraViews(NamedTuple):
    """Working memory for up to 64 views of a single camera, for one position and 64 orientations (one word)."""

    lists: WordArray
    """`(4, BITS)` indices. Row `ORIENTATION` has the orientation of each view, row `NUMBER` the view of each
    orientation, row `WHOSE` the view of each listed pair of a landmark and a view. Row `TAKEN` has two entries: the bit
    set of the orientations that have a view, and the number of listed pairs.
    """
    rows: FloatArray
    """`(WIDTH BITS,)` sums of the landmarks' information in each view: sum j of view v is entry `j * BITS + v`."""
    met: np.ndarray
    """`(BITS,)` uint8, 1 for a view within the limits of `Precision`."""
    weights: FloatArray
    """`(2, BITS)` pixel density of a landmark in each view, 0 in views without the landmark: rows `DISAPPEARS`,
    `APPEARS`.
    """
    moments: FloatArray
    """`(2, P, WIDTH)` moments (`information.moments`) of the moving landmark as seen from each position: row `LEFT` for
    its old place, row `TRIED` for the place tried.
    """
    found: np.ndarray
    """`(P,)` uint8, 1 for positions whose `moments` have been computed for the move tried last."""
    other: FloatArray
    """`(WIDTH,)` moments (`information.moments`) of a landmark other than the moving landmark."""


class BodyViews(NamedTuple):
    """Working memory for up to 64 views of a rig, for one position of the body and 64 orientations (one word)."""

    lists: WordArray
    """See `CameraViews`."""
    rows: FloatArray
    """`(MIRRORED_WIDTH BITS,)` sums of the landmarks' information in each view: sum j of view v is entry
    `j * BITS + v`.
    """
    met: np.ndarray
    """See `CameraViews`."""
    work: FloatArray
    """`(WORK BITS,)` floats: `WORK` numbers for each listed pair of a landmark and a view. Number j of pair e is entry
    `j * BITS + e`; `pairs.AT` describes the numbers.
    """


Views: TypeAlias = CameraViews | BodyViews


def camera_views(size: int) -> CameraViews:
    """New working memory for the views of a single camera, with moments for `size` positions."""
    lists, met, found = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8), np.zeros(size, np.uint8)
    rows, weights, moments = np.zeros(WIDTH * BITS), np.zeros((2, BITS)), np.zeros((2, size, WIDTH))
    return CameraViews(lists, rows, met, weights, moments, found, np.zeros(WIDTH))


def body_views() -> BodyViews:
    """New working memory for the views of a rig."""
    lists, met = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8)
    return BodyViews(lists, np.zeros(MIRRORED_WIDTH * BITS), met, np.zeros(WORK * BITS))


@dispatched
def is_met(views: Any, precision: Precision, v: Integer, several: Any) -> Any:
    """True if the variances of view v are within the limits of `precision`, and its pose is unambiguous if required.

    `several` is True if the view shows two landmarks or more.
    """


@is_met.register(CameraViews)
def _camera_is_met(views: CameraViews, precision: Precision, v: Integer, several: Any) -> Any:
    return meets(precision, views.rows, v, VIEW) & (several | has_one_pose(precision.residual, views.rows, v, VIEW))


@is_met.register(BodyViews)
def _body_is_met(views: BodyViews, precision: Precision, v: Integer, several: Any) -> Any:
    rows = views.rows
    return body_meets(precision, rows, v, VIEW) & (several | body_has_one_pose(precision.residual, rows, v, VIEW))


@inlined
def whole(count: Integer) -> np.uint64:
    """Round a number of views up to a multiple of the vector length, so that loops over views have no remainder."""
    return (count + GROUP - ONE) & ~(GROUP - ONE)


@inner
def met_views(precision: Precision, views: Views, count: Integer, several: np.uint64) -> np.uint64:
    """Bit set of the orientations of the views that are within the limits of `precision`.

    The first `count` views are tested. `several` is the bit set of the orientations with two landmarks or more in view.
    """
    bits, met, good = views.lists[ORIENTATION], views.met, ZERO
    for v in range(whole(count)):
        met[v] = is_met(views, precision, v, several >> bits[v] & ONE != ZERO)
    for v in range(count):
        good |= np.uint64(met[v]) << bits[v]
    return good


@inlined
def seen_twice(was: np.uint64, now: np.uint64, digits: WordArray) -> np.uint64:
    """Bit set of the orientations with which two landmarks or more are seen after one landmark moves.

    `digits` `(J,)` are the binary digits of the numbers of seen landmarks before the move, as bit sets. `was` and `now`
    are the orientations with which the moving landmark is seen before and after the move.
    """
    found, change = ZERO, was ^ now
    for j in range(np.uint64(len(digits))):
        digit, change = add_digit(digits[j], change, was)
        found |= digit if j else ZERO
    return found


@inlined
def landmark_moments(offset: Vector, normal: Vector, precision: Precision, k: Integer, row: FloatArray) -> None:
    """Write the `information.moments` of landmark k, and its `camera_residual`, into `row` `(WIDTH,)`.

    `offset` is the landmark's offset from the camera, metres, and `normal` its unit normal.
    """
    right, up = upright_sides(half_of(precision, k), normal)
    (
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14],
    ) = moments((offset, right, up), precision.share)  # fmt: skip
    row[NUMBERS] = camera_residual(precision.residual, (offset, right, up))


@inlined
def weigh(
    which: int, seen: np.uint64, offset: Vector, camera: Any, w: Integer, views: CameraViews, count: Integer
) -> None:
    """Write the `pixel_density` of a landmark in each of the first `count` views into row `which` of `weights`.

    The views are orientations of word w (64 orientations). `seen` is the bit set of the orientations with the landmark
    in view; the other views get 0.
    """
    bits, weights = views.lists[ORIENTATION], views.weights[which]
    for v in range(count):
        bit = bits[v]
        shown = seen >> bit & ONE
        weights[v] = pixel_density(camera.sight, offset, camera.axes, w * VIEW + bit) if shown else 0.0
    for v in range(count, whole(count)):
        weights[v] = 0.0


@inner
def add_moments(rows: FloatArray, moments: FloatArray, weights: FloatArray, sign: float, count: Integer) -> None:
    """Add the information of a landmark, times `sign`, to the information `rows` of a camera's first `count` views.

    `moments` `(WIDTH,)` is a row of `landmark_moments`, and `weights` are the landmark's `pixel_density` in each view.
    """
    for j in range(np.uint64(len(moments))):
        moment = moments[j]
        for v in range(whole(count)):
            rows[j * VIEW + v] += sign * share_of(moment, weights[v])


@inner
def replace_moments(
    rows: FloatArray, lost: FloatArray, gained: FloatArray, weights: FloatArray, count: Integer
) -> None:
    """Replace the information of one landmark by that of another in the information `rows` of a single camera's views.

    `lost` are the moments of the landmark that is subtracted, `gained` those of the landmark that is added. Rows
    `DISAPPEARS` and `APPEARS` of `weights` are the `pixel_density` of the first and of the second landmark in each
    view.
    """
    for j in range(np.uint64(len(lost))):
        old, new = lost[j], gained[j]
        for v in range(whole(count)):
            number = rows[j * VIEW + v] - share_of(old, weights[DISAPPEARS, v])
            rows[j * VIEW + v] = number + share_of(new, weights[APPEARS, v])


@inlined
def load_rows(left: np.uint64, first: Integer, sums: FloatArray, views: CameraViews) -> np.uint64:
    """Set up a view for each orientation in the bit set `left` of a word (64 orientations).

    The rows of `sums` with the information of these views are prefetched. Row `first` belongs to the first orientation
    of the word.

    Returns:
        number of views that were set up.
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
    """Copy the rows of `sums` that `load_rows` has prefetched into the first `count` views of the working memory."""
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(np.uint64(WIDTH)):
            rows[j * VIEW + v] = sums[first + bits[v], j]


@inner
def add_to_sums(
    moments: FloatArray, seen: np.uint64, offset: Vector, look: Any, w: Integer, sign: float, first: Integer,
    sums: FloatArray,
) -> None:  # fmt: skip
    """Add the information of a landmark, times `sign`, to the rows of `sums` for several views.

    The bit set `seen` has the orientations of these views, among the 64 orientations of word w. Row `first` of `sums`
    belongs to the first orientation of the word. `moments` `(WIDTH,)` are those of the landmark, and `offset` is its
    offset from the camera, metres. `look` has the camera's model of sight and the axes.
    """
    while seen:
        bit = lowest(seen)
        seen &= seen - ONE
        weight = pixel_density(look[0], offset, look[1], w * VIEW + bit)
        for j in range(np.uint64(sums.shape[1])):
            sums[first + bit, j] += sign * share_of(moments[j], weight)


@dispatched_call
def see_place(known: Any, k: Integer, n: Integer, localised: WordArray, cover: Any, trial: Any) -> Any:
    """Find the orientations with which landmark k is seen at its new place, and write them to the row `FRESH`.

    An orientation may be left out if it cannot change whether its view is localised.

    Args:
        known, trial: state and scratch (working memory) of coverage; `FRESH` is a row of `trial.sets`.
        k: index of the moving landmark.
        n: number of landmarks that must be covered.
        localised: bit sets of the localised views, `(Q, W)`: for each of Q positions, W words of 64 orientations.
        cover: incremental evaluator (field) of coverage, such as `CoverageField`.

    Returns:
        number of positions in the row `LISTED` of `trial.lists`: the positions whose values may change.
    """


@dispatched_call
def see_touched(known: Any, k: Integer, n: Integer, positions: WordArray, cover: Any, trial: Any) -> None:
    """Repeat `see_place` at the touched `positions`, from which the move changes the occlusion of a landmark."""


@dispatched_call
def see_rest(known: Any, k: Integer, cover: Any, trial: Any) -> None:
    """Find the orientations that `see_place` has left out, before the move of landmark k is carried out.

    The row `FRESH` then has all orientations with which the landmark is seen at its new place.
    """


@dispatched_call
def find_turns(known: Any, trial: Any, lost: WordArray, gained: WordArray) -> None:
    """Find the orientations with which the move makes a landmark other than the moving one disappear or appear.

    Orientations with which some camera ceases to see such a landmark are added to `lost`. Orientations with which some
    camera begins to see one are added to `gained`. `lost` and `gained` are bit sets, `(Q, W)`: for each of Q positions,
    W words of 64 orientations.
    """


@overridable
def clear_moments(views: Any, p: Integer) -> None:
    """Discard the stored `information.moments` of the moving landmark as seen from position p.

    For a rig, no moments are stored.
    """


@dispatched
def sum_views(
    known: Any, k: Integer, p: Integer, w: Integer, left: np.uint64, field: Any, state: Any, scratch: Any
) -> Any:
    """Set up a view for each orientation in the bit set `left`, and compute its information after the move.

    The views are at position p, and `left` is limited to word w (64 orientations).

    Returns:
        number of views that were set up.
    """


@dispatched
def change_sums(
    known: Any, k: Integer, p: Integer, w: Integer, changed: np.uint64, sign: float, field: Any, state: Any,
    scratch: Any,
) -> None:  # fmt: skip
    """Add the change that a move makes in the information of several views, times `sign`, to the state.

    The views are at position p. The bit set `changed` has the orientations of these views, among the 64 orientations of
    word w.
    """


@dispatched
def sum_anew(known: Any, p: Integer, w: Integer, seen: np.uint64, field: Any, state: Any, scratch: Any) -> Any:
    """Sum the information of all landmarks in a view for each orientation in the bit set `seen`.

    The views are at position p, and `seen` is limited to word w (64 orientations). The sums are also added to the
    state.

    Returns:
        number of views that were set up.
    """


@inlined
def first_row(p: Integer, w: Integer, state: Any) -> Any:
    """Index of the row of `sums` (information of the views) for position p and the first orientation of word w."""
    return (p * np.uint64(state.localised.shape[1]) + w) * VIEW
