"""Upper bound on a selection of landmarks by submodularity, and the value of the greedy choice.

Greedy selection maximises f, the `selection` of an objective, which is monotone and submodular in the landmarks without
occlusion. So for *any* set S the best K poses of a grid, each taken once, reach at most

    f(S) + the sum of the K largest gains at S        (Nemhauser, Wolsey and Fisher 1978),

where S is the greedy choice or empty, whichever gives the lower bound. The greedy choice always reaches 1 - 1/e of the
best value; the bound gives the share for this problem. A landmark adds nothing to the views from which it is hidden,
and more landmarks never lower f, so the bound also holds with occlusion.

The bound is valid for poses of the grid and for f, and not for the objective itself, of which f is a surrogate.

With K_s tags of size s, a candidate is a pose with a size. For each size s, the gains of the best choice at S are at
most the K_s largest gains of that size. The greedy choice always reaches half of the best value (Fisher, Nemhauser and
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

# Share of the best value that the greedy choice always reaches if no pose excludes another: for one size, and for
# several.
GUARANTEE, GUARANTEE_OF_SIZES = 1.0 - np.exp(-1.0), 0.5


@dataclass(frozen=True)
class SelectionBound:
    """Bound on the selection of an objective; values are relative to the value with the fixed landmarks alone."""

    label: str
    """Name of the selection."""
    greedy: float
    """Value of the greedy choice."""
    grid: float
    """Bound for all choices of poses of the grid."""
    guarantee: float = GUARANTEE
    """Share of the best value that the greedy choice always reaches."""

    @property
    def share(self) -> float:
        """Lower bound on the value of the greedy choice over the value of the best choice."""
        return self.greedy / self.grid if self.grid > 0.0 else 1.0


def selection_upper_bound(
    problem: Problem, count: int, spacing: float, limit: TimeLimit | None = None
) -> SelectionBound:
    """Bound the selection of `count` landmarks, fixed landmarks included, from a grid of poses `spacing` metres apart.

    The bound counts the views that the problem's fitness counts. The greedy choice keeps footprints apart; the bound
    also holds for overlapping footprints. The result does not depend on the number of threads.

    Args:
        problem: the problem.
        count: number of landmarks.
        spacing: largest distance between poses, metres.
        limit: limit of the time after one scan of every pose; None for none.

    Raises:
        InputError: the objective has no selection, the spacing is not positive, or there are several sizes and `count`
            is not the problem's number of landmarks.
    """
    footprints, objective = problem.scene.footprints, selectable(problem.objective)
    evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
    several = problem.scene.has_several_sizes
    if several and count != problem.count:
        raise InputError(f"of {count} landmarks it is not known how many have each size.")
    sizes = problem.free_sizes if several else np.full(count - problem.fixed_count, problem.sizes[0])
    poses, stock = candidates(footprints, problem.free_edges, spacing), Tags(sizes, problem.scene.tag)
    own = poses.edges_of(problem.scene.tag)
    limit, selection, greedy = limit or TimeLimit(), objective.selection(evaluator, relevance), 0.0
    add_each(selection, problem.fixed_with_edges)

    def largest(gains: FloatArray) -> float:
        """Sum of the K_s largest gains of each size s."""
        counts = zip(*np.unique(sizes, return_counts=True), strict=True)
        return sum(float(np.sort(gains[own == edge])[-number:].sum()) for edge, number in counts)

    began = clock()
    at_first = largest(selection.gains(poses))
    scans = limit.left / (clock() - began) - 1.0  # one scan is reserved for the gains at the end
    empty, fixed = objective.selection(evaluator, relevance), problem.fixed_with_edges
    chosen, spent = select(empty, poses, stock, footprints, scans * len(poses), fixed)
    if spent + (GAINS_BATCH if spent else len(poses)) > scans * len(poses):
        limit.cut.append(f"the greedy choice after {len(chosen)} of {count - problem.fixed_count} landmarks")
    if not len(chosen):
        return SelectionBound(selection.label, 0.0, at_first, 0.0)
    for j in chosen:
        greedy += float(selection.gains(poses[j : j + 1])[0])
        selection.add(poses[j : j + 1])
    gains = selection.gains(poses)
    gains[chosen] = 0.0  # each pose is taken once
    guarantee = 0.0 if limit.cut else GUARANTEE_OF_SIZES if several else GUARANTEE
    return SelectionBound(selection.label, greedy, min(at_first, greedy + largest(gains)), guarantee)
