"""Base of searches that solve the integer program of `lattice` again and again.

The solver is limited by nodes of its tree, not by time, so a result depends on the seed and the settings alone; only a
budget of seconds makes it depend on the machine.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from lmd.core.checks import InputError, IntArray, integer, real
from lmd.core.compiled import clock
from lmd.objectives.base import selectable
from lmd.optimisers.base import Callback, Result
from lmd.optimisers.deployment_search import DeploymentSearch
from lmd.optimisers.lattice import POLL_SECONDS, Program, check_lattice, covers_of, lattice_of, placed, solved_beside
from lmd.optimisers.ledger import Budget
from lmd.optimisers.selection import Tags, select
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

PERFECT = 1.0  # largest fitness


@dataclass(frozen=True)
class Round:
    """Program to solve next."""

    views: int
    """Number of poses whose views are evaluated for it."""
    poses: Deployment
    """Poses of the program."""
    make: Callable[[], tuple[Program, IntArray | None, IntArray | None]]
    """Makes the program, with the least and the largest number of landmarks at each pose, see `Program.solver`."""


class LatticeSearch(DeploymentSearch):
    """Search from the greedy choice on a lattice; subclasses write `_next`, `_accept` and `_ended`.

    A round solves a program, places the landmarks at its choice and evaluates them with occlusion. It costs 1
    evaluation, also if the choice is not new. The views of a pose cost as much as moving one landmark, once. The solver
    costs time alone. A stopped run is resumed with the round that it was in.

    Args:
        spacing: spacing of the lattice, metres.
        nodes: largest number of nodes in the solver's tree in each round.
        margin: height of the program's threshold above the true one, in value: occlusion takes away some value.
        seed: seed of the start and of all random choices, see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(self, spacing: float, nodes: int, margin: float, seed: int) -> None:
        super().__init__(seed)
        self.margin = real("margin", margin, low=0.0, high=1.0)
        self.spacing, self.nodes = real("spacing", spacing, above=0.0), integer("nodes", nodes, low=1)
        self.rounds = 0  # number of completed rounds
        self.lattice: Deployment  # poses of the lattice
        self.covers: NDArray[np.int8]  # their views, see `covers_of`

    @abstractmethod
    def _begin(self, problem: Problem, taken: IntArray, fitness: float) -> None:
        """Take over the greedy choice, `taken` `(J,)` landmarks at each pose of the lattice, and its fitness."""

    @abstractmethod
    def _next(self, problem: Problem) -> "Round":
        """Return the next round."""

    @abstractmethod
    def _accept(self, problem: Problem, poses: Deployment, taken: IntArray, value: float, fitness: float) -> None:
        """Learn the choice of a round, its value in the program and its fitness with occlusion."""

    @abstractmethod
    def _failed(self) -> None:
        """Learn that a round found no choice within its nodes."""

    @abstractmethod
    def _ended(self) -> bool:
        """True if no further round is worth its cost."""

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        check_lattice(problem, lattice_of(problem, self.spacing), self.spacing)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger = self.ledger
        began = clock() - ledger.seconds

        def note(evaluations: float, found: Deployment | None) -> float:
            return self._record(problem, ledger.evaluations + evaluations, found, began)

        def stop() -> bool | None:
            ledger.seconds = clock() - began
            return callback(self) if callback else None

        self.lattice = lattice_of(problem, self.spacing)
        if not ledger.history:
            self._start(problem, budget, note)
        self.covers = covers_of(problem, self.lattice)
        while ledger.best_fitness < PERFECT and not self._ended():
            following = self._next(problem)
            cost = following.views / problem.count + 1
            left = np.inf if budget.seconds is None else budget.seconds - (clock() - began)
            if ledger.evaluations + cost > budget.limit or left <= 0.0:
                break
            limits: dict[str, float] = {"node_limit": self.nodes}
            if np.isfinite(left):
                limits["time_limit"] = max(left, POLL_SECONDS)
            program, least, most = following.make()
            outcome = solved_beside(program.solver(limits, least, most), stop)
            if outcome is None:
                return self.result(problem, "interrupted")
            if outcome.x is None:
                note(cost, None)
                self._failed()
            else:
                taken, poses = program.taken(outcome), following.poses
                fitness = note(cost, placed(problem, poses, taken))
                self._accept(problem, poses, taken, program.value(outcome), fitness)
            self.rounds += 1
            if callback and callback(self):
                return self.result(problem, "interrupted")
        return self.result(problem, "proven" if ledger.best_fitness >= PERFECT else "budget")

    def _start(self, problem: Problem, budget: Budget, note: Callable[[float, Deployment], float]) -> None:
        """Evaluate the start and the greedy choice."""
        needed = len(self.lattice) / problem.count + 2
        if needed > budget.limit:
            raise InputError(
                f"the lattice of the integer program has {len(self.lattice)} poses: with what they cover it takes "
                f"{needed:.4g} evaluations, more than the {budget.limit:g} of the budget."
            )
        note(1, problem.draw(np.random.default_rng(self.seed)))
        taken = self._greedy(problem)
        self._begin(problem, taken, note(needed - 1, placed(problem, self.lattice, taken)))

    def _greedy(self, problem: Problem) -> IntArray:
        """Return the greedy choice, as the number of landmarks at each pose; needs no view that is not paid for."""
        selection = selectable(problem.objective).selection(problem.fitness_evaluator, problem.fitness_relevance)
        footprints, stock = problem.scene.footprints, Tags(problem.free_sizes, problem.scene.tag)
        chosen, _ = select(selection, self.lattice, stock, footprints, fixed=problem.fixed_with_edges)
        if footprints.edge and len(chosen) < problem.free_count:
            raise InputError(
                f"the greedy choice finds room for {len(chosen)} of {problem.free_count} papers on the lattice of "
                f"poses {self.spacing:g} m apart."
            )
        # Points beyond one for each pose are added to stacks.
        return np.bincount(np.resize(chosen, problem.free_count), minlength=len(self.lattice))

    @override
    def state(self) -> dict[str, Any]:
        return {**super().state(), "rounds": self.rounds}

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        super().restore(state, problem)
        self.lattice = lattice_of(problem, self.spacing)
        self.rounds = integer("rounds", state["rounds"], low=0, high=len(self.ledger.history))
