"""Fitness and metrics of a scene with a crowd, and the fitness over the worst groups of positions.

A crowd state is one arrangement of the crowd's people and robots. A group has the positions of one crowd state, or of
one drive. The worst groups are those with the least fitness.
"""

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
    """Fitness that is the mean over the worst groups of positions, those with the least fitness; a `Target`.

    A group has the positions of one crowd state (arrangement of people), or of one drive. The attribute `target` is
    another `Target`, which computes the fitness within a group. The attribute `worst` is the number of groups in the
    mean.
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
        """Target for derivatives of the fitness: a sum over the positions of the worst groups only.

        The worst groups are chosen once, from the quantised values `units` `(Q,)` of the positions. At these values,
        the returned target's fitness has the derivatives of this target's fitness.
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
    """Mean fitness over the worst groups, from the contribution of each position to the fitness, `terms` `(Q,)`."""
    sums = np.zeros(target.number)
    for p in range(len(terms)):
        sums[target.groups[p]] += terms[p]
    return _mean_of_worst(sums, target.worst)


@allocating
def _worst_of_units(target: Any, units: Any) -> Any:
    """Mean fitness over the worst groups of positions, from the quantised (integer) values `units` `(Q,)`."""
    sums = np.zeros(target.number)
    for p in range(len(units)):
        sums[target.groups[p]] += contribution(target.target, p, units[p])
    return _mean_of_worst(sums, target.worst)


@inner
def _mean_of_worst(sums: FloatArray, worst: Integer) -> Any:
    """Mean fitness over the worst groups, from the contribution of each of S groups to the fitness.

    `sums` `(S,)` has the contributions, and is overwritten. The fitness within a group is S times the group's
    contribution. `worst` is the number of groups in the mean: those with the least contributions.
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
    """True if the fitness is the mean over the worst crowd states (arrangements of people) only."""
    crowd = evaluator.scene.crowd
    return crowd is not None and crowd.crowd.fitness == "worst"


def over_states(objective: Objective, values: FloatArray, evaluator: Evaluator, relevance: FloatArray) -> FloatArray:
    """Fitness `(...)` of deployments, from the values `(..., P)` and the weights `(P,)` of an evaluator's positions.

    If `seeks_worst` is True, this is the mean fitness over the worst crowd states (arrangements of people). Otherwise
    it is the fitness of all positions in all states.
    """
    if not seeks_worst(evaluator):
        return objective.fitness(values, relevance)
    count = len(_states(evaluator)[0])
    by_state = values.reshape(*values.shape[:-1], count, -1)
    fitness = objective.fitness(by_state, relevance[: by_state.shape[-1]])
    return worst_mean(fitness, _worst_count(evaluator, count))


def target_of(objective: Objective, field: Field, evaluator: Evaluator, relevance: FloatArray) -> Target:
    """Return the `Target` that computes the result of `over_states` from the values of `field`.

    `field` is an incremental evaluator for the positions of `evaluator`; `relevance` has the weights of these
    positions.
    """
    target = incremental(objective).target(in_order(field, relevance))
    if not seeks_worst(evaluator):
        return target
    present, state = _states(evaluator)
    states = np.zeros(field.size, dtype=np.int64)  # copies of positions have no weight
    states[field.index_of] = state
    return WorstGroups(target, states, len(present), _worst_count(evaluator, len(present)))


def slope_target(target: Target, units: IntArray) -> Target:
    """Target with which optimisers compute derivatives of the fitness at the quantised values `units` `(Q,)`.

    The fitness of the returned target is a sum over positions, which can be differentiated position by position. At the
    values `units`, the derivatives of this sum are those of the fitness of `target`.
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
    """Mean of `shares` over the worst crowd states (arrangements of people).

    `shares` `(P,)` are the contributions of P positions to a figure (metric), see `Objective.shares`. The worst states
    are those with the lowest mean contribution.
    """
    count = len(_states(evaluator)[0])
    return worst_mean(shares.reshape(count, -1).mean(axis=-1), _worst_count(evaluator, count))


def _states(evaluator: Evaluator) -> tuple[IntArray, IntArray]:
    """Crowd states (arrangements of people) at the positions of an evaluator.

    Returns:
        indices of the states that occur, and an array `(P,)`: for each position, the place of its state in the first
            array.
    """
    assert evaluator.states is not None, "there is a crowd"
    present, index = np.unique(evaluator.states, return_inverse=True)
    return present, index.reshape(-1)


def _worst_count(evaluator: Evaluator, count: int) -> int:
    """Number of states that count as the worst among `count` states."""
    assert evaluator.scene.crowd is not None, "there is a crowd"
    return worst_of(count, evaluator.scene.crowd.crowd.worst)
