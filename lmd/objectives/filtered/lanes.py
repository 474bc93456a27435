"""Filters of several drives side by side, so that each operation of a step is done for all of them at once.

Number j of lane l lies at `array[j * LANES + l]`.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.core.dispatch import overridable
from lmd.geometry.vectors import read3
from lmd.objectives.filtered.covariance import (
    NUMBERS,
    position_variance,
    predicted,
    rotation_variance,
    update_beyond_rounding,
    updated,
)

LANES = 16  # fewer would be unrolled and not vectorised
MOVES = 5  # numbers of a move, see `Drives.moves`
# First entry of each number of the lanes, unsigned: numba tests whether a signed index is negative.
(
    _1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, _17, _18, _19, _20
) = (np.uint64(LANES * j) for j in range(1, NUMBERS))  # fmt: skip


class Tolerance(NamedTuple):
    """Limits of a pose that counts as known, and the unit of the information."""

    position: float
    """Greatest trace of the covariance of the position, m^2."""
    rotation: float
    """Greatest trace of the covariance of the rotation, rad^2; infinite for no limit."""
    scale: float
    """Information of one unit of the sums: the squared focal length over the squared noise of a corner, pixels."""
    least: float | None
    """Least information of a direction that is no rounding error, in units of the sums; None where the first estimate
    is good enough that rounding does not matter."""


class Lanes(NamedTuple):
    """Working memory of the filters."""

    covariance: FloatArray
    """`(21 LANES,)` covariance of each lane."""
    information: FloatArray
    """`(21 LANES,)` information of the frame of each lane."""
    moves: FloatArray
    """`(5 LANES,)` displacement and variances of the odometry of each lane."""
    informed: np.ndarray
    """`(LANES,)` uint8, 1 if the frame of the lane has information."""
    frames: IntArray
    """`(2, LANES)` next frame of each lane and the end of its drive; equal for a lane without work."""
    dense: FloatArray
    """`(3, 6, 6)` memory of `update_beyond_rounding`."""


def lanes() -> Lanes:
    """Empty working memory."""
    return Lanes(
        np.zeros(NUMBERS * LANES), np.zeros(NUMBERS * LANES), np.zeros(MOVES * LANES), np.zeros(LANES, np.uint8),
        np.zeros((2, LANES), np.int64), np.zeros((3, 6, 6)),
    )  # fmt: skip


@inlined
def column(rows: FloatArray, lane: Integer) -> tuple[Any, ...]:
    """The 21 numbers of a lane."""
    return (
        rows[lane], rows[lane + _1], rows[lane + _2], rows[lane + _3], rows[lane + _4], rows[lane + _5],
        rows[lane + _6], rows[lane + _7], rows[lane + _8], rows[lane + _9], rows[lane + _10], rows[lane + _11],
        rows[lane + _12], rows[lane + _13], rows[lane + _14], rows[lane + _15], rows[lane + _16], rows[lane + _17],
        rows[lane + _18], rows[lane + _19], rows[lane + _20],
    )  # fmt: skip


@inlined
def _write(rows: FloatArray, lane: Integer, p: Any) -> None:
    """Write the 21 numbers of a lane."""
    (
        rows[lane], rows[lane + _1], rows[lane + _2], rows[lane + _3], rows[lane + _4], rows[lane + _5],
        rows[lane + _6], rows[lane + _7], rows[lane + _8], rows[lane + _9], rows[lane + _10], rows[lane + _11],
        rows[lane + _12], rows[lane + _13], rows[lane + _14], rows[lane + _15], rows[lane + _16], rows[lane + _17],
        rows[lane + _18], rows[lane + _19], rows[lane + _20],
    ) = p  # fmt: skip


@inner
def predict_lanes(lanes: Lanes) -> None:
    """Move each lane to its next frame."""
    rows, moves = lanes.covariance, lanes.moves
    for lane in range(np.uint64(LANES)):
        way = read3(moves, lane, _1)
        _write(rows, lane, predicted(column(rows, lane), way, moves[lane + _3], moves[lane + _4]))


@overridable
def update_lanes(least: Any, lanes: Lanes, scale: float) -> None:
    """Add the information of each lane that is `informed`; see `Tolerance`."""
    for lane in range(LANES):
        if lanes.informed[lane]:
            update_beyond_rounding(lanes.covariance, lanes.information, lane, LANES, scale, least, lanes.dense)


@update_lanes.register(type(None))
def _update_lanes_none(least: None, lanes: Lanes, scale: float) -> None:
    rows, sums, informed = lanes.covariance, lanes.information, lanes.informed
    for lane in range(np.uint64(LANES)):
        known = informed[lane] != 0
        p = column(rows, lane)
        u = updated(p, column(sums, lane), scale)
        _write(rows, lane, (
            u[0] if known else p[0], u[1] if known else p[1], u[2] if known else p[2], u[3] if known else p[3],
            u[4] if known else p[4], u[5] if known else p[5], u[6] if known else p[6], u[7] if known else p[7],
            u[8] if known else p[8], u[9] if known else p[9], u[10] if known else p[10], u[11] if known else p[11],
            u[12] if known else p[12], u[13] if known else p[13], u[14] if known else p[14],
            u[15] if known else p[15], u[16] if known else p[16], u[17] if known else p[17],
            u[18] if known else p[18], u[19] if known else p[19], u[20] if known else p[20],
        ))  # fmt: skip


@inlined
def is_known(p: Any, tolerance: Tolerance) -> Any:
    """True if a pose with the covariance `p` is known to the tolerance."""
    return (position_variance(p) <= tolerance.position) & (rotation_variance(p) <= tolerance.rotation)


@kernel
def filter_drives(
    first: IntArray, moves: FloatArray, sums: FloatArray, informed: np.ndarray, start: FloatArray,
    tolerance: Tolerance, work: Lanes, known: np.ndarray, kept: FloatArray,
) -> None:  # fmt: skip
    """Filter D drives.

    Args:
        first, moves, start: see `Drives`.
        sums: information of each frame, `(F, 21)`.
        informed: uint8, 1 for frames whose information is used, `(F,)`.
        tolerance: limits of a known pose.
        work: working memory.
        known: receives 1 for frames with a known pose, uint8, `(F,)`.
        kept: receives the covariance of each frame, `(F, 21)`.
    """
    drives = len(first) - 1
    for group in range(0, drives, LANES):
        longest = np.int64(0)
        for lane in range(LANES):
            d = min(group + lane, drives - 1)
            work.frames[0, lane], work.frames[1, lane] = first[d], first[d + 1] if group + lane < drives else first[d]
            longest = max(longest, work.frames[1, lane] - work.frames[0, lane])
            for j in range(NUMBERS):
                work.covariance[j * LANES + lane] = start[j]
        for step in range(longest):
            some = False
            for lane in range(LANES):
                f = work.frames[0, lane] + step
                there = f < work.frames[1, lane]
                work.informed[lane] = informed[f] if there else np.uint8(0)
                some |= work.informed[lane] != 0
                for j in range(MOVES):
                    work.moves[j * LANES + lane] = moves[f, j] if there else 0.0
                if there:
                    for j in range(NUMBERS):
                        work.information[j * LANES + lane] = sums[f, j]
            predict_lanes(work)
            if some:
                update_lanes(tolerance.least, work, tolerance.scale)
            for lane in range(LANES):
                f = work.frames[0, lane] + step
                if f < work.frames[1, lane]:
                    known[f] = is_known(column(work.covariance, lane), tolerance)
                    for j in range(NUMBERS):
                        kept[f, j] = work.covariance[j * LANES + lane]
