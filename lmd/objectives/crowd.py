"""Fitness and figures over the crowd states of a scene.

A view in a crowd state is a further view. An evaluator has each position once for each state, and the value of an
objective at such a position holds for that state. The mean over states is the mean over all these positions. The
fitness of the worst states is the mean fitness over the share of the states with the least fitness.
"""

from collections.abc import Mapping

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.incremental.field import Field, Target, in_order
from lmd.incremental.worst_groups import WorstGroups
from lmd.objectives.base import Objective, incremental
from lmd.sight.evaluator import Evaluator
from lmd.space.crowd import worst_mean, worst_of

WORST = "worst_crowd_"  # prefix of the figures of the worst states


def seeks_worst(evaluator: Evaluator) -> bool:
    """True if the fitness is that of the worst crowd states."""
    crowd = evaluator.scene.crowd
    return crowd is not None and crowd.crowd.fitness == "worst"


def over_states(objective: Objective, values: FloatArray, evaluator: Evaluator, relevance: FloatArray) -> FloatArray:
    """Fitness from values `(..., P)` at the positions of an evaluator with weights `(P,)`, `(...)`."""
    if not seeks_worst(evaluator):
        return objective.fitness(values, relevance)
    count = len(_states(evaluator)[0])
    by_state = values.reshape(*values.shape[:-1], count, -1)
    fitness = objective.fitness(by_state, relevance[: by_state.shape[-1]])
    return worst_mean(fitness, _worst_count(evaluator, count))


def target_of(objective: Objective, field: Field, evaluator: Evaluator, relevance: FloatArray) -> Target:
    """Function from the values of a field, made for `evaluator`, to the fitness of `over_states`."""
    target = incremental(objective).target(in_order(field, relevance))
    if not seeks_worst(evaluator):
        return target
    present, state = _states(evaluator)
    states = np.zeros(field.size, dtype=np.int64)  # copies of positions have no weight
    states[field.index_of] = state
    return WorstGroups(target, states, len(present), _worst_count(evaluator, len(present)))


def slope_target(target: Target, units: IntArray) -> Target:
    """Target with the slope of `target` at the values `units` `(Q,)`, whose fitness is a sum over positions."""
    return target.of_worst(units) if isinstance(target, WorstGroups) else target


def worst_figures(objective: Objective, values: FloatArray, evaluator: Evaluator) -> dict[str, float]:
    """Headline figure over the worst states of values `(P,)`, by its name; empty without a crowd."""
    if evaluator.scene.crowd is None:
        return {}
    key = objective.headline.key
    shares = objective.shares(values).get(key, values)
    return {WORST + key: float(worst_share(np.asarray(shares), evaluator))}


def describe_crowd(objective: Objective, figures: Mapping[str, float], evaluator: Evaluator) -> dict[str, str]:
    """Crowd and its worst states as labelled sentences for the terminal; empty without a crowd."""
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
    """Mean of `shares` `(P,)` over the positions of the worst states, each state by its mean."""
    count = len(_states(evaluator)[0])
    return worst_mean(shares.reshape(count, -1).mean(axis=-1), _worst_count(evaluator, count))


def _states(evaluator: Evaluator) -> tuple[IntArray, IntArray]:
    """Crowd states of the positions of an evaluator, and the index of each position's state among them, `(P,)`."""
    assert evaluator.states is not None, "there is a crowd"
    present, index = np.unique(evaluator.states, return_inverse=True)
    return present, index.reshape(-1)


def _worst_count(evaluator: Evaluator, count: int) -> int:
    """Number of the worst states, of `count`."""
    assert evaluator.scene.crowd is not None, "there is a crowd"
    return worst_of(count, evaluator.scene.crowd.crowd.worst)
