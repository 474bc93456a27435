"""Upper bounds on the fitness of any deployment, from a concave relaxation of the problem and the dual of this
relaxation.

The objective is P_n, the probability that a view covers n landmarks. The fitness is the average of P_n over the
positions, or the fraction of qualified positions, where P_n reaches a threshold thold_p.

Let x_j be the number of landmarks with pose j (any flush pose on the walls; sum_j x_j = K). A_jpa is 1 if a landmark
with pose j is covered at position p and axis (orientation) a, without occlusion, else 0. Let c_pa = sum_j x_j A_jpa,
let w_a be the probability of an axis (sum 1), and r_p the weight of a position in the fitness (sum 1). Occlusion only
lowers c, and the indicator (0 or 1) of c >= n is at most min(c/n, 1). So P_n(p) <= s_p = sum_a w_a min(c_pa/n, 1), and
the indicator (0 or 1) that p is qualified is at most min(s_p/t, 1) with t = thold_p. Both kinds of fitness are
therefore at most

    F(x) = sum_p r_p min(s_p / t, 1),        with t = 1 for the average of P_n (there s_p <= 1 anyway).

F is concave in x >= 0, fractions allowed. The bound has Lagrange multipliers in [0, 1]: z_p for each position, and d_pa
for each position and axis. Each multiplier bounds one min in F, as min(v, 1) <= 1 - d + d v for 0 <= d <= 1. Let y_pa =
d_pa z_p r_p w_a / (n t), and let g_j = sum_pa y_pa A_jpa be the gain of a landmark with pose j. Then

    F(x) <= sum_p r_p (1 - z_p + z_p / t) - n sum_pa y_pa + sum_j x_j g_j
         <= constant(z, y) + K max_j g_j.

*Any* multipliers z and d give a valid bound, and none gives a bound below F(x). Good multipliers are the slopes of a
smoothed min(v, 1) at an x with a large F(x), which is found by accelerated projected ascent.

While x is improved, the largest g_j is sought over a grid of poses; at the end it is sought over the whole walls, by
branch and bound on cells (`lmd.sight.poses`). So the bound holds for every flush deployment.

Fixed landmarks are not chosen, and K is the number of free landmarks. Let b_pa be the number of fixed landmarks that
are covered at position p and axis a, without occlusion. Then c_pa = b_pa + sum_j x_j A_jpa adds sum_pa y_pa b_pa to the
constant.

With K_s tags of size s, of which x_js are at pose j, each size has its own A^s_jpa and g_js. K max_j g_j becomes sum_s
K_s max_j g_js; each maximum is sought where a tag of that size may hang.

A localised view covers n landmarks, so the bounds also hold for `Localisation`, although they ignore its tolerance.

A second upper bound follows from submodularity. This bound holds for landmarks chosen from a grid of poses, and is
compared with the value of the greedy choice.

Greedy selection maximises a surrogate f of the objective, see `lmd.objectives.base.Selectable`. Without occlusion, f is
monotone and submodular in the landmarks. The gain of a landmark at a set S of landmarks is the increase of f if the
landmark is added to S. For *any* set S the best K poses of a grid, each taken once, reach at most

    f(S) + the sum of the K largest gains at S.        (Nemhauser, Wolsey and Fisher 1978)

S is the greedy choice or empty, whichever gives the smaller bound. The greedy choice always reaches 1 - 1/e of the best
value; the bound gives a fraction that the greedy choice certainly reaches in this problem. A landmark adds nothing to
the views from which it is hidden, and more landmarks never lower f, so the bound also holds with occlusion.

This bound is valid only for poses of the grid, and for the surrogate f instead of the objective itself.

With K_s tags of size s, a candidate is a pose with a size. The best choice has K_s landmarks of each size s. The gains
at S of these landmarks add up to at most the sum of the K_s largest gains of that size. The greedy choice always
reaches half of the best value (Fisher, Nemhauser and Wolsey 1978, for a partition matroid).
"""

import math
import operator
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from lmd.core.checks import Checked, Count, FloatArray, InputError, Positive, real
from lmd.core.compiled import clock
from lmd.evaluation.relaxation import Dual, Relaxation, TimeLimit, largest_gain, solve
from lmd.objectives.base import selectable
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.selection import GAINS_BATCH, Tags, add_each, candidates, select
from lmd.problem import Problem
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import Cells, gains, wall_cells

# Greatest number of landmarks; a target that needs more landmarks raises an error.
MOST_LANDMARKS = 10_000
# Number of scans of each pose that the time limit allows for all bounds of a problem.
SCANS = 250
CALIBRATION_POSES = 500  # number of poses whose scan is timed
MULTIPLIERS_SHARE = 0.3  # share of the time for the multipliers


@dataclass(frozen=True)
class Search(Checked):
    """Limits of the computing effort that is spent on a bound.

    Raises:
        InputError: a number is out of range.
    """

    spacing: Positive = 0.125
    """Largest distance between neighbouring poses of the grid on which the multipliers are found, metres."""
    iterations: Count = 200
    """Largest number of steps of the search for multipliers."""
    tolerance: Positive = 1e-3
    """The search for multipliers stops when its bound exceeds the best value found on the grid by at most this number;
    both are fractions in [0, 1].
    """
    limit: TimeLimit = field(default_factory=TimeLimit)
    """Time limit; the fraction `MULTIPLIERS_SHARE` of it is for the multipliers, and the rest for the search on the
    walls.
    """


@dataclass(frozen=True)
class UpperBound:
    """Upper bounds on the fitness, fractions in [0, 1], and the Lagrange multipliers that prove them."""

    walls: float
    """Upper bound on the fitness of all deployments whose landmarks are flush on the walls."""
    grid: float
    """Upper bound on the fitness of all deployments whose landmarks have poses of the grid."""
    fractional: float
    """Greatest value found if fractions of a landmark may be placed at poses of the grid. The relaxation gives no bound
    for the grid below this value.
    """
    dual: Dual
    """Multipliers for which the bounds hold."""
    gain: float
    """Largest gain of a flush landmark (its contribution to the bound), computed with the multipliers `dual`; for
    several sizes, the mean of their largest gains weighted by the numbers of tags.
    """


def average_upper_bound(problem: Problem, count: int, search: Search) -> UpperBound:
    """Upper bound on the mean of P_n that `count` landmarks can reach.

    P_n is the probability that a view covers n landmarks. The mean is over the grid positions, with equal weights.
    """
    size = len(problem.evaluator.positions)
    shares, n = np.full(size, 1.0 / size), _at_most_coverage(problem).n
    return _bound(problem, Relaxation(problem.evaluator, shares, n, 1.0, problem.fixed_with_edges), count, search)


def fitness_upper_bound(problem: Problem, count: int, search: Search) -> UpperBound:
    """Upper bound on the fitness that `count` landmarks can reach. The fitness is either the total relevance (weight)
    of the qualified positions, or the mean of the objective's values weighted by relevance.
    """
    evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
    objective = _at_most_coverage(problem)
    averaged = isinstance(objective, Localisation) and objective.climbs == "mean"
    # Positions qualify from TOLERANCE below thold_p on; for thold_p = 0 all positions qualify.
    threshold = 1.0 if averaged else objective.thold_p - TOLERANCE
    if threshold <= 0.0:
        return UpperBound(1.0, 1.0, 1.0, Dual(1.0, np.zeros((len(relevance), evaluator.axes.shape[1]))), 0.0)
    relaxation = Relaxation(evaluator, relevance / relevance.sum(), objective.n, threshold, problem.fixed_with_edges)
    return _bound(problem, relaxation, count, search)


def fewest_landmarks(problem: Problem, target: float, search: Search) -> int:
    """Number of landmarks below which no deployment reaches the fitness `target`.

    The number exceeds that of the fixed landmarks. The search increases a number K of landmarks, and stops when the
    upper bound on the fitness with K landmarks reaches the target. Until then, the Lagrange multipliers of this bound
    also bound the fitness with any other number of landmarks, by a linear function of this number. The least number at
    which the function reaches the target is the next K, as no smaller number can suffice.

    Raises:
        InputError: even `MOST_LANDMARKS` landmarks do not reach the target, or tags have several sizes.
    """
    problem.scene.check_one_size("a least number of landmarks")
    real("target", target, low=0.0, high=1.0)
    count = max(_at_most_coverage(problem).n, problem.fixed_count + 1)
    while (bound := fitness_upper_bound(problem, count, search)).walls < target - TOLERANCE:
        count = problem.fixed_count + math.ceil((target - bound.dual.constant) / bound.gain - TOLERANCE)
        if count > MOST_LANDMARKS:
            raise InputError(f"target = {target:g} cannot be reached with {MOST_LANDMARKS} landmarks.", "target")
    return count


def affordable(problem: Problem, count: int, search: Search) -> Search:
    """Return `search` with a spacing of the grid of poses at which the search for a bound keeps its time limit.

    The bound is that for `count` landmarks. The time of the search is estimated from the time of evaluating some poses.
    Without a time limit `search` is returned unchanged.

    Raises:
        InputError: there is no upper bound for the objective, or the visibility model has no compiled code.
    """
    _at_most_coverage(problem)
    spacing, evaluator, each = search.spacing, problem.evaluator, 0.0
    widest = max(max(wall.extent) for wall in problem.scene.room.surfaces())
    while search.limit.seconds < math.inf:
        poses = reduce(operator.add, (kind.poses for kind in _kinds(problem, evaluator, count, spacing)))
        if not each:
            some, began = poses[:: max(len(poses) // CALIBRATION_POSES, 1)], clock()
            gains(evaluator, some, np.ones((len(evaluator.positions), evaluator.axes.shape[1])))
            each = (clock() - began) / len(some)
        if SCANS * each * len(poses) <= search.limit.left or spacing >= widest:
            break
        spacing *= 1.3
    return replace(search, spacing=spacing)


def _at_most_coverage(problem: Problem) -> Coverage | Localisation:
    """Return the objective of the problem, after a check that its values never exceed P_n, the probability that a view
    covers n landmarks. Raises `InputError` otherwise.
    """
    if not isinstance(problem.objective, Coverage | Localisation):
        raise InputError(
            f"there is no upper bound for the objective {type(problem.objective).__name__}, only for Coverage and "
            "Localisation."
        )
    problem.scene.check_compiled("an upper bound")
    return problem.objective


class Kind(NamedTuple):
    """Landmarks of one size whose poses are to be chosen (free landmarks), and the places where they may hang."""

    evaluator: Evaluator
    """Evaluator of the problem's scene, in which all tags have the size of this group."""
    cells: Cells
    """Cells of the walls where the landmarks may hang."""
    poses: Deployment
    """Landmarks at the centres of the cells, with their edge lengths."""
    number: int
    """Number of free landmarks in the group."""


def _free_sizes(problem: Problem, count: int) -> FloatArray:
    """Edge lengths, metres, of the landmarks among `count` whose poses are to be chosen, not fixed; 0 for points.

    Raises `InputError` if tags have several sizes and `count` is not the problem's number of landmarks.
    """
    if not problem.scene.has_several_sizes:
        return np.full(count - problem.fixed_count, problem.sizes[0])
    if count != problem.count:
        raise InputError(f"tags have several sizes: how many of each is known for {problem.count}, not for {count}.")
    return problem.free_sizes


def _kinds(problem: Problem, evaluator: Evaluator, count: int, spacing: float) -> list[Kind]:
    """Group, by size, the landmarks among `count` whose poses are to be chosen, not fixed.

    The walls are divided into cells of at most `spacing` metres.

    Raises:
        InputError: tags have several sizes and `count` is not the problem's number of landmarks, so the numbers of each
            size are unknown.
    """
    footprints, kinds = problem.scene.footprints, []
    for edge, number in zip(*np.unique(_free_sizes(problem, count), return_counts=True), strict=True):
        cells = wall_cells(footprints.inset(footprints.tag.paper_share * edge), spacing)
        poses = replace(cells.poses, edges=np.full(len(cells.poses), edge or np.nan))
        kinds.append(Kind(evaluator.sized(np.array([edge])), cells, poses, int(number)))
    return kinds


def _bound(problem: Problem, relaxation: Relaxation, count: int, search: Search) -> UpperBound:
    """Compute upper bounds on the fitness with `count` landmarks.

    Lagrange multipliers are found on a grid of poses; then the bound that they give for the whole walls is computed.
    """
    kinds, limit = _kinds(problem, relaxation.evaluator, count, search.spacing), search.limit
    free, numbers = count - problem.fixed_count, np.array([kind.number for kind in kinds])
    solving = limit.part(MULTIPLIERS_SHARE)
    poses = [(kind.poses, kind.number) for kind in kinds]
    dual, grid, fractional = solve(relaxation, poses, search.iterations, search.tolerance, solving)
    limit.cut += solving.cut
    if grid >= 1.0:  # the search on the walls cannot lower the bound
        return UpperBound(1.0, 1.0, fractional, dual, 0.0)
    each, tolerance = np.empty(len(kinds)), search.tolerance / free
    for i, kind in enumerate(kinds):
        walls = limit.part(1.0 / (len(kinds) - i))
        each[i] = largest_gain(kind.evaluator, kind.cells, dual.prices, tolerance, walls)
        limit.cut += walls.cut
    gain = float(each.max() - numbers @ (each.max() - each) / free)  # weighted mean, exact for one size
    return UpperBound(dual.bound(free, gain), grid, fractional, dual, gain)


# Share of the best value that the greedy choice always reaches if no pose excludes another: for one size, and for
# several.
GUARANTEE, GUARANTEE_OF_SIZES = 1.0 - np.exp(-1.0), 0.5


@dataclass(frozen=True)
class SelectionBound:
    """Value of the surrogate (`selection`) that the greedy choice reaches, and upper bound on it for all choices.

    Greedy selection maximises the surrogate in place of the objective. Both numbers are gains over the fixed landmarks.
    """

    label: str
    """Name of the surrogate."""
    greedy: float
    """Value of the surrogate for the greedy choice."""
    grid: float
    """Upper bound for all choices of poses from the grid."""
    guarantee: float = GUARANTEE
    """Fraction of the best value that the greedy choice always reaches."""

    @property
    def share(self) -> float:
        """Lower bound on the ratio between the value of the greedy choice and the value of the best choice."""
        return self.greedy / self.grid if self.grid > 0.0 else 1.0


def selection_upper_bound(
    problem: Problem, count: int, spacing: float, limit: TimeLimit | None = None
) -> SelectionBound:
    """Upper bound on the objective's surrogate (`selection`) for `count` landmarks, chosen from a grid of poses.

    The surrogate refers to the same poses of the camera as the problem's fitness. The greedy choice keeps the areas of
    the tags on the walls apart; the bound also holds if they overlap. The result does not depend on the number of
    threads.

    Args:
        problem: the problem.
        count: number of landmarks, including fixed ones.
        spacing: largest distance between neighbouring poses of the grid, metres.
        limit: time limit; every pose is evaluated once even if this takes longer. None for no limit.

    Raises:
        InputError: the objective has no selection, the spacing is not positive, or there are several sizes and `count`
            is not the problem's number of landmarks.
    """
    footprints, objective = problem.scene.footprints, selectable(problem.objective)
    evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
    sizes = _free_sizes(problem, count)
    poses, stock = candidates(footprints, problem.free_edges, spacing), Tags(sizes, problem.scene.tag)
    own = poses.edges_of(problem.scene.tag)
    limit, selection, greedy = limit or TimeLimit(), objective.selection(evaluator, relevance), 0.0
    add_each(selection, problem.fixed_with_edges)

    def largest(gains: FloatArray) -> float:
        """Sum of the largest gains of candidates of each size, over all sizes.

        As many gains of a size are summed as landmarks of this size are chosen. `gains` has the gains of all
        candidates.
        """
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
    guarantee = 0.0 if limit.cut else GUARANTEE_OF_SIZES if problem.scene.has_several_sizes else GUARANTEE
    return SelectionBound(selection.label, greedy, min(at_first, greedy + largest(gains)), guarantee)
