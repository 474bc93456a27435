"""Simulated annealing of the cameras of a rig, one camera after the other.

The pose of each camera is encoded by genes, numbers in [0, 1]. A move changes some genes of one camera by random steps,
whose size shrinks during the run, or draws new values for all genes of this camera. After a move only the moved camera
is evaluated (`lmd.cameras.problem`), so moving each camera once (a sweep) costs one evaluation.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.cameras.problem import CameraProblem
from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.core.compiled import clock
from lmd.optimisers.base import Callback, Optimiser, Result
from lmd.optimisers.ledger import Budget, Ledger
from lmd.optimisers.stored import array, generator, generator_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig

SHARE_SKIPPED = 0.5  # share of the schedule that is skipped for a given start


class CameraAnnealing(Optimiser):
    """Simulated annealing of the mounts (poses) of the cameras of a rig, encoded as genes in [0, 1].

    The annealing maximises an energy: the fitness plus `mean_share` times the *mean value*. The objective gives each
    position a value, and the mean value is the mean over positions, weighted by relevance. A move changes some genes of
    a camera by random steps, or is a *jump*, which replaces all genes of the camera by random numbers. The temperature,
    the size of steps and the fraction of jumps change during the run from a first to a last number. A run that starts
    from given cameras skips the first half of these changes, because moves at a high temperature would discard the
    given cameras.

    Args:
        temperature: first and last temperature, on the scale of the energy.
        step: first and last standard deviation of the random step of a gene.
        jump: first and last fraction of jumps among the moves.
        mean_share: small weight of the mean value in the energy. The mean value changes even where the fitness is
            constant, and so guides the search.
        seed: see `Optimiser`.

    Raises:
        InputError: a value is out of range.
    """

    def __init__(
        self,
        temperature: Sequence[float] = (0.02, 2e-4),
        step: Sequence[float] = (0.3, 0.01),
        jump: Sequence[float] = (0.5, 0.05),
        mean_share: float = 0.2,
        seed: int = 0,
    ) -> None:
        super().__init__(seed)
        self.temperature = vector("temperature", temperature, 2, above=0.0)
        self.step = vector("step", step, 2, above=0.0)
        self.jump = vector("jump", jump, 2, low=0.0, high=1.0)
        self.mean_share = real("mean_share", mean_share, low=0.0)
        self.rng = np.random.default_rng(self.seed)
        self.here: FloatArray | None = None  # genes of the current cameras, (C, G)
        self.best: FloatArray | None = None  # genes of the best cameras

    @override
    def state(self) -> dict[str, Any]:
        places = {"here": self.here, "best": self.best}
        return {**self.ledger.state(), **places, "rng": generator_state(self.rng)}

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        cameras = _cameras(problem)
        space = cameras.space
        self.ledger = Ledger.of(state)
        cameras.reached(self.ledger.best_fitness)
        if self.ledger.history:
            shape = (space.count, len(space.names))
            self.here, self.best = (
                array(name, state[name], np.float64, *shape, low=0.0, high=1.0) for name in ("here", "best")
            )
            self.rng = generator("rng", state["rng"])

    @override
    def check(self, problem: Problem) -> None:
        _cameras(problem)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        """Move the cameras one after the other until the budget is used up; a sweep over all cameras counts as one
        evaluation.
        """
        cameras, ledger = _cameras(problem), self.ledger
        began = clock() - ledger.seconds
        if self.here is None:
            self.here = self.best = cameras.draw_genes(self.rng).reshape(cameras.space.count, -1)
            ledger.note(1, self._scored(cameras, self.here)[0])
        energy = self._scored(cameras, self.here)[1]

        def step(used: float) -> None:
            nonlocal energy
            skipped = 0.0 if cameras.varies else SHARE_SKIPPED
            energy, fitness = self._swept(cameras, skipped + (1.0 - skipped) * used, energy)
            ledger.seconds = clock() - began
            self._note(fitness)

        return self._spend(problem, budget, callback, step, lambda: ledger.evaluations)

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return None if self.best is None else _cameras(problem).tags

    @override
    def found_rig(self, problem: Problem) -> Rig | None:
        return None if self.best is None else _cameras(problem).rig(self.best.reshape(-1))

    def _note(self, fitness: FloatArray) -> None:
        """Record a sweep, in which one move of each of the C cameras was tried, in the ledger.

        `fitness` `(C,)` has the fitness of the rig that each move proposed, accepted or not. Improvements and the last
        move get a record; a move costs 1/C of an evaluation.
        """
        ledger, spent, last = self.ledger, self.ledger.evaluations, len(fitness) - 1
        for move, reached in enumerate(fitness.tolist()):
            if reached > ledger.best_fitness and move < last:
                ledger.note(spent + (move + 1) / len(fitness), reached)
        ledger.note(spent + 1, reached)

    def _swept(self, problem: CameraProblem, used: float, energy: float) -> tuple[float, FloatArray]:
        """Try to move each of the C cameras once; moves are accepted by Metropolis' rule.

        Args:
            problem: problem of the cameras.
            used: completed fraction of the annealing, in [0, 1].
            energy: energy of the present cameras.

        Returns:
            energy of the resulting cameras, and the fitness of the rig tried in each move, `(C,)`.
        """
        assert self.here is not None
        best, reached = self.ledger.best_fitness, np.empty(len(self.here))
        temperature = self.temperature[0] * (self.temperature[1] / self.temperature[0]) ** used
        for camera in range(len(self.here)):
            tried = self.here.copy()
            tried[camera] = self._changed(tried[camera], used)
            reached[camera], there = self._scored(problem, tried)
            if reached[camera] > best:
                best, self.best = reached[camera], tried
            # The first condition also holds if both are -inf, for a start that is not admissible.
            if there >= energy or self.rng.random() < math.exp((there - energy) / temperature):
                self.here, energy = tried, there
        return energy, reached

    def _changed(self, genes: FloatArray, used: float) -> FloatArray:
        """Return the genes `(G,)` of a camera after a random change.

        `used` is the completed fraction of the annealing, on which the size of the change depends.
        """
        if self.rng.random() < self.jump[0] + used * (self.jump[1] - self.jump[0]):
            return self.rng.random(len(genes))
        step = self.step[0] * (self.step[1] / self.step[0]) ** used
        chosen = self.rng.random(len(genes)) < 0.5
        chosen[self.rng.integers(len(genes))] = True
        moved = genes + chosen * self.rng.normal(0.0, step, len(genes))
        moved[0] %= 1.0  # the first gene is periodic, as the faces form a circle
        return np.clip(moved, 0.0, 1.0)

    def _scored(self, problem: CameraProblem, genes: FloatArray) -> tuple[float, float]:
        """Fitness and energy of the rig whose C cameras have the `genes` `(C, G)`.

        Both are -inf for cameras that are not admissible.
        """
        mounts = problem.space.mounts(genes)
        fitness = problem.fitness_of_cameras(mounts)
        if mounts is None or not math.isfinite(fitness):
            return -math.inf, -math.inf
        values, relevance = problem.values_of(mounts), problem.fitness_relevance
        return fitness, fitness + self.mean_share * float((values * relevance).sum() / relevance.sum())


def _cameras(problem: Problem) -> CameraProblem:
    if not isinstance(problem, CameraProblem):
        raise InputError("CameraAnnealing places cameras, not landmarks; use Annealing for landmarks.")
    return problem
