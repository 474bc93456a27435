"""Target of the worst groups of positions: the mean fitness over the share of the groups with the least fitness.

A group is a crowd state or a drive, its fitness that of its positions, and all groups weigh equally. The mean over the
worst groups is monotone in every value, as the targets that the walk of annealing needs.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import allocating, inner
from lmd.incremental.field import combined, contribution, fitness_of, smoothed


class WorstGroups(NamedTuple):
    """Mean of a target over the worst of S groups; a `Target`."""

    target: Any
    """Target of all positions, whose relevance has an equal sum in each group."""
    groups: IntArray
    """`(Q,)` group of each position, 0 to S - 1."""
    number: int
    """Number S of groups."""
    worst: int
    """Number of the worst groups."""

    @property
    def relevance(self) -> FloatArray:
        """See `Target.relevance`."""
        return self.target.relevance  # type: ignore[no-any-return]

    def of_worst(self, units: IntArray) -> Any:
        """Target of the groups that are the worst with the values `units` `(Q,)`, which has the slope of this one."""
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
    """Fitness from the contributions `terms` of the positions."""
    sums = np.zeros(target.number)
    for p in range(len(terms)):
        sums[target.groups[p]] += terms[p]
    return _mean_of_worst(sums, target.worst)


@allocating
def _worst_of_units(target: Any, units: Any) -> Any:
    """Fitness from the values of the positions."""
    sums = np.zeros(target.number)
    for p in range(len(units)):
        sums[target.groups[p]] += contribution(target.target, p, units[p])
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


@combined.register(WorstGroups)
def _combined(target: Any, terms: FloatArray, total: Any) -> Any:  # noqa: ARG001 # see `combined`
    return _worst_of_terms(target, terms)


@fitness_of.register(WorstGroups)
def _fitness_of(target: Any, units: Any) -> Any:
    return _worst_of_units(target, units)
