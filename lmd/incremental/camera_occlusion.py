"""Occlusion for a single camera: from a position, a landmark is hidden for all orientations or for none.

For each landmark and position, a state has the number of landmarks that hide the landmark, and the number of landmarks
that it hides.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ONE, ZERO, Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.vectors import column3, dot3, minus3
from lmd.incremental.camera import view_place
from lmd.incremental.nearby import is_near, pose_of
from lmd.incremental.occlusion import FIRST_PLACE, NEW_PLACE, OLD_PLACE, note_neighbour, note_pair, search, touch
from lmd.incremental.state import (
    BLOCK_COUNT,
    BLOCKS,
    HIDDEN,
    HIDING,
    LANDMARK,
    PAIR_COUNT,
    POSITION,
    REACHED,
    WANTED,
    State,
)
from lmd.incremental.trial import find_pairs
from lmd.scene.criteria import hide_between, sized
from lmd.sight.blocks import BLOCK


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
    """Reduce `WANTED` to the few blocks from which landmark k hides another landmark or is hidden."""
    hiding, hidden, wanted = state.hides[HIDING], state.hides[HIDDEN], scratch.flags[WANTED]
    for b in scratch.lists[BLOCKS][: scratch.numbers[BLOCK_COUNT]]:
        some = np.int16(0)
        for p in range(b * np.uint64(BLOCK), (b + ONE) * np.uint64(BLOCK)):
            some |= hiding[k, p] | hidden[k, p]
        wanted[b] = some != 0


@inlined
def _hide_from(p: Integer, one: Any, pose: Any, two: Any, other: Any, positions: FloatArray) -> Any:
    """`hide_between` for the sights and poses of two landmarks, from position p."""
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
    """Record that, from position p, the place hides landmark i (if `one`) and landmark i hides the place (if `two`)."""
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
    """True if a landmark appears or disappears when the number of its occluders changes from `was` to `now`."""
    return reachable & ((was == 0) != (now == 0))


@inner
def _touch_flips(state: Any, scratch: Any) -> None:
    """Mark the positions from which another landmark appears or disappears as `TOUCHED`."""
    hidden, reachable, changes = state.hides[HIDDEN], state.reachable, scratch.changes[HIDDEN]
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, p = np.uint64(scratch.pairs[LANDMARK, e]), np.uint64(scratch.pairs[POSITION, e])
        if turns(reachable[i, p], hidden[i, p], hidden[i, p] + changes[i, p]):
            touch(p, scratch)
