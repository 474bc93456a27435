"""Occlusion of landmarks for a rig: sets of orientations with which each landmark is hidden from each camera.

A bound for all cameras around a centre (`mount_occlusion.may_hide_around`) excludes most pairs of landmarks. The other
pairs are tested for each orientation with which the landmark that may be hidden is covered.
"""

import math
from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ZERO, Integer, lowest
from lmd.core.compiled import inlined, inner
from lmd.geometry.vectors import Vector, column3, cross3, dot3, minus3, plus3, row3
from lmd.incremental.occlusion import (
    FIRST_PLACE,
    NEW_PLACE,
    OLD_PLACE,
    line_radius,
    note_neighbour,
    note_pair,
    pose_of,
    search,
    target_of,
    touch,
)
from lmd.incremental.state import ASKED, COVERED, LANDMARK, OCCLUDED, POSITION, RigState
from lmd.incremental.trial import find_pairs
from lmd.sight.blocks import BLOCK
from lmd.sight.mount_occlusion import hidden_bits, hiding_bound, may_hide_around


@inner
def _hidden_bits(
    group: Any, m: Integer, w: Integer, left: Any, i: Integer, k: Integer, body: Vector, one: Any, other: Any
) -> Any:
    """Bit set of the orientations of word w (64 orientations) with which landmark i hides landmark k from mount m.

    The function calls `hidden_bits` and is not inlined, which shortens compilation.
    """
    return hidden_bits(group, m, w, left, i, k, body, one, other)


@inner
def _drop_hidden(
    group: Any, c: Integer, i: Integer, k: Integer, q: Integer, body: Vector, state: Any, flipped: Any
) -> None:
    """Remove from the set `flipped` of landmark i the orientations with which it is hidden anyway.

    An orientation is removed if a landmark other than k hides landmark i from the cameras around centre c. The body is
    at position q, with the coordinates `body`, metres.
    """
    other, width = pose_of(i, state), line_radius(group.sight)
    offset = minus3(other[0], plus3(body, row3(group.centres, c)))
    for j in range(np.uint64(len(state.surfaces))):
        one = pose_of(j, state)
        away = plus3(offset, minus3(one[0], other[0]))
        if may_hide_around(away, offset, group.radius[c], width) and j != i and j != k:
            for m in range(group.mounts[c], group.mounts[c + 1]):
                for w in range(np.uint64(flipped.shape[3])):
                    bits = flipped[i, q, m, w]
                    flipped[i, q, m, w] ^= _hidden_bits(group, m, w, bits, j, i, body, one, other)


@inlined
def _find_pair(
    groups: Any, near: Any, q: Integer, body: Vector, place: Any, role: Any, state: Any, scratch: Any
) -> None:
    """Update the orientations with which the move of landmark k changes whether landmark i is hidden.

    The orientations are the set `flipped` of landmark i. The update is for one place of landmark k: its old place or
    its new place, as `role` says. The body is at position q, with the coordinates `body`, metres. If the set changes, q
    is marked as touched, and the pair of i and q is listed.
    """
    (group, mine, other), (c, _, i, k, _) = groups, near
    pose, changed, covered, occluded = pose_of(i, state), False, mine[COVERED], mine[OCCLUDED]
    for m in range(group.mounts[c], group.mounts[c + 1]):
        for w in range(np.uint64(covered.shape[3])):
            # The sets exceed the cache, so only the needed sets are read.
            bits = covered[i, q, m, w] if role == NEW_PLACE else occluded[i, q, m, w]
            found = _hidden_bits(group, m, w, bits, k, i, body, place, pose) if bits else ZERO
            if found == ZERO:
                continue
            was = flips = other.flipped[i, q, m, w]
            flips = found if role == OLD_PLACE else (flips & ~found) | (found & ~occluded[i, q, m, w])
            changed |= flips != was
            other.flipped[i, q, m, w] = flips
    if changed and role == OLD_PLACE:
        _drop_hidden(group, c, i, k, q, body, state, other.flipped)
    if changed:
        touch(q, scratch)
        note_pair(i, q, scratch)


@note_neighbour.register(RigState)
def _note_neighbour(state: Any, groups: Any, near: Any, role: Any, place: Any, field: Any, scratch: Any) -> None:
    (group, _, other), (c, b, i, _, (away, diagonal)), body = groups, near, field.positions
    e, centre, lanes = minus3(column3(state.poses, i), place[0]), row3(group.centres, c), np.uint32(0)
    there, apart = plus3(away, e), math.sqrt(dot3(e, e))
    far = math.sqrt(max(dot3(away, away), dot3(there, there)))
    most = hiding_bound(far + diagonal, apart, group.radius[c], line_radius(group.sight))
    for lane in range(np.uint64(BLOCK)):
        s = cross3(minus3(place[0], plus3(column3(body, b * np.uint64(BLOCK) + lane), centre)), e)
        lanes |= np.uint32(dot3(s, s) <= most) << np.uint32(lane)
    while lanes:
        q = b * np.uint64(BLOCK) + lowest(np.uint64(lanes))
        lanes &= lanes - np.uint32(1)
        if role != FIRST_PLACE:
            _find_pair(groups, near, q, column3(body, q), place, role, state, scratch)
        if role != OLD_PLACE:
            m, centred = other.occluders[0], np.uint64(c * len(scratch.units)) + q
            other.pairs[LANDMARK, m], other.pairs[POSITION, m], other.occluders[0] = i, centred, m + 1


@inner
def find_occluded(k: Integer, group: Any, field: Any, state: Any, scratch: Any) -> None:
    """Find the orientations with which another landmark hides landmark k at its new place from a camera of `group`.

    Only orientations in both rows `COVERED` and `ASKED` are tested. The result is added to the row `OCCLUDED`.
    """
    other, size, body = scratch.groups[group.number], np.uint64(len(scratch.units)), field.positions
    asked, tried_covered, tried_occluded = scratch.sets[ASKED], other.sets[COVERED], other.sets[OCCLUDED]
    place = target_of(scratch)
    landmark, position = other.pairs[LANDMARK], other.pairs[POSITION]
    for e in range(other.occluders[0]):
        i, c, q = np.uint64(landmark[e]), position[e] // size, position[e] % size
        for m in range(group.mounts[c], group.mounts[c + np.uint64(1)]):
            for w in range(np.uint64(tried_covered.shape[2])):
                bits = tried_covered[q, m, w] & asked[q, w] & ~tried_occluded[q, m, w]
                if bits:
                    found = _hidden_bits(group, m, w, bits, i, k, column3(body, q), pose_of(i, state), place)
                    if found:
                        tried_occluded[q, m, w] |= found
                        touch(q, scratch)


@inner
def _find_pairs_of(kinds: Any, k: Integer, role: Any, field: Any, state: Any, scratch: Any) -> None:
    """Run `find_pairs` for a rig: search each of the mount groups (equal cameras) `kinds`."""
    for group in literal_unroll(kinds):
        if group.sight.reach >= 0.0:
            groups = group, state.groups[group.number], scratch.groups[group.number]
            search(groups, k, role, field, state, scratch)
            if role == NEW_PLACE:
                find_occluded(k, group, field, state, scratch)


@find_pairs.register(RigState)
def _find_pairs(state: Any, k: Integer, role: Any, field: Any, scratch: Any) -> None:
    _find_pairs_of(field.cameras.groups, k, role, field, state, scratch)
