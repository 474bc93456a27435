"""Best choice of landmark poses from a lattice, with a proof of optimality, by mixed-integer linear programming.

The solver is HiGHS. A lattice is a regular grid of poses on the surfaces. A view is a position p together with an
optical axis a of the camera. The program uses these numbers:

- `A_jpa`: 1 if the view of position p and axis a sees a landmark at pose j (occlusion ignored), else 0;
- `x_j`: number of landmarks at pose j; K is the number of landmarks to place;
- `w_a`: probability of axis a; `r_p`: relevance of position p;
- `thold_p`: total probability that views with at least n visible landmarks must reach for p to be qualified.

The program is:

    maximise   sum_p r_p z_p                                        z_p: position p is qualified
    such that  n y_pa <= sum_j A_jpa x_j   for all p, a             y_pa: the view sees at least n landmarks
               thold_p z_p <= sum_a w_a y_pa   for all p
               sum_j x_j = K,   of each size of tags if there are several,   y and z 0 or 1,
               x_j 0 to n for points; 0 or 1 for tags, and x_i + x_j <= 1 where their papers overlap.

Views of a position that see the same set of poses share one constraint and one y, with the sum of their `w_a`.
Occlusion only reduces the numbers of landmarks seen, so an upper bound on the program also holds with occlusion. The
chosen deployment is evaluated with occlusion, after landmarks that share a pose are moved apart.
"""

import operator
from collections.abc import Callable, Mapping
from concurrent.futures import wait
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, OptimizeResult, milp
from scipy.sparse import block_array, block_diag, coo_array, csr_array, eye_array
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, real
from lmd.core.compiled import clock
from lmd.core.threads import in_daemon
from lmd.objectives.coverage import Coverage
from lmd.objectives.crowd import seeks_worst
from lmd.optimisers.annealing.surrogate import STACK_SPREAD, pulled_apart
from lmd.optimisers.base import Callback, DeploymentSearch, Result
from lmd.optimisers.ledger import Budget
from lmd.optimisers.selection import candidates
from lmd.problem import Problem
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.poses import covered_amounts

MOST_PAIRS = 20_000_000  # largest number of pairs of a pose and a view; HiGHS solves far fewer pairs in an hour


def lattice_of(problem: Problem, spacing: float) -> Deployment:
    """Poses of a lattice, a regular grid on the surfaces, at which free landmarks may be placed.

    Poses whose footprints would overlap the footprints of fixed tags are left out. `spacing` is in metres.
    """
    footprints, hung = problem.scene.footprints, problem.fixed_with_edges
    poses = candidates(footprints, problem.free_edges, spacing)
    if hung is None or not footprints.edge:
        return poses
    taken = [footprints.touched(poses, hung[k : k + 1]) for k in range(len(hung))]
    return poses[~np.any(taken, axis=0)]


def check_lattice(problem: Problem, poses: Deployment, spacing: float) -> None:
    """Raise `InputError` if the integer program of a problem is not possible, or too large, for the lattice `poses`."""
    objective = problem.objective
    if not isinstance(objective, Coverage) or objective.sampling is not None:
        raise InputError("the integer program needs the objective Coverage on the grid, without a sampling.")
    if problem.scene.rig is not None:
        raise InputError("the integer program needs a single camera, not a rig.")
    if seeks_worst(problem.evaluator):
        raise InputError("the integer program needs crowd.fitness = mean, the mean over all crowd states.")
    views = _views(problem).size
    lattice = f"the lattice of the integer program has {len(poses)} poses, {spacing:g} m apart"
    if len(poses) * views > MOST_PAIRS:
        raise InputError(
            f"{lattice}, which makes {len(poses) * views:.3g} pairs with the {views} views: at most {MOST_PAIRS:.3g} "
            "can be solved; increase spacing."
        )
    if any(len(of) * per_pose(problem) < count for of, count in by_size(problem, poses)):
        raise InputError(f"{lattice}, too few for {problem.free_count} landmarks: reduce spacing.")


def by_size(problem: Problem, poses: Deployment) -> list[tuple[IntArray, int]]:
    """For each size of free landmarks: the indices of the lattice poses for it, and the number of these landmarks.

    Landmarks of different sizes have different poses, because each size has a grid of its own.
    """
    sizes, own = problem.free_sizes, poses.edges_of(problem.scene.tag)
    return [(np.flatnonzero(own == edge), int((sizes == edge).sum())) for edge in np.unique(sizes)]


def per_pose(problem: Problem) -> int:
    """Largest number of landmarks at a pose: for points, the number n that a view must see; for tags with a size, 1."""
    return 1 if problem.scene.footprints.edge else problem.objective.n


def placed(problem: Problem, poses: Deployment, taken: IntArray) -> Deployment:
    """Make the deployment with `taken[j]` landmarks at the j-th of J poses; fixed landmarks come first.

    Point landmarks that share a pose are moved apart, onto a small circle around the pose. If the poses have edge
    lengths, the tags are in the order of their edge lengths in `problem.free_sizes`.
    """
    if poses.has_own_edges:
        sizes, own = problem.free_sizes, poses.edges_of(problem.scene.tag)
        order = np.empty(len(sizes), dtype=int)
        for of, _ in by_size(problem, poses):
            order[sizes == own[of[0]]] = np.repeat(of, taken[of])
        chosen = poses[order]
        return problem.complete(Deployment(chosen.positions, chosen.normals, chosen.surfaces))
    parts, distance = [], STACK_SPREAD * problem.scene.spacing
    for stack in np.unique(taken[taken > 0]).tolist():
        at = poses[taken == stack]
        parts.append(pulled_apart(problem, at, np.zeros(len(at)), stack, distance))
    return problem.complete(reduce(operator.add, parts))


def _seen(problem: Problem, landmarks: Deployment) -> NDArray[np.int8]:
    """Number of `landmarks` that each view (a position with an optical axis) sees, `(P, A)`, if none hides another one.

    Numbers above n, the number that the objective requires, are replaced by n.
    """
    counts = covered_amounts(problem.evaluator, landmarks, np.ones(len(landmarks)))
    return np.minimum(counts[:, _used(problem)], problem.objective.n).astype(np.int8)


def _views(problem: Problem) -> FloatArray:
    """Probability of each view (a position with an optical axis), `(P, A)`; axes that never occur are left out."""
    evaluator = problem.evaluator
    probability = evaluator.probability[:, _used(problem)]
    return np.broadcast_to(probability, (len(evaluator.positions), probability.shape[1]))


def _used(problem: Problem) -> BoolArray:
    """Mask of the optical axes that have a positive probability; the evaluator also stores axes that never occur."""
    return np.asarray(problem.evaluator.probability.max(axis=0) > 0.0)


@dataclass(frozen=True)
class Program:
    """Integer program of the module docstring, with J variables x, R variables y and P variables z.

    J is the number of poses, and P the number of positions. A *row* consists of all views of one position that see the
    same set of poses. The R rows have one variable y each.
    """

    covers: csr_array
    """Matrix `(R, J)` with 1 if the views of the row see a landmark at the pose, else 0."""
    counted: IntArray
    """Number of fixed landmarks that the views of each row see, `(R,)`."""
    weights: csr_array
    """Matrix `(P, R)`: the total probability of the views of row r if they belong to position p, else 0."""
    overlaps: coo_array
    """Matrix `(C, J)` with 1 at both poses of each of C pairs whose footprints overlap."""
    sizes: csr_array
    """Matrix `(S, J)` with 1 if pose j is meant for tags of size s, else 0."""
    counts: IntArray
    """Number of landmarks of each size, `(S,)`."""
    relevance: FloatArray
    """Relevance of each position, `(P,)`."""
    n: int
    """Number n of landmarks that a view must see to count as covered."""
    threshold: float
    """Threshold thold_p: a position is qualified if its covered views have at least this total probability."""
    copies: int
    """Largest number of landmarks that may share a pose, see `per_pose`."""

    @classmethod
    def of(cls, problem: Problem, poses: Deployment) -> "Program":
        """Make the program for the poses of a lattice."""
        views, footprints, hung = _views(problem), problem.scene.footprints, problem.fixed_with_edges
        already = np.zeros(views.shape, np.int8) if hung is None else _seen(problem, hung)
        each = (_seen(problem, poses[j : j + 1]) for j in range(len(poses)))
        cover = np.stack([already, *each], axis=-1)  # (P, A, 1 + J)
        kinds = [np.unique(views, axis=0, return_inverse=True) for views in cover]
        rows = np.concatenate([distinct for distinct, _ in kinds])
        weights = [np.bincount(kind, weight)[None] for (_, kind), weight in zip(kinds, views, strict=True)]
        close = [footprints.touched(poses, poses[j : j + 1]) for j in range(len(poses))] if footprints.edge else []
        pairs = np.argwhere(np.triu(close, 1)) if close else np.empty((0, 2), dtype=int)
        overlaps = coo_array((np.ones(pairs.size), (np.arange(len(pairs)).repeat(2), pairs.reshape(-1))),
                             shape=(len(pairs), len(poses)))  # fmt: skip
        sizes = by_size(problem, poses)
        of = csr_array([np.isin(np.arange(len(poses)), own) for own, _ in sizes], dtype=float)
        counts = np.array([count for _, count in sizes])
        left = csr_array(rows[:, 1:], dtype=float), rows[:, 0], block_diag(weights), overlaps, of, counts
        threshold = max(problem.objective.threshold - TOLERANCE, 0.0)
        return cls(*left, problem.fitness_relevance, problem.objective.n, threshold, per_pose(problem))

    def solver(self, options: Mapping[str, Any]) -> Callable[[], OptimizeResult]:
        """Return a function that solves the program by HiGHS.

        HiGHS minimises, so its objective is the total relevance of the qualified positions with the opposite sign.

        Args:
            options: limits of `scipy.optimize.milp`, such as `time_limit`.
        """
        (rows, poses), positions = self.covers.shape, len(self.relevance)
        left = block_array([
            [self.sizes, None, None],
            [self.covers, -self.n * eye_array(rows), None],
            [None, self.weights, -self.threshold * eye_array(positions)],
            [self.overlaps, None, None],
        ])  # fmt: skip
        overlaps = self.overlaps.shape[0]
        low = np.concatenate([self.counts, -self.counted, np.zeros(positions), np.full(overlaps, -np.inf)])
        high = np.concatenate([self.counts, np.full(rows + positions, np.inf), np.ones(overlaps)])
        largest = np.ones(poses + rows + positions)
        largest[:poses] = self.copies
        return partial(
            milp,
            np.concatenate([np.zeros(poses + rows), -self.relevance]),
            constraints=LinearConstraint(left.tocsc(), low, high),
            # For n = 1, integral x give integral y; for larger n, y must be declared integral.
            integrality=np.concatenate([np.ones(poses), np.full(rows, self.n > 1), np.ones(positions)]),
            bounds=Bounds(0.0, largest),
            options={**options, "mip_rel_gap": 0.0},
        )

    def taken(self, solved: OptimizeResult) -> IntArray:
        """Number of landmarks at each pose in a solution, `(J,)`."""
        return np.asarray(np.rint(solved.x[: self.covers.shape[1]]), dtype=np.int64)  # HiGHS returns integers to 1e-6

    def value(self, solved: OptimizeResult) -> float:
        """Total relevance of the qualified positions in a solution, as a fraction of that of all positions."""
        qualified = np.rint(solved.x[-len(self.relevance) :]).astype(int)
        return float(self.relevance @ qualified / self.relevance.sum())


PROVEN, INFEASIBLE = 0, 2  # status of scipy.optimize.milp
POLL_SECONDS = 0.2  # seconds between two calls of the callback while the solver runs


class Milp(DeploymentSearch):
    """Optimiser that finds the best deployment on a lattice of poses, and an upper bound on the fitness.

    The bound holds for all deployments on this lattice.

    The start is the result until the solver finds a better deployment. For each pose of the lattice, computing the
    views that would see a landmark at this pose costs as much of the budget as moving one landmark; the solver costs
    only time. The solver cannot be resumed: a resumed run starts over.

    Args:
        spacing: spacing of the lattice, metres.
        seconds: time limit of the solver; the best deployment found until then is the result, and the upper bound found
            until then is valid.
        seed: seed of the start, see `Optimiser`; the solver draws no random numbers.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(self, spacing: float = 0.5, seconds: float = 600.0, seed: int = 0) -> None:
        super().__init__(seed)
        self.spacing = real("spacing", spacing, above=0.0)
        self.seconds = real("seconds", seconds, above=0.0)
        self.proven: dict[str, float] = {}

    def figures(self) -> dict[str, float]:
        """Metrics of the proof, keyed by name.

        `lattice_bound` is the upper bound on the fitness, `lattice_found` the fitness of the solver's deployment if
        occlusion is ignored, and `lattice_gap` the bound minus the fitness of the result.
        """
        return self.proven

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        check_lattice(problem, lattice_of(problem, self.spacing), self.spacing)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger, poses = self.ledger, lattice_of(problem, self.spacing)
        began = clock() - ledger.seconds

        def note(evaluations: float, found: Deployment) -> None:
            self._record(problem, ledger.evaluations + evaluations, found, began)

        costs = len(poses) / problem.count
        needed = (not ledger.evaluations) + costs + 1
        if ledger.evaluations + needed > budget.limit:
            raise InputError(
                f"the lattice of the integer program has {len(poses)} poses: it costs {needed:.4g} evaluations to find "
                f"the views that see them, but only {budget.limit - ledger.evaluations:g} are left; increase spacing."
            )
        if not ledger.evaluations:
            note(1, problem.draw(np.random.default_rng(self.seed)))
        program, most = Program.of(problem, poses), problem.fitness_relevance.sum()
        limit = min(self.seconds, (budget.seconds or np.inf) - (clock() - began))

        outcome = in_daemon(program.solver({"time_limit": max(limit, POLL_SECONDS)}))
        while not wait([outcome], POLL_SECONDS).done:
            ledger.seconds = clock() - began
            if callback and callback(self):
                return self.result(problem, "interrupted")
        solved = outcome.result()
        if solved.status == INFEASIBLE:
            raise InputError(
                f"{problem.free_count} tags cannot be placed without overlap on the lattice with a spacing of "
                f"{self.spacing:g} m."
            )
        self.proven = {
            "lattice_bound": 1.0 if solved.mip_dual_bound is None else min(-solved.mip_dual_bound / most, 1.0)
        }
        if solved.x is not None:
            note(costs + 1, placed(problem, poses, program.taken(solved)))
            self.proven["lattice_found"] = found = program.value(solved)
            if solved.status == PROVEN:
                self.proven["lattice_bound"] = found
        self.proven["lattice_gap"] = self.proven["lattice_bound"] - ledger.best_fitness
        return self.result(problem, "proven" if solved.status == PROVEN else "budget")
