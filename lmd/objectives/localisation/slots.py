"""Views of a rig that are worked on together: those of some orientations of one position, a word of bits at most.

What landmarks tell is found for a list of pairs of a landmark and a view at a time, in a loop that vectorises: the
numbers of a pair, and those of a view, lie `BITS` apart, those of the pairs, and of the views, side by side.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import upright
from lmd.objectives.localisation.ambiguity import asks_apart, square_of
from lmd.objectives.localisation.body import BODY_NUMBERS, about_body, body_meets
from lmd.objectives.localisation.information import half_of, moments, share_of
from lmd.objectives.localisation.rig_ambiguity import (
    MIRRORED,
    MIRRORED_WIDTH,
    has_one_pose,
    mirrored_numbers,
    numbers_of,
)
from lmd.scene.criteria import pixel_density

GROUP = np.uint64(8)
VIEW = np.uint64(BITS)
# Where the numbers of pairs begin: offset, weight, offset of the camera, sides of the tag, and what it tells.
AT = tuple(np.uint64(BITS * i) for i in range(13 + BODY_NUMBERS + MIRRORED))
TOLD = np.uint64(13)


class Mounts(NamedTuple):
    """The M cameras of a part of a rig, as far as what landmarks tell them goes: a tuple is copied for many calls.

    number: which part it is; sight, offsets, axes: as in `lmd.sight.mounts.Part`; gain: see `body.gain_of`.
    """

    number: int
    sight: Any
    offsets: np.ndarray
    axes: np.ndarray
    gain: float


# Rows of `Slots.lists`.
ORIENTATION = 0  # of each view: which orientation of the word it is
NUMBER = 1  # of each orientation: which view it is
WHOSE = 2  # of each pair: its view
TAKEN = 3  # two numbers: the orientations that are views, as bits, and how many pairs are listed


class Slots(NamedTuple):
    """The views."""

    lists: np.ndarray
    """`(4, BITS)` uint64: `ORIENTATION`, `NUMBER`, `WHOSE`, `TAKEN`."""
    rows: np.ndarray
    """`(MIRRORED_WIDTH BITS,)` their sums, number j of view v at j BITS + v."""
    work: np.ndarray
    """`(39 BITS,)` numbers of the pairs, see `AT`."""
    met: np.ndarray
    """`(BITS,)` whether a view is what is asked for."""


def new_slots() -> Slots:
    """Working memory."""
    lists, met = np.zeros((4, BITS), np.uint64), np.zeros(BITS, np.uint8)
    return Slots(lists, np.zeros(MIRRORED_WIDTH * BITS), np.zeros(len(AT) * BITS), met)


@inlined
def _whole(count):
    """So many, to whole groups: the compiler would make another loop, that does not vectorise, for what is left."""
    return (count + GROUP - ONE) & ~(GROUP - ONE)


def tags_of(precision: Any, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """Of landmarks, `(K, 3)`, the centres and from there the middles of the right and the upper edges, `(K, 9)`."""
    half = np.reshape(half_of(precision, slice(None)), (-1, 1))  # one, or each tag's
    return np.hstack([positions, *(half * side for side in upright(normals))])


@inner
def fill_slots(left, precision, slots):
    """Take the orientations `left` of a word, with sums of zero; returns how many there are."""
    bits, number, rows, count = slots.lists[ORIENTATION], slots.lists[NUMBER], slots.rows, ZERO
    slots.lists[TAKEN, 0], slots.lists[TAKEN, 1] = left, ZERO
    while left:
        bit = lowest(left)
        bits[count], number[bit] = bit, count
        left &= left - ONE
        count += ONE
    for j in range(numbers_of(precision)):
        for v in range(_whole(count)):
            rows[j * VIEW + v] = 0.0
    return count


@inner
def ask_for(sums, first, slots, count):
    """Ask the cache for the rows of `sums` `(V, width)` that `take_sums` takes."""
    width, bits = np.uint64(sums.shape[1]), slots.lists[ORIENTATION]
    for v in range(count):
        at = (first + bits[v]) * width
        prefetch(sums, at)
        prefetch(sums, at + width // np.uint64(2))


@inner
def take_sums(sums, first, precision, slots, count):
    """Add to the views their rows of `sums` `(V, width)`, the first orientation of the word has row `first`."""
    bits, rows = slots.lists[ORIENTATION], slots.rows
    for v in range(count):
        for j in range(numbers_of(precision)):
            rows[j * VIEW + v] += sums[first + bits[v], j]


@inner
def give_sums(sums, first, precision, slots, count):
    """Add the views to their rows of `sums`."""
    bits, rows = slots.lists[ORIENTATION], slots.rows
    for v in range(count):
        for j in range(numbers_of(precision)):
            sums[first + bits[v], j] += rows[j * VIEW + v]


@inner
def met_slots(precision, slots, count, several):
    """The orientations whose view is what `precision` asks for, as bits; `several` those with two landmarks or more."""
    bits, rows, met, good = slots.lists[ORIENTATION], slots.rows, slots.met, ZERO
    for v in range(_whole(count)):
        two = several >> bits[v] & ONE != ZERO
        met[v] = body_meets(precision, rows, v, VIEW) & (two | has_one_pose(precision, rows, v, VIEW))
    for v in range(count):
        good |= np.uint64(met[v]) << bits[v]
    return good


@inner
def add_landmark(mounts, m, w, seen, place, tag, sign, precision, slots):
    """List what a landmark tells one of the mounts, times `sign`, in the views in which the mount covers it.

    Args:
        mounts, m: see `Mounts`, and which.
        w, seen: the word of the views, and the orientations with which the mount covers the landmark.
        place: three numbers, the body's position.
        tag: nine numbers, see `tags_of`.
        sign: 1 or -1.
        precision: has the share of each corner.
        slots: the views.
    """
    taken = slots.lists[TAKEN]
    left, filled = seen & taken[0], taken[1]
    if left == ZERO:
        return
    number, whose, work = slots.lists[NUMBER], slots.lists[WHOSE], slots.work
    sight, axes, offsets, worth = mounts.sight, mounts.axes[m], mounts.offsets[m], sign * mounts.gain
    (px, py, pz), (lx, ly, lz, rx, ry, rz, ux, uy, uz) = place, tag
    while left:
        bit = lowest(left)
        left &= left - ONE
        a, i = w * VIEW + bit, filled
        ox, oy, oz = offsets[0, a], offsets[1, a], offsets[2, a]
        x, y, z = lx - (px + ox), ly - (py + oy), lz - (pz + oz)
        whose[i] = number[bit]
        work[i], work[AT[1] + i], work[AT[2] + i] = x, y, z
        work[AT[3] + i] = worth * pixel_density(sight, x, y, z, axes, a)
        work[AT[4] + i], work[AT[5] + i], work[AT[6] + i] = ox, oy, oz
        work[AT[7] + i], work[AT[8] + i], work[AT[9] + i] = rx, ry, rz
        work[AT[10] + i], work[AT[11] + i], work[AT[12] + i] = ux, uy, uz
        filled += ONE
        if filled == VIEW:
            taken[1] = filled
            add_up(precision, slots)
            filled = ZERO
    taken[1] = filled


@inner
def add_up(precision, slots):
    """Add what the listed pairs tell to the views."""
    rows, work, whose, taken = slots.rows, slots.work, slots.lists[WHOSE], slots.lists[TAKEN]
    share, filled = precision.share, taken[1]
    _find_told(work, share, filled)
    if asks_apart(precision):
        _find_mirrored(work, square_of(precision), filled)
    for i in range(filled):
        v = whose[i]
        for j in range(numbers_of(precision)):
            rows[j * VIEW + v] += work[(TOLD + j) * VIEW + i]
    taken[1] = ZERO


@inner
def _find_told(work, share, filled):
    """Find what so many pairs tell; of one array alone, or LLVM would not vectorise this."""
    for i in range(_whole(filled)):
        weight = work[AT[3] + i]
        told = about_body(
            moments(
                work[i], work[AT[1] + i], work[AT[2] + i], work[AT[7] + i], work[AT[8] + i], work[AT[9] + i],
                work[AT[10] + i], work[AT[11] + i], work[AT[12] + i], share,
            ),
            work[AT[4] + i], work[AT[5] + i], work[AT[6] + i],
        )  # fmt: skip
        work[AT[13] + i], work[AT[14] + i], work[AT[15] + i] = (
            share_of(told[0], weight), share_of(told[1], weight), share_of(told[2], weight),
        )  # fmt: skip
        work[AT[16] + i], work[AT[17] + i], work[AT[18] + i] = (
            share_of(told[3], weight), share_of(told[4], weight), share_of(told[5], weight),
        )  # fmt: skip
        work[AT[19] + i], work[AT[20] + i], work[AT[21] + i] = (
            share_of(told[6], weight), share_of(told[7], weight), share_of(told[8], weight),
        )  # fmt: skip
        work[AT[22] + i], work[AT[23] + i], work[AT[24] + i] = (
            share_of(told[9], weight), share_of(told[10], weight), share_of(told[11], weight),
        )  # fmt: skip
        work[AT[25] + i], work[AT[26] + i], work[AT[27] + i] = (
            share_of(told[12], weight), share_of(told[13], weight), share_of(told[14], weight),
        )  # fmt: skip
        work[AT[28] + i], work[AT[29] + i], work[AT[30] + i] = (
            share_of(told[15], weight), share_of(told[16], weight), share_of(told[17], weight),
        )  # fmt: skip
        work[AT[31] + i], work[AT[32] + i], work[AT[33] + i] = (
            share_of(told[18], weight), share_of(told[19], weight), share_of(told[20], weight),
        )  # fmt: skip


@inner
def _find_mirrored(work, square, filled):
    """Find the `mirrored_numbers` of so many pairs."""
    for i in range(_whole(filled)):
        weight = work[AT[3] + i]
        told = mirrored_numbers(
            work[i], work[AT[1] + i], work[AT[2] + i], work[AT[7] + i], work[AT[8] + i], work[AT[9] + i],
            work[AT[10] + i], work[AT[11] + i], work[AT[12] + i], square,
        )  # fmt: skip
        work[AT[34] + i], work[AT[35] + i], work[AT[36] + i], work[AT[37] + i], work[AT[38] + i] = (
            share_of(told[0], weight), share_of(told[1], weight), share_of(told[2], weight),
            share_of(told[3], weight), share_of(told[4], weight),
        )  # fmt: skip
