"""Carrying out the moves of single landmarks where a rig looks for them, as `move` does for one camera."""

from typing import Any

import numpy as np

from lmd.core.bits import ALL, BITS
from lmd.core.compiled import borrowing, inlined, inner
from lmd.core.memory import check_views
from lmd.incremental.counts import given_counts, ripple, sum_up
from lmd.incremental.field import places_of
from lmd.incremental.move import exchange_place
from lmd.incremental.nearby import list_blocks
from lmd.incremental.rig_pairs import ARRIVES, find_pairs
from lmd.incremental.rig_state import (
    ASKED,
    CAPS,
    FRESH,
    PAIR_COUNT,
    VEILED,
    WHERE,
    WHO,
    RigState,
    rig_scratch_of,
)
from lmd.incremental.rig_trial import forget, list_near, see_anew, shown_by
from lmd.incremental.state import LISTED
from lmd.scene.deployment import Deployment

# Of a landmark and a centre around a position: whether it is a rival of the place tried.
CENTRE_BYTES = 8
# And of a landmark with a camera and an orientation: bits of caps, of what is veiled, and of what flips.
CAMERA_BYTES = 3 / 8


@inlined
def _show(i, q, w, now, n, state):
    """Let `now` be the orientations of word w with which landmark i is seen; returns what they were."""
    was = state.shown[i, q, w]
    if now != was:
        ripple(q, w, now ^ was, was, n, state.counts)
        state.shown[i, q, w] = now
    return was


@inner
def _exchange_part(k, positions, mine, other):
    """Exchange what a part has of landmark k, `mine`, at `positions` for what its scratch has, the `other`."""
    caps, veiled, cap, veil = mine[CAPS], mine[VEILED], other[CAPS], other[VEILED]
    for q in positions:
        for m in range(caps.shape[2]):
            for w in range(caps.shape[3]):
                caps[k, q, m, w], cap[q, m, w] = cap[q, m, w], caps[k, q, m, w]
                veiled[k, q, m, w], veil[q, m, w] = veil[q, m, w], veiled[k, q, m, w]


@inner
def _exchange_parts(k, positions, state, scratch):
    """The same of all parts."""
    for j in range(len(state.parts)):
        _exchange_part(k, positions, state.parts[j], scratch.parts[j].sets)  # copied: outside of other loops


@inner
def see_whole(k, field, state, scratch):
    """Find all that the cameras see of landmark k in the place tried.

    Returns:
        how many positions there are in `LISTED`, from where they look.
    """
    positions, asked = scratch.lists[LISTED][: list_near(scratch, True)], scratch.sets[ASKED]
    for q in positions:
        for w in range(np.uint64(asked.shape[1])):
            asked[q, w] = ALL
    see_anew(np.uint64(k), field.parts, positions, field, state, scratch)
    return len(positions)


@inner
def take_back_rig(field, k, state, scratch):
    """Exchange landmark k for what `scratch` has of its other place; to do so twice changes nothing."""
    k, fresh, who, where = np.uint64(k), scratch.sets[FRESH], scratch.pairs[WHO], scratch.pairs[WHERE]
    n, words = field.n, np.uint64(fresh.shape[1])
    positions = scratch.lists[LISTED][: list_near(scratch, True)]
    for q in positions:
        state.units[q], scratch.units[q] = scratch.units[q], state.units[q]
        for w in range(words):
            fresh[q, w] = _show(k, q, w, fresh[q, w], n, state)
    _exchange_parts(k, positions, state, scratch)
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, q = np.uint64(who[e]), np.uint64(where[e])
        for w in range(words):
            _show(i, q, w, shown_by(i, q, w, state, scratch), n, state)
            for j in range(len(state.parts)):
                veiled, flipped = state.parts[j][VEILED], scratch.parts[j].flipped
                for m in range(veiled.shape[2]):
                    veiled[i, q, m, w] ^= flipped[i, q, m, w]
    exchange_place(k, state, scratch)


@inner
def carry_out_rig(field, k, state, scratch):
    """See `move.carry_out`."""
    see_whole(k, field, state, scratch)
    take_back_rig(field, k, state, scratch)


@borrowing
def _fill(field, state, scratch):
    """Let the landmarks of `state` come, one after the other."""
    fresh = scratch.sets[FRESH]
    for k in range(np.uint64(state.poses.shape[1])):
        for i in range(6):
            scratch.target[i] = state.poses[i, k]
        forget(scratch)
        list_blocks(k, field, state, scratch)
        find_pairs(k, ARRIVES, field.parts, field, state, scratch)
        positions = scratch.lists[LISTED][: see_whole(k, field, state, scratch)]
        for q in positions:
            for w in range(np.uint64(fresh.shape[1])):
                _show(k, q, w, fresh[q, w], field.n, state)
        _exchange_parts(k, positions, state, scratch)
    sum_up(field, state)


def rig_state_of(field: Any, deployment: Deployment) -> RigState:
    """The coverage of `deployment`, ready for moves; `field` a `lmd.incremental.rig_field.RigField`."""
    count, (size, words), parts = len(deployment), field.given.shape, [stations.part for stations in field.parts]
    centres, mounts = tuple(len(part.centres) for part in parts), [len(part.axes) for part in parts]
    check_views(CENTRE_BYTES * sum(centres) + CAMERA_BYTES * sum(mounts) * BITS * words, size, 1, count)
    state = RigState(
        **places_of(deployment)._asdict(),
        parts=tuple(np.zeros((2, count, size, each, words), dtype=np.uint64) for each in mounts),
        shown=np.zeros((count, size, words), dtype=np.uint64),
        counts=given_counts(field.given, count, field.n),
        units=np.zeros(size, dtype=np.int64),
    )
    _fill(field, state, rig_scratch_of(state, centres))
    return state
