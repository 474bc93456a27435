"""The Metropolis walk of simulated annealing: one landmark moves at a time on a smoothed objective.

The objective counts positions whose P_n reaches thold_p: a staircase that hides whether a move nearly qualified a
position. The walk climbs a smooth stand-in, the relevance-weighted mean over positions of

    1 / (1 + exp(-(P_n - thold_p - margin) / width)) + share * P_n,

and keeps the deployment that is best on the true objective. As `width` shrinks the two become the same.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lmd.coverage.incremental import move
from lmd.coverage.kernels import PROBABILITY_ONE
from lmd.room import Room


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
    """The true objective: what qualifies a position (units of P_n), and its weight `(P,)`, with mean 1."""

    threshold: int
    relevance: np.ndarray


class Climate(NamedTuple):
    """How the walk behaves while conditions last.

    temperature: loss (in the smoothed objective) accepted with probability 1/e; width, margin and share shape the
    smoothed objective; step: standard deviation of a local move, metres; jump: probability of a move to anywhere;
    join: probability of a move next to another landmark, at a distance of about `near` metres.
    """

    temperature: float
    width: float
    margin: float
    share: float
    step: float
    jump: float
    join: float
    near: float


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
def _propose(k, state, walls, climate, rng):
    """A new place for landmark k, flush on a wall: index of the wall and wall coordinates."""
    kind = rng.random()
    wall, last = 0, len(walls.shares) - 1
    if kind < climate.jump:
        drawn = rng.random()
        while wall < last and drawn > walls.shares[wall]:
            wall += 1
        return wall, rng.random() * walls.extent[wall, 0], rng.random() * walls.extent[wall, 1]
    near, step = k, climate.step
    if kind < climate.jump + climate.join:
        near, step = int(rng.random() * state.landmarks.shape[1]), climate.near
    facing = -2.0
    for w in range(last + 1):
        cosine = 0.0
        for i in range(3):
            cosine += walls.normal[w, i] * state.normals[i, near]
        if cosine > facing:
            wall, facing = w, cosine
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = state.landmarks[i, near] - walls.origin[wall, i]
        a += offset * walls.u[wall, i]
        b += offset * walls.v[wall, i]
    return wall, _reflect(a, walls.extent[wall, 0]), _reflect(b, walls.extent[wall, 1])


@njit(nogil=True, cache=True)
def _value(units, threshold, climate):
    """The smoothed objective at one position."""
    above = (units - threshold) / PROBABILITY_ONE - climate.margin
    return 1.0 / (1.0 + math.exp(-above / climate.width)) + climate.share * units / PROBABILITY_ONE


@njit(nogil=True, cache=True)
def walk(moves, fixed, state, scratch, goal, walls, climate, rng, best):
    """Try `moves` moves from `state`, which ends where the walk ends; `best` is updated."""
    before, threshold, relevance = state.units, goal.threshold, goal.relevance
    positions, count = len(before), state.landmarks.shape[1]
    units, value, trial = np.empty_like(before), np.empty(positions), np.empty(positions)
    total = 0.0
    for p in range(positions):
        value[p] = relevance[p] * _value(before[p], threshold, climate)
        total += value[p]
    for _ in range(moves):
        k = int(rng.random() * count)
        wall, a, b = _propose(k, state, walls, climate, rng)
        x = walls.origin[wall, 0] + a * walls.u[wall, 0] + b * walls.v[wall, 0]
        y = walls.origin[wall, 1] + a * walls.u[wall, 1] + b * walls.v[wall, 1]
        z = walls.origin[wall, 2] + a * walls.u[wall, 2] + b * walls.v[wall, 2]
        nx, ny, nz = walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2]
        move(k, x, y, z, nx, ny, nz, fixed, state, scratch, units, False)
        sum_value = fitness = 0.0
        for p in range(positions):
            trial[p] = value[p]
            if units[p] != before[p]:
                trial[p] = relevance[p] * _value(units[p], threshold, climate)
            sum_value += trial[p]
            fitness += relevance[p] * (units[p] >= threshold)
        gain = (sum_value - total) / positions
        if gain >= 0.0 or rng.random() < math.exp(gain / climate.temperature):
            move(k, x, y, z, nx, ny, nz, fixed, state, scratch, units, True)
            value, trial, total = trial, value, sum_value
            if fitness > best.fitness[0]:
                best.fitness[0] = fitness
                best.landmarks[:] = state.landmarks
                best.normals[:] = state.normals
