"""Trial of a move of one landmark along drives: the filter runs again from the first frame that the move changes.

A move changes the information of the frames in which the landmark is seen at its old place or at its new place. The
move also changes the frames in which the landmark begins or ceases to hide another landmark. Each drive with changed
frames is filtered again from its first changed frame to its end; the covariances of earlier frames do not change.

The values of the frames are exact after `bound_move`, so `settle_move` has nothing to do.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ZERO, Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.geometry.vectors import pair3
from lmd.objectives.filtered.lanes import LANES, MOVES, NUMBERS, column, is_known, predict_lanes, update_lanes
from lmd.objectives.filtered.sightings import (
    PAIRS,
    add_landmark,
    begin,
    bit_of,
    covers_alone,
    hide_each_other,
    see,
    word_of,
)
from lmd.objectives.localisation.information import NUMBERS as SUMS
from lmd.scene.criteria import sized
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.obstacles import find_ends, is_clear


@inlined
def _load(lane: Integer, f: Integer, field: Any, state: Any, scratch: Any) -> Any:
    """Load the odometry and the information of frame f into a lane (one of the drives that are filtered in parallel).

    Returns:
        True if the information is used: at least n landmarks are in view.
    """
    work, changed = scratch.lanes, scratch.changed[f] != 0
    count, s = scratch.counts[f] if changed else state.counts[f], work.information
    row = scratch.sums[f] if changed else state.sums[f]
    informed = count >= field.n
    work.informed[lane] = informed
    for j in range(MOVES):
        work.moves[j * LANES + lane] = field.moves[f, j]
    if informed:
        gx, gy, gz = row[6], row[7], row[8]  # the block of v and w is -[g]x
        for j in range(6):
            s[j * LANES + lane] = row[9 + j]
            s[(15 + j) * LANES + lane] = row[j]
        s[6 * LANES + lane], s[7 * LANES + lane], s[8 * LANES + lane] = 0.0, gz, -gy
        s[9 * LANES + lane], s[10 * LANES + lane], s[11 * LANES + lane] = -gz, 0.0, gx
        s[12 * LANES + lane], s[13 * LANES + lane], s[14 * LANES + lane] = gy, -gx, 0.0
    return informed


@inlined
def _store(lane: Integer, f: Integer, field: Any, scratch: Any) -> None:
    """Store the covariance of a lane (one of the drives filtered in parallel) and the resulting value for frame f.

    The quantised value is `PROBABILITY_ONE` if the pose is known to the tolerance, else 0.
    """
    work = scratch.lanes
    for j in range(NUMBERS):
        scratch.covariances[f, j] = work.covariance[j * LANES + lane]
    scratch.units[f] = PROBABILITY_ONE if is_known(column(work.covariance, lane), field.tolerance) else 0


@inlined
def _begin_drive(lane: Integer, d: Integer, field: Any, state: Any, scratch: Any) -> None:
    """Put drive d into a lane of the filter, which filters several drives in parallel, one in each lane.

    The filter starts at the drive's first frame that the trial move changes, with the covariance of the frame before.
    If this frame is the first frame of the drive, the filter starts with the initial covariance `field.start`.
    """
    work, f = scratch.lanes, scratch.starts[d]
    work.frames[0, lane], work.frames[1, lane] = f, field.first[d + 1]
    for j in range(NUMBERS):
        known = state.covariances[f - 1, j] if f > field.first[d] else field.start[j]
        work.covariance[j * LANES + lane] = known


@inner
def _filter(field: Any, state: Any, scratch: Any) -> None:
    """Filter each drive with frames that the trial move changes, from the first changed frame to the end of the drive.

    Several drives are filtered in parallel, each in a lane; a lane at the end of its drive takes the next drive. The
    covariances and the quantised values of the frames are written to the scratch.
    """
    work, first, starts, d, drives = scratch.lanes, field.first, scratch.starts, 0, len(field.first) - 1
    frames = work.frames
    for lane in range(LANES):
        frames[0, lane] = frames[1, lane] = 0
    going = True
    while going:
        going, some = False, False
        for lane in range(LANES):
            if frames[0, lane] == frames[1, lane]:
                while d < drives and starts[d] == first[d + 1]:
                    d += 1
                if d < drives:
                    _begin_drive(lane, d, field, state, scratch)
                    d += 1
            if frames[0, lane] < frames[1, lane]:
                some |= _load(lane, frames[0, lane], field, state, scratch)
                going = True
            else:
                work.informed[lane] = 0
        if going:
            predict_lanes(work)
        if some:
            update_lanes(field.tolerance.least, work, field.tolerance.scale)
        for lane in range(LANES):
            if frames[0, lane] < frames[1, lane]:
                _store(lane, frames[0, lane], field, scratch)
                frames[0, lane] += 1


@inner
def bound_move(field: Any, k: Integer, pose: FloatArray, surface: Integer, state: Any, scratch: Any) -> None:
    """Try a move of landmark k: write the quantised values of the frames after the move into `scratch.units`.

    The value of a frame is 1 if its pose is known to the tolerance, else 0. `pose` `(6,)` is the new position (metres)
    and unit normal of the landmark.
    """
    begin(field, k, pose, surface, state, scratch)
    see(field, k, state, scratch)
    _filter(field, state, scratch)


@inner
def settle_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Do nothing: `bound_move` has already written exact values."""


@inner
def exchange_move(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Carry out the move tried last, or undo it.

    The place of landmark k, and all data that depend on it, are swapped between state and scratch (working memory).
    """
    for i in range(6):
        state.poses[i, k], scratch.pose[i] = scratch.pose[i], state.poses[i, k]
    state.surfaces[k], scratch.surface[0] = scratch.surface[0], state.surfaces[k]
    for e in range(scratch.numbers[PAIRS]):
        change = scratch.pairs[2, e]
        state.hidden[np.int64(scratch.pairs[0, e]), np.int64(scratch.pairs[1, e])] += change
        scratch.pairs[2, e] = -change
    for f in range(len(state.units)):
        was = state.covered[f, word_of(k)] & bit_of(k) != ZERO
        if was != (scratch.covered[f] != 0):
            state.covered[f, word_of(k)] ^= bit_of(k)
            scratch.covered[f] = was
        state.hidden[f, k], scratch.hidden[f] = scratch.hidden[f], state.hidden[f, k]
        if scratch.changed[f] != 0:
            state.counts[f], scratch.counts[f] = scratch.counts[f], state.counts[f]
            for j in range(SUMS):
                state.sums[f, j], scratch.sums[f, j] = scratch.sums[f, j], state.sums[f, j]
    for d in range(len(field.first) - 1):
        for f in range(scratch.starts[d], field.first[d + 1]):
            state.units[f], scratch.units[f] = scratch.units[f], state.units[f]
            for j in range(NUMBERS):
                state.covariances[f, j], scratch.covariances[f, j] = (
                    scratch.covariances[f, j], state.covariances[f, j]
                )  # fmt: skip


@kernel
def fill_state(field: Any, state: Any, scratch: Any) -> None:
    """Compute all arrays of a new state from the poses of its landmarks: coverage, information and covariances."""
    poses, clear, ends = state.poses, is_clear(field.obstacles), scratch.ends
    for k in range(poses.shape[1]):
        mine, pose = sized(field.sight, k), pair3(poses, k)
        if not clear:
            find_ends(field.obstacles, mine, pose[0], pose[1], ends, 0)
        for f in range(len(state.units)):
            if covers_alone(f, pose, mine, clear, ends, field):
                state.covered[f, word_of(k)] |= bit_of(k)
    for k in range(poses.shape[1]):
        pose = pair3(poses, k)
        for f in range(len(state.units)):
            if not state.covered[f, word_of(k)] & bit_of(k):
                continue
            if field.sight.reach >= 0.0:
                for i in range(poses.shape[1]):
                    hides, _ = hide_each_other(i, pair3(poses, i), k, pose, f, field)
                    state.hidden[f, k] += np.int16(hides and i != k)
            if state.hidden[f, k] == 0:
                add_landmark(state.sums[f], 1.0, f, k, pose, field, scratch)
                state.counts[f] += 1
    for f in range(len(state.units)):
        scratch.changed[f] = 0
    for d in range(len(field.first) - 1):
        scratch.starts[d] = field.first[d]
    _filter(field, state, scratch)
    for f in range(len(state.units)):
        state.units[f] = scratch.units[f]
        for j in range(NUMBERS):
            state.covariances[f, j] = scratch.covariances[f, j]
