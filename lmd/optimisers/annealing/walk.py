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
from lmd.incremental.field import Places, accept, bound, lead, placed, settle, smoothed, total_worth, undo
from lmd.optimisers.annealing.proposals import exchange, gather, overlap, pair_up, propose

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
    exchange: float
    """Probability that, where there are several sizes, a landmark exchanges its place with one of another size."""


class Best(NamedTuple):
    """The best deployment met."""

    fitness: np.ndarray
    """`(1,)` what it is worth."""
    places: Places
    """The poses and surfaces of its landmarks."""


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
def _keep_best(units, here, target, best):
    """Update `best` if the landmarks `here`, with the values `units`, are better."""
    fitness, places = total_worth(target, units), best.places
    if fitness > best.fitness[0]:
        best.fitness[0] = fitness
        for k in range(len(here.surfaces)):
            places.surfaces[k] = here.surfaces[k]
            for i in range(6):
                places.poses[i, k] = here.poses[i, k]


@inner
def _try(group, on, new, field, state, scratches, target, settings, rng, known):
    """Move the landmarks of `group` to their `new` places on the surfaces `on`, if the random numbers say so.

    `known` is what the walk knows of the smoothed objective: its total, accepted units, their terms, and room for those
    that are tried. Returns the total then, and whether they were moved.
    """
    total, accepted, value, trial = known
    last = len(group) - 1
    for m in range(last + 1):
        k, scratch = group[m], layer(scratches, m)
        bound(field, k, new[m], on[m], state, scratch)
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


@kernel
def walk(moves, places, members, several, field, state, scratches, target, surfaces, papers, settings, rng, best):
    """Move landmarks `moves` times from `places`; `state` ends where the walk ends, and `best` is updated.

    Args:
        moves: landmarks that are moved in all.
        places: where the walk begins, see `Places`; nothing moves to an empty one.
        members: the landmarks that may move, at least as many as can move together.
        several: for those that do, as many as can.
        field, target: what is climbed.
        state: of the field.
        scratches: `layers` of one, at least as many as landmarks can move together, two for an exchange.
        surfaces: where landmarks may hang.
        papers: see `Papers`; moves that are not even tried count.
        settings: see `Settings`.
        best: see `Best`.
    """
    # Here, not in a kernel of its own: what moves landmarks is compiled once. And by inner functions alone, as for
    # numba what a kernel calls by itself is something else.
    lead(places, field, state, scratches, np.empty(6))
    known = placed(state)
    here, positions, count = Places(known.poses, known.surfaces), len(state.units), len(members)
    accepted = state.units.copy()
    value, trial = np.empty(positions), np.empty(positions)
    single, pair = np.empty(1, dtype=np.int64), np.empty(2, dtype=np.int64)
    new, on = np.empty((max(len(several), 2), 6)), np.empty(max(len(several), 2), dtype=np.int64)
    sizes = len(papers.first)
    total = 0.0
    for p in range(positions):
        value[p] = smoothed(target, p, accepted[p], settings.margin, settings.width, settings.share)
        total += value[p]
    moved = 0
    while moved < moves:
        group = single
        group[0] = members[int(rng.random() * count)]
        exchanges = sizes > 1 and moves - moved >= 2 and rng.random() < settings.exchange
        if exchanges and pair_up(group[0], members, papers, rng, pair):
            group = pair
            possible = exchange(group, here, surfaces, papers, new, on)
        else:
            if moves - moved >= len(several) > 1 and rng.random() < settings.together:
                gather(group[0], members, here.poses, several)
                group = several
            possible = propose(group, here, surfaces, papers, settings, rng, new, on)
        moved += len(group)
        if not possible or (papers.edges[0] > 0.0 and overlap(group, on, new, here, surfaces, papers)):
            continue
        terms = (total, accepted, value, trial)
        total, taken = _try(group, on, new, field, state, scratches, target, settings, rng, terms)
        if taken:
            for p in range(positions):
                accepted[p] = state.units[p]
            value, trial = trial, value
            _keep_best(state.units, here, target, best)
