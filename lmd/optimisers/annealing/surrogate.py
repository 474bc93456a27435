"""What the walk of simulated annealing climbs: the true problem, or a surrogate of it."""

import numpy as np

from lmd.checks import FloatArray
from lmd.deployment import Deployment
from lmd.objectives.field import in_order
from lmd.optimisers.annealing.walk import Best, Settings, total_worth, walk
from lmd.plates import TOUCHING
from lmd.problem import Problem
from lmd.sight.evaluator import Evaluator
from lmd.space.surface import SurfaceArrays


class Surrogate:
    """A problem in the arrays of the walk, and where on it the walk is.

    `is_true` says whether the walk climbs the problem itself. The surrogates are stacks, which nothing hides; plates
    that are smaller than they are; and, if the objective has a sampling, a sample drawn anew at every `prepare`.

    Args:
        problem: the true problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._surfaces = SurfaceArrays.of(problem.scene.plates.hanging.surfaces())
        self._survey(problem.fitness_evaluator, problem.fitness_relevance)
        self._apart = 0.0  # least distance between plates
        self._climbed: tuple[bool, float] | None = None  # in stacks, size of plates

    def _survey(self, evaluator: Evaluator, relevance: FloatArray) -> None:
        """Lay out positions, orientations and relevance for the walk."""
        objective = self._problem.objective
        self._true = objective.field(evaluator)
        self._target = objective.target(in_order(self._true, relevance))

    @property
    def stack(self) -> int:
        """See `Field.stack`."""
        return self._true.stack

    def prepare(
        self, here: Deployment, best: Deployment, in_stacks: bool, size: float, used: float, rng: np.random.Generator
    ) -> None:
        """Make ready to walk on from `here`.

        Args:
            here: stacks or single landmarks.
            best: what single landmarks have to beat on the true problem.
            in_stacks: whether `here` is stacks.
            size: of the plates; 1 is the truth.
            used: share of the budget. Samples for an objective with a sampling grow with its square: a rough direction
                will do for the first steps, but the last ones are lost in what a small sample errs.
            rng: draws the samples.
        """
        redrawn = self._problem.resampled(used**2, rng)
        if redrawn is None and self._climbed == (in_stacks, size):
            return
        if redrawn is not None:
            self._survey(*redrawn)
        self._climbed = in_stacks, size
        self.is_true = redrawn is None and not in_stacks and size == 1.0
        if not in_stacks:
            plates = self._problem.scene.plates
            pushed, self._apart = plates.apart(here, size), size * plates.edge * (1.0 - TOUCHING)
            here = best if pushed is None else pushed  # where there is no room for the plates, the best found has it
        self._field = self._true.stacked() if in_stacks else self._true.shrunk(size)
        self._state = self._field.state(here)
        together = max(1, min(self._field.stack, len(here)))
        self._scratches = tuple(self._field.scratch(self._state) for _ in range(together))
        known = self._true.state(best) if self.is_true else self._state
        reached = total_worth(self._target, known.units)
        self._best = Best(np.array([reached]), known.landmarks.copy(), known.normals.copy(), known.surfaces.copy())

    def walk(self, moves: int, settings: Settings, rng: np.random.Generator) -> bool:
        """Try `moves` moves; True if one led to a better deployment than any before."""
        before = self._best.fitness[0]
        surfaces, target, apart = self._surfaces, self._target, self._apart
        walk(moves, self._field, self._state, self._scratches, target, surfaces, apart, settings, rng, self._best)
        return bool(self._best.fitness[0] > before)

    def here(self) -> Deployment:
        """Where the walk is."""
        return Deployment(self._state.landmarks.T, self._state.normals.T, self._state.surfaces)

    def best(self) -> Deployment:
        """The best deployment met since `prepare`, or the one given to it."""
        return Deployment(self._best.landmarks.T, self._best.normals.T, self._best.surfaces)
