"""Carrying out the moves of single landmarks where a rig looks for them, as `move` does for one camera."""

from typing import Any

import numpy as np
from numba import literal_unroll

from lmd.core.bits import BITS
from lmd.core.compiled import inlined, inner, kernel
from lmd.core.memory import check_views
from lmd.incremental.hiding import exchange_hiding, find_new
from lmd.incremental.move import BACK, FORTH, exchange_place, given_counts, ripple, sum_up
from lmd.incremental.nearby import list_blocks
from lmd.incremental.rig_state import RigState, StationState, rig_scratch_of
from lmd.incremental.rig_trial import see_anew, shown_by
from lmd.scene.deployment import Deployment

# What is kept of a landmark seen from a station: who hides it, whom it hides, and whether there is a cap.
STATION_BYTES = 5
# And of a landmark with a camera and an orientation: bits of caps, of what is veiled, and of what flips.
CAMERA_BYTES = 3 / 8


@inner
def _exchange_parts(k, sign, parts, state, scratch):
    for part in literal_unroll(parts):
        mine, other = state.parts[part.number], scratch.parts[part.number]
        for m in range(len(mine.caps)):
            for q in range(other.cap.shape[1]):
                for w in range(other.cap.shape[2]):
                    mine.caps[m, k, q, w], other.cap[m, q, w] = other.cap[m, q, w], mine.caps[m, k, q, w]
                    mine.veiled[m, k, q, w], other.veil[m, q, w] = other.veil[m, q, w], mine.veiled[m, k, q, w]
        exchange_hiding(k, sign, part.sight, mine, other)


@inlined
def _show(i, q, w, now, n, state):
    """Let `now` be the orientations of word w with which landmark i is seen; returns what they were."""
    was = state.shown[i, q, w]
    if now != was:
        ripple(q, w, now ^ was, was, n, state.counts, state.short, state.just)
        state.shown[i, q, w] = now
    return was


@inner
def _exchange(k, sign, field, state, scratch):
    """Exchange landmark k for what `scratch` has of its other place; to do so twice changes nothing."""
    n, words = field.n, np.uint64(scratch.fresh.shape[1])
    for q in range(np.uint64(len(state.units))):
        state.units[q], scratch.units[q] = scratch.units[q], state.units[q]
        for w in range(words):
            scratch.fresh[q, w] = _show(k, q, w, scratch.fresh[q, w], n, state)
    for e in range(scratch.found[0]):
        i, q = np.uint64(scratch.who[e]), np.uint64(scratch.where[e])
        for w in range(words):
            _show(i, q, w, shown_by(i, q, w, state, scratch), n, state)
            for j in range(len(state.parts)):
                veiled, flipped = state.parts[j].veiled, scratch.parts[j].flipped
                for m in range(len(veiled)):
                    veiled[m, i, q, w] ^= flipped[m, i, q, w]
    _exchange_parts(k, sign, field.parts, state, scratch)
    exchange_place(k, state, scratch)


@inner
def carry_out_rig(field, k, state, scratch):
    """See `move.carry_out`."""
    see_anew(field.parts, scratch, True)
    _exchange(np.uint64(k), FORTH, field, state, scratch)


@inner
def take_back_rig(field, k, state, scratch):
    """See `move.take_back`."""
    _exchange(np.uint64(k), BACK, field, state, scratch)


@inner
def _arrive(k, parts, state, scratch):
    """Find what all parts see of landmark k at the place tried, and keep it."""
    for part in literal_unroll(parts):
        list_blocks(k, part, state.parts[part.number], scratch.parts[part.number])
        if part.sight.reach >= 0.0:
            find_new(k, part, state.parts[part.number], scratch.parts[part.number])
    see_anew(parts, scratch, True)
    for i in range(len(state.parts)):
        mine, other = state.parts[i], scratch.parts[i]
        for s in range(len(other.new.reached)):
            mine.reachable[k, s] = other.new.reached[s]
            mine.hidden[k, s], mine.hiding[k, s] = other.after.count_hidden[s], other.after.count_hides[s]
        for m in range(len(mine.caps)):
            for q in range(other.cap.shape[1]):
                for w in range(other.cap.shape[2]):
                    mine.caps[m, k, q, w], mine.veiled[m, k, q, w] = other.cap[m, q, w], other.veil[m, q, w]


@kernel
def _fill(field, state, scratch):
    """Let the landmarks of `state` come, one after the other."""
    for k in range(np.uint64(state.landmarks.shape[1])):
        for i in range(3):
            scratch.target[i], scratch.target[3 + i] = state.landmarks[i, k], state.normals[i, k]
        _arrive(k, field.parts, state, scratch)
        for q in range(np.uint64(scratch.fresh.shape[0])):
            for w in range(np.uint64(scratch.fresh.shape[1])):
                _show(k, q, w, scratch.fresh[q, w], field.n, state)
    sum_up(field, state)


def rig_state_of(field: Any, deployment: Deployment) -> RigState:
    """The coverage of `deployment`, ready for moves; `field` a `lmd.incremental.rig_field.RigField`."""
    count, (size, words) = len(deployment), field.given.shape
    stations, mounts = (
        sum(sizes) for sizes in zip(*((p.positions.shape[1], len(p.axes)) for p in field.parts), strict=True)
    )
    check_views(STATION_BYTES * stations / size + CAMERA_BYTES * mounts * BITS * words, size, 1, count)
    landmarks, normals = (np.ascontiguousarray(v.T).copy() for v in (deployment.positions, deployment.normals))
    parts = []
    for part in field.parts:
        caps, veiled = np.zeros((2, len(part.axes), count, size, words), dtype=np.uint64)
        hidden, hiding = np.zeros((2, count, part.positions.shape[1]), dtype=np.int16)
        reachable = np.zeros(hidden.shape, dtype=np.bool_)
        parts.append(StationState(landmarks, normals, caps, veiled, reachable, hidden, hiding))
    state = RigState(
        landmarks=landmarks,
        normals=normals,
        surfaces=deployment.surfaces.copy(),
        parts=tuple(parts),
        shown=np.zeros((count, size, words), dtype=np.uint64),
        **given_counts(field.given, count, field.n),
    )
    _fill(field, state, rig_scratch_of(state))
    return state
