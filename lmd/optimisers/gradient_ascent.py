"""Gradient ascent of all landmarks together, from random deployments."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.core.compiled import clock, kernel
from lmd.incremental.field import combined, runner, smoothed
from lmd.objectives.base import incremental
from lmd.objectives.crowd import slope_target, target_of
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing.ascent import PLACES_TRIED, SHARE, moved_along, slopes
from lmd.optimisers.base import Callback, DeploymentSearch, Result
from lmd.optimisers.ledger import Budget
from lmd.optimisers.stored import array, deployment, deployment_state, generator, generator_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.space.surface import SurfaceArrays

GROWTH, SHRINKAGE = 1.5, 0.5  # factors of the step after a trial that raises the objective, and after any other trial


@kernel
def _smooth_fitness(target: Any, units: Any, width: float) -> Any:
    """Fitness of a deployment, with a smooth step in place of the objective's threshold.

    The objective gives each camera position a value in [0, 1], to which the threshold applies.

    Args:
        target: functions that compute the fitness from the values of all positions, a `Target`.
        units: values of Q positions as integers, multiples of 1 / `PROBABILITY_ONE`, `(Q,)`.
        width: width of the smooth step, on the scale of the values.
    """
    total, terms = 0.0, np.empty(len(units))
    for p in range(len(units)):
        terms[p] = smoothed(target, p, units[p], 0.0, width, SHARE)
        total += terms[p]
    return combined(target, terms, total)


class GradientAscent(DeploymentSearch):
    """Gradient ascents on the smoothed objective, one after the other, each from a random deployment.

    The objective gives each position a value in [0, 1]. Smoothing replaces a threshold on this value by a gradual
    transition. The slope of each landmark, along its surface, is a central difference of the smoothed objective,
    occlusion included.

    A trial moves each landmark in the direction of its slope; all move by an equal length. If the smoothed objective
    rises, the trial is kept and the length grows, otherwise the length shrinks. When the length falls below its
    minimum, the ascent goes on with the next width of the transition. After the last width the next ascent begins. The
    deployment with the best *true* fitness is kept.

    Computing the slopes of all landmarks costs as much of the budget as moving each free landmark to four places; a
    trial costs one evaluation.

    Args:
        step: first and smallest length by which a trial moves landmarks, metres. The present length is also the step of
            the central difference.
        widths: widths of the transition, on the scale of the values, in the order of use.
        seed: see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self, step: Sequence[float] = (1.0, 0.02), widths: Sequence[float] = (0.1, 0.03, 0.01), seed: int = 0
    ) -> None:
        super().__init__(seed)
        self.first, self.smallest = vector("step", step, size=2, above=0.0)
        if self.smallest > self.first:
            raise InputError(f"step must not grow from {self.first:g} to {self.smallest:g}.", "step")
        self.widths = vector("widths", widths, size=None, above=0.0)
        self.spent = 0  # number of moved landmarks; K moves count as an evaluation
        self.rng: np.random.Generator
        self.here: Deployment  # current deployment of the ascent
        self.stage = 0  # index of the width
        self.step = self.first
        self.direction: FloatArray | None = None  # `(K, 2)` along u and v; None before the slopes at `here` are known
        self.climb: _Climb | None = None

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        incremental(problem.objective)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger, count = self.ledger, problem.count
        began = clock() - ledger.seconds

        def note(moved: int, found: Deployment | None) -> None:
            self.spent += moved
            self._record(problem, self.spent / count, found, began)

        if not self.spent:
            self.rng = np.random.default_rng(self.seed)
            self.here = _movable(problem, problem.draw(self.rng))
            note(count, self.here)
        self.climb = self.climb or _Climb(problem, self.here)
        climb, slopes_cost = self.climb, PLACES_TRIED * problem.free_count

        def step(_: float) -> None:
            cost = count + (slopes_cost if self.direction is None else 0)
            left = budget.limit * count - self.spent
            if left < cost:
                note(int(left), None)  # the rest of the budget is too small for a trial
            else:
                note(cost, self._trial(problem, climb))

        return self._spend(problem, budget, callback, step, lambda: self.spent / count)

    def _trial(self, problem: Problem, climb: "_Climb") -> Deployment:
        """Try a step of the present ascent, or begin the next ascent; return the deployment that is to be evaluated."""
        width = self.widths[self.stage]
        if self.direction is None:
            self.direction = climb.direction(self.step, width)
        trial = climb.moved(self.step * self.direction)
        if climb.rises(trial, width):
            self.here, self.direction, self.step = trial, None, min(GROWTH * self.step, self.first)
            return trial
        self.step *= SHRINKAGE
        if self.step < self.smallest:
            self.step, self.direction, self.stage = self.first, None, self.stage + 1
            if self.stage == len(self.widths):
                self.stage, self.here = 0, self._random(problem)
                climb.begin(self.here)
                return self.here
        return trial

    def _random(self, problem: Problem) -> Deployment:
        """Draw a random deployment from which an ascent begins, also if the problem's start is not random."""
        if problem.start.varies:
            return _movable(problem, problem.draw(self.rng))
        drawn = problem.scene.footprints.draw(RandomDeployment(problem.free_count), self.rng, problem.fixed)
        return problem.separated(drawn) or self.here

    @override
    def state(self) -> dict[str, Any]:
        if not self.spent:
            return super().state()
        return {
            **super().state(),
            "here": deployment_state(self.here),
            "rng": generator_state(self.rng),
            "stage": self.stage,
            "step": self.step,
            "direction": self.direction,
        }

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        count = problem.count
        super().restore(state, problem)
        if not self.ledger.history:
            return
        self.spent = integer("moved landmarks", round(self.ledger.evaluations * count), low=1)
        self.here = deployment("here", state["here"], problem, count)
        self.rng = generator("rng", state["rng"])
        self.stage = integer("stage", state["stage"], low=0, high=len(self.widths) - 1)
        self.step = real("step", state["step"], low=self.smallest, high=self.first)
        if state["direction"] is not None:
            self.direction = array("direction", state["direction"], np.float64, count, 2, low=-1.0, high=1.0)


def _movable(problem: Problem, start: Deployment) -> Deployment:
    """Copy of the deployment `start` whose free landmarks are assigned to the surfaces on which they may move.

    Raises:
        InputError: a free landmark is on no surface, or has a size and is not flush with its surface.
    """
    footprints = problem.scene.footprints
    return problem.complete(problem.free(start).movable(footprints.room, flush=footprints.edge > 0.0))


class _Climb:
    """State of one ascent: the present deployment, and the state of the objective's incremental evaluator.

    Args:
        problem: problem with an incremental objective.
        here: current deployment.
    """

    def __init__(self, problem: Problem, here: Deployment) -> None:
        self._problem = problem
        self._field = field_of(problem.objective, problem.fitness_evaluator)
        evaluator, relevance = problem.fitness_evaluator, problem.fitness_relevance
        self._target = target_of(problem.objective, self._field, evaluator, relevance)
        self._surfaces = SurfaceArrays.of(problem.scene.footprints.hanging.surfaces())
        self.begin(here)

    def begin(self, here: Deployment) -> None:
        """Begin a new ascent from the deployment `here`."""
        self._here, self._state = here, self._field.state(here)

    def direction(self, difference: float, width: float) -> FloatArray:
        """Direction in which each landmark increases the smoothed objective most, `(K, 2)`, along u and v.

        The directions are unit vectors, or zero for a landmark without a slope.

        Args:
            difference: step of the central difference, metres.
            width: width of the smooth step that replaces the objective's threshold, see `GradientAscent`.
        """
        out, scratch = np.zeros((len(self._here), 2)), self._field.scratch(self._state)
        target = slope_target(self._target, self._state.units)
        parts = self._problem.fixed_count, self._field, self._state, scratch, target, self._surfaces
        runner(self._field, slopes)(*parts, difference, width, out)
        length = np.linalg.norm(out, axis=1, keepdims=True)
        return np.asarray(out / np.where(length > 0.0, length, 1.0))

    def moved(self, away: FloatArray) -> Deployment:
        """Deployment in which the landmarks are moved by `away` `(K, 2)` along u and v, metres.

        Overlapping footprints are pushed apart; if they find no room, the present deployment is returned.
        """
        return moved_along(self._problem, self._here, self._surfaces, away)

    def rises(self, trial: Deployment, width: float) -> bool:
        """Move to the deployment `trial` if its smoothed fitness is higher; return True in this case.

        `width` is the width of the smooth step that replaces the objective's threshold, see `GradientAscent`.
        """
        state, smooth = self._field.state(trial), runner(self._field, _smooth_fitness)
        before, now = (smooth(self._target, each.units, width) for each in (self._state, state))
        if now > before:
            self._here, self._state = trial, state
        return bool(now > before)
