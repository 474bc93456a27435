"""The Metropolis walk of simulated annealing: landmarks move, one or a few at a time, on a smoothed objective.

The objective counts positions whose P_n reaches thold_p: a staircase that hides whether a move nearly qualified a
position. The walk climbs a smooth stand-in, the relevance-weighted mean over positions of

    1 / (1 + exp(-(P_n - thold_p - margin) / width)) + share * P_n,

and keeps the deployment that is best on the true objective. As `width` shrinks the two become the same.

Most moves are rejected, and most of these before they are tried exactly: the objective rises with every P_n, so with
P_n at most what `bound_move` finds, it bounds the gain. If that is a loss, so is the gain, and the random number that
decides is drawn at once. If even the bound is rejected, the gain would be too; otherwise the gain and the same number
decide. So neither decisions nor random numbers depend on the bound.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lmd.sight.incremental.move import carry_out, move, take_back
from lmd.sight.incremental.trial import bound_move, finish_move
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.space.cuboid import Room

# Relative, for the bound: exp may fall by a rounding error or two where its argument rises.
_SLACK = 1e-12


class Walls(NamedTuple):
    """The walls that may carry landmarks as arrays: origin, u, v, normal `(W, 3)`, extent `(W, 2)`, shares `(W,)`.

    `shares` is the cumulative share of the area, for drawing a wall.
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    normal: np.ndarray
    extent: np.ndarray
    shares: np.ndarray


class Goal(NamedTuple):
    """The true objective: what qualifies a position (units of P_n), and the weight of each, `(Q,)`, with sum 1."""

    threshold: int
    relevance: np.ndarray


class Climate(NamedTuple):
    """How the walk behaves while conditions last.

    temperature: loss (in the smoothed objective) accepted with probability 1/e; width, margin and share shape the
    smoothed objective; step: standard deviation of a local move, metres; jump: probability of a move to anywhere;
    join: probability of a move next to another landmark, at a distance of about `near` metres; together: probability
    that a landmark takes its n - 1 nearest neighbours along, unchanged among themselves.
    """

    temperature: float
    width: float
    margin: float
    share: float
    step: float
    jump: float
    join: float
    near: float
    together: float


class Best(NamedTuple):
    """The best deployment met: fitness `(1,)` (sum of relevance), landmarks and normals `(3, K)`."""

    fitness: np.ndarray
    landmarks: np.ndarray
    normals: np.ndarray


def walls_of(room: Room) -> Walls:
    """The walls of a room that may carry landmarks."""
    walls = room.landmark_walls()
    area = np.array([wall.area for wall in walls])
    origin, u, v, normal, extent = (
        np.array([getattr(wall, name) for wall in walls]) for name in ("origin", "u", "v", "normal", "extent")
    )
    return Walls(origin, u, v, normal, extent, np.cumsum(area / area.sum()))


@njit(nogil=True, cache=True)
def _reflect(value, extent):
    """Fold a coordinate that left [0, extent] back into it."""
    value = abs(value) % (2.0 * extent)
    return 2.0 * extent - value if value > extent else value


@njit(nogil=True, cache=True)
def _wall_of(k, state, walls):
    """Index of the wall that landmark k faces away from."""
    wall, facing = 0, -2.0
    for w in range(len(walls.shares)):
        cosine = 0.0
        for i in range(3):
            cosine += walls.normal[w, i] * state.normals[i, k]
        if cosine > facing:
            wall, facing = w, cosine
    return wall


@njit(nogil=True, cache=True)
def _propose(k, state, walls, climate, rng):
    """A new place for landmark k, flush on a wall: index of the wall and wall coordinates."""
    kind = rng.random()
    if kind < climate.jump:
        wall, drawn = 0, rng.random()
        while wall < len(walls.shares) - 1 and drawn > walls.shares[wall]:
            wall += 1
        return wall, rng.random() * walls.extent[wall, 0], rng.random() * walls.extent[wall, 1]
    near, step = k, climate.step
    if kind < climate.jump + climate.join:
        near, step = int(rng.random() * state.landmarks.shape[1]), climate.near
    wall = _wall_of(near, state, walls)
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = state.landmarks[i, near] - walls.origin[wall, i]
        a += offset * walls.u[wall, i]
        b += offset * walls.v[wall, i]
    return wall, _reflect(a, walls.extent[wall, 0]), _reflect(b, walls.extent[wall, 1])


@njit(nogil=True, cache=True)
def _gather(k, state, group):
    """Fill `group` with landmark k and its nearest neighbours."""
    group[0] = k
    for m in range(1, len(group)):
        nearest = np.inf
        for j in range(state.landmarks.shape[1]):
            distance = 0.0
            for i in range(3):
                distance += (state.landmarks[i, j] - state.landmarks[i, k]) ** 2
            taken = False
            for other in group[:m]:
                taken = taken or other == j
            if distance < nearest and not taken:
                nearest, group[m] = distance, j


@njit(nogil=True, cache=True)
def _places(group, state, walls, climate, rng, new):
    """Write where the landmarks of `group` shall go, `(len(group), 6)`: position and normal.

    The first goes to a proposed place, the others keep their offset from it in wall coordinates.
    """
    k = group[0]
    before = _wall_of(k, state, walls)
    wall, a, b = _propose(k, state, walls, climate, rng)
    for m in range(len(group)):
        da = db = 0.0
        for i in range(3):
            offset = state.landmarks[i, group[m]] - state.landmarks[i, k]
            da += offset * walls.u[before, i]
            db += offset * walls.v[before, i]
        am, bm = _reflect(a + da, walls.extent[wall, 0]), _reflect(b + db, walls.extent[wall, 1])
        for i in range(3):
            new[m, i] = walls.origin[wall, i] + am * walls.u[wall, i] + bm * walls.v[wall, i]
            new[m, 3 + i] = walls.normal[wall, i]


@njit(nogil=True, cache=True)
def _bound(k, place, fixed, state, scratch):
    """`bound_move` to a row of `_places`."""
    bound_move(k, place[0], place[1], place[2], place[3], place[4], place[5], fixed, state, scratch)


@njit(nogil=True, cache=True)
def _move(k, place, fixed, state, scratch):
    """`move` to a row of `_places`."""
    move(k, place[0], place[1], place[2], place[3], place[4], place[5], fixed, state, scratch)


@njit(nogil=True, cache=True)
def _value(units, threshold, climate):
    """The smoothed objective at one position."""
    above = (units - threshold) / PROBABILITY_ONE - climate.margin
    return 1.0 / (1.0 + math.exp(-above / climate.width)) + climate.share * units / PROBABILITY_ONE


@njit(nogil=True, cache=True)
def _sum_values(units, accepted, value, goal, climate, trial):
    """The smoothed objective for `units`, its terms in `trial`; `value` has those for `accepted`."""
    total = 0.0
    for p in range(len(units)):
        trial[p] = value[p]
        if units[p] != accepted[p]:
            trial[p] = goal.relevance[p] * _value(units[p], goal.threshold, climate)
        total += trial[p]
    return total


@njit(nogil=True, cache=True)
def _keep_best(state, goal, best):
    """Update `best` if `state` is better."""
    fitness = 0.0
    for p in range(len(state.units)):
        fitness += goal.relevance[p] * (state.units[p] >= goal.threshold)
    if fitness > best.fitness[0]:
        best.fitness[0] = fitness
        best.landmarks[:] = state.landmarks
        best.normals[:] = state.normals


@njit(nogil=True, cache=True)
def walk(moves, fixed, state, scratches, goal, walls, climate, rng, best):
    """Move landmarks `moves` times from `state`, which ends where the walk ends; `best` is updated.

    scratches: as many as landmarks can move together.
    """
    positions, count = len(state.units), state.landmarks.shape[1]
    accepted = state.units.copy()
    value, trial = np.empty(positions), np.empty(positions)
    single, several = np.empty(1, dtype=np.int64), np.empty(len(scratches), dtype=np.int64)
    new = np.empty((len(several), 6))
    total = 0.0
    for p in range(positions):
        value[p] = goal.relevance[p] * _value(accepted[p], goal.threshold, climate)
        total += value[p]
    moved = 0
    while moved < moves:
        group = single
        group[0] = int(rng.random() * count)
        if moves - moved >= len(several) > 1 and rng.random() < climate.together:
            _gather(group[0], state, several)
            group = several
        last = len(group) - 1
        moved += last + 1
        scratch = scratches[last]
        units = scratch.units
        _places(group, state, walls, climate, rng, new)
        for m in range(last):
            _move(group[m], new[m], fixed, state, scratches[m])
        _bound(group[last], new[last], fixed, state, scratch)
        most = _sum_values(units, accepted, value, goal, climate, trial) - total + _SLACK * (1.0 + climate.share)
        drawn = rng.random() if most < 0.0 else -1.0
        taken = drawn < math.exp(min(most, 0.0) / climate.temperature) * (1.0 + _SLACK)
        if taken:
            finish_move(group[last], fixed, state, scratch)
            sum_value = _sum_values(units, accepted, value, goal, climate, trial)
            gain = sum_value - total
            if gain < 0.0 <= most:
                drawn = rng.random()
            taken = gain >= 0.0 or drawn < math.exp(gain / climate.temperature)
        if taken:
            carry_out(group[last], fixed, state, scratch)
            accepted[:] = state.units
            value, trial, total = trial, value, sum_value
            _keep_best(state, goal, best)
        else:
            for m in range(last - 1, -1, -1):
                take_back(group[m], fixed, state, scratches[m])
