"""The Metropolis walk of simulated annealing: landmarks move, one or a few at a time, on a smoothed objective.

An objective that counts positions whose value reaches a threshold is a staircase, which hides whether a move nearly
qualified a position. The walk climbs a smooth stand-in (`smoothed`); for coverage this is the relevance-weighted mean
over positions of

    1 / (1 + exp(-(P_n - thold_p - margin) / width)) + share * P_n.

It keeps the deployment that is best on the true objective (`worth`). As `width` shrinks the two become the same.

Most moves are rejected, and most of these before they are tried exactly: the objective rises with every value, so with
values at most what `bound` finds, it bounds the gain. If that is a loss, so is the gain, and the random number that
decides is drawn at once. If even the bound is rejected, the gain would be too; otherwise the gain and the same number
decide. So neither decisions nor random numbers depend on the bound.
"""

import math
from typing import NamedTuple

import numpy as np

from lmd.core.compiled import inner, kernel
from lmd.core.layers import layer
from lmd.incremental.field import accept, bound, lead, settle, smoothed, total_worth, undo
from lmd.space.allowed import allows, spread_one

# Relative, for the bound: exp may fall by a rounding error or two where its argument rises.
_SLACK = 1e-12


class Settings(NamedTuple):
    """How the walk behaves while conditions last."""

    temperature: float
    """Loss, in the smoothed objective, that is accepted with probability 1/e."""
    width: float
    """In value, over which the objective is smoothed."""
    margin: float
    """By which the smoothed threshold lies above the true one."""
    share: float
    """Of the value itself that is added."""
    step: float
    """Standard deviation of a local move, metres."""
    jump: float
    """Probability of a move to anywhere."""
    join: float
    """Probability of a move next to another landmark."""
    near: float
    """About how far from the other that is, metres."""
    together: float
    """Probability that a landmark takes its n - 1 nearest neighbours along, unchanged among themselves."""


class Best(NamedTuple):
    """The best deployment met: fitness `(1,)`, landmarks and normals `(3, K)`, surfaces `(K,)`."""

    fitness: np.ndarray
    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray


@inner
def _reflect(value, extent):
    """Fold a coordinate that left [0, extent] back into it."""
    value = abs(value) % (2.0 * extent)
    return 2.0 * extent - value if value > extent else value


@inner
def _propose(k, state, surfaces, settings, rng):
    """A new place for landmark k, flush on a surface: index of the surface and coordinates there."""
    kind = rng.random()
    if kind < settings.jump:
        t, drawn = 0, rng.random()
        while t < len(surfaces.shares) - 1 and drawn > surfaces.shares[t]:
            t += 1
        x, y, piece = rng.random(), rng.random(), surfaces.pieces[t]
        a, b = spread_one(piece[0], piece[1], piece[2], piece[3], piece[4], piece[5], x, y)
        return surfaces.of_piece[t], a, b
    near, step = k, settings.step
    if kind < settings.jump + settings.join:
        near, step = int(rng.random() * state.landmarks.shape[1]), settings.near
    s = state.surfaces[near]
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = state.landmarks[i, near] - surfaces.origin[s, i]
        a += offset * surfaces.u[s, i]
        b += offset * surfaces.v[s, i]
    return s, _reflect(a, surfaces.extent[s, 0]), _reflect(b, surfaces.extent[s, 1])


@inner
def _gather(k, members, state, group):
    """Fill `group` with landmark k and its nearest neighbours among the `members`."""
    group[0] = k
    for m in range(1, len(group)):
        nearest = np.inf
        for j in members:
            distance = 0.0
            for i in range(3):
                distance += (state.landmarks[i, j] - state.landmarks[i, k]) ** 2
            taken = False
            for other in group[:m]:
                taken = taken or other == j
            if distance < nearest and not taken:
                nearest, group[m] = distance, j


@inner
def propose(group, state, surfaces, settings, rng, new):
    """Write where the landmarks of `group` shall go, `(len(group), 6)`: position and normal.

    The first goes to a proposed place, the others keep their offset from it in surface coordinates.

    Returns:
        the surface, or -1 if one of the landmarks may not hang where it would go.
    """
    k = group[0]
    before = state.surfaces[k]
    s, a, b = _propose(k, state, surfaces, settings, rng)
    for m in range(len(group)):
        da = db = 0.0
        for i in range(3):
            offset = state.landmarks[i, group[m]] - state.landmarks[i, k]
            da += offset * surfaces.u[before, i]
            db += offset * surfaces.v[before, i]
        am, bm = _reflect(a + da, surfaces.extent[s, 0]), _reflect(b + db, surfaces.extent[s, 1])
        if not allows(surfaces.pieces, surfaces.first[s], surfaces.first[s + 1], am, bm):
            return -1
        for i in range(3):
            new[m, i] = surfaces.origin[s, i] + am * surfaces.u[s, i] + bm * surfaces.v[s, i]
            new[m, 3 + i] = surfaces.normal[s, i]
    return s


@inner
def _overlaps(group, surface, new, state, surfaces, apart):
    """Whether a plate of `group` at its `new` place on a surface would be less than `apart` from another there."""
    u, v, landmarks = surfaces.u[surface], surfaces.v[surface], state.landmarks
    for m in range(len(group)):
        for j in range(landmarks.shape[1]):
            if state.surfaces[j] != surface:
                continue
            along = up = 0.0
            for i in range(3):
                away = landmarks[i, j] - new[m, i]
                along, up = along + away * u[i], up + away * v[i]
            if max(abs(along), abs(up)) < apart:
                stays = True
                for other in group:
                    stays = stays and other != j
                if stays:
                    return True
        for other in range(m):
            along = up = 0.0
            for i in range(3):
                away = new[other, i] - new[m, i]
                along, up = along + away * u[i], up + away * v[i]
            if max(abs(along), abs(up)) < apart:
                return True
    return False


@inner
def _sum_values(units, accepted, value, target, settings, trial):
    """The smoothed objective for `units`, its terms in `trial`; `value` has those for `accepted`."""
    total = 0.0
    for p in range(len(units)):
        trial[p] = value[p]
        if units[p] != accepted[p]:
            trial[p] = smoothed(target, p, units[p], settings.margin, settings.width, settings.share)
        total += trial[p]
    return total


@inner
def _keep_best(state, target, best):
    """Update `best` if `state` is better."""
    fitness = total_worth(target, state.units)
    if fitness > best.fitness[0]:
        best.fitness[0] = fitness
        for k in range(len(state.surfaces)):
            best.surfaces[k] = state.surfaces[k]
            for i in range(3):
                best.landmarks[i, k], best.normals[i, k] = state.landmarks[i, k], state.normals[i, k]


@inner
def _try(group, surface, new, field, state, scratches, target, settings, rng, known):
    """Move the landmarks of `group` to their `new` places on a surface, if the random numbers say so.

    `known` is what the walk knows of the smoothed objective: its total, accepted units, their terms, and room for those
    that are tried. Returns the total then, and whether they were moved.
    """
    total, accepted, value, trial = known
    last = len(group) - 1
    for m in range(last + 1):
        k, scratch = group[m], layer(scratches, m)
        bound(field, k, new[m], surface, state, scratch)
        most = drawn = 0.0
        if m == last:
            most = _sum_values(scratch.units, accepted, value, target, settings, trial) - total
            most += _SLACK * (1.0 + settings.share)
            drawn = rng.random() if most < 0.0 else -1.0
            if drawn >= math.exp(min(most, 0.0) / settings.temperature) * (1.0 + _SLACK):
                break
        settle(field, k, state, scratch)
        if m == last:
            sum_value = _sum_values(scratch.units, accepted, value, target, settings, trial)
            gain = sum_value - total
            if gain < 0.0 <= most:
                drawn = rng.random()
            if gain < 0.0 and drawn >= math.exp(gain / settings.temperature):
                break
        accept(field, k, state, scratch)
        if m == last:
            return sum_value, True
    for m in range(last - 1, -1, -1):
        undo(field, group[m], state, layer(scratches, m))
    return total, False


@inner
def _walk(
    moves, places, members, several, field, state, scratches, target, surfaces, apart, settings, rng, best, memory
):
    """Do what `walk` says, in its `memory`."""
    single, new, pose, accepted, value, trial = memory
    lead(places, field, state, scratches, pose)
    positions, count = len(state.units), len(members)
    total = 0.0
    for p in range(positions):
        accepted[p] = state.units[p]
        value[p] = smoothed(target, p, accepted[p], settings.margin, settings.width, settings.share)
        total += value[p]
    moved = 0
    while moved < moves:
        group = single
        group[0] = members[int(rng.random() * count)]
        if moves - moved >= len(several) > 1 and rng.random() < settings.together:
            _gather(group[0], members, state, several)
            group = several
        moved += len(group)
        surface = propose(group, state, surfaces, settings, rng, new)
        if surface < 0 or (apart > 0.0 and _overlaps(group, surface, new, state, surfaces, apart)):
            continue
        known = (total, accepted, value, trial)
        total, taken = _try(group, surface, new, field, state, scratches, target, settings, rng, known)
        if taken:
            for p in range(positions):
                accepted[p] = state.units[p]
            value, trial = trial, value
            _keep_best(state, target, best)


@kernel
def walk(moves, places, members, several, field, state, scratches, target, surfaces, apart, settings, rng, best):
    """Move landmarks `moves` times from `places`; `state` ends where the walk ends, and `best` is updated.

    Args:
        moves: landmarks that are moved in all.
        places: where the walk begins, see `Places`; nothing moves to an empty one.
        members: the landmarks that may move, at least as many as can move together.
        several: for those that do, as many as can.
        field, target: what is climbed.
        state: of the field.
        scratches: `layers` of one, at least as many as landmarks can move together.
        surfaces: where landmarks may hang.
        apart: least distance of plates on a surface, along its u or its v, metres; moves that come closer, or lead
            where no landmark may hang, are not even tried, but count.
        settings: see `Settings`.
        rng: the source of all random numbers.
        best: see `Best`.
    """
    # Arrays are made here, as inner functions do not count them. All else is done there: for numba what a kernel calls
    # by itself is something else, and what moves landmarks is compiled once.
    positions = len(state.units)
    single, new, pose = np.empty(1, dtype=np.int64), np.empty((len(several), 6)), np.empty(6)
    accepted, value, trial = np.empty(positions, dtype=np.int64), np.empty(positions), np.empty(positions)
    memory = (single, new, pose, accepted, value, trial)
    _walk(
        moves, places, members, several, field, state, scratches, target, surfaces, apart, settings, rng, best, memory
    )  # fmt: skip
