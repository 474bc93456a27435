"""Large neighbourhood search over the integer program of `lattice`: most landmarks stay, some are placed anew."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import InputError, IntArray, integer, real
from lmd.optimisers.lattice import Program, per_pose
from lmd.optimisers.lattice_search import LatticeSearch, Round
from lmd.optimisers.stored import array
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

NEAR_SHARE = 0.5  # share of the rounds that free neighbours; the others free landmarks anywhere


class LargeNeighbourhoods(LatticeSearch):
    """Rounds in which a few landmarks may move to some poses of the lattice while the others stay.

    The landmarks of a round are neighbours of a random one, or any, with equal probability. A choice is kept unless its
    fitness with occlusion is lower.

    Args:
        spacing: spacing of the lattice, metres.
        freed: number of landmarks placed anew in a round.
        candidates: number of poses, drawn for each round, that they may move to, beside those that are taken.
        nodes: largest number of nodes in the solver's tree in each round.
        margin: see `LatticeSearch`.
        patience: number of rounds without a higher fitness after which the run ends.
        seed: see `LatticeSearch`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self,
        spacing: float = 0.5,
        freed: int = 3,
        candidates: int = 50,
        nodes: int = 20,
        margin: float = 0.0,
        patience: int = 50,
        seed: int = 0,
    ) -> None:
        super().__init__(spacing, nodes, margin, seed)
        self.candidates = integer("candidates", candidates, low=1)
        self.freed, self.patience = integer("freed", freed, low=1), integer("patience", patience, low=1)
        self.taken: IntArray  # number of landmarks at each pose
        self.fitness = -np.inf  # with `taken`
        self.without = 0  # number of rounds since the fitness has risen
        self.program: Program | None = None

    @override
    def _begin(self, problem: Problem, taken: IntArray, fitness: float) -> None:
        self.taken, self.fitness = taken, fitness

    @override
    def _next(self, problem: Problem) -> Round:
        return Round(0, self.lattice, lambda: self._neighbourhood(problem))

    def _neighbourhood(self, problem: Problem) -> tuple[Program, IntArray, IntArray]:
        """Return the program of this round, the landmarks that stay, and the largest number at each pose."""
        self.program = self.program or Program.of(problem, self.lattice, self.covers, self.margin)
        rng, chosen = np.random.default_rng([self.seed, self.rounds]), np.repeat(np.arange(len(self.taken)), self.taken)
        order = rng.permutation(len(chosen))
        if rng.random() < NEAR_SHARE:
            away = self.lattice.positions[chosen] - self.lattice.positions[chosen[order[0]]]
            order = order[np.argsort(np.linalg.norm(away[order], axis=1), kind="stable")]
        open_to = self.taken > 0
        open_to[rng.permutation(len(self.taken))[: self.candidates]] = True
        stay = np.bincount(chosen[order[self.freed :]], minlength=len(self.taken))
        return self.program, stay, self.program.copies * open_to

    @override
    def _accept(self, problem: Problem, poses: Deployment, taken: IntArray, value: float, fitness: float) -> None:
        self.without = 0 if fitness > self.fitness else self.without + 1
        if fitness >= self.fitness:
            self.taken, self.fitness = taken, fitness

    @override
    def _failed(self) -> None:
        self.without += 1

    @override
    def _ended(self) -> bool:
        return self.without >= self.patience

    @override
    def state(self) -> dict[str, Any]:
        state = super().state()
        if self.ledger.history:
            state |= {"taken": self.taken, "fitness": self.fitness, "without": self.without}
        return state

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        super().restore(state, problem)
        if not self.ledger.history:
            return
        taken = array("taken", state["taken"], np.int64, len(self.lattice), low=0, high=per_pose(problem))
        if taken.sum() != problem.free_count:
            raise InputError(f"taken must place {problem.free_count} landmarks, not {taken.sum()}.", "taken")
        self.taken, self.fitness = taken, real("fitness", state["fitness"], low=0.0, high=1.0)
        self.without = integer("without", state["without"], low=0, high=self.rounds)
