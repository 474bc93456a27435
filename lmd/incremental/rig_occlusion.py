"""Occlusion for the cameras of a rig: a set of orientations for each landmark, camera and position.

A bound for all cameras around a centre (`mount_occlusion.may_hide_around`) excludes most pairs of landmarks; the others
are tested for each orientation that covers the landmark.
"""

import math
from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ZERO, Integer, lowest
from lmd.core.compiled import inlined, inner
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.occlusion import (
    FIRST_PLACE,
    NEW_PLACE,
    OLD_PLACE,
    line_radius,
    note_neighbour,
    note_pair,
    search,
    touch,
)
from lmd.incremental.state import ASKED, COVERED, LANDMARK, OCCLUDED, POSITION, RigState
from lmd.incremental.trial import find_pairs
from lmd.sight.blocks import BLOCK
from lmd.sight.mount_occlusion import hidden_bits, hiding_bound, may_hide_around


@inner
def _hidden_bits(
    group: Any, m: Integer, w: Integer, left: Any, i: Integer, k: Integer, px: float, py: float, pz: float, one: Any,
    other: Any,
) -> Any:  # fmt: skip
    """`hidden_bits` as a function that is not inlined, which shortens compilation."""
    return hidden_bits(group, m, w, left, i, k, px, py, pz, one, other)


@inner
def _drop_hidden(
    group: Any, c: Integer, i: Integer, k: Integer, q: Integer, px: float, py: float, pz: float, state: Any,
    flipped: Any,
) -> None:  # fmt: skip
    """Remove the orientations with which a landmark other than k hides landmark i at position q from `flipped`."""
    other, width = pose_of(i, state), line_radius(group.sight)
    x, y, z = (
        other[0] - (px + group.centres[c, 0]),
        other[1] - (py + group.centres[c, 1]),
        other[2] - (pz + group.centres[c, 2]),
    )  # fmt: skip
    for j in range(np.uint64(len(state.surfaces))):
        one = pose_of(j, state)
        ax, ay, az = x + (one[0] - other[0]), y + (one[1] - other[1]), z + (one[2] - other[2])
        if may_hide_around(ax, ay, az, x, y, z, group.radius[c], width) and j != i and j != k:
            for m in range(group.mounts[c], group.mounts[c + 1]):
                for w in range(np.uint64(flipped.shape[3])):
                    bits = flipped[i, q, m, w]
                    flipped[i, q, m, w] ^= _hidden_bits(group, m, w, bits, j, i, px, py, pz, one, other)


@inlined
def _find_pair(
    group: Any, c: Integer, i: Integer, k: Integer, q: Integer, px: float, py: float, pz: float, place: Any, role: Any,
    mine: Any, other: Any, state: Any, scratch: Any,
) -> None:  # fmt: skip
    """Record the orientations with which landmark k at a `place` hides landmark i at position q in `flipped`."""
    pose, changed, covered, occluded = pose_of(i, state), False, mine[COVERED], mine[OCCLUDED]
    for m in range(group.mounts[c], group.mounts[c + 1]):
        for w in range(np.uint64(covered.shape[3])):
            # The sets exceed the cache, so only the needed sets are read.
            bits = covered[i, q, m, w] if role == NEW_PLACE else occluded[i, q, m, w]
            found = _hidden_bits(group, m, w, bits, k, i, px, py, pz, place, pose) if bits else ZERO
            if found == ZERO:
                continue
            was = flips = other.flipped[i, q, m, w]
            flips = found if role == OLD_PLACE else (flips & ~found) | (found & ~occluded[i, q, m, w])
            changed |= flips != was
            other.flipped[i, q, m, w] = flips
    if changed and role == OLD_PLACE:
        _drop_hidden(group, c, i, k, q, px, py, pz, state, other.flipped)
    if changed:
        touch(q, scratch)
        note_pair(i, q, scratch)


@note_neighbour.register(RigState)
def _note_neighbour(
    state: Any, group: Any, c: Integer, b: Integer, i: Integer, k: Integer, role: Any, place: Any, box: Any, mine: Any,
    other: Any, field: Any, scratch: Any,
) -> None:  # fmt: skip
    body, size, radius, (mx, my, mz, diagonal) = field.positions, len(scratch.units), group.radius[c], box
    cx, cy, cz = group.centres[c, 0], group.centres[c, 1], group.centres[c, 2]
    ax, ay, az, width = place[0], place[1], place[2], line_radius(group.sight)
    ex, ey, ez, lanes = state.poses[0, i] - ax, state.poses[1, i] - ay, state.poses[2, i] - az, np.uint32(0)
    vx, vy, vz, apart = mx + ex, my + ey, mz + ez, math.sqrt(ex * ex + ey * ey + ez * ez)
    far = math.sqrt(max(mx * mx + my * my + mz * mz, vx * vx + vy * vy + vz * vz))
    most = hiding_bound(far + diagonal, apart, radius, width)
    for lane in range(np.uint64(BLOCK)):
        q = b * np.uint64(BLOCK) + lane
        ux, uy, uz = ax - (body[0, q] + cx), ay - (body[1, q] + cy), az - (body[2, q] + cz)
        sx, sy, sz = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
        lanes |= np.uint32(sx * sx + sy * sy + sz * sz <= most) << np.uint32(lane)
    while lanes:
        q = b * np.uint64(BLOCK) + lowest(np.uint64(lanes))
        lanes &= lanes - np.uint32(1)
        if role != FIRST_PLACE:
            _find_pair(group, c, i, k, q, body[0, q], body[1, q], body[2, q], place, role, mine, other, state, scratch)
        if role != OLD_PLACE:
            other.pairs[LANDMARK, other.occluders[0]], other.pairs[POSITION, other.occluders[0]] = (
                i,
                np.uint64(c * size) + q,
            )
            other.occluders[0] += 1


@inner
def find_occluded(k: Integer, group: Any, field: Any, state: Any, scratch: Any) -> None:
    """Write the orientations of `COVERED` and `ASKED` with which other landmarks hide the place tried into
    `OCCLUDED`.
    """
    other, size, body = scratch.groups[group.number], np.uint64(len(scratch.units)), field.positions
    place, asked, tried_covered, tried_occluded = (
        target_of(scratch),
        scratch.sets[ASKED],
        other.sets[COVERED],
        other.sets[OCCLUDED],
    )
    landmark, position = other.pairs[LANDMARK], other.pairs[POSITION]
    for e in range(other.occluders[0]):
        i, c, q = np.uint64(landmark[e]), position[e] // size, position[e] % size
        for m in range(group.mounts[c], group.mounts[c + np.uint64(1)]):
            for w in range(np.uint64(tried_covered.shape[2])):
                bits = tried_covered[q, m, w] & asked[q, w] & ~tried_occluded[q, m, w]
                if bits:
                    px, py, pz = body[0, q], body[1, q], body[2, q]
                    found = _hidden_bits(group, m, w, bits, i, k, px, py, pz, pose_of(i, state), place)
                    if found:
                        tried_occluded[q, m, w] |= found
                        touch(q, scratch)


@inner
def _find_pairs_of(groups: Any, k: Integer, role: Any, field: Any, state: Any, scratch: Any) -> None:
    """Run `find_pairs` for all groups of a rig."""
    for group in literal_unroll(groups):
        if group.sight.reach >= 0.0:
            search(group, k, role, state.groups[group.number], scratch.groups[group.number], field, state, scratch)
            if role == NEW_PLACE:
                find_occluded(k, group, field, state, scratch)


@find_pairs.register(RigState)
def _find_pairs(state: Any, k: Integer, role: Any, field: Any, scratch: Any) -> None:
    _find_pairs_of(field.cameras.groups, k, role, field, state, scratch)
