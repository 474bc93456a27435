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
from lmd.coverage.kernels import OCCLUSION_CODES, band_of, evaluate_range
from lmd.deployment import Deployment
from lmd.visibility import TOLERANCE

_LINE_OF_SIGHT = OCCLUSION_CODES["line_of_sight"]


class Fixed(NamedTuple):
    """What does not change while landmarks move; the arguments of `kernels.evaluate_range`."""

    positions: np.ndarray
    limits: np.ndarray
    reach: float
    mode: int
    axes: np.ndarray
    bands: np.ndarray
    weights: np.ndarray
    n: int


class State(NamedTuple):
    """Coverage of one deployment.

    landmarks, normals `(3, K)`; counts `(P, D)` landmarks covered per position and axis; reachable `(P, K)` whether
    a landmark faces a position within reach of the camera; hidden `(P, K)` how many others hide it, hiding `(P, K)` how
    many others it hides; units `(P,)` P_n.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    counts: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    hiding: np.ndarray
    units: np.ndarray


class Scratch(NamedTuple):
    """Working memory: a row of counts `(D,)`, and who hides or is hidden `(K,)`, before and after a move."""

    counts: np.ndarray
    hid: np.ndarray
    hidden_by_then: np.ndarray
    hides: np.ndarray
    hidden_by: np.ndarray


@njit(nogil=True, cache=True)
def reaches(x, y, z, nx, ny, nz, limits):
    """Whether a landmark at offset (x, y, z) faces the camera and some depth up to its distance is in limits."""
    distance = np.sqrt(x * x + y * y + z * z)
    if distance * limits[0] > limits[2] or distance * (1.0 + TOLERANCE) < limits[1]:
        return False
    return -(nx * x + ny * y + nz * z) > TOLERANCE * distance


@njit(nogil=True, cache=True)
def change_cap(x, y, z, sign, limits, axes, bands, weights, n, counts):
    """Add (sign 1) or remove (-1) the cap of the landmark at offset (x, y, z) in `counts` `(D,)`.

    Returns the change of P_n in units.
    """
    distance = np.sqrt(x * x + y * y + z * z)
    low, high = max(distance * limits[0], limits[1]), limits[2]
    first, last = band_of(z / distance, low / distance, bands)
    crossing = n - 1 if sign > 0 else n
    change = np.int64(0)
    for a in range(np.uint64(first), np.uint64(last)):
        depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
        inside = (depth >= low) & (depth <= high)
        count = counts[a]
        change += weights[a] if inside & (count == crossing) else 0
        counts[a] = count + sign if inside else count
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
        if mode == _LINE_OF_SIGHT:
            in_front = x * ox + y * oy + z * oz > 0.0
            a = a & in_front & (squared <= other * (1.0 + TOLERANCE))
            b = b & in_front & (other <= further)
        hides[i], hidden_by[i] = a, b
        count_hides += a
        count_hidden += b
    return count_hides, count_hidden


@njit(nogil=True, cache=True)
def move(k, ax, ay, az, nx, ny, nz, fixed, state, scratch, units, commit):
    """Write P_n in units with landmark k at (ax, ay, az) and normal (nx, ny, nz) into `units` `(P,)`.

    A trial leaves `state` as it is; with `commit` the landmark really moves.
    """
    # Unpacked once, and the loop body not split into functions: passing an array on costs an atomic reference count.
    positions, limits, reach, mode, axes, bands, weights, n = fixed
    landmarks, normals, counts, reachable, hidden, hiding, before = state
    row, hid, hidden_by_then, hides, hidden_by = scratch
    count = landmarks.shape[1]
    for i in range(count):
        hid[i] = hidden_by_then[i] = False
    for p in range(len(units)):
        px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
        x, y, z = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
        x1, y1, z1 = ax - px, ay - py, az - pz
        leaves = reachable[p, k] and hidden[p, k] == 0
        comes = reached = reaches(x1, y1, z1, nx, ny, nz, limits)
        blocked, others, known = 0, False, False
        if mode:
            # Most landmarks hide nothing and are hidden by nothing: then there is nothing to find out again.
            known = hiding[p, k] > 0 or (commit and hidden[p, k] > 0)
            if known:
                _flag_hiding(px, py, pz, x, y, z, landmarks, reach, mode, hid, hidden_by_then)
            count_hides, blocked = _flag_hiding(px, py, pz, x1, y1, z1, landmarks, reach, mode, hides, hidden_by)
            # Not itself, where it was before it moved.
            count_hides -= hides[k]
            blocked -= hidden_by[k]
            comes = reached and blocked == 0
            others = hiding[p, k] > 0 or count_hides > 0
        units[p] = before[p]
        if leaves or comes or others:
            for a in range(counts.shape[1]):  # a slice assignment would take ten times as long
                row[a] = counts[p, a]
            if leaves:
                units[p] += change_cap(x, y, z, -1, limits, axes, bands, weights, n, row)
            if others:
                for i in range(count):
                    if i == k or hid[i] == hides[i]:
                        continue
                    was = hidden[p, i]
                    now = was - 1 if hid[i] else was + 1
                    if reachable[p, i] and (was == 0 or now == 0):
                        ox, oy, oz = landmarks[0, i] - px, landmarks[1, i] - py, landmarks[2, i] - pz
                        sign = 1 if now == 0 else -1
                        units[p] += change_cap(ox, oy, oz, sign, limits, axes, bands, weights, n, row)
                    if commit:
                        hidden[p, i] = now
            if comes:
                units[p] += change_cap(x1, y1, z1, 1, limits, axes, bands, weights, n, row)
            if commit:
                for a in range(counts.shape[1]):
                    counts[p, a] = row[a]
        if commit:
            hidden[p, k], reachable[p, k], before[p] = blocked, reached, units[p]
            if mode:
                if known or blocked > 0:
                    for i in range(count):
                        hiding[p, i] += hidden_by[i] - hidden_by_then[i]
                hiding[p, k] = count_hides
        if known:
            for i in range(count):
                hid[i] = hidden_by_then[i] = False
    if commit:
        landmarks[0, k], landmarks[1, k], landmarks[2, k] = ax, ay, az
        normals[0, k], normals[1, k], normals[2, k] = nx, ny, nz


@njit(nogil=True, cache=True)
def _fill(fixed, state):
    """Compute `reachable`, `hidden` and `hiding` of `state` from its landmarks."""
    positions, limits, reach, mode, _, _, _, _ = fixed
    landmarks, normals, _, reachable, hidden, hiding, _ = state
    count = landmarks.shape[1]
    hides, hidden_by = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)
    for p in range(len(positions)):
        px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
        for k in range(count):
            x, y, z = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
            reachable[p, k] = reaches(x, y, z, normals[0, k], normals[1, k], normals[2, k], limits)
            if mode:
                count_hides, by = _flag_hiding(px, py, pz, x, y, z, landmarks, reach, mode, hides, hidden_by)
                hiding[p, k], hidden[p, k] = count_hides - hides[k], by - hidden_by[k]


def fixed_of(evaluator: Evaluator, n: int) -> Fixed:
    """The fixed part of an evaluator's scene."""
    e = evaluator
    return Fixed(e.positions, e.limits, e.reach, e.mode, e.axes, e.bands, e.weights, n)


def state_of(fixed: Fixed, deployment: Deployment) -> State:
    """The coverage of `deployment`, ready for moves."""
    positions, count, axes = len(fixed.positions), len(deployment), fixed.axes.shape[1]
    state = State(
        landmarks=deployment.positions.T.copy(order="C"),
        normals=deployment.normals.T.copy(order="C"),
        counts=np.zeros((positions, axes), dtype=np.int16),
        reachable=np.zeros((positions, count), dtype=np.bool_),
        hidden=np.zeros((positions, count), dtype=np.int16),
        hiding=np.zeros((positions, count), dtype=np.int16),
        units=np.zeros(positions, dtype=np.int64),
    )
    evaluate_range(0, positions, fixed.positions, state.landmarks[None], state.normals[None], *fixed[1:],
                   state.units[None], state.counts[None], True)  # fmt: skip
    _fill(fixed, state)
    return state


def scratch_of(state: State) -> Scratch:
    """Working memory for trials on `state`."""
    flags = np.empty((4, state.landmarks.shape[1]), dtype=np.bool_)
    return Scratch(np.empty_like(state.counts[0]), *flags)
