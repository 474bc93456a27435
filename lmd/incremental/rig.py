"""Moves of landmarks seen by a rig, whose cameras change their positions when the body turns.

Landmarks are counted for each orientation of the body. For each landmark, `RigState.shown` has the orientations with
which at least one camera sees the landmark.
"""

from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ZERO, Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import allocating, inner
from lmd.geometry.vectors import column3, minus3, plus3, row3
from lmd.incremental.occlusion import target_of
from lmd.incremental.rig_occlusion import find_occluded
from lmd.incremental.state import (
    ASKED,
    COVERED,
    FIRST,
    FRESH,
    HIGH,
    JUST,
    LANDMARK,
    LAST,
    LISTED,
    LOW,
    OCCLUDED,
    PAIR_COUNT,
    POSITION,
    SHORT,
    SPAN_COUNT,
    SURE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    RigScratch,
    RigState,
    X,
    Y,
    Z,
)
from lmd.incremental.trial import (
    bound_views,
    clear_views,
    exchange_sets,
    exchange_views,
    fresh_of,
    list_changing,
    see,
    shown_of,
    turned,
)
from lmd.scene.criteria import frame_of, sized
from lmd.sight.mounts import blocked_bits, bounds_from, covered_bits, split_by_certainty, table_row
from lmd.sight.obstacles import find_ends, is_clear, new_ends

ROW, LEFT_OVER = 0, 1  # rows of `GroupScratch.lists`


@shown_of.register(RigState)
def _shown_of(state: Any, k: Integer, p: Integer, w: Integer) -> Any:
    return state.shown[k, p, w]


@turned.register(RigState)
def _turned(state: Any, i: Integer, q: Integer, w: Integer, scratch: Any) -> Any:
    shown = ZERO
    for j in range(len(state.groups)):
        covered, occluded, flipped = state.groups[j][COVERED], state.groups[j][OCCLUDED], scratch.groups[j].flipped
        for m in range(covered.shape[2]):
            shown |= covered[i, q, m, w] & ~(occluded[i, q, m, w] ^ flipped[i, q, m, w])
    return state.shown[i, q, w], shown


@clear_views.register(RigScratch)
def _clear_views(scratch: Any) -> None:
    landmark, position = scratch.pairs[LANDMARK], scratch.pairs[POSITION]
    for j in range(len(scratch.groups)):
        group = scratch.groups[j]  # copied by numba
        flipped = group.flipped
        group.occluders[0] = 0
        for e in range(scratch.numbers[PAIR_COUNT]):
            i, q = landmark[e], position[e]
            for m in range(flipped.shape[2]):
                for w in range(flipped.shape[3]):
                    flipped[i, q, m, w] = ZERO


@allocating
def _find_covered(k: Integer, group: Any, positions: FloatArray, body: FloatArray, scratch: Any, rig: Any) -> None:
    """Find the orientations of the body with which each camera of a mount group covers the landmark's new place.

    Occlusion by landmarks is ignored, and only the orientations in the row `ASKED` are tested. The result is written to
    the row `COVERED` of the group, and added to the row `FRESH` of the rig. The row `OCCLUDED` of the group is cleared.

    Args:
        k: index of the landmark.
        group: a `MountGroup` (equal cameras of the rig).
        positions: indices of the positions of the body to evaluate.
        body: all positions of the body, `(3, Q)`, metres.
        scratch, rig: working memory of the mount group, and of the rig.
    """
    obstacles, asked, fresh = group.obstacles, rig.sets[ASKED], rig.sets[FRESH]
    tried_covered, tried_occluded, seen = scratch.sets[COVERED], scratch.sets[OCCLUDED], scratch.seen
    x, y, z, most, start, sure = seen[X], seen[Y], seen[Z], seen[HIGH], seen[LOW], seen[SURE]
    row, left_over, reached = scratch.lists[ROW], scratch.lists[LEFT_OVER], scratch.reached
    words, half = np.uint64(asked.shape[1]), np.uint64(group.tables.shape[1] // 2)
    target, sight = target_of(rig), sized(group.sight, k)
    place, normal = target
    clear, frame, ends = is_clear(obstacles), frame_of(sight, normal), new_ends(obstacles, 1)
    if not clear:
        find_ends(obstacles, sight, place, normal, ends, 0)
    for q in positions:
        for m in range(tried_covered.shape[1]):
            for w in range(words):
                tried_covered[q, m, w] = tried_occluded[q, m, w] = ZERO
    for c in range(len(group.centres)):
        centre, count, kept = row3(group.centres, c), ZERO, ZERO
        for i in range(np.uint64(len(positions))):
            offset = minus3(place, plus3(column3(body, positions[i]), centre))
            x[i], y[i], z[i] = offset
            reached[i], most[i], start[i], sure[i] = bounds_from(group, c, k, offset, normal)
        for i in range(np.uint64(len(positions))):
            left_over[count] = i
            count += np.uint64(reached[i])
        for i in left_over[:count]:
            row[i] = table_row(group, c, (x[i], y[i], z[i]))
        for i in left_over[:count]:
            q, some = positions[i], ZERO
            for m in range(group.mounts[c], group.mounts[c + 1]):
                for w in range(words):
                    left = group.tables[row[i], half + np.uint64(m) * words + w] & asked[q, w]
                    tried_covered[q, m, w] = left
                    some |= left
            left_over[kept] = i
            kept += np.uint64(some != ZERO)
        for i in left_over[:kept]:
            q = positions[i]
            at, offset, bounds = column3(body, q), (x[i], y[i], z[i]), (most[i], start[i], sure[i])
            for m in range(group.mounts[c], group.mounts[c + 1]):
                for w in range(words):
                    if tried_covered[q, m, w] == ZERO:
                        continue
                    tried = tried_covered[q, m, w]
                    found, left = split_by_certainty(group, m, w, tried, words, offset, bounds, row[i])
                    found |= covered_bits(group, m, w, left, k, at, target, frame)
                    if not clear:
                        found &= ~blocked_bits(group, m, w, found, k, q, ends, 0)
                    tried_covered[q, m, w] = found
                    fresh[q, w] |= found


@inner
def _join(positions: FloatArray, scratch: Any) -> None:
    """Recompute the row `FRESH` at `positions`: the orientations with which the rig sees the landmark's new place.

    The result is the union, over all cameras, of the orientations in the row `COVERED` that are not in the row
    `OCCLUDED`.
    """
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for j in range(len(scratch.groups)):
        sets = scratch.groups[j].sets
        tried_covered, tried_occluded = sets[COVERED], sets[OCCLUDED]
        for q in positions:
            for m in range(tried_covered.shape[1]):
                for w in range(np.uint64(fresh.shape[1])):
                    fresh[q, w] |= tried_covered[q, m, w] & ~tried_occluded[q, m, w]


@inner
def _see_with(groups: Any, k: Integer, positions: FloatArray, field: Any, state: Any, scratch: Any) -> None:
    """Find the orientations with which a rig sees landmark k at its new place, and write them to the row `FRESH`.

    Only the orientations in the row `ASKED` at `positions` (indices) are tested. `groups` are all mount groups (equal
    cameras) of the rig. Landmarks hide landmark k only if the search (`lmd.incremental.occlusion`) has listed them.
    """
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for group in literal_unroll(groups):
        _find_covered(k, group, positions, field.positions, scratch.groups[group.number], scratch)
        find_occluded(k, group, field, state, scratch)
    _join(scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]], scratch)


@see.register(RigState)
def _see(state: Any, k: Integer, positions: np.ndarray, field: Any, scratch: Any) -> None:
    _see_with(field.cameras.groups, k, positions, field, state, scratch)


@inner
def list_near(scratch: Any, all_of_them: bool) -> Any:
    """Write into the row `LISTED` the positions near the landmark's old place or near its new place.

    If `all_of_them` is False, a position is left out if it is not touched by the move and has no orientation in
    `ASKED`.

    Returns:
        number of the listed positions.
    """
    listed, first, last, count = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST], ZERO
    asked, touched = scratch.sets[ASKED], scratch.flags[TOUCHED]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            some = ZERO
            for w in range(np.uint64(asked.shape[1])):
                some |= asked[q, w]
            listed[count] = q
            count += np.uint64(all_of_them | (some != ZERO) | touched[q])
    return count


@bound_views.register(RigState)
def _bound_views(state: Any, k: Integer, field: Any, scratch: Any) -> Any:
    shown, asked, short, just = state.shown, scratch.sets[ASKED], state.counts.sets[SHORT], state.counts.sets[JUST]
    first, last, touched = scratch.lists[FIRST], scratch.lists[LAST], scratch.flags[TOUCHED]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            for w in range(np.uint64(0 if touched[q] else asked.shape[1])):
                mine = shown[k, q, w]
                asked[q, w] = (short[q, w] & ~mine) | (just[q, w] & mine)
    return list_near(scratch, False)


@list_changing.register(RigState)
def _list_changing(state: Any, k: Integer, scratch: Any) -> Any:
    return list_near(scratch, True)


@fresh_of.register(RigScratch)
def _fresh_of(scratch: Any, p: Integer, w: Integer) -> Any:
    return scratch.sets[FRESH, p, w]


@exchange_sets.register(RigState)
def _exchange_sets(state: Any, k: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    was, now = state.shown[k, p, w], scratch.sets[FRESH, p, w]
    state.shown[k, p, w], scratch.sets[FRESH, p, w] = now, was
    return was, now


@inner
def _exchange_group(k: Integer, positions: FloatArray, mine: Any, other: Any) -> None:
    """Swap the sets of orientations that belong to landmark k at `positions` between state and scratch.

    `mine` has the sets of a mount group (equal cameras) in the state, `other` those in the scratch.
    """
    covered, occluded, tried_covered, tried_occluded = mine[COVERED], mine[OCCLUDED], other[COVERED], other[OCCLUDED]
    for q in positions:
        for m in range(covered.shape[2]):
            for w in range(covered.shape[3]):
                covered[k, q, m, w], tried_covered[q, m, w] = tried_covered[q, m, w], covered[k, q, m, w]
                occluded[k, q, m, w], tried_occluded[q, m, w] = tried_occluded[q, m, w], occluded[k, q, m, w]


@exchange_views.register(RigState)
def _exchange_views(state: Any, k: Integer, scratch: Any) -> None:
    positions = scratch.lists[LISTED][: list_near(scratch, True)]
    for j in range(len(state.groups)):
        _exchange_group(k, positions, state.groups[j], scratch.groups[j].sets)  # copied by numba
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, q = np.uint64(scratch.pairs[LANDMARK, e]), np.uint64(scratch.pairs[POSITION, e])
        for w in range(np.uint64(state.shown.shape[2])):
            _, state.shown[i, q, w] = turned(state, i, q, w, scratch)
            for j in range(len(state.groups)):
                occluded, flipped = state.groups[j][OCCLUDED], scratch.groups[j].flipped
                for m in range(occluded.shape[2]):
                    occluded[i, q, m, w] ^= flipped[i, q, m, w]
