"""Moves and occlusion of landmarks seen by a single camera, whose centre does not depend on the orientation.

A landmark that is hidden from a position for one orientation is hidden for all orientations. So a state has two numbers
for each landmark and position: the number of other landmarks that hide it, and the number of landmarks that it hides.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, BITS, HALF, LOWER, ONE, ZERO, Integer, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import allocating, inlined, inner
from lmd.geometry.vectors import column3, dot3, minus3
from lmd.incremental.occlusion import (
    FIRST_PLACE,
    NEW_PLACE,
    OLD_PLACE,
    is_near,
    note_neighbour,
    note_pair,
    pose_of,
    search,
    target_of,
    touch,
)
from lmd.incremental.state import (
    ASKED,
    BLOCK_COUNT,
    BLOCKS,
    FIRST,
    FRESH,
    HIDDEN,
    HIDING,
    HIGH,
    JUST,
    LANDMARK,
    LAST,
    LISTED,
    LOW,
    PAIR_COUNT,
    PLACES,
    POSITION,
    REACHED,
    SHORT,
    SPAN_COUNT,
    SURE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    UNSURE,
    VISIBLE,
    WANTED,
    Scratch,
    State,
    X,
    Y,
    Z,
)
from lmd.incremental.trial import (
    bound_views,
    clear_views,
    exchange_sets,
    exchange_views,
    find_pairs,
    fresh_of,
    list_changing,
    see,
    shown_of,
    turned,
)
from lmd.scene.criteria import covering, covers_one, frame_of, from_position, hide_between, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import CERTAIN, EMPTY_ROW, POSSIBLE, cell_of
from lmd.sight.kernels import weights_row
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, new_ends

CELL, OUTER = 0, 1  # rows of `Scratch.cell`


@shown_of.register(State)
def _shown_of(state: Any, k: Integer, p: Integer, w: Integer) -> Any:
    return state.covered[k, p, w] if state.hides[HIDDEN, k, p] == 0 else ZERO


@turned.register(State)
def _turned(state: Any, i: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    covered, hidden = state.covered[i, p, w], state.hides[HIDDEN, i, p]
    return covered if hidden == 0 else ZERO, covered if hidden + scratch.changes[HIDDEN, i, p] == 0 else ZERO


@clear_views.register(Scratch)
def _clear_views(scratch: Any) -> None:
    landmark, position, changes = scratch.pairs[LANDMARK], scratch.pairs[POSITION], scratch.changes
    first, last, reached = scratch.lists[FIRST], scratch.lists[LAST], scratch.flags[REACHED]
    hidden, hiding = scratch.hides[HIDDEN], scratch.hides[HIDING]
    for e in range(scratch.numbers[PAIR_COUNT]):
        changes[HIDDEN, landmark[e], position[e]] = changes[HIDING, landmark[e], position[e]] = 0
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = False
            hidden[p] = hiding[p] = 0


@inner
def view_place(k: Integer, field: Any, scratch: Any) -> None:
    """Compute how a single camera sees the moving landmark's new place from each nearby position.

    Other landmarks are ignored. Three arrays of the scratch are filled. `seen` gets the offset of the place and bounds
    on its depth. The flag `REACHED` tells if some orientation may cover the place. `cell` gets the index of the place's
    direction in the direction tables (`lmd.sight.directions`).
    """
    positions, sight, seen = field.positions, sized(field.cameras.sight, k), scratch.seen
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached, first, last = scratch.cell[CELL], scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    place, normal = target_of(scratch)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):  # without a branch, so that the loop vectorises
            offset = minus3(place, column3(positions, p))
            x[p], y[p], z[p] = offset
            reached[p], low[p], high[p], sure[p] = from_position(sight, offset, normal, 0.0)
            cell[p] = cell_of(offset)
    if not is_clear(field.cameras.obstacles):
        _block(k, field.cameras, scratch)


@allocating
def _block(k: Integer, camera: Any, scratch: Any) -> None:
    """Set `REACHED` to False at the positions from which an obstacle of the room hides the landmark's new place."""
    reached, first, last = scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    ends, sight = new_ends(camera.obstacles, 1), sized(camera.sight, k)
    place, normal = target_of(scratch)
    find_ends(camera.obstacles, sight, place, normal, ends, 0)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = reached[p] and not is_blocked(camera.obstacles, sight, p, ends, 0)


@bound_views.register(State)
def _bound_views(state: Any, k: Integer, field: Any, scratch: Any) -> Any:
    # All words are handled in one pass: writing sets for all positions first would take a tenth of a trial.
    sight, axes, weights = sized(field.cameras.sight, k), field.cameras.axes, field.weights
    certain, possible = field.cameras.tables[CERTAIN], field.cameras.tables[POSSIBLE]
    seen, flags, lists, frame = scratch.seen, scratch.flags, scratch.lists, frame_of(sight, target_of(scratch)[1])
    covered, reachable, hidden = state.covered, state.reachable, state.hides[HIDDEN]
    short, just = state.counts.sets[SHORT], state.counts.sets[JUST]
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, outer, reached, touched = scratch.cell[CELL], scratch.cell[OUTER], flags[REACHED], flags[TOUCHED]
    visible, listed, firsts, lasts = lists[VISIBLE], lists[LISTED], lists[FIRST], lists[LAST]
    units, unsure, places = scratch.units, lists[UNSURE], lists[PLACES]
    count, found, size = ZERO, ZERO, np.uint64(covered.shape[2])
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = firsts[s], lasts[s]
        for p in range(first, last):
            shown = reached[p] & (not touched[p])
            outer[p] = cell[p] if shown else EMPTY_ROW
            visible[p] = ALL if reachable[k, p] & (hidden[k, p] == 0) & (not touched[p]) else ZERO
        for p in range(first, last):
            listed[count] = p
            count += np.uint64((visible[p] != ZERO) | (outer[p] != EMPTY_ROW))
    for m in range(count):
        p = listed[m]
        o = np.uint64(outer[p])
        i = o if sure[p] == np.inf else np.uint64(EMPTY_ROW)
        for w in range(size):
            was = covered[k, p, w] & visible[p]
            unsure[found] = (short[p, w] & ~was & possible[o, w]) | (just[p, w] & was & ~certain[i, w])
            places[found] = p << HALF | w
            found += np.uint64(unsure[found] != ZERO)
    for m in range(found):
        left, p, w = unsure[m], places[m] >> HALF, places[m] & LOWER
        offset, depths = (x[p], y[p], z[p]), (low[p] if outer[p] != EMPTY_ROW else np.inf, high[p], sure[p])
        well = certain[np.uint64(outer[p]), w]
        was, change, row = covered[k, p, w] & visible[p], np.int64(0), weights_row(weights, p)
        while left:
            bit = lowest(left)
            a = w * np.uint64(BITS) + bit
            central = (well >> bit & ONE) != ZERO
            inside = covers_one(sight, offset, frame, depths, central, axes, a)
            change += weights[row, a] * (np.int64(inside) - np.int64(was >> bit & ONE))
            left &= left - ONE
        units[p] += change
    for m in range(scratch.numbers[TOUCHED_COUNT]):
        listed[m] = lists[TOUCHED_LIST, m]
    return scratch.numbers[TOUCHED_COUNT]


@list_changing.register(State)
def _list_changing(state: Any, k: Integer, scratch: Any) -> Any:
    reachable, reached, touched = state.reachable, scratch.flags[REACHED], scratch.flags[TOUCHED]
    listed, first, last = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST]
    count = ZERO
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            listed[count] = p
            count += np.uint64(reachable[k, p] | reached[p] | touched[p])
    return count


@see.register(State)
def _see(state: Any, k: Integer, positions: np.ndarray, field: Any, scratch: Any) -> None:
    camera, sight, seen, sets = field.cameras, sized(field.cameras.sight, k), scratch.seen, scratch.sets
    certain, possible, fresh, asked = camera.tables[CERTAIN], camera.tables[POSSIBLE], sets[FRESH], sets[ASKED]
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached = scratch.cell[CELL], scratch.flags[REACHED]
    frame = frame_of(sight, target_of(scratch)[1])
    for p in positions:
        row = np.uint64(cell[p] if reached[p] else EMPTY_ROW)
        sure_row = row if sure[p] == np.inf else np.uint64(EMPTY_ROW)
        offset, depths = (x[p], y[p], z[p]), (low[p], high[p], sure[p])
        for w in range(np.uint64(fresh.shape[1])):
            covered, well = certain[sure_row, w] & asked[p, w], certain[row, w]
            left = possible[row, w] & asked[p, w] & ~covered
            if left:
                covered |= covering(sight, left, w, offset, frame, depths, well, camera.axes)
            fresh[p, w] = covered


@fresh_of.register(Scratch)
def _fresh_of(scratch: Any, p: Integer, w: Integer) -> Any:
    return scratch.sets[FRESH, p, w] if scratch.hides[HIDDEN, p] == 0 else ZERO


@exchange_sets.register(State)
def _exchange_sets(state: Any, k: Integer, p: Integer, w: Integer, scratch: Any) -> Any:
    was, now, covered = shown_of(state, k, p, w), fresh_of(scratch, p, w), state.covered[k, p, w]
    state.covered[k, p, w], scratch.sets[FRESH, p, w] = scratch.sets[FRESH, p, w], covered
    return was, now


@inlined
def _swap(one: Any, other: Any, first: Integer, last: Integer) -> None:
    """Exchange the elements `first` to `last - 1` of two arrays in place."""
    for p in range(first, last):
        one[p], other[p] = other[p], one[p]


@exchange_views.register(State)
def _exchange_views(state: Any, k: Integer, scratch: Any) -> None:
    changes, lists, hidden, hiding = scratch.changes, scratch.lists, state.hides[HIDDEN], state.hides[HIDING]
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(scratch.pairs[LANDMARK, e]), np.uint64(scratch.pairs[POSITION, e])
        hidden[i, p] += changes[HIDDEN, i, p]
        hiding[i, p] += changes[HIDING, i, p]
        changes[HIDDEN, i, p], changes[HIDING, i, p] = -changes[HIDDEN, i, p], -changes[HIDING, i, p]
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = lists[FIRST, s], lists[LAST, s]
        _swap(state.reachable[k], scratch.flags[REACHED], first, last)
        _swap(hidden[k], scratch.hides[HIDDEN], first, last)
        _swap(hiding[k], scratch.hides[HIDING], first, last)


@find_pairs.register(State)
def _find_pairs(state: Any, k: Integer, role: Any, field: Any, scratch: Any) -> None:
    if role != NEW_PLACE:
        view_place(k, field, scratch)
    if field.cameras.sight.reach < 0.0:
        return
    if role == OLD_PLACE:
        _want_blocks(k, state, scratch)
    search((field.cameras, ZERO, ZERO), k, role, field, state, scratch)
    _touch_flips(state, scratch)


@inner
def _want_blocks(k: Integer, state: Any, scratch: Any) -> None:
    """Clear the flag `WANTED` of the blocks of positions that need no search for occlusion at the landmark's old place.

    In a block that keeps the flag, landmark k hides another landmark from some position, or is hidden by one.
    """
    hiding, hidden, wanted = state.hides[HIDING], state.hides[HIDDEN], scratch.flags[WANTED]
    for b in scratch.lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        some = np.int16(0)
        for p in range(b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)):
            some |= hiding[k, p] | hidden[k, p]
        wanted[b] = some != 0


@inlined
def _hide_from(p: Integer, one: Any, pose: Any, two: Any, other: Any, positions: FloatArray) -> Any:
    """Two flags as seen from position p: the first landmark hides the second, and the second hides the first.

    `one` and `two` are the models of sight of the first and of the second landmark; `pose` and `other` are their
    positions and normals.
    """
    (place, facing), (there, turned), at = pose, other, column3(positions, p)
    a, b = minus3(place, at), minus3(there, at)
    return hide_between(one, two, a, dot3(a, a), b, dot3(b, b), facing, turned)


@note_neighbour.register(State)
def _note_neighbour(state: Any, groups: Any, near: Any, role: Any, place: Any, field: Any, scratch: Any) -> None:
    (cameras, _, _), (_, b, i, k, _) = groups, near
    positions, first, last = field.positions, b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)
    mine, theirs, other, some = sized(cameras.sight, k), sized(cameras.sight, i), pose_of(i, state), np.int64(0)
    for p in range(first, last):
        one, two = _hide_from(p, mine, place, theirs, other, positions)
        some += one | two
    if some == 0 or not is_near(field, b, other[0]):
        return
    for p in range(first, last):
        one, two = _hide_from(p, mine, place, theirs, other, positions)
        if one | two:
            _note_hiding(i, p, one, two, role, scratch)


@inlined
def _note_hiding(i: Integer, p: Integer, one: Any, two: Any, role: Any, scratch: Any) -> None:
    """Record in the scratch the occlusion between landmark i and the moving landmark, as seen from position p.

    `role` selects the place of the moving landmark, see `find_pairs`. `one` is True if the moving landmark hides
    landmark i, `two` is True if landmark i hides the moving landmark.
    """
    changes, hides = scratch.changes, scratch.hides
    if role != OLD_PLACE:
        hides[HIDING, p] += one
        hides[HIDDEN, p] += two
        if two and scratch.flags[REACHED, p]:
            touch(p, scratch)
    if role != FIRST_PLACE:
        note_pair(i, p, scratch)
        sign = np.int8(-1) if role == OLD_PLACE else np.int8(1)
        changes[HIDDEN, i, p] += sign * np.int8(one)
        changes[HIDING, i, p] += sign * np.int8(two)


@inlined
def turns(reachable: Any, was: Any, now: Any) -> Any:
    """True if a landmark is hidden before or after a move, but not both.

    `was` and `now` are the numbers of landmarks that hide it. The result is False unless `reachable` is True: some
    orientation covers the landmark, occlusion ignored.
    """
    return reachable & ((was == 0) != (now == 0))


@inner
def _touch_flips(state: Any, scratch: Any) -> None:
    """Mark as `TOUCHED` the positions from which the trial move makes another landmark visible or hidden."""
    hidden, reachable, changes = state.hides[HIDDEN], state.reachable, scratch.changes[HIDDEN]
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(scratch.pairs[LANDMARK, e]), np.uint64(scratch.pairs[POSITION, e])
        if turns(reachable[i, p], hidden[i, p], hidden[i, p] + changes[i, p]):
            touch(p, scratch)
