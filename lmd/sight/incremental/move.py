"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed.

`trial` (the module) finds what a move would lead to; `carry_out` makes the last trial true, and it alone needs the new
cap with all its axes. It exchanges what `state` and `scratch` know of the two places, P_n included, so that `take_back`
only has to exchange them again. The decisions are those of `kernels`, operation by operation, so after any sequence of
moves the counts equal a full evaluation's, bit for bit.
"""

import numpy as np
from numba import njit

from lmd.deployment import Deployment
from lmd.sight.incremental.bits import ALL, BITS, LANES, NONE, ONE, lowest, unpacked
from lmd.sight.incremental.directions import NOWHERE, see
from lmd.sight.incremental.hiding import find_neighbours
from lmd.sight.incremental.state import Fixed, State, scratch_of
from lmd.sight.incremental.trial import bound_move, finish_move
from lmd.sight.kernels import BLOCK

# Indices are unsigned where it counts: signed ones cost extra instructions, as they might be negative.


@njit(nogil=True, cache=True, error_model="numpy")
def _find_cap(positions, fixed, scratch):
    """Find the axes that cover the place tried at `positions`, nobody hiding it.

    So many need the exact test that to test half a word at once is faster than to pick them out.
    """
    axes, possible, max_depth = fixed.axes, fixed.possible, fixed.limits[2]
    x, y, z, low, cell, _, reached = scratch.new
    caps = scratch.cap
    for p in positions:
        row = np.uint64(cell[p] if reached[p] else NOWHERE)
        px, py, pz, least = x[p], y[p], z[p], low[p]
        for w in range(np.uint64(caps.shape[1])):
            some, cap = possible[row, w], NONE
            for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
                if some >> first << np.uint64(BITS - LANES):
                    half = np.uint32(0)
                    for lane in range(np.uint64(LANES)):
                        a = w * np.uint64(BITS) + first + lane
                        depth = axes[0, a] * px + axes[1, a] * py + axes[2, a] * pz
                        half |= np.uint32((depth >= least) & (depth <= max_depth)) << np.uint32(lane)
                    cap |= np.uint64(half) << first
            caps[p, w] = cap & some


@njit(inline="always")
def _ripple(p, w, changed, goes, n, counts, short, just):
    """Count a landmark less at those axes `changed` that are in `goes`, one more at the others, digit by digit."""
    one, two = ALL, ALL
    for j in range(np.uint64(counts.shape[2])):
        digit = counts[p, w, j]
        now = digit ^ changed
        changed &= digit ^ goes  # borrowed or carried
        counts[p, w, j] = now
        one &= now if (n - 1) >> j & 1 else ~now
        two &= now if n >> j & 1 else ~now
    short[p, w], just[p, w] = one, two


@njit(nogil=True, cache=True, error_model="numpy")
def _recount(k, positions, sign, fixed, state, scratch):
    """Exchange the cap of landmark k for the other in `scratch` at `positions`, and update the counts.

    `sign` says whether other landmarks turn as in `turns`, or, with -1, back.
    """
    n, caps, other = fixed.n, state.caps, scratch.cap
    reachable, hidden, counts, short, just = state.reachable, state.hidden, state.counts, state.short, state.just
    reached, count_hidden, flips = scratch.new.reached, scratch.after.count_hidden, scratch.flips
    found, who, change = scratch.turns
    words = np.uint64(counts.shape[1])
    for p in positions:
        shown = ALL if reachable[k, p] & (hidden[k, p] == 0) else NONE
        seen = ALL if reached[p] & (count_hidden[p] == 0) else NONE
        for w in range(words):
            old, new = caps[k, p, w], other[p, w]
            caps[k, p, w], other[p, w] = new, old
            changed = (old & shown) ^ (new & seen)
            if changed:
                _ripple(p, w, changed, old & shown, n, counts, short, just)
        if not flips[p]:
            continue
        b, q = p // np.uint64(BLOCK), p % np.uint64(BLOCK)
        for m in range(found[b]):
            i = np.uint64(who[b, m])
            was, now = hidden[i, p], hidden[i, p] + sign * change[b, m, q]
            if reachable[i, p] & ((was == 0) != (now == 0)):
                for w in range(words):
                    _ripple(p, w, caps[i, p, w], ALL if was == 0 else NONE, n, counts, short, just)


@njit(nogil=True, cache=True, error_model="numpy")
def _touched(k, state, scratch):
    """Positions at which a move of landmark k may change anything."""
    reachable, reached, flips, listed = state.reachable, scratch.new.reached, scratch.flips, scratch.listed
    count = NONE
    for p in range(np.uint64(len(flips))):
        listed[count] = p
        count += np.uint64(reachable[k, p] | reached[p] | flips[p])
    return listed[:count]


@njit(nogil=True, cache=True, error_model="numpy")
def _exchange(k, sign, fixed, state, scratch):
    """Exchange landmark k for what `scratch` has of its other place."""
    landmarks, normals, reachable, hidden, hiding, units = (
        state.landmarks, state.normals, state.reachable, state.hidden, state.hiding, state.units
    )  # fmt: skip
    place, others, reached, before, after = (
        scratch.place, scratch.units, scratch.new.reached, scratch.before, scratch.after
    )  # fmt: skip
    found, who, change = scratch.turns
    _recount(np.uint64(k), _touched(k, state, scratch), sign, fixed, state, scratch)
    if fixed.mode:
        for b in range(len(found)):
            for q in range(BLOCK if found[b] + before.found[b] + after.found[b] else 0):
                p = b * BLOCK + q
                for m in range(found[b]):
                    hidden[who[b, m], p] += sign * change[b, m, q]
                for m in range(before.found[b]):
                    hiding[before.who[b, m], p] -= sign * before.hidden_by[b, m, q]
                for m in range(after.found[b]):
                    hiding[after.who[b, m], p] += sign * after.hidden_by[b, m, q]
    for p in range(len(reached)):
        units[p], others[p] = others[p], units[p]
        reachable[k, p], reached[p] = reached[p], reachable[k, p]
        hidden[k, p], after.count_hidden[p] = after.count_hidden[p], hidden[k, p]
        hiding[k, p], after.count_hides[p] = after.count_hides[p], hiding[k, p]
    for i in range(3):
        landmarks[i, k], place[i] = place[i], landmarks[i, k]
        normals[i, k], place[3 + i] = place[3 + i], normals[i, k]


@njit(nogil=True, cache=True, error_model="numpy")
def carry_out(k, fixed, state, scratch):
    """Move landmark k to where it was tried last; no other move may have been tried or carried out since."""
    _find_cap(_touched(k, state, scratch), fixed, scratch)
    _exchange(k, 1, fixed, state, scratch)


@njit(nogil=True, cache=True, error_model="numpy")
def take_back(k, fixed, state, scratch):
    """Undo the last `carry_out` with this `scratch`, all later ones being undone."""
    _exchange(k, -1, fixed, state, scratch)


@njit(nogil=True, cache=True, error_model="numpy")
def move(k, ax, ay, az, nx, ny, nz, fixed, state, scratch):
    """Move landmark k to (ax, ay, az) with normal (nx, ny, nz)."""
    bound_move(k, ax, ay, az, nx, ny, nz, fixed, state, scratch)
    finish_move(k, fixed, state, scratch)
    carry_out(k, fixed, state, scratch)


@njit(nogil=True, cache=True)
def _fill(fixed, state, scratch):
    """Let the landmarks of `state` come, one after the other."""
    landmarks, normals, new, after = state.landmarks, state.normals, scratch.new, scratch.after
    positions = np.arange(len(state.units)).astype(np.uint64)
    scratch.wanted[:] = True
    for k in range(landmarks.shape[1]):
        x, y, z = landmarks[0, k], landmarks[1, k], landmarks[2, k]
        see(x, y, z, normals[0, k], normals[1, k], normals[2, k], fixed.positions, fixed.limits, new)
        if fixed.mode:
            find_neighbours(k, x, y, z, new.x, new.y, new.z, fixed, landmarks, scratch.wanted, scratch.ways, after)
        _find_cap(positions, fixed, scratch)
        _recount(np.uint64(k), positions, 1, fixed, state, scratch)
        state.reachable[k], state.hidden[k], state.hiding[k] = new.reached, after.count_hidden, after.count_hides
    for p in positions:
        for w in range(np.uint64(state.counts.shape[1])):
            # Whether counts are at least n: from the lowest digit up, each digit overrules those below.
            has = ALL
            for j in range(np.uint64(state.counts.shape[2])):
                digit = state.counts[p, w, j]
                has = has & digit if fixed.n >> j & 1 else has | digit
            while has:
                state.units[p] += fixed.weights[w * np.uint64(BITS) + lowest(has)]
                has &= has - ONE


def state_of(fixed: Fixed, deployment: Deployment) -> State:
    """The coverage of `deployment`, ready for moves."""
    positions, count, words = fixed.positions.shape[1], len(deployment), fixed.possible.shape[1]
    state = State(
        landmarks=deployment.positions.T.copy(order="C"),
        normals=deployment.normals.T.copy(order="C"),
        caps=np.zeros((count, positions, words), dtype=np.uint64),
        reachable=np.zeros((count, positions), dtype=np.bool_),
        hidden=np.zeros((count, positions), dtype=np.int16),
        hiding=np.zeros((count, positions), dtype=np.int16),
        counts=np.zeros((positions, words, max(count, fixed.n).bit_length()), dtype=np.uint64),
        short=np.full((positions, words), ALL if fixed.n == 1 else NONE),  # nothing is covered yet
        just=np.zeros((positions, words), dtype=np.uint64),
        units=np.zeros(positions, dtype=np.int64),
    )
    _fill(fixed, state, scratch_of(state))
    return state


def counts_of(state: State, axes: int) -> np.ndarray:
    """Landmarks covered at each position and each of so many `axes`, `(Q, axes)`."""
    digits = unpacked(state.counts.transpose(2, 0, 1), axes)
    counts = np.zeros(digits.shape[1:], dtype=np.int16)
    for digit in digits[::-1]:
        counts = 2 * counts + digit
    return counts
