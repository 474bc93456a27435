"""Best choice of poses from a lattice with a proof of optimality: an integer program, solved by HiGHS.

Let `x_j` be the number of landmarks at pose j of the lattice, `A_jpa` = 1 if a landmark at pose j covers axis a from
position p without occlusion, else 0, `w_a` the probability of an axis and `r_p` the relevance of a position. Then

    maximise   sum_p r_p z_p                                        z_p: position p is qualified
    such that  n y_pa <= sum_j A_jpa x_j   for all p, a             y_pa: at least n landmarks are covered
               thold_p z_p <= sum_a w_a y_pa   for all p
               sum_j x_j = K,   of each size of tags if there are several,   y and z 0 or 1,
               x_j 0 to n for points; 0 or 1 for papers, and x_i + x_j <= 1 where they overlap.

Axes that equal sets of poses cover from a position are combined to one row, with the sum of their weights. Occlusion
only reduces the numbers of covered landmarks, so the bound also holds with occlusion. The chosen deployment is
evaluated with occlusion, after the landmarks of each stack are separated.
"""

import operator
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial, reduce
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, OptimizeResult, milp
from scipy.sparse import block_array, block_diag, coo_array, csr_array, eye_array
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, real
from lmd.core.compiled import clock
from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing.surrogate import STACK_SPREAD, pulled_apart
from lmd.optimisers.base import Callback, Optimiser, Result
from lmd.optimisers.ledger import Budget, Ledger
from lmd.optimisers.selection import candidates
from lmd.optimisers.stored import deployment, deployment_state
from lmd.problem import Problem
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.poses import covered_amounts

MOST_PAIRS = 20_000_000  # largest number of pairs of a pose and a view; HiGHS solves far fewer pairs in an hour
PROVEN, INFEASIBLE = 0, 2  # status of scipy.optimize.milp
POLL_SECONDS = 0.2  # seconds between two calls of the callback while the solver runs


class Milp(Optimiser):
    """Best deployment on a lattice of poses, with a bound for all deployments on it.

    The start is the result until the solver finds a better deployment. Computing the views of a pose costs as much of
    the budget as moving one landmark; the solver costs only time. The solver cannot be resumed: a resumed run begins
    anew.

    Args:
        spacing: spacing of the lattice, metres.
        seconds: time limit of the solver; the best deployment found by then is the result, and the bound is valid.
        seed: seed of the start, see `Optimiser`; the solver draws no random numbers.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(self, spacing: float = 0.5, seconds: float = 600.0, seed: int = 0) -> None:
        super().__init__(seed)
        self.spacing = real("spacing", spacing, above=0.0)
        self.seconds = real("seconds", seconds, above=0.0)
        self.best: Deployment | None = None
        self.proven: dict[str, float] = {}

    @override
    def state(self) -> dict[str, Any]:
        best = None if self.best is None else deployment_state(self.best)
        return {**self.ledger.state(), "best": best}

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        self.ledger = Ledger.of(state)
        if self.ledger.history:
            self.best = deployment("best", state["best"], problem, problem.count)

    def figures(self) -> dict[str, float]:
        """Bound, value of the solver's choice without occlusion, and distance of the result from the bound."""
        return self.proven

    @override
    def check(self, problem: Problem) -> None:
        objective = problem.objective
        if not isinstance(objective, Coverage) or objective.sampling is not None:
            raise InputError("the integer program needs the objective of plain coverage at the grid's own positions.")
        if problem.scene.rig is not None:
            raise InputError("the integer program needs a single camera, not a rig.")
        lattice_poses = self._poses(problem)
        poses, views = len(lattice_poses), _views(problem).size
        lattice = f"the lattice of the integer program has {poses} poses, {self.spacing:g} m apart"
        if poses * views > MOST_PAIRS:
            raise InputError(
                f"{lattice}, and {views} views: no more than {MOST_PAIRS:.3g} pairs of a pose and a view make a "
                "program that can be solved."
            )
        if any(len(of) * _per_pose(problem) < count for of, count in _by_size(problem, lattice_poses)):
            raise InputError(f"{lattice}: too few for {problem.free_count} landmarks.")

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger, poses = self.ledger, self._poses(problem)
        began = clock() - ledger.seconds

        def note(evaluations: float, found: Deployment) -> None:
            fitness, ledger.seconds = problem.fitness_of(found), clock() - began
            if ledger.note(ledger.evaluations + evaluations, fitness):
                self.best = found

        costs = len(poses) / problem.count
        needed = (not ledger.evaluations) + costs + 1
        if ledger.evaluations + needed > budget.limit:
            raise InputError(
                f"the lattice of the integer program has {len(poses)} poses: with what they cover it takes "
                f"{needed:.4g} evaluations, more than the {budget.limit - ledger.evaluations:g} that are left."
            )
        if not ledger.evaluations:
            note(1, problem.draw(np.random.default_rng(self.seed)))
        program, most = _Program.of(problem, poses), problem.fitness_relevance.sum()
        outcome: Future[OptimizeResult] = Future()
        limit = min(self.seconds, (budget.seconds or np.inf) - (clock() - began))
        Thread(target=_fulfil, args=(outcome, program.solver(max(limit, POLL_SECONDS))), daemon=True).start()
        while not wait([outcome], POLL_SECONDS).done:
            ledger.seconds = clock() - began
            if callback and callback(self):
                return self.result(problem, "interrupted")
        solved = outcome.result()
        if solved.status == INFEASIBLE:
            raise InputError(
                f"no {problem.free_count} poses of the lattice, {self.spacing:g} m apart, have papers that do not "
                "overlap."
            )
        self.proven = {
            "lattice_bound": 1.0 if solved.mip_dual_bound is None else min(-solved.mip_dual_bound / most, 1.0)
        }
        if solved.x is not None:
            taken = np.rint(solved.x).astype(int)  # HiGHS returns integers to 1e-6
            placed = _in_order if poses.has_own_edges else _separated
            note(costs + 1, placed(problem, poses, taken[: len(poses)]))
            self.proven["lattice_found"] = found = float(problem.fitness_relevance @ taken[-program.positions :] / most)
            if solved.status == PROVEN:
                self.proven["lattice_bound"] = found
        self.proven["lattice_gap"] = self.proven["lattice_bound"] - ledger.best_fitness
        return self.result(problem, "proven" if solved.status == PROVEN else "budget")

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return self.best

    def _poses(self, problem: Problem) -> Deployment:
        """Poses of the lattice whose footprints do not overlap footprints of fixed tags."""
        footprints = problem.scene.footprints
        poses, hung = candidates(footprints, problem.free_edges, self.spacing), problem.fixed_with_edges
        if hung is None or not footprints.edge:
            return poses
        taken = [footprints.touched(poses, hung[k : k + 1]) for k in range(len(hung))]
        return poses[~np.any(taken, axis=0)]


def _by_size(problem: Problem, poses: Deployment) -> list[tuple[IntArray, int]]:
    """Indices of the poses of each size of the free landmarks, and the number of these landmarks."""
    sizes, own = problem.free_sizes, poses.edges_of(problem.scene.tag)
    return [(np.flatnonzero(own == edge), int((sizes == edge).sum())) for edge in np.unique(sizes)]


def _per_pose(problem: Problem) -> int:
    """Largest number of landmarks at a pose: n for points, as in a stack of `Annealing`; 1 for tags with a size."""
    return 1 if problem.scene.footprints.edge else problem.objective.n


def _separated(problem: Problem, poses: Deployment, copies: IntArray) -> Deployment:
    """Make the deployment with `copies` `(J,)` landmarks at each pose: fixed landmarks first, then separated stacks."""
    parts, distance = [], STACK_SPREAD * problem.scene.spacing
    for stack in np.unique(copies[copies > 0]).tolist():
        chosen = poses[copies == stack]
        parts.append(pulled_apart(problem, chosen, np.zeros(len(chosen)), stack, distance))
    return problem.complete(reduce(operator.add, parts))


def _in_order(problem: Problem, poses: Deployment, taken: IntArray) -> Deployment:
    """Make the deployment with a tag at each pose with `taken` `(J,)` 1, in the order of the problem's sizes."""
    sizes = problem.free_sizes
    order = np.empty(len(sizes), dtype=int)
    for of, _ in _by_size(problem, poses):
        order[sizes == poses.edges[of[0]]] = of[taken[of] == 1]
    chosen = poses[order]
    return problem.complete(Deployment(chosen.positions, chosen.normals, chosen.surfaces))


def _views(problem: Problem) -> FloatArray:
    """Probability of each axis that `_used` selects, at each position, `(P, A)`."""
    evaluator = problem.evaluator
    probability = evaluator.probability[:, _used(problem)]
    return np.broadcast_to(probability, (len(evaluator.positions), probability.shape[1]))


def _used(problem: Problem) -> BoolArray:
    """Mask of the axes with a positive probability; axes of probability 0 only pad words of bits."""
    return np.asarray(problem.evaluator.probability.max(axis=0) > 0.0)


@dataclass(frozen=True)
class _Program:
    """Integer program: `x` of the J poses, `y` of the R rows, `z` of the P positions."""

    covers: csr_array
    """`(R, J)` 1 if a landmark at the pose covers the views of the row."""
    counted: IntArray
    """`(R,)` number of fixed landmarks that cover the views of each row."""
    weights: csr_array
    """`(P, R)` probability of the views of each row, at its position."""
    overlaps: coo_array
    """`(C, J)` 1 at the two poses of a pair with overlapping footprints."""
    sizes: csr_array
    """`(S, J)` 1 if the pose is for tags of the size."""
    counts: IntArray
    """`(S,)` number of landmarks of each size."""
    problem: Problem
    """Problem of plain coverage."""

    @classmethod
    def of(cls, problem: Problem, poses: Deployment) -> "_Program":
        """Make the program for the poses of a lattice."""
        used, footprints, n = _used(problem), problem.scene.footprints, problem.objective.n

        def seen(landmarks: Deployment) -> NDArray[np.int8]:
            counts = covered_amounts(problem.evaluator, landmarks, np.ones(len(landmarks)))
            return np.minimum(counts[:, used], n).astype(np.int8)

        views = _views(problem)
        already = np.zeros(views.shape, np.int8) if problem.fixed_with_edges is None else seen(problem.fixed_with_edges)
        cover = np.stack([already, *(seen(poses[j : j + 1]) for j in range(len(poses)))], axis=-1)  # (P, A, 1 + J)
        kinds = [np.unique(views, axis=0, return_inverse=True) for views in cover]
        rows = np.concatenate([distinct for distinct, _ in kinds])
        weights = [np.bincount(kind, weight)[None] for (_, kind), weight in zip(kinds, views, strict=True)]
        close = [footprints.touched(poses, poses[j : j + 1]) for j in range(len(poses))] if footprints.edge else []
        pairs = np.argwhere(np.triu(close, 1)) if close else np.empty((0, 2), dtype=int)
        overlaps = coo_array((np.ones(pairs.size), (np.arange(len(pairs)).repeat(2), pairs.reshape(-1))),
                             shape=(len(pairs), len(poses)))  # fmt: skip
        sizes = _by_size(problem, poses)
        of = csr_array([np.isin(np.arange(len(poses)), own) for own, _ in sizes], dtype=float)
        counts = np.array([count for _, count in sizes])
        covers = csr_array(rows[:, 1:], dtype=float)
        return cls(covers, rows[:, 0], block_diag(weights), overlaps, of, counts, problem)

    @property
    def positions(self) -> int:
        """P, the number of variables z, which come last."""
        return len(self.problem.fitness_relevance)

    def solver(self, seconds: float) -> Callable[[], OptimizeResult]:
        """Return a call of HiGHS with a time limit; its objective is minus the relevance of qualified positions."""
        (rows, poses), n = self.covers.shape, self.problem.objective.n
        threshold = max(self.problem.objective.threshold - TOLERANCE, 0.0)
        left = block_array([
            [self.sizes, None, None],
            [self.covers, -n * eye_array(rows), None],
            [None, self.weights, -threshold * eye_array(self.positions)],
            [self.overlaps, None, None],
        ])  # fmt: skip
        overlaps = self.overlaps.shape[0]
        low = np.concatenate([self.counts, -self.counted, np.zeros(self.positions), np.full(overlaps, -np.inf)])
        high = np.concatenate([self.counts, np.full(rows + self.positions, np.inf), np.ones(overlaps)])
        return partial(
            milp,
            np.concatenate([np.zeros(poses + rows), -self.problem.fitness_relevance]),
            constraints=LinearConstraint(left.tocsc(), low, high),
            # For n = 1, integral x give integral y; for larger n, y must be declared integral.
            integrality=np.concatenate([np.ones(poses), np.full(rows, n > 1), np.ones(self.positions)]),
            bounds=Bounds(
                0.0, np.concatenate([np.full(poses, _per_pose(self.problem)), np.ones(rows + self.positions)])
            ),
            options={"time_limit": seconds, "mip_rel_gap": 0.0},
        )


def _fulfil(future: "Future[OptimizeResult]", work: Callable[[], OptimizeResult]) -> None:
    """Run `work`, and put its result or its error into `future`."""
    try:
        future.set_result(work())
    except BaseException as error:
        future.set_exception(error)
