"""Moves of landmarks before a single camera: its centre is the position itself, whatever the orientation.

Occlusion and bounds on the depth depend on the position alone: a landmark is hidden with all orientations or with none,
and the state counts by how many others. So trials are settled without sets of orientations at most positions.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, BITS, HALF, LOWER, ONE, ZERO, lowest
from lmd.core.compiled import allocating, inlined, inner
from lmd.core.memory import check_views
from lmd.incremental.counts import JUST, SHORT
from lmd.incremental.nearby import is_near, pose_of, target_of
from lmd.incremental.occlusion import ARRIVES, COMES, LEAVES, note_neighbour, note_pair, search, touch
from lmd.incremental.state import (
    ASKED,
    BLOCK_COUNT,
    BLOCKS,
    FIRST,
    FRESH,
    GOES,
    HIDDEN,
    HIDING,
    HIGH,
    LAST,
    LISTED,
    LOW,
    NAMES,
    PAIR_COUNT,
    PLACES,
    REACHED,
    SPAN_COUNT,
    SURE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    UNSURE,
    VISIBLE,
    WANTED,
    WHERE,
    WHO,
    Scratch,
    State,
    X,
    Y,
    Z,
    scratch_of,
)
from lmd.incremental.trial import (
    bound_views,
    exchange_sets,
    exchange_views,
    find_pairs,
    forget_views,
    fresh_of,
    list_changing,
    see,
    shown_of,
    turned,
)
from lmd.scene.criteria import (
    covering,
    covers_one,
    frame_of,
    from_position,
    hide_between,
    horizon_of,
    sized,
)
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import CERTAIN, NOWHERE, POSSIBLE, cell_of
from lmd.sight.kernels import weights_row
from lmd.sight.obstacles import find_ends, is_blocked, is_clear, no_ends

CELL, OUTER = 0, 1  # rows of `Scratch.cell`
# Bytes of a landmark in a view: a bit for the cap, and as much again for occlusion.
LANDMARK_BYTES = 0.25


class OneCamera(NamedTuple):
    """A single camera, at Q positions with all orientations."""

    sight: Any
    """The compiled model of sight."""
    horizon: float
    """See `criteria.horizon_of`, metres."""
    centres: np.ndarray
    """`(1, 3)` zeros: offset of the camera from a position, metres."""
    radius: np.ndarray
    """`(1,)` zero: distance of the camera from the centre, metres."""
    obstacles: Any
    """Obstacles of the room before the positions, see `lmd.sight.obstacles`."""
    axes: np.ndarray
    """`(6, 64 W)` optical axis and right, filled up with zeros to whole words."""
    tables: np.ndarray
    """`(2, cells + 1, W)`: `CERTAIN`, `POSSIBLE` of `lmd.sight.directions`."""

    @property
    def sights(self) -> tuple[Any, ...]:
        """The model of sight of each kind of camera."""
        return (self.sight,)

    def with_sights(self, change: Any) -> "OneCamera":
        """The camera with the model of sight that `change` makes of its own."""
        sight = change(self.sight)
        return self._replace(sight=sight, horizon=horizon_of(sight))

    def state(self, shared: dict[str, Any]) -> State:
        """An empty state with the `shared` fields."""
        (size, words), count = shared["counts"].sets.shape[1:], len(shared["surfaces"])
        check_views(LANDMARK_BYTES, size, BITS * words, count)
        return State(
            **shared,
            caps=np.zeros((count, size, words), dtype=np.uint64),
            reachable=np.zeros((count, size), dtype=np.bool_),
            hides=np.zeros((2, count, size), dtype=np.int16),
        )

    def scratch(self, state: State) -> Scratch:
        """Working memory for moves of a state."""
        return scratch_of(state)


@shown_of.register(State)
def _shown_of(state, k, p, w):  # type: ignore[no-untyped-def]
    return state.caps[k, p, w] if state.hides[HIDDEN, k, p] == 0 else ZERO


@turned.register(State)
def _turned(state, i, p, w, scratch):  # type: ignore[no-untyped-def]
    cap, hidden = state.caps[i, p, w], state.hides[HIDDEN, i, p]
    return cap if hidden == 0 else ZERO, cap if hidden + scratch.changes[HIDDEN, i, p] == 0 else ZERO


@forget_views.register(Scratch)
def _forget_views(scratch):  # type: ignore[no-untyped-def]
    who, where, changes = scratch.pairs[WHO], scratch.pairs[WHERE], scratch.changes
    first, last, reached = scratch.lists[FIRST], scratch.lists[LAST], scratch.flags[REACHED]
    hidden, hiding = scratch.hides[HIDDEN], scratch.hides[HIDING]
    for e in range(scratch.numbers[PAIR_COUNT]):
        changes[HIDDEN, who[e], where[e]] = changes[HIDING, who[e], where[e]] = 0
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = False
            hidden[p] = hiding[p] = 0


@inner
def _look_around(k, field, scratch):  # type: ignore[no-untyped-def]
    """Find what is seen of the place tried from the positions near it."""
    positions, sight, seen = field.positions, sized(field.cameras.sight, k), scratch.seen
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached, first, last = scratch.cell[CELL], scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    ax, ay, az, nx, ny, nz = target_of(scratch)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):  # without a branch, so that it vectorises
            x[p], y[p], z[p] = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            reached[p], low[p], high[p], sure[p] = from_position(sight, x[p], y[p], z[p], nx, ny, nz, 0.0)
            cell[p] = cell_of(x[p], y[p], z[p])
    if not is_clear(field.cameras.obstacles):
        _block(k, field.cameras, scratch)


@allocating
def _block(k, camera, scratch):  # type: ignore[no-untyped-def]
    """Do not let landmark k reach the place tried where something of the room stands in the way."""
    reached, first, last = scratch.flags[REACHED], scratch.lists[FIRST], scratch.lists[LAST]
    ends, sight = no_ends(camera.obstacles, 1), sized(camera.sight, k)
    x, y, z, nx, ny, nz = target_of(scratch)
    find_ends(camera.obstacles, sight, x, y, z, nx, ny, nz, ends, 0)
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            reached[p] = reached[p] and not is_blocked(camera.obstacles, sight, p, ends, 0)


@find_pairs.register(State)
def _find_pairs(state, k, how, field, scratch):  # type: ignore[no-untyped-def]
    if how != COMES:
        _look_around(k, field, scratch)
    if field.cameras.sight.reach < 0.0:
        return
    if how == LEAVES:
        _want_blocks(k, state, scratch)
    search(field.cameras, k, how, ZERO, ZERO, field, state, scratch)
    _touch_flips(state, scratch)


@inner
def _want_blocks(k, state, scratch):  # type: ignore[no-untyped-def]
    """Leave in `WANTED` the blocks from which landmark k hides another or is hidden: nearly everywhere it is not."""
    hiding, hidden, wanted = state.hides[HIDING], state.hides[HIDDEN], scratch.flags[WANTED]
    for b in scratch.lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        some = np.int16(0)
        for p in range(b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)):
            some |= hiding[k, p] | hidden[k, p]
        wanted[b] = some != 0


@note_neighbour.register(OneCamera)
def _note_neighbour(cameras, c, b, i, k, how, place, mine, other, field, state, scratch):  # type: ignore[no-untyped-def]
    positions, first, last = field.positions, b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)
    ax, ay, az, nx, ny, nz = place
    lx, ly, lz, vx, vy, vz = pose_of(i, state)
    one_sight, two_sight, some = sized(cameras.sight, k), sized(cameras.sight, i), np.int64(0)
    for p in range(first, last):
        x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        ox, oy, oz = lx - positions[0, p], ly - positions[1, p], lz - positions[2, p]
        squared, square = x * x + y * y + z * z, ox * ox + oy * oy + oz * oz
        one, two = hide_between(one_sight, two_sight, x, y, z, squared, ox, oy, oz, square, nx, ny, nz, vx, vy, vz)
        some += one | two
    if some == 0 or not is_near(field, b, lx, ly, lz):
        return
    for p in range(first, last):
        x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        ox, oy, oz = lx - positions[0, p], ly - positions[1, p], lz - positions[2, p]
        squared, square = x * x + y * y + z * z, ox * ox + oy * oy + oz * oz
        one, two = hide_between(one_sight, two_sight, x, y, z, squared, ox, oy, oz, square, nx, ny, nz, vx, vy, vz)
        if one | two:
            _note_hiding(i, p, one, two, how, scratch)


@inlined
def _note_hiding(i, p, one, two, how, scratch):  # type: ignore[no-untyped-def]
    """Note from position p that the place hides landmark i, `one`, and that this hides the place, `two`."""
    changes, hides = scratch.changes, scratch.hides
    if how != LEAVES:
        hides[HIDING, p] += one
        hides[HIDDEN, p] += two
        if two and scratch.flags[REACHED, p]:
            touch(p, scratch)
    if how != ARRIVES:
        note_pair(i, p, scratch)
        sign = np.int8(-1) if how == LEAVES else np.int8(1)
        changes[HIDDEN, i, p] += sign * np.int8(one)
        changes[HIDING, i, p] += sign * np.int8(two)


@inlined
def turns(reachable, was, now):  # type: ignore[no-untyped-def]
    """True if a landmark appears or disappears when `now` others hide it instead of `was`."""
    return reachable & ((was == 0) != (now == 0))


@inner
def _touch_flips(state, scratch):  # type: ignore[no-untyped-def]
    """Touch the positions from which another landmark appears or disappears."""
    hidden, reachable, changes = state.hides[HIDDEN], state.reachable, scratch.changes[HIDDEN]
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(scratch.pairs[WHO, e]), np.uint64(scratch.pairs[WHERE, e])
        if turns(reachable[i, p], hidden[i, p], hidden[i, p] + changes[i, p]):
            touch(p, scratch)


@bound_views.register(State)
def _bound_views(state, k, field, scratch):  # type: ignore[no-untyped-def]
    # One pass over words, without sets for all positions: these would cost a tenth of a trial.
    sight, axes, weights = sized(field.cameras.sight, k), field.cameras.axes, field.weights
    certain, possible = field.cameras.tables[CERTAIN], field.cameras.tables[POSSIBLE]
    target, seen, flags, lists = scratch.target, scratch.seen, scratch.flags, scratch.lists
    frame = frame_of(sight, target[3], target[4], target[5])
    caps, reachable, hidden = state.caps, state.reachable, state.hides[HIDDEN]
    short, just = state.counts.sets[SHORT], state.counts.sets[JUST]
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, outer, reached, touched = scratch.cell[CELL], scratch.cell[OUTER], flags[REACHED], flags[TOUCHED]
    visible, listed, firsts, lasts = lists[VISIBLE], lists[LISTED], lists[FIRST], lists[LAST]
    units, unsure, places = scratch.units, lists[UNSURE], lists[PLACES]
    count, found, size = ZERO, ZERO, np.uint64(caps.shape[2])
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = firsts[s], lasts[s]
        for p in range(first, last):
            shown = reached[p] & (not touched[p])
            outer[p] = cell[p] if shown else NOWHERE
            visible[p] = ALL if reachable[k, p] & (hidden[k, p] == 0) & (not touched[p]) else ZERO
        for p in range(first, last):
            listed[count] = p
            count += np.uint64((visible[p] != ZERO) | (outer[p] != NOWHERE))
    for m in range(count):
        p = listed[m]
        o = np.uint64(outer[p])
        i = o if sure[p] == np.inf else np.uint64(NOWHERE)
        for w in range(size):
            was = caps[k, p, w] & visible[p]
            unsure[found] = (short[p, w] & ~was & possible[o, w]) | (just[p, w] & was & ~certain[i, w])
            places[found] = p << HALF | w
            found += np.uint64(unsure[found] != ZERO)
    for m in range(found):
        left, p, w = unsure[m], places[m] >> HALF, places[m] & LOWER
        px, py, pz, least = x[p], y[p], z[p], low[p] if outer[p] != NOWHERE else np.inf
        well = certain[np.uint64(outer[p]), w]
        was, change, row = caps[k, p, w] & visible[p], np.int64(0), weights_row(weights, p)
        while left:
            bit = lowest(left)
            a = w * np.uint64(BITS) + bit
            central = (well >> bit & ONE) != ZERO
            inside = covers_one(sight, px, py, pz, frame, least, high[p], sure[p], central, axes, a)
            change += weights[row, a] * (np.int64(inside) - np.int64(was >> bit & ONE))
            left &= left - ONE
        units[p] += change
    for m in range(scratch.numbers[TOUCHED_COUNT]):
        listed[m] = lists[TOUCHED_LIST, m]
    return scratch.numbers[TOUCHED_COUNT]


@list_changing.register(State)
def _list_changing(state, k, scratch):  # type: ignore[no-untyped-def]
    reachable, reached, touched = state.reachable, scratch.flags[REACHED], scratch.flags[TOUCHED]
    listed, first, last = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST]
    count = ZERO
    for s in range(scratch.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            listed[count] = p
            count += np.uint64(reachable[k, p] | reached[p] | touched[p])
    return count


@see.register(State)
def _see(state, k, positions, field, scratch):  # type: ignore[no-untyped-def]
    camera, sight, target, seen = field.cameras, sized(field.cameras.sight, k), scratch.target, scratch.seen
    certain, possible, fresh, asked = (
        camera.tables[CERTAIN], camera.tables[POSSIBLE], scratch.sets[FRESH], scratch.sets[ASKED]
    )  # fmt: skip
    x, y, z, low, high, sure = seen[X], seen[Y], seen[Z], seen[LOW], seen[HIGH], seen[SURE]
    cell, reached = scratch.cell[CELL], scratch.flags[REACHED]
    frame = frame_of(sight, target[3], target[4], target[5])
    for p in positions:
        row = np.uint64(cell[p] if reached[p] else NOWHERE)
        given = row if sure[p] == np.inf else np.uint64(NOWHERE)
        px, py, pz, least, most, deep = x[p], y[p], z[p], low[p], high[p], sure[p]
        for w in range(np.uint64(fresh.shape[1])):
            cap, well = certain[given, w] & asked[p, w], certain[row, w]
            left = possible[row, w] & asked[p, w] & ~cap
            if left:
                cap |= covering(sight, left, w, px, py, pz, frame, least, most, deep, well, camera.axes)
            fresh[p, w] = cap


@fresh_of.register(Scratch)
def _fresh_of(scratch, p, w):  # type: ignore[no-untyped-def]
    return scratch.sets[FRESH, p, w] if scratch.hides[HIDDEN, p] == 0 else ZERO


@exchange_sets.register(State)
def _exchange_sets(state, k, p, w, scratch):  # type: ignore[no-untyped-def]
    was, now, cap = shown_of(state, k, p, w), fresh_of(scratch, p, w), state.caps[k, p, w]
    state.caps[k, p, w], scratch.sets[FRESH, p, w] = scratch.sets[FRESH, p, w], cap
    return was, now


@inlined
def _swap(one, other, first, last):  # type: ignore[no-untyped-def]
    """Exchange a part of two arrays; by itself, so that the loop vectorises."""
    for p in range(first, last):
        one[p], other[p] = other[p], one[p]


@exchange_views.register(State)
def _exchange_views(state, k, scratch):  # type: ignore[no-untyped-def]
    changes, lists, hidden, hiding = scratch.changes, scratch.lists, state.hides[HIDDEN], state.hides[HIDING]
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(scratch.pairs[WHO, e]), np.uint64(scratch.pairs[WHERE, e])
        hidden[i, p] += changes[HIDDEN, i, p]
        hiding[i, p] += changes[HIDING, i, p]
        changes[HIDDEN, i, p], changes[HIDING, i, p] = -changes[HIDDEN, i, p], -changes[HIDING, i, p]
    for s in range(scratch.numbers[SPAN_COUNT]):
        first, last = lists[FIRST, s], lists[LAST, s]
        _swap(state.reachable[k], scratch.flags[REACHED], first, last)
        _swap(hidden[k], scratch.hides[HIDDEN], first, last)
        _swap(hiding[k], scratch.hides[HIDING], first, last)


@inlined
def list_turning(p, state, scratch):  # type: ignore[no-untyped-def]
    """List in `NAMES` and `GOES` the other landmarks that appear or disappear at position p; returns their number."""
    hidden, changes, known, count = state.hides[HIDDEN], scratch.changes[HIDDEN], scratch.known, ZERO
    names, goes = scratch.lists[NAMES], scratch.lists[GOES]
    for i in range(np.uint64(known.shape[1])):
        if known[p, i]:
            was = hidden[i, p]
            names[count], goes[count] = i, ALL if was == 0 else ZERO
            count += np.uint64(turns(state.reachable[i, p], was, was + changes[i, p]))
    return count
