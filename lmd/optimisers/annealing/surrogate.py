"""What the walk of simulated annealing climbs: the true problem, or a stand-in for it."""

import math

import numpy as np

from lmd.checks import FloatArray
from lmd.deployment import Deployment
from lmd.optimisers.annealing.walk import Best, Climate, Goal, walk, walls_of
from lmd.problem import CoverageProblem
from lmd.sight.evaluator import Evaluator
from lmd.sight.incremental.move import state_of
from lmd.sight.incremental.state import fixed_of, scratch_of
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.visibility import TOLERANCE


class Ground:
    """A problem in the arrays of the walk, and where on it the walk is.

    `is_true` says whether the walk climbs the problem itself. The stand-ins are stacks, which nothing hides; plates
    that are smaller than they are; and, if the objective has a design, a sample that is drawn anew at every `enter`.

    Args:
        problem: the true problem.
    """

    def __init__(self, problem: CoverageProblem) -> None:
        self._problem = problem
        self._walls = walls_of(problem.scene.room)
        self._survey(problem.fitness_evaluator, problem.fitness_relevance)
        self._stand_in: tuple[bool, float] | None = None  # what the walk climbs: in stacks, size of plates

    def _survey(self, evaluator: Evaluator, relevance: FloatArray) -> None:
        """Lay out positions, orientations and relevance for the walk."""
        objective = self._problem.objective
        self._true = fixed_of(evaluator, objective.n)
        in_place = np.zeros(self._true.positions.shape[1])
        in_place[self._true.place] = relevance / relevance.sum()
        self._goal = Goal(math.ceil((objective.thold_p - TOLERANCE) * PROBABILITY_ONE), in_place)

    def enter(
        self, here: Deployment, best: Deployment, in_stacks: bool, size: float, used: float, rng: np.random.Generator
    ) -> None:
        """Make ready to walk on from `here`.

        Args:
            here: stacks or single landmarks.
            best: what single landmarks have to beat on the true problem.
            in_stacks: whether `here` is stacks.
            size: of the plates, in virtual diameters; 1 is the truth.
            used: share of the budget. Samples for an objective with a design grow with its square: a rough direction
                will do for the first steps, but the last ones are lost in what a small sample errs.
            rng: draws the samples.
        """
        redrawn = self._problem.resampled(used**2, rng)
        if redrawn is None and self._stand_in == (in_stacks, size):
            return
        if redrawn is not None:
            self._survey(*redrawn)
        self._stand_in = in_stacks, size
        self.is_true = redrawn is None and not in_stacks and size == 1.0
        if in_stacks:
            # A stack of n that nothing hides is seen whenever one landmark in its place is.
            self._fixed = self._true._replace(n=1, mode=0)
        else:
            self._fixed = self._true._replace(reach=self._true.reach * size**2)
        self._state = state_of(self._fixed, here)
        together = min(self._fixed.n, len(here))
        self._scratches = tuple(scratch_of(self._state) for _ in range(together))
        known = state_of(self._true, best) if self.is_true else self._state
        reached = (known.units >= self._goal.threshold) @ self._goal.relevance
        self._best = Best(np.array([float(reached)]), known.landmarks.copy(), known.normals.copy())

    def walk(self, moves: int, climate: Climate, rng: np.random.Generator) -> bool:
        """Try `moves` moves; True if one led to a better deployment than any before."""
        before = self._best.fitness[0]
        walk(moves, self._fixed, self._state, self._scratches, self._goal, self._walls, climate, rng, self._best)
        return bool(self._best.fitness[0] > before)

    def here(self) -> Deployment:
        """Where the walk is."""
        return Deployment(self._state.landmarks.T, self._state.normals.T)

    def best(self) -> Deployment:
        """The best deployment met since `enter`, or the one given to it."""
        return Deployment(self._best.landmarks.T, self._best.normals.T)
