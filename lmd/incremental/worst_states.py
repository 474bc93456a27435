"""Target of the worst crowd states: the mean fitness over the share of the states with the least fitness.

The fitness of a state is the fitness of its positions, so a state is a block of positions in any order. The mean over
the worst states is monotone in every value, as the targets that the walk of annealing needs.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import allocating, inner
from lmd.incremental.field import combined, contribution, fitness_of, smoothed


class WorstStates(NamedTuple):
    """Mean of a target over the worst of S crowd states; a `Target`."""

    target: Any
    """Target of all positions."""
    states: IntArray
    """`(Q,)` crowd state of each position, 0 to S - 1."""
    number: int
    """Number S of states."""
    worst: int
    """Number of the worst states."""

    @property
    def relevance(self) -> FloatArray:
        """See `Target.relevance`."""
        return self.target.relevance  # type: ignore[no-any-return]

    def of_worst(self, units: IntArray) -> Any:
        """Target of the states that are the worst with the values `units` `(Q,)`, which has the slope of this one."""
        terms = np.array([contribution(self.target, p, units[p]) for p in range(len(units))])
        sums = np.bincount(self.states, terms, self.number)
        chosen = np.argsort(sums, kind="stable")[: self.worst]
        within = np.isin(self.states, chosen) * (self.number / self.worst)
        return self.target._replace(relevance=self.target.relevance * within)


@smoothed.register(WorstStates)
def _smoothed(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    return smoothed(target.target, p, units, margin, width, share)


@contribution.register(WorstStates)
def _contribution(target, p, units):  # type: ignore[no-untyped-def]
    return contribution(target.target, p, units)


@allocating
def _worst_of_terms(target: Any, terms: FloatArray) -> Any:
    """Fitness from the contributions `terms` of the positions."""
    sums = np.zeros(target.number)
    for p in range(len(terms)):
        sums[target.states[p]] += terms[p]
    return _mean_of_worst(sums, target.worst)


@allocating
def _worst_of_units(target: Any, units: Any) -> Any:
    """Fitness from the values of the positions."""
    sums = np.zeros(target.number)
    for p in range(len(units)):
        sums[target.states[p]] += contribution(target.target, p, units[p])
    return _mean_of_worst(sums, target.worst)


@inner
def _mean_of_worst(sums: FloatArray, worst: Integer) -> Any:
    """Mean of the `worst` least of S sums, times S: each is a share of the fitness of all. Overwrites `sums`."""
    total, number = 0.0, len(sums)
    for _ in range(worst):
        least = 0
        for s in range(number):
            if sums[s] < sums[least]:
                least = s
        total += sums[least]
        sums[least] = np.inf
    return total * (number / worst)


@combined.register(WorstStates)
def _combined(target: Any, terms: FloatArray, total: Any) -> Any:  # noqa: ARG001 # see `combined`
    return _worst_of_terms(target, terms)


@fitness_of.register(WorstStates)
def _fitness_of(target: Any, units: Any) -> Any:
    return _worst_of_units(target, units)
