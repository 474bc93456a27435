"""How good a deployment can be at best: upper bounds from a concave relaxation and its dual.

Let x_j be the number of landmarks with pose j (any flush pose on the walls; sum_j x_j = K), A_jpa whether such a
landmark covers axis a from position p when nothing hides it, c_pa = sum_j x_j A_jpa, w_a the probability of an axis
(sum 1) and r_p the share of a position (sum 1). Landmarks hidden by others only lower c, and c >= n is worth at most
min(c/n, 1), so P_n(p) <= s_p = sum_a w_a min(c_pa/n, 1), and whether p is qualified is at most min(s_p/t, 1) with
t = thold_p. Both objectives are therefore at most

    F(x) = sum_p r_p min(s_p / t, 1),        with t = 1 for the average of P_n (there s_p <= 1 anyway),

which is concave in x >= 0, fractions allowed. From min(v, 1) = min over 0 <= d <= 1 of 1 - d + d v, once for each
position (z_p) and once for each axis (d_pa), with y_pa = d_pa z_p r_p w_a / (n t),

    F(x) <= sum_p r_p (1 - z_p + z_p / t) - n sum_pa y_pa + sum_j x_j g_j,   g_j = sum_pa y_pa A_jpa,
         <= constant(z, y) + K max_j g_j.

*Any* choice of z and d gives a valid bound. Good ones are slopes of a smoothed min at a good x; x is found by
accelerated projected ascent. F(x) itself is what no choice can get below.

The largest g_j is sought over a grid of poses while x is improved, and in the end over the whole walls, by branch and
bound on cells (`lmd.sight.poses`): that makes the bound one for every flush deployment.

Landmarks that hang already are not chosen: where nothing hides them they cover b_pa, and c_pa = b_pa + sum_j x_j A_jpa
adds sum_pa y_pa b_pa to the constant, with K the number of the others.

With K_s tags of size s, x_js of them at pose j, each size has covers A^s_jpa and gains g_js of its own, and K max_j g_j
becomes sum_s K_s max_j g_js, each sought where a tag of that size may hang.

A view that is localised covers n landmarks, so the same bounds hold for what `Localisation` makes of P_n: they are
valid, but take no account of its tolerance.
"""

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import InputError, check_fields, integer, real
from lmd.core.compiled import clock
from lmd.evaluation.relaxation import Dual, Relaxation, nearest_on_simplex
from lmd.evaluation.time_limit import TimeLimit
from lmd.evaluation.wall_gains import largest_gain
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.problem import Problem
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import Cells, covered_amounts, gains, wall_cells

# The smoothed min is rounded off this far on both sides of its kink: at first, and in the end. Halved as x improves.
FIRST_WIDTH, LAST_WIDTH, STEPS_PER_WIDTH = 0.3, 0.01, 25
# A target that more than these would be needed for counts as out of reach.
MOST_LANDMARKS = 10_000
# Within a time limit every pose can be looked at so often for all bounds of a problem; so many tell what a look takes.
LOOKS, SOME = 250, 500
MULTIPLIERS_SHARE = 0.3  # of the time


@dataclass(frozen=True)
class Search:
    """How long to improve a bound.

    Args:
        spacing: largest distance between the poses on which the multipliers are found, metres.
        iterations: at most this many steps.
        tolerance: stop when this close to the best bound on that grid.
        limit: of the time, of which the multipliers have `MULTIPLIERS_SHARE`, the walls the rest.

    Raises:
        InputError: a number is out of range.
    """

    spacing: float = 0.125
    iterations: int = 200
    tolerance: float = 1e-3
    limit: TimeLimit = field(default_factory=TimeLimit)

    def __post_init__(self) -> None:
        real("spacing", self.spacing, above=0.0)
        check_fields(self, integer, "iterations", low=1)
        real("tolerance", self.tolerance, above=0.0)


@dataclass(frozen=True)
class UpperBound:
    """An upper bound, as fractions in [0, 1].

    Args:
        walls: no deployment of flush landmarks on the walls is better.
        grid: no deployment on the grid of poses is better.
        fractional: what fractions of landmarks on that grid reach; bounds for the grid end here.
        dual: the multipliers.
        gain: no flush landmark earns more than this with them; of several sizes on average, as many as there are of
            each.
    """

    walls: float
    grid: float
    fractional: float
    dual: Dual
    gain: float


def average_upper_bound(problem: Problem, count: int, search: Search) -> UpperBound:
    """Bounds the mean of P_n over the grid (positions count alike) for `count` landmarks."""
    size = len(problem.evaluator.positions)
    shares, n = np.full(size, 1.0 / size), _at_most_coverage(problem).n
    return _bound(problem, Relaxation(problem.evaluator, shares, n, 1.0, problem.hung), count, search)


def fitness_upper_bound(problem: Problem, count: int, search: Search) -> UpperBound:
    """Bounds the fitness, the share of positions that are qualified or a mean, by relevance, for `count` landmarks."""
    evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
    objective = _at_most_coverage(problem)
    averaged = isinstance(objective, Localisation) and objective.climbs == "mean"
    # Positions qualify from TOLERANCE below thold_p; where nothing is asked, all do.
    threshold = 1.0 if averaged else objective.thold_p - TOLERANCE
    if threshold <= 0.0:
        return UpperBound(1.0, 1.0, 1.0, Dual(1.0, np.zeros((len(relevance), evaluator.axes.shape[1]))), 0.0)
    relaxation = Relaxation(evaluator, relevance / relevance.sum(), objective.n, threshold, problem.hung)
    return _bound(problem, relaxation, count, search)


def fewest_landmarks(problem: Problem, target: float, search: Search) -> int:
    """No fewer landmarks than this reach a fitness of `target`, the fixed ones and at least one more among them.

    A dual bounds every K by a line in K: too few landmarks become as many as their own line asks for, which by
    concavity are never too many, until the bound reaches the target.

    Raises:
        InputError: not even `MOST_LANDMARKS` reach it, or tags have several sizes.
    """
    problem.scene.check_one_size("a least number of landmarks")
    real("target", target, low=0.0, high=1.0)
    count = max(_at_most_coverage(problem).n, problem.fixed_count + 1)
    while (bound := fitness_upper_bound(problem, count, search)).walls < target - TOLERANCE:
        count = problem.fixed_count + math.ceil((target - bound.dual.constant) / bound.gain - TOLERANCE)
        if count > MOST_LANDMARKS:
            raise InputError(f"target = {target:g} is out of reach of {MOST_LANDMARKS} landmarks.", "target")
    return count


def affordable(problem: Problem, count: int, search: Search) -> Search:
    """The search with its poses as far apart as it takes for its time to suffice, by what a look at some of them takes.

    Where the time has no limit it is the same.

    Raises:
        InputError: the visibility model has no compiled half.
    """
    problem.scene.check_compiled("an upper bound")
    spacing, evaluator, each = search.spacing, problem.evaluator, 0.0
    widest = max(max(wall.extent) for wall in problem.scene.room.surfaces())
    while search.limit.seconds < math.inf:
        poses = reduce(operator.add, (kind.poses for kind in _kinds(problem, evaluator, count, spacing)))
        if not each:
            some, began = poses[:: max(len(poses) // SOME, 1)], clock()
            gains(evaluator, some, np.ones((len(evaluator.positions), evaluator.axes.shape[1])))
            each = (clock() - began) / len(some)
        if LOOKS * each * len(poses) <= search.limit.left or spacing >= widest:
            break
        spacing *= 1.3
    return replace(search, spacing=spacing)


def _at_most_coverage(problem: Problem) -> Coverage | Localisation:
    """The objective, whose values are at most P_n."""
    if not isinstance(problem.objective, Coverage | Localisation):
        raise InputError(
            f"there is no upper bound for the objective {type(problem.objective).__name__}, only for Coverage and "
            "Localisation."
        )
    problem.scene.check_compiled("an upper bound")
    return problem.objective


class Kind(NamedTuple):
    """The free landmarks of one size."""

    evaluator: Evaluator
    """The scene with tags of that size alone."""
    cells: Cells
    """Pieces of the walls where they may hang."""
    poses: Deployment
    """Landmarks at the centres of the cells, with their edge."""
    number: int
    """How many there are."""


def _kinds(problem: Problem, evaluator: Evaluator, count: int, spacing: float) -> list[Kind]:
    """The sizes of the free landmarks of `count`.

    Raises:
        InputError: there are several, and another number of landmarks than that of the problem.
    """
    plates, sizes = problem.scene.plates, problem.free_sizes
    if not problem.scene.has_several_sizes:
        sizes = np.full(count - problem.fixed_count, sizes[0])
    elif count != problem.count:
        raise InputError(f"of {count} landmarks it is not known how many have each size.")
    kinds = []
    for edge, number in zip(*np.unique(sizes, return_counts=True), strict=True):
        cells = wall_cells(plates.inset(plates.tag.paper_share * edge), spacing)
        poses = replace(cells.poses, edges=np.full(len(cells.poses), edge or np.nan))
        kinds.append(Kind(evaluator.sized(np.array([edge])), cells, poses, int(number)))
    return kinds


def _bound(problem: Problem, relaxation: Relaxation, count: int, search: Search) -> UpperBound:
    """Multipliers found on the grid of poses, and what they prove for the whole walls."""
    kinds, limit = _kinds(problem, relaxation.evaluator, count, search.spacing), search.limit
    free, numbers = count - problem.fixed_count, np.array([kind.number for kind in kinds])
    solving = limit.part(MULTIPLIERS_SHARE)
    dual, grid, fractional = _solve(relaxation, kinds, replace(search, limit=solving))
    limit.cut += solving.cut
    if grid >= 1.0:  # whatever the walls earn
        return UpperBound(1.0, 1.0, fractional, dual, 0.0)
    each, tolerance = np.empty(len(kinds)), search.tolerance / free
    for i, kind in enumerate(kinds):
        walls = limit.part(1.0 / (len(kinds) - i))
        each[i] = largest_gain(kind.evaluator, kind.cells, dual.prices, tolerance, walls)
        limit.cut += walls.cut
    gain = float(each.max() - numbers @ (each.max() - each) / free)  # the mean; of one size exactly its own
    return UpperBound(dual.bound(free, gain), grid, fractional, dual, gain)


def _solve(relaxation: Relaxation, kinds: Sequence[Kind], search: Search) -> tuple[Dual, float, float]:
    """The best multipliers found for the landmarks of all kinds, their bound on the poses, and the largest F found."""
    evaluator, poses = relaxation.evaluator, reduce(operator.add, (kind.poses for kind in kinds))
    ends = np.cumsum([0, *(len(kind.poses) for kind in kinds)]).tolist()
    parts = [(slice(*at), kind.number) for at, kind in zip(pairwise(ends), kinds, strict=True)]
    x = ahead = np.concatenate([np.full(len(kind.poses), kind.number / len(kind.poses)) for kind in kinds])
    began, limit = clock(), search.limit
    covered = covered_ahead = covered_amounts(evaluator, poses, x)
    look = clock() - began  # the longest there is: every pose counts
    fractional, momentum, curvature = relaxation.value(covered), 1.0, 0.0
    best, grid = Dual(1.0, np.zeros_like(covered)), 1.0
    for step in range(search.iterations):
        so_far = f"after {step} of {search.iterations} steps"
        limit.tell(f"{so_far}: <= {grid:.2%} on the grid of poses, where fractions of landmarks reach {fractional:.2%}")
        if not limit.leaves(look, f"the multipliers {so_far}"):
            break
        width = max(FIRST_WIDTH * 0.5 ** (step // STEPS_PER_WIDTH), LAST_WIDTH)
        value, dual = relaxation.smoothed(covered_ahead, width)
        gradient = gains(evaluator, poses, dual.prices)
        earned = sum(count * float(gradient[part].max()) for part, count in parts)
        if (bound := dual.bound(1, earned)) < grid:
            best, grid = dual, bound
        if grid - fractional <= search.tolerance:
            break
        curvature = 0.9 * curvature or 0.01 * gradient.max() / x.max()
        while limit.leaves(look, f"the multipliers {so_far}"):
            up = ahead + gradient / curvature
            new = np.concatenate([nearest_on_simplex(up[part], count) for part, count in parts])
            covered_new, moved = covered_amounts(evaluator, poses, new), new - ahead
            model = value + gradient @ moved - curvature / 2.0 * moved @ moved
            if relaxation.smoothed(covered_new, width)[0] >= model - TOLERANCE:
                break
            curvature *= 2.0
        else:
            break
        fractional = max(fractional, relaxation.value(covered_new))
        # Momentum that no longer leads uphill, or belongs to another width, is dropped.
        if gradient @ (new - x) < 0.0 or step % STEPS_PER_WIDTH == STEPS_PER_WIDTH - 1:
            momentum = 1.0
        before, momentum = momentum, (1.0 + math.sqrt(1.0 + 4.0 * momentum**2)) / 2.0
        carry = (before - 1.0) / momentum
        ahead, covered_ahead = new + carry * (new - x), covered_new + carry * (covered_new - covered)
        x, covered = new, covered_new
    return best, grid, fractional
