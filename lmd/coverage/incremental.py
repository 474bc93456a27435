"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed.

A moved landmark changes the counts at a position in at most four ways: its old cap goes, caps it used to hide come
back, caps it now hides go, its new cap comes. Everything else at that position, and every position where none of
the four happens, stays as it is. The decisions are those of `kernels`, operation by operation, so after any sequence
of moves the counts equal a full evaluation's, bit for bit.

A *trial* works on a copy of the counts of one position at a time and changes nothing; *commit* repeats an accepted
move on the state itself. Both run the same code.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lmd.coverage.evaluator import Evaluator
from lmd.coverage.kernels import _PAPER, _band, count_at, units_of
from lmd.deployment import Deployment
from lmd.visibility import TOLERANCE


class Fixed(NamedTuple):
    """What does not change while landmarks move; the arguments of the kernels, see `kernels.counts_in_range`."""

    positions: np.ndarray
    limits: np.ndarray
    reach: float
    mode: int
    axes: np.ndarray
    index: np.ndarray
    weights: np.ndarray
    n: int


class State(NamedTuple):
    """Coverage of one deployment.

    landmarks, normals `(3, K)`; counts `(P, D)` landmarks covered per position and axis; reachable `(P, K)` whether
    a landmark faces a position within reach of the camera; hidden `(P, K)` how many others hide it; units `(P,)` P_n.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    counts: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    units: np.ndarray


class Scratch(NamedTuple):
    """Working memory: a row of counts `(1, D)`, and who hides or is hidden `(K,)`, before and after a move."""

    counts: np.ndarray
    hid: np.ndarray
    hides: np.ndarray
    hidden_by: np.ndarray


@njit(nogil=True, cache=True)
def reaches(x, y, z, nx, ny, nz, limits):
    """`kernels._reachable` for a landmark at offset (x, y, z) from the camera."""
    distance = np.sqrt(x * x + y * y + z * z)
    if distance * limits[0] > limits[2] or distance * (1.0 + TOLERANCE) < limits[1]:
        return False
    return -(nx * x + ny * y + nz * z) > TOLERANCE * distance


@njit(nogil=True, cache=True)
def change_cap(x, y, z, sign, limits, axes, index, weights, n, counts, row):
    """Add (sign 1) or remove (-1) the cap of the landmark at offset (x, y, z) in `counts[row]`.

    Returns the change of P_n in units.
    """
    distance = np.sqrt(x * x + y * y + z * z)
    low, high = max(distance * limits[0], limits[1]), limits[2]
    first, last = _band(z / distance, low / distance, index)
    crossing = n - 1 if sign > 0 else n
    change = np.int64(0)
    for a in range(np.uint64(first), np.uint64(last)):
        depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
        inside = (depth >= low) & (depth <= high)
        count = counts[row, a]
        change += weights[a] * (inside & (count == crossing))
        counts[row, a] = count + sign * inside
    return sign * change


@njit(nogil=True, cache=True)
def _flag_hiding(px, py, pz, x, y, z, landmarks, reach, mode, hides, hidden_by):
    """Which landmarks the one at offset (x, y, z) hides, and which hide it, seen from (px, py, pz).

    Fills `hides` and `hidden_by` `(K,)` and returns how many entries are set in each.
    """
    squared = x * x + y * y + z * z
    bound, further = reach * squared, squared * (1.0 + TOLERANCE)
    count_hides = count_hidden = 0
    for i in range(landmarks.shape[1]):
        ox, oy, oz = landmarks[0, i] - px, landmarks[1, i] - py, landmarks[2, i] - pz
        other = ox * ox + oy * oy + oz * oz
        cx = oy * z - oz * y
        cy = oz * x - ox * z
        cz = ox * y - oy * x
        cross = cx * cx + cy * cy + cz * cz
        a, b = cross <= reach * other, cross <= bound
        if mode != _PAPER:
            in_front = x * ox + y * oy + z * oz > 0.0
            a = a & in_front & (squared <= other * (1.0 + TOLERANCE))
            b = b & in_front & (other <= further)
        hides[i], hidden_by[i] = a, b
        count_hides += a
        count_hidden += b
    return count_hides, count_hidden


@njit(nogil=True, cache=True, inline="always")
def shift(
    p, k, ax, ay, az, nx, ny, nz, positions, limits, reach, mode, axes, index, weights, n,
    landmarks, reachable, hidden, hid, hides, hidden_by, counts, row, commit,
):  # fmt: skip
    """Change of P_n (units) at position p when landmark k moves to (ax, ay, az) with normal (nx, ny, nz).

    `counts[row]` is what is changed: a copy for a trial, the state's own row when `commit` is set, which also updates
    `hidden` and `reachable` (but not `landmarks`, `normals` and `units`, shared by all positions).
    """
    px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
    x, y, z = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
    x1, y1, z1 = ax - px, ay - py, az - pz
    reached = reaches(x1, y1, z1, nx, ny, nz, limits)
    change = np.int64(0)
    if reachable[p, k] and hidden[p, k] == 0:
        change += change_cap(x, y, z, -1, limits, axes, index, weights, n, counts, row)
    blocked = 0
    if mode:
        count_hid, _ = _flag_hiding(px, py, pz, x, y, z, landmarks, reach, mode, hid, hidden_by)
        count_hides, blocked = _flag_hiding(px, py, pz, x1, y1, z1, landmarks, reach, mode, hides, hidden_by)
        blocked -= hidden_by[k]  # where it was before it moved
        if count_hid > hid[k] or count_hides > hides[k]:
            for i in range(landmarks.shape[1]):
                if i == k or hid[i] == hides[i]:
                    continue
                before = hidden[p, i]
                after = before - 1 if hid[i] else before + 1
                if reachable[p, i] and (before == 0 or after == 0):
                    ox, oy, oz = landmarks[0, i] - px, landmarks[1, i] - py, landmarks[2, i] - pz
                    sign = 1 if after == 0 else -1
                    change += change_cap(ox, oy, oz, sign, limits, axes, index, weights, n, counts, row)
                if commit:
                    hidden[p, i] = after
    if reached and blocked == 0:
        change += change_cap(x1, y1, z1, 1, limits, axes, index, weights, n, counts, row)
    if commit:
        hidden[p, k] = blocked
        reachable[p, k] = reached
    return change


@njit(nogil=True, cache=True)
def trial(k, ax, ay, az, nx, ny, nz, fixed, state, scratch, units):
    """Write P_n in units at every position, as it would be with landmark k at (ax, ay, az), into `units` `(P,)`."""
    # Unpacked once: reading an array out of a tuple in the loop costs an atomic reference count.
    positions, limits, reach, mode, axes, index, weights, n = fixed
    landmarks, _, counts, reachable, hidden, before = state
    row, hid, hides, hidden_by = scratch
    for p in range(len(units)):
        for a in range(counts.shape[1]):  # a slice assignment would take ten times as long
            row[0, a] = counts[p, a]
        units[p] = before[p] + shift(
            p, k, ax, ay, az, nx, ny, nz, positions, limits, reach, mode, axes, index, weights, n,
            landmarks, reachable, hidden, hid, hides, hidden_by, row, 0, False,
        )  # fmt: skip


@njit(nogil=True, cache=True)
def commit(k, ax, ay, az, nx, ny, nz, fixed, state, scratch):
    """Move landmark k to (ax, ay, az) with normal (nx, ny, nz)."""
    positions, limits, reach, mode, axes, index, weights, n = fixed
    landmarks, normals, counts, reachable, hidden, units = state
    _, hid, hides, hidden_by = scratch
    for p in range(len(units)):
        units[p] += shift(
            p, k, ax, ay, az, nx, ny, nz, positions, limits, reach, mode, axes, index, weights, n,
            landmarks, reachable, hidden, hid, hides, hidden_by, counts, p, True,
        )  # fmt: skip
    landmarks[0, k], landmarks[1, k], landmarks[2, k] = ax, ay, az
    normals[0, k], normals[1, k], normals[2, k] = nx, ny, nz


@njit(nogil=True, cache=True)
def _fill(fixed, state):
    """Compute counts, reachable, hidden and units of `state` from its landmarks."""
    count = state.landmarks.shape[1]
    offset = np.empty((5, count))
    row = np.empty(state.counts.shape[1], dtype=np.int32)
    flags = np.empty((2, count), dtype=np.uint8)
    for p in range(len(state.units)):
        position = fixed.positions[p]
        count_at(
            position, state.landmarks, state.normals, fixed.limits, fixed.reach, fixed.mode, fixed.axes,
            fixed.index, offset, row,
        )  # fmt: skip
        state.counts[p] = row
        state.units[p] = units_of(row, fixed.weights, fixed.n)
        for k in range(count):
            x, y, z = offset[0, k], offset[1, k], offset[2, k]
            normal = state.normals[:, k]
            state.reachable[p, k] = reaches(x, y, z, normal[0], normal[1], normal[2], fixed.limits)
            if fixed.mode:
                _, by = _flag_hiding(
                    position[0], position[1], position[2], x, y, z, state.landmarks, fixed.reach, fixed.mode,
                    flags[0], flags[1],
                )  # fmt: skip
                state.hidden[p, k] = by - flags[1, k]


def fixed_of(evaluator: Evaluator, n: int) -> Fixed:
    """The fixed part of an evaluator's scene."""
    e = evaluator
    return Fixed(e.positions, e.limits, e.reach, e.mode, e.axes, e.index, e.weights, n)


def state_of(fixed: Fixed, deployment: Deployment) -> State:
    """The coverage of `deployment`, ready for moves."""
    positions, count, axes = len(fixed.positions), len(deployment), fixed.axes.shape[1]
    state = State(
        landmarks=np.ascontiguousarray(deployment.positions.T),
        normals=np.ascontiguousarray(deployment.normals.T),
        counts=np.zeros((positions, axes), dtype=np.int16),
        reachable=np.zeros((positions, count), dtype=np.bool_),
        hidden=np.zeros((positions, count), dtype=np.int16),
        units=np.zeros(positions, dtype=np.int64),
    )
    _fill(fixed, state)
    return state


def scratch_of(state: State) -> Scratch:
    """Working memory for trials on `state`."""
    flags = np.empty((3, state.landmarks.shape[1]), dtype=np.uint8)
    return Scratch(np.empty_like(state.counts[:1]), flags[0], flags[1], flags[2])
