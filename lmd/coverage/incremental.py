"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed.

A moved landmark changes the counts at a position in at most four ways: its old cap goes, caps it used to hide come
back, caps it now hides go, its new cap comes. Everything else at that position, and every position where none of
the four happens, stays as it is. The decisions are those of `kernels`, operation by operation, so after any sequence
of moves the counts equal a full evaluation's, bit for bit.

Sets of axes are bits. The caps of all landmarks where they are, and at each position the axes one landmark short of n
and those with just n, are known beforehand. So a *trial* tests few axes. On the paper's problem, one local move:

1. `see`: what is seen of the new place from all 756 positions, without a branch, so that the loop vectorises.
2. `find_flips`: who hides whom. 250 of 4,320 pairs of landmark and block of positions need the exact test, 10 pass, and
   another landmark appears or disappears at 29 positions.
3. `_try_caps`, at the 290 other positions that see the old or the new place: P_n changes only at an axis that is one
   short and not in the old cap, or has just n and is in it. With the tables of `cones`, of 35,000 axes in bands of
   height 670 are left for the exact test.
4. `_try_flips`, at the positions of step 2: counts, as binary digits of whole sets, with the caps added or taken away.

`carry_out` makes the last trial true: it alone needs the new cap with all its axes.
"""

import numpy as np
from numba import njit

from lmd.coverage.bits import ALL, BITS, NONE, ONE, lowest, unpacked
from lmd.coverage.cones import NOWHERE, see
from lmd.coverage.kernels import BLOCK
from lmd.coverage.neighbours import blocks_with, find_flips, find_neighbours
from lmd.coverage.state import Fixed, State, scratch_of
from lmd.deployment import Deployment

# Indices are unsigned where it counts: signed ones cost extra instructions, as they might be negative.


@njit(nogil=True, cache=True, error_model="numpy")
def _try_caps(k, fixed, state, scratch):
    """Find P_n where landmark k comes or goes and no other does; copy it where nothing happens."""
    axes, weights, max_depth = fixed.axes, fixed.weights, fixed.limits[2]
    certain, possible = fixed.certain, fixed.possible
    caps, reachable, hidden, short, just, before = (
        state.caps, state.reachable, state.hidden, state.short, state.just, state.units
    )  # fmt: skip
    x, y, z, low, cell, limited, reached = scratch.new
    count_hidden, flips, units = scratch.after.count_hidden, scratch.flips, scratch.units
    old, inner, outer = scratch.mask, scratch.inner, scratch.outer
    listed, unsure, places = scratch.listed, scratch.unsure, scratch.places
    for p in range(np.uint64(len(units))):
        units[p] = before[p]
        seen = reached[p] & (count_hidden[p] == 0) & (not flips[p])
        outer[p] = cell[p] if seen else NOWHERE
        inner[p] = cell[p] if seen & (not limited[p]) else NOWHERE
        old[p] = ALL if reachable[k, p] & (hidden[k, p] == 0) & (not flips[p]) else NONE
    count, found, size = NONE, NONE, np.uint64(caps.shape[2])
    for p in range(np.uint64(len(units))):
        listed[count] = p
        count += np.uint64((old[p] != NONE) | (outer[p] != NOWHERE))
    for m in range(count):
        p = listed[m]
        i, o = np.uint64(inner[p]), np.uint64(outer[p])
        for w in range(size):
            was = caps[k, p, w] & old[p]
            unsure[found] = (short[p, w] & ~was & possible[o, w]) | (just[p, w] & was & ~certain[i, w])
            places[found] = p * size + w
            found += np.uint64(unsure[found] != NONE)
    for m in range(found):
        left, p = unsure[m], places[m] // size
        w = places[m] - p * size
        px, py, pz, least = x[p], y[p], z[p], low[p] if outer[p] != NOWHERE else np.inf
        was = caps[k, p, w] & old[p]
        while left:
            bit = lowest(left)
            a = w * np.uint64(BITS) + bit
            depth = axes[0, a] * px + axes[1, a] * py + axes[2, a] * pz
            inside = (depth >= least) & (depth <= max_depth)
            units[p] += weights[a] * (np.int64(inside) - np.int64(was >> bit & ONE))
            left &= left - ONE


@njit(nogil=True, cache=True, error_model="numpy")
def _try_flips(k, positions, fixed, state, scratch):
    """Find P_n at `positions`, where other landmarks appear or disappear."""
    axes, weights, possible, n, max_depth = fixed.axes, fixed.weights, fixed.possible, fixed.n, fixed.limits[2]
    caps, reachable, hidden, counts, before = state.caps, state.reachable, state.hidden, state.counts, state.units
    x, y, z, low, cell, _, reached = scratch.new
    count_hidden, units, digits = scratch.after.count_hidden, scratch.units, scratch.digits
    names, goes = scratch.names, scratch.goes
    found, who, change = scratch.turns
    size = np.uint64(counts.shape[2])
    for p in positions:
        b, q = p // np.uint64(BLOCK), p % np.uint64(BLOCK)
        flipped = NONE
        for m in range(np.uint64(found[b])):
            i = np.uint64(who[b, m])
            was, now = hidden[i, p], hidden[i, p] + change[b, m, q]
            names[flipped], goes[flipped] = i, ALL if was == 0 else NONE
            flipped += np.uint64(reachable[i, p] & ((was == 0) != (now == 0)))
        names[flipped], goes[flipped] = k, ALL
        flipped += np.uint64(reachable[k, p] & (hidden[k, p] == 0))
        row = np.uint64(cell[p] if reached[p] & (count_hidden[p] == 0) else NOWHERE)
        px, py, pz, least = x[p], y[p], z[p], low[p]
        units[p] = before[p]
        for w in range(np.uint64(counts.shape[1])):
            # Whether counts are at least n: from the lowest digit up, each digit overrules those below.
            had, has, almost = ALL, ALL, ALL
            for j in range(size):
                digits[j] = counts[p, w, j]
                had = had & digits[j] if n >> j & 1 else had | digits[j]
            for m in range(flipped):  # added with a carry, or taken away with a borrow, digit by digit
                carry = caps[names[m], p, w]
                for j in range(size):
                    digit = digits[j]
                    digits[j] = digit ^ carry
                    carry &= digit ^ goes[m]
            for j in range(size):
                has = has & digits[j] if n >> j & 1 else has | digits[j]
                almost &= digits[j] if (n - 1) >> j & 1 else ~digits[j]
            left = almost & possible[row, w]
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                depth = axes[0, a] * px + axes[1, a] * py + axes[2, a] * pz
                has |= np.uint64((depth >= least) & (depth <= max_depth)) << bit
                left &= left - ONE
            left = had ^ has
            while left:
                bit = lowest(left)
                weight = weights[w * np.uint64(BITS) + bit]
                units[p] += weight if has >> bit & ONE else -weight
                left &= left - ONE


@njit(nogil=True, cache=True, error_model="numpy")
def _recount(k, positions, fixed, state, scratch):
    """Carry the last trial out on the caps of landmark k and the counts at `positions`."""
    axes, certain, possible, n, max_depth = fixed.axes, fixed.certain, fixed.possible, fixed.n, fixed.limits[2]
    caps, reachable, hidden, counts, short, just = (
        state.caps, state.reachable, state.hidden, state.counts, state.short, state.just
    )  # fmt: skip
    x, y, z, low, cell, limited, reached = scratch.new
    count_hidden, flips = scratch.after.count_hidden, scratch.flips
    found, who, change = scratch.turns
    size = np.uint64(counts.shape[2])
    for p in positions:
        b, q = p // np.uint64(BLOCK), p % np.uint64(BLOCK)
        shown = ALL if reachable[k, p] & (hidden[k, p] == 0) else NONE
        seen = ALL if reached[p] & (count_hidden[p] == 0) else NONE
        outer = np.uint64(cell[p] if reached[p] else NOWHERE)
        inner = np.uint64(cell[p] if reached[p] & (not limited[p]) else NOWHERE)
        px, py, pz, least = x[p], y[p], z[p], low[p]
        for w in range(np.uint64(counts.shape[1])):
            cap = certain[inner, w]
            left = possible[outer, w] & ~cap
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                depth = axes[0, a] * px + axes[1, a] * py + axes[2, a] * pz
                cap |= np.uint64((depth >= least) & (depth <= max_depth)) << bit
                left &= left - ONE
            old, new = caps[k, p, w] & shown, cap & seen
            caps[k, p, w] = cap
            comes, goes = new & ~old, old & ~new
            touched = comes | goes
            for j in range(size if touched else NONE):
                digit = counts[p, w, j]
                counts[p, w, j] = digit ^ (comes | goes)
                comes, goes = comes & digit, goes & ~digit
            for m in range(found[b] if flips[p] else 0):
                i = np.uint64(who[b, m])
                was, now = hidden[i, p], hidden[i, p] + change[b, m, q]
                if not (reachable[i, p] & ((was == 0) != (now == 0))):
                    continue
                carry, mask = caps[i, p, w], ALL if was == 0 else NONE
                touched |= carry
                for j in range(size):
                    digit = counts[p, w, j]
                    counts[p, w, j] = digit ^ carry
                    carry &= digit ^ mask
            if touched:
                one, two = ALL, ALL
                for j in range(size):
                    digit = counts[p, w, j]
                    one &= digit if (n - 1) >> j & 1 else ~digit
                    two &= digit if n >> j & 1 else ~digit
                short[p, w], just[p, w] = one, two


@njit(nogil=True, cache=True, error_model="numpy")
def try_move(k, ax, ay, az, nx, ny, nz, fixed, state, scratch):
    """Find P_n with landmark k at (ax, ay, az) and normal (nx, ny, nz): `scratch.units`. `state` stays as it is."""
    place, flips, listed = scratch.place, scratch.flips, scratch.listed
    place[0], place[1], place[2], place[3], place[4], place[5] = ax, ay, az, nx, ny, nz
    see(ax, ay, az, nx, ny, nz, fixed.positions, fixed.limits, scratch.new)
    if fixed.mode:
        find_flips(k, fixed, state, scratch)
    _try_caps(np.uint64(k), fixed, state, scratch)
    count = NONE
    for p in range(np.uint64(len(flips))):
        listed[count] = p
        count += np.uint64(flips[p])
    _try_flips(np.uint64(k), listed[:count], fixed, state, scratch)


@njit(nogil=True, cache=True, error_model="numpy")
def carry_out(k, fixed, state, scratch):
    """Move landmark k to where it was tried last; no other move may have been tried or carried out since."""
    landmarks, normals, reachable, hidden, hiding = (
        state.landmarks, state.normals, state.reachable, state.hidden, state.hiding
    )  # fmt: skip
    place, reached, flips, old = scratch.place, scratch.new.reached, scratch.flips, scratch.old
    listed, wanted, before, after = scratch.listed, scratch.wanted, scratch.before, scratch.after
    found, who, change = scratch.turns
    count = NONE
    for p in range(np.uint64(len(flips))):
        listed[count] = p
        count += np.uint64(reachable[k, p] | reached[p] | flips[p])
    _recount(np.uint64(k), listed[:count], fixed, state, scratch)
    state.units[:] = scratch.units
    if fixed.mode:
        blocks_with(hidden[k], wanted)  # nearly everywhere nothing hid it
        x, y, z = landmarks[0, k], landmarks[1, k], landmarks[2, k]
        find_neighbours(k, x, y, z, old[0], old[1], old[2], fixed, landmarks, wanted, scratch.ways, before)
        for b in range(len(found)):
            for q in range(BLOCK if found[b] + before.found[b] + after.found[b] else 0):
                p = b * BLOCK + q
                for m in range(found[b]):
                    hidden[who[b, m], p] += change[b, m, q]
                for m in range(before.found[b]):
                    hiding[before.who[b, m], p] -= before.hidden_by[b, m, q]
                for m in range(after.found[b]):
                    hiding[after.who[b, m], p] += after.hidden_by[b, m, q]
    for p in range(len(flips)):
        reachable[k, p], hidden[k, p], hiding[k, p] = reached[p], after.count_hidden[p], after.count_hides[p]
    for i in range(3):
        landmarks[i, k], normals[i, k] = place[i], place[3 + i]


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
        _recount(np.uint64(k), positions, fixed, state, scratch)
        state.reachable[k], state.hidden[k], state.hiding[k] = new.reached, after.count_hidden, after.count_hides


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
        units=np.empty(positions, dtype=np.int64),
    )
    _fill(fixed, state, scratch_of(state))
    state.units[:] = (counts_of(state, len(fixed.weights)) >= fixed.n) @ fixed.weights
    return state


def counts_of(state: State, axes: int) -> np.ndarray:
    """Landmarks covered at each position and each of so many `axes`, `(Q, axes)`."""
    digits = unpacked(state.counts.transpose(2, 0, 1), axes)
    counts = np.zeros(digits.shape[1:], dtype=np.int16)
    for digit in digits[::-1]:
        counts = 2 * counts + digit
    return counts
