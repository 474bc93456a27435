"""Fitness and metrics over the crowd states of a scene, and a `Target` that uses only the worst groups of positions."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import allocating, inner
from lmd.incremental.field import Field, Target, combined, contribution, fitness_of, in_order, smoothed
from lmd.objectives.base import Objective, incremental
from lmd.sight.evaluator import Evaluator
from lmd.space.crowd import worst_mean, worst_of


class WorstGroups(NamedTuple):
    """Target whose fitness is the mean fitness of another target over the worst of S groups of positions. The positions
    of one crowd state, or of one drive, form a group.
    """

    target: Any
    """Target that is applied to all positions; the relevance has an equal sum in each group."""
    groups: IntArray
    """`(Q,)` index of each position's group, 0 to S - 1."""
    number: int
    """Number S of groups."""
    worst: int
    """Number of groups over which the mean is taken: the groups with the least fitness."""

    @property
    def relevance(self) -> FloatArray:
        """See `Target.relevance`."""
        return self.target.relevance  # type: ignore[no-any-return]

    def of_worst(self, units: IntArray) -> Any:
        """Target that sums only over the positions of the worst groups, which are chosen by the values `units` `(Q,)`.
        At these values, the fitness of the returned target and the fitness of this target have equal derivatives.
        """
        terms = np.array([contribution(self.target, p, units[p]) for p in range(len(units))])
        sums = np.bincount(self.groups, terms, self.number)
        chosen = np.argsort(sums, kind="stable")[: self.worst]
        within = np.isin(self.groups, chosen) * (self.number / self.worst)
        return self.target._replace(relevance=self.target.relevance * within)


@smoothed.register(WorstGroups)
def _smoothed(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    return smoothed(target.target, p, units, margin, width, share)


@contribution.register(WorstGroups)
def _contribution(target, p, units):  # type: ignore[no-untyped-def]
    return contribution(target.target, p, units)


@allocating
def _worst_of_terms(target: Any, terms: FloatArray) -> Any:
    """Fitness over the worst groups. `terms` `(Q,)` has the contribution of each position to the fitness of the other
    target, `target.target`.
    """
    sums = np.zeros(target.number)
    for p in range(len(terms)):
        sums[target.groups[p]] += terms[p]
    return _mean_of_worst(sums, target.worst)


@allocating
def _worst_of_units(target: Any, units: Any) -> Any:
    """Fitness over the worst groups, computed from the quantised values `units` `(Q,)` of the positions."""
    sums = np.zeros(target.number)
    for p in range(len(units)):
        sums[target.groups[p]] += contribution(target.target, p, units[p])
    return _mean_of_worst(sums, target.worst)


@inner
def _mean_of_worst(sums: FloatArray, worst: Integer) -> Any:
    """Mean of the `worst` smallest of the S `sums`, times S; the function overwrites `sums`. Without the factor S, the
    mean would be the fitness of a single group, a part of the whole.
    """
    total, number = 0.0, len(sums)
    for _ in range(worst):
        least = 0
        for s in range(number):
            if sums[s] < sums[least]:
                least = s
        total += sums[least]
        sums[least] = np.inf
    return total * (number / worst)


@combined.register(WorstGroups)
def _combined(target: Any, terms: FloatArray, total: Any) -> Any:  # noqa: ARG001 # see `combined`
    return _worst_of_terms(target, terms)


@fitness_of.register(WorstGroups)
def _fitness_of(target: Any, units: Any) -> Any:
    return _worst_of_units(target, units)


WORST = "worst_crowd_"  # prefix of the figures of the worst states


def seeks_worst(evaluator: Evaluator) -> bool:
    """True if the fitness is the mean over the worst crowd states."""
    crowd = evaluator.scene.crowd
    return crowd is not None and crowd.crowd.fitness == "worst"


def over_states(objective: Objective, values: FloatArray, evaluator: Evaluator, relevance: FloatArray) -> FloatArray:
    """Fitness `(...)` from the values `(..., P)` and the weights `(P,)` of an evaluator's positions. If the fitness is
    the mean over the worst crowd states (`seeks_worst`), the result is this mean. Otherwise it is the fitness of all
    positions in all states.
    """
    if not seeks_worst(evaluator):
        return objective.fitness(values, relevance)
    count = len(_states(evaluator)[0])
    by_state = values.reshape(*values.shape[:-1], count, -1)
    fitness = objective.fitness(by_state, relevance[: by_state.shape[-1]])
    return worst_mean(fitness, _worst_count(evaluator, count))


def target_of(objective: Objective, field: Field, evaluator: Evaluator, relevance: FloatArray) -> Target:
    """Return the `Target` with the fitness of `over_states`: it computes this fitness from the values of `field`, a
    field of `evaluator`.
    """
    target = incremental(objective).target(in_order(field, relevance))
    if not seeks_worst(evaluator):
        return target
    present, state = _states(evaluator)
    states = np.zeros(field.size, dtype=np.int64)  # copies of positions have no weight
    states[field.index_of] = state
    return WorstGroups(target, states, len(present), _worst_count(evaluator, len(present)))


def slope_target(target: Target, units: IntArray) -> Target:
    """Target for the computation of slopes at the values `units` `(Q,)`. Its fitness is a sum over positions. At these
    values, this fitness and the fitness of `target` have equal derivatives.
    """
    return target.of_worst(units) if isinstance(target, WorstGroups) else target


def worst_figures(objective: Objective, values: FloatArray, evaluator: Evaluator) -> dict[str, float]:
    """The objective's main figure in the worst crowd states, computed from values `(P,)`. The key is the figure's name
    with the prefix `WORST`. Empty without a crowd.
    """
    if evaluator.scene.crowd is None:
        return {}
    key = objective.headline.key
    shares = objective.shares(values).get(key, values)
    return {WORST + key: float(worst_share(np.asarray(shares), evaluator))}


def describe_crowd(objective: Objective, figures: Mapping[str, float], evaluator: Evaluator) -> dict[str, str]:
    """Sentences for the terminal, keyed by label, about the crowd and about the metrics in its worst states. Empty
    without a crowd.
    """
    crowd = evaluator.scene.crowd
    if crowd is None:
        return {}
    share = figures[WORST + objective.headline.key]
    each = len(evaluator.positions) // len(crowd)
    return {
        "crowd": f"{crowd.crowd.number} in the way, in {len(crowd)} states, each seen from {each} positions",
        "worst crowds": f"{objective.headline.label} {objective.headline.text(share)} in the worst {crowd.worst_count} "
        f"of {len(crowd)} states",
    }


def worst_share(shares: FloatArray, evaluator: Evaluator) -> FloatArray:
    """Mean of `shares` `(P,)`, values in [0, 1], over the worst crowd states: the states in which the mean of `shares`
    is lowest.
    """
    count = len(_states(evaluator)[0])
    return worst_mean(shares.reshape(count, -1).mean(axis=-1), _worst_count(evaluator, count))


def _states(evaluator: Evaluator) -> tuple[IntArray, IntArray]:
    """Indices of the crowd states that occur at the positions of an evaluator, and an array `(P,)`: for each position,
    the index of its state in the first array.
    """
    assert evaluator.states is not None, "there is a crowd"
    present, index = np.unique(evaluator.states, return_inverse=True)
    return present, index.reshape(-1)


def _worst_count(evaluator: Evaluator, count: int) -> int:
    """Number of states that count as the worst among `count` states."""
    assert evaluator.scene.crowd is not None, "there is a crowd"
    return worst_of(count, evaluator.scene.crowd.crowd.worst)
