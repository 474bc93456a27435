"""Best choice of poses from a lattice with a proof of optimality, by the integer program of `lattice`."""

from concurrent.futures import wait

import numpy as np
from typing_extensions import override

from lmd.core.checks import InputError, real
from lmd.core.compiled import clock
from lmd.core.threads import in_daemon
from lmd.optimisers.base import Callback, Result
from lmd.optimisers.deployment_search import DeploymentSearch
from lmd.optimisers.lattice import Program, check_lattice, lattice_of, placed
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

PROVEN, INFEASIBLE = 0, 2  # status of scipy.optimize.milp
POLL_SECONDS = 0.2  # seconds between two questions while the solver runs


class Milp(DeploymentSearch):
    """Best deployment on a lattice of poses, with a bound for all deployments on it.

    The start is the result until the solver finds a better deployment. Computing the views of a pose costs as much of
    the budget as moving one landmark; the solver costs only time. The solver cannot be resumed: a resumed run starts
    over.

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
        self.proven: dict[str, float] = {}

    def figures(self) -> dict[str, float]:
        """Bound, value of the solver's choice without occlusion, and distance of the result from the bound."""
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
                f"the lattice of the integer program has {len(poses)} poses: with what they cover it takes "
                f"{needed:.4g} evaluations, more than the {budget.limit - ledger.evaluations:g} that are left."
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
                f"no {problem.free_count} poses of the lattice, {self.spacing:g} m apart, have papers that do not "
                "overlap."
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
