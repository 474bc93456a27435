"""Views of a rig that are worked on together: those of some orientations of one position, a word of bits at most.

What landmarks tell is found for `GROUP` of them at a time, in loops that vectorise: the numbers of a view lie `BITS`
apart, those of the views side by side.
"""

from typing import NamedTuple

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, lowest, prefetch
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import VERTICAL_TOLERANCE, upright_axes
from lmd.objectives.localisation.body import BODY_WIDTH, about_body, body_meets
from lmd.objectives.localisation.information import half_of, moments, share_of
from lmd.scene.criteria import pixel_density

GROUP = np.uint64(8)
VIEW = np.uint64(BITS)
NUMBERS = np.uint64(21)


class Slots(NamedTuple):
    """The views.

    bits: which orientations they are, `(BITS + GROUP,)`; rows: their sums, number j of view v at j BITS + v,
    `(BODY_WIDTH * BITS,)`; work: what is put in for a group, `(7 GROUP,)`.
    """

    bits: np.ndarray
    rows: np.ndarray
    work: np.ndarray


def new_slots() -> Slots:
    """Working memory."""
    return Slots(np.zeros(BITS + int(GROUP), np.uint64), np.zeros(BODY_WIDTH * BITS), np.zeros(7 * int(GROUP)))


@inner
def fill_slots(left, slots):
    """Take the orientations `left` of a word, with sums of zero; returns how many there are."""
    bits, rows, count = slots.bits, slots.rows, ZERO
    while left:
        bits[count] = lowest(left)
        left &= left - ONE
        count += ONE
    for lane in range(GROUP):  # whole groups: these count for nothing
        bits[count + lane] = bits[ZERO]
    for j in range(NUMBERS):
        for v in range(count + GROUP if count + GROUP < VIEW else VIEW):
            rows[j * VIEW + v] = 0.0
    return count


@inner
def ask_for(sums, first, slots, count):
    """Ask the cache for the rows of `sums` `(V, BODY_WIDTH)` that `take_sums` takes."""
    for v in range(count):
        at = (first + slots.bits[v]) * np.uint64(BODY_WIDTH)
        prefetch(sums, at)
        prefetch(sums, at + np.uint64(BODY_WIDTH // 2))


@inner
def take_sums(sums, first, slots, count):
    """Add to the views their rows of `sums` `(V, BODY_WIDTH)`, the first orientation of the word has row `first`."""
    bits, rows = slots.bits, slots.rows
    for v in range(count):
        for j in range(NUMBERS):
            rows[j * VIEW + v] += sums[first + bits[v], j]


@inner
def give_sums(sums, first, slots, count):
    """Add the views to their rows of `sums`."""
    bits, rows = slots.bits, slots.rows
    for v in range(count):
        for j in range(NUMBERS):
            sums[first + bits[v], j] += rows[j * VIEW + v]


@inner
def met_slots(precision, slots, count):
    """The orientations whose view is what `precision` asks for, as bits."""
    bits, rows, good = slots.bits, slots.rows, ZERO
    for start in range(ZERO, count, GROUP):
        met = np.uint32(0)
        for lane in range(GROUP):
            met |= np.uint32(body_meets(precision, rows, start + lane, VIEW)) << np.uint32(lane)
        while met:
            v = start + lowest(np.uint64(met))
            met &= met - np.uint32(1)
            good |= ONE << bits[v]
    return good


@inlined
def _put_in(part, m, w, seen, start, place, pose, gain, slots):
    """Write the offsets of landmark and camera, and the weight, of a group of views to `work`."""
    bits, work, sight, axes, offsets = slots.bits, slots.work, part.sight, part.axes[m], part.offsets[m]
    for lane in range(GROUP):
        bit = bits[start + lane]
        a = w * VIEW + bit
        ox, oy, oz = offsets[0, a], offsets[1, a], offsets[2, a]
        x, y, z = pose[0] - (place[0] + ox), pose[1] - (place[1] + oy), pose[2] - (place[2] + oz)
        work[lane], work[GROUP + lane], work[2 * GROUP + lane] = x, y, z
        work[3 * GROUP + lane], work[4 * GROUP + lane], work[5 * GROUP + lane] = ox, oy, oz
        covers = seen >> bit & ONE
        work[6 * GROUP + lane] = gain * pixel_density(sight, x, y, z, axes, a) if covers else 0.0


@inner
def add_landmark(part, m, w, seen, place, pose, k, sign, gain, precision, slots, count):
    """Add what landmark k tells mount m of a part, times `sign`, to the views in which the mount covers it.

    Args:
        part, m: see `lmd.sight.stations.Part`.
        w, seen: the word of the views, and the orientations with which the mount covers the landmark.
        place: three numbers, the body's position.
        pose: six numbers, position and normal of the landmark.
        sign: 1 or -1.
        gain: see `body.gain_of`.
        precision: has the size of the tags.
        slots, count: the views.
    """
    bits, rows, work, half = slots.bits, slots.rows, slots.work, half_of(precision, k)
    nx, ny, nz = pose[3], pose[4], pose[5]
    rx, ry, rz, ux, uy, uz = upright_axes(nx, ny, nz, VERTICAL_TOLERANCE)
    rx, ry, rz, ux, uy, uz = half * rx, half * ry, half * rz, half * ux, half * uy, half * uz
    for start in range(ZERO, count, GROUP):
        some = ZERO
        for lane in range(GROUP):
            some |= seen >> bits[start + lane]
        if some & ONE == ZERO:
            continue
        _put_in(part, m, w, seen, start, place, pose, gain, slots)
        for lane in range(GROUP):
            x, y, z, weight = work[lane], work[GROUP + lane], work[2 * GROUP + lane], work[6 * GROUP + lane]
            ox, oy, oz = work[3 * GROUP + lane], work[4 * GROUP + lane], work[5 * GROUP + lane]
            told = about_body(moments(x, y, z, rx, ry, rz, ux, uy, uz, precision.share), ox, oy, oz)
            v = start + lane
            rows[v] += sign * share_of(told[0], weight)
            rows[VIEW + v] += sign * share_of(told[1], weight)
            rows[2 * VIEW + v] += sign * share_of(told[2], weight)
            rows[3 * VIEW + v] += sign * share_of(told[3], weight)
            rows[4 * VIEW + v] += sign * share_of(told[4], weight)
            rows[5 * VIEW + v] += sign * share_of(told[5], weight)
            rows[6 * VIEW + v] += sign * share_of(told[6], weight)
            rows[7 * VIEW + v] += sign * share_of(told[7], weight)
            rows[8 * VIEW + v] += sign * share_of(told[8], weight)
            rows[9 * VIEW + v] += sign * share_of(told[9], weight)
            rows[10 * VIEW + v] += sign * share_of(told[10], weight)
            rows[11 * VIEW + v] += sign * share_of(told[11], weight)
            rows[12 * VIEW + v] += sign * share_of(told[12], weight)
            rows[13 * VIEW + v] += sign * share_of(told[13], weight)
            rows[14 * VIEW + v] += sign * share_of(told[14], weight)
            rows[15 * VIEW + v] += sign * share_of(told[15], weight)
            rows[16 * VIEW + v] += sign * share_of(told[16], weight)
            rows[17 * VIEW + v] += sign * share_of(told[17], weight)
            rows[18 * VIEW + v] += sign * share_of(told[18], weight)
            rows[19 * VIEW + v] += sign * share_of(told[19], weight)
            rows[20 * VIEW + v] += sign * share_of(told[20], weight)
