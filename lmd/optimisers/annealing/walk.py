"""Metropolis walk of simulated annealing: one landmark or a few landmarks move at a time, on a smoothed objective.

An objective that counts positions above a threshold is piecewise constant, so it gives no credit for a position that is
nearly qualified. The walk therefore maximises a smoothed objective (`smoothed`). For coverage this is the mean over
positions, weighted by their relevance, of

    1 / (1 + exp(-(P_n - thold_p - margin) / width)) + share * P_n.

P_n is the value of a position: the probability that at least n landmarks are seen from there. The true objective counts
positions with P_n >= thold_p. The first term is a smooth step of the given width, `margin` above this threshold. The
second term gives credit far from the threshold, too. margin, width and share are settings of the walk (`Settings`). The
walk records the best deployment by the true objective.

Metropolis' rule accepts a move if its gain is positive, or else with a probability that falls with the loss. Most moves
are rejected before their exact gain is computed. First an upper bound on the gain is computed from upper bounds on the
values of positions (`bound`). If the rule would reject even this bound, the move is rejected. Otherwise the gain is
computed, and the rule is applied to it with the same random number, so the bound changes no decision.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import inner, kernel
from lmd.core.layers import layer
from lmd.incremental.field import (
    Places,
    accept,
    bound,
    combined,
    move_to,
    placed,
    settle,
    smoothed,
    total_fitness,
    undo,
)
from lmd.optimisers.annealing.moves import FootprintArrays, Settings, exchange, gather, overlap, pair_up, propose
from lmd.space.surface import SurfaceArrays

# Relative safety margin of the bound on a gain, as the computed exp is not exactly monotone.
_SLACK = 1e-12


class Best(NamedTuple):
    """Best deployment that a walk has met."""

    fitness: FloatArray
    """Fitness of the deployment, `(1,)`."""
    places: Places
    """Poses and surfaces of the deployment's landmarks."""


class Walker(NamedTuple):
    """Data that one of several simultaneous walks keeps from one phase to the next."""

    members: IntArray
    """Indices of the landmarks that this walk moves, `(M,)`."""
    group: IntArray
    """Working memory for the indices of landmarks that move together, `(n,)`."""
    state: Any
    """State of the field (the incremental evaluator) with the landmarks at the end of the walk's last phase."""
    scratches: Any
    """Working memory of the field: one layer for each landmark that a single move can change (`layers`)."""
    best: Best
    """Best deployment of the walk; the best of the problem only if there is a single walk, on the problem itself."""


class Known(NamedTuple):
    """Smoothed fitness of the walk's present deployment, and the contributions of Q positions to this fitness."""

    total: float
    """Smoothed fitness, the combination of `terms`, see `combined`."""
    units: IntArray
    """Quantised value at each position, `(Q,)`."""
    terms: FloatArray
    """Contribution of each position to the smoothed fitness, `(Q,)`."""
    tried: FloatArray
    """Working memory, `(Q,)`: contribution of each position after a move that is tried."""


@inner
def _sum_values(units: IntArray, known: Known, target: Any, settings: Settings) -> float:
    """Return the smoothed fitness after a tried move; the contribution of each position is put into `known.tried`.

    `units` `(Q,)` has the objective's value at each position after the move, as an integer multiple of
    1 / `PROBABILITY_ONE`.
    """
    accepted, terms, tried = known.units, known.terms, known.tried
    total = 0.0
    for p in range(len(units)):
        tried[p] = terms[p]
        if units[p] != accepted[p]:
            tried[p] = smoothed(target, p, units[p], settings.margin, settings.width, settings.share)
        total += tried[p]
    value: float = combined(target, tried, total)
    return value


@inner
def _keep_best(units: IntArray, here: Places, target: Any, best: Best) -> None:
    """Overwrite `best` with the deployment `here` if the fitness of `here` is higher.

    `units` `(Q,)` has the objective's value for `here` at each of Q positions, as an integer multiple of
    1 / `PROBABILITY_ONE`.
    """
    fitness, places = total_fitness(target, units), best.places
    if fitness > best.fitness[0]:
        best.fitness[0] = fitness
        for k in range(len(here.surfaces)):
            places.surfaces[k] = here.surfaces[k]
            for i in range(6):
                places.poses[i, k] = here.poses[i, k]


@inner
def _try(
    tried: Any, field: Any, state: Any, scratches: Any, target: Any, settings: Settings, rng: np.random.Generator,
    known: Known,
) -> tuple[float, bool]:  # fmt: skip
    """Make a move, or reject it by Metropolis' rule.

    `tried` has the indices `group` `(G,)` of the landmarks, their new poses `new` `(G, 6)`, and their new surfaces `on`
    `(G,)`.

    Returns:
        smoothed fitness after the decision, and True if the landmarks were moved.
    """
    group, new, on = tried
    last = len(group) - 1
    for m in range(last + 1):
        k, scratch = group[m], layer(scratches, m)
        bound(field, k, new[m], on[m], state, scratch)
        most = drawn = 0.0
        if m == last:
            most = _sum_values(scratch.units, known, target, settings) - known.total
            most += _SLACK * (1.0 + settings.share)
            drawn = rng.random() if most < 0.0 else -1.0
            if drawn >= math.exp(min(most, 0.0) / settings.temperature) * (1.0 + _SLACK):
                break
        settle(field, k, state, scratch)
        if m == last:
            total = _sum_values(scratch.units, known, target, settings)
            gain = total - known.total
            if gain < 0.0 <= most:
                drawn = rng.random()
            if gain < 0.0 and drawn >= math.exp(gain / settings.temperature):
                break
        accept(field, k, state, scratch)
        if m == last:
            return total, True
    for m in range(last - 1, -1, -1):
        undo(field, group[m], state, layer(scratches, m))
    return known.total, False


@kernel
def walk(
    moves: int, places: Places, walker: Walker, field: Any, target: Any, room: tuple[SurfaceArrays, FootprintArrays],
    settings: Settings, rng: np.random.Generator,
) -> None:  # fmt: skip
    """Make a walk: propose moves, and accept or reject each move by Metropolis' rule.

    The `state` and the `best` deployment of `walker` are updated in place.

    Args:
        moves: length of the walk, counted in landmarks: a proposal for g landmarks counts g, also if it is rejected.
        places: poses and surfaces at the beginning of the walk; if empty, the walk begins with the `state` of `walker`.
        walker: data that the walk keeps between calls.
        field: incremental evaluator, a `Field`, which updates the objective's values at all positions after a move.
        target: functions that compute the fitness from these values, a `Target`.
        room: surfaces of the room, and footprints of all landmarks.
        settings: settings of the moves and of the smoothed objective.
        rng: random generator for proposals and decisions.
    """
    (members, several, state, scratches, best), (surfaces, footprints) = walker, room
    # The places are reached in this kernel, as in another kernel the functions that move landmarks would be compiled
    # again.
    move_to(places, field, state, scratches, np.empty(6))
    layout = placed(state)
    here, positions, count = Places(layout.poses, layout.surfaces), len(state.units), len(members)
    units = state.units.copy()
    terms, tried = np.empty(positions), np.empty(positions)
    single, pair = np.empty(1, dtype=np.int64), np.empty(2, dtype=np.int64)
    new, on = np.empty((max(len(several), 2), 6)), np.empty(max(len(several), 2), dtype=np.int64)
    sizes = len(footprints.first)
    total = 0.0
    for p in range(positions):
        terms[p] = smoothed(target, p, units[p], settings.margin, settings.width, settings.share)
        total += terms[p]
    total = combined(target, terms, total)
    moved = 0
    while moved < moves:
        group = single
        group[0] = members[int(rng.random() * count)]
        exchanges = sizes > 1 and moves - moved >= 2 and rng.random() < settings.exchange
        if exchanges and pair_up(group[0], members, footprints, rng, pair):
            group = pair
            possible = exchange(group, here, surfaces, footprints, new, on)
        else:
            if moves - moved >= len(several) > 1 and rng.random() < settings.together:
                gather(group[0], members, here.poses, several)
                group = several
            possible = propose(group, here, surfaces, footprints, settings, rng, new, on)
        moved += len(group)
        if not possible or (footprints.edges[0] > 0.0 and overlap(group, on, new, here, surfaces, footprints)):
            continue
        known = Known(total, units, terms, tried)
        total, taken = _try((group, new, on), field, state, scratches, target, settings, rng, known)
        if taken:
            for p in range(positions):
                units[p] = state.units[p]
            terms, tried = tried, terms
            _keep_best(state.units, here, target, best)
