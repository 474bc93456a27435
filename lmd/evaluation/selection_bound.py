"""How good a greedy choice of landmarks is at the least: the upper bound that submodularity gives.

What greedy selection climbs, f, is an objective's `selection`: monotone and submodular in the landmarks, nobody hiding
anybody. So for *any* set S the best K poses of a grid, each taken once, reach at most

    f(S) + the sum of the K largest gains at S        (Nemhauser, Wolsey and Fisher 1978),

and S is the greedy choice itself, or nothing, whichever tells more. Greedy reaches 1 - 1/e of the best in any case;
this says how much it is in the case at hand. A landmark that is hidden adds nothing to the views it is hidden from, and
as more landmarks never lower f, hiding only does: the bound holds with hiding, too.

It is one for poses of the grid and for f, not for the objective that f stands for.

With K_s tags of size s a candidate is a pose and a size. The best choice has K_s of size s, so its gains at S are at
most the K_s largest of that size, for each size; and greedy reaches half of the best in any case (Fisher, Nemhauser and
Wolsey 1978, for a partition matroid).
"""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.compiled import clock
from lmd.evaluation.time_limit import TimeLimit
from lmd.objectives.base import selectable
from lmd.optimisers.selection import GAINS_BATCH, Tags, add_each, candidates, select
from lmd.problem import Problem

# The share of the best that the greedy choice reaches in any case, where every pose is free to take.
GUARANTEE, GUARANTEE_OF_SIZES = 1.0 - np.exp(-1.0), 0.5


@dataclass(frozen=True)
class SelectionBound:
    """A bound on what an objective's selection can reach, above the value with none but the fixed landmarks chosen.

    Args:
        label: what is bounded.
        greedy: what the greedy choice reaches.
        grid: no choice of poses of the grid is better.
        guarantee: the share that the greedy choice reaches in any case.
    """

    label: str
    greedy: float
    grid: float
    guarantee: float = GUARANTEE

    @property
    def share(self) -> float:
        """The share of the best that the greedy choice reaches at the least."""
        return self.greedy / self.grid if self.grid > 0.0 else 1.0


def selection_upper_bound(
    problem: Problem, count: int, spacing: float, limit: TimeLimit | None = None
) -> SelectionBound:
    """Bounds what `count` landmarks, fixed ones among them, reach on a grid of poses at most `spacing` metres apart.

    Views are those of the problem's fitness. The greedy choice keeps plates apart, the bound is also for those that
    overlap. The result does not depend on the number of threads.

    Args:
        limit: of the time, but for one look at every pose; None for none.

    Raises:
        InputError: the objective has no selection, the spacing is not positive, or there are several sizes and another
            number of landmarks than that of the problem.
    """
    plates, objective = problem.scene.plates, selectable(problem.objective)
    evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
    several = problem.scene.has_several_sizes
    if several and count != problem.count:
        raise InputError(f"of {count} landmarks it is not known how many have each size.")
    sizes = problem.free_sizes if several else np.full(count - problem.fixed_count, problem.sizes[0])
    poses, stock = candidates(plates, problem.free_edges, spacing), Tags(sizes, problem.scene.tag)
    own = poses.edges_of(problem.scene.tag)
    limit, selection, greedy = limit or TimeLimit(), objective.selection(evaluator, relevance), 0.0
    add_each(selection, problem.hung)

    def largest(gains: FloatArray) -> float:
        """The sum of as many of the largest gains as there are landmarks, of each size."""
        counts = zip(*np.unique(sizes, return_counts=True), strict=True)
        return sum(float(np.sort(gains[own == edge])[-number:].sum()) for edge, number in counts)

    began = clock()
    at_first = largest(selection.gains(poses))
    looks = limit.left / (clock() - began) - 1.0  # one is left for the gains in the end
    chosen, spent = select(
        objective.selection(evaluator, relevance), poses, stock, plates, looks * len(poses), problem.hung
    )
    if spent + (GAINS_BATCH if spent else len(poses)) > looks * len(poses):
        limit.cut.append(f"the greedy choice after {len(chosen)} of {count - problem.fixed_count} landmarks")
    if not len(chosen):
        return SelectionBound(selection.label, 0.0, at_first, 0.0)
    for j in chosen:
        greedy += float(selection.gains(poses[j : j + 1])[0])
        selection.add(poses[j : j + 1])
    gains = selection.gains(poses)
    gains[chosen] = 0.0  # each pose once
    guarantee = 0.0 if limit.cut else GUARANTEE_OF_SIZES if several else GUARANTEE
    return SelectionBound(selection.label, greedy, min(at_first, greedy + largest(gains)), guarantee)
