"""Simulated annealing of landmarks on the surfaces of a room.

An orientation of the camera counts only if at least n landmarks are seen, so good deployments of K landmarks have
clusters of about n landmarks. A run with few clusters from a random start therefore has up to three stages:

1. K/n *stacks* (groups of n coincident landmarks) are annealed without occlusion. A stack acts as one landmark of a
   problem with n = 1, which is smaller, smoother and faster to evaluate.
2. The landmarks of each stack are separated, and single landmarks are annealed at a low temperature. If all landmarks
   were pushed apart in one step until none hides another, they would cover less than the stack did. So the assumed
   footprints are small at first and *grow* to their true size, which separates the landmarks gradually.
3. For an objective that is evaluated on random samples of poses (an objective "with a sampling"), a gradient ascent of
   all landmarks together (`ascent`) finds the local optimum. Single moves do not suffice, because their gains are
   smaller than the sampling error.

Stages 1 and 2 are random walks: sequences of random moves, each of which is accepted or rejected. A walk mostly
maximises a simplified problem (`surrogate`). From time to time the present deployment is evaluated on the full problem,
which costs an evaluation of the budget.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, boolean, integer, real
from lmd.core.compiled import clock
from lmd.incremental.field import stack_of
from lmd.objectives.base import Selectable, incremental
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing.ascent import PLACES_TRIED, Ascent
from lmd.optimisers.annealing.moves import (
    CHOSEN_STAGE,
    GIVEN_STAGE,
    REFINING_STAGE,
    SAMPLED_STAGE,
    SINGLE_STAGE,
    STACKED_STAGE,
    Stage,
    changed,
)
from lmd.optimisers.annealing.surrogate import (
    STACK_SPREAD,
    Conditions,
    MeanPlaces,
    Surrogate,
    count_stacks,
    pulled_apart,
)
from lmd.optimisers.base import Callback, DeploymentSearch, Result
from lmd.optimisers.ledger import Budget
from lmd.optimisers.selection import GRID_SPACING, greedy_start
from lmd.optimisers.stored import array, deployment, deployment_state, generator, generator_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

MAX_MOVES = 2000  # greatest number of moves in a phase; after each phase budget and callback are checked
MIN_STRETCHES = 500  # least number of phases in a run, so that conditions change smoothly
CHECK_EVALUATIONS = 10  # cost of the moves on a surrogate, in evaluations, between two evaluations on the problem
CHECK_FACTOR_ON_SAMPLES = 2  # factor on `CHECK_EVALUATIONS` for walks on samples, which are drawn for each phase
ASCENT_STEPS = 10  # number of steps of the ascent between two evaluations on the problem
GROWTH = 0.8  # share of the stage `single` in which footprints grow to their true size: nu, or the paper of tags
MOST_STACKS = 150  # above, a greedy choice finds a better layout than a walk of stacks from random places
SMALLEST_SIZE = 0.2  # size of footprints, relative to the true size, when the separation of stacks begins


class Annealing(DeploymentSearch):
    """Simulated annealing of stacks of landmarks and then of single landmarks, which lie flat (flush) on a surface.

    A start that is not random (`uniform`, `file`) is improved in a single stage, without stacks and with footprints of
    true size. Landmarks are flush, because tilting a landmark never helps inside a cuboid.

    The conditions of a stage are numbers such as temperatures and step sizes. The conditions are given as a `Stage`, or
    as a mapping of the fields of `Stage` that differ from the default.

    Args:
        stacked: conditions of the stage that moves stacks.
        single: conditions of the stage that moves single landmarks after the stacks are separated.
        sampled: conditions that replace `single` for an objective that is evaluated on random samples of poses. These
            conditions smooth the objective more, so that the walk does not overfit the samples.
        given: conditions of the only stage if there are no stacks, for example because the start is not random. The
            temperature is higher than in `single`, because the start may be bad. An objective that is evaluated on
            samples is smoothed as in `sampled`.
        chosen: conditions that replace `given` if the start is chosen greedily (`selection`): each landmark in turn is
            put where it adds most. A greedy choice replaces a random start if the objective allows no stacks, or if
            there would be more than `MOST_STACKS`.
        refining: conditions that replace `chosen` if there would be more than `MOST_STACKS` stacks.
        stacked_share: share of the budget spent on stacks.
        climb_share: share of the budget spent on the gradient ascent, if the objective is evaluated on samples.
        walkers: largest number of walks that move landmarks at the same time, see `Surrogate`.
        seed: see `Optimiser`.

    Raises:
        InputError: a value is out of range.
    """

    spacing = GRID_SPACING
    """Spacing of the grid of poses from which a greedy start is chosen, metres."""

    def __init__(
        self,
        stacked: Stage | Mapping[str, Any] = STACKED_STAGE,
        single: Stage | Mapping[str, Any] = SINGLE_STAGE,
        sampled: Stage | Mapping[str, Any] = SAMPLED_STAGE,
        given: Stage | Mapping[str, Any] = GIVEN_STAGE,
        chosen: Stage | Mapping[str, Any] = CHOSEN_STAGE,
        refining: Stage | Mapping[str, Any] = REFINING_STAGE,
        stacked_share: float = 0.5,
        climb_share: float = 0.2,
        walkers: int = 2,
        seed: int = 0,
    ) -> None:
        super().__init__(seed)
        self.stacked, self.single = changed("stacked", STACKED_STAGE, stacked), changed("single", SINGLE_STAGE, single)
        self.sampled, self.given = changed("sampled", SAMPLED_STAGE, sampled), changed("given", GIVEN_STAGE, given)
        self.chosen = changed("chosen", CHOSEN_STAGE, chosen)
        self.refining = changed("refining", REFINING_STAGE, refining)
        self.stacked_share = real("stacked_share", stacked_share, low=0.0, high=0.9)
        self.climb_share = real("climb_share", climb_share, low=0.0, high=1.0 - self.stacked_share)
        self.walkers = integer("walkers", walkers, low=1)
        self.spent = 0  # number of moved landmarks; K moved landmarks count as an evaluation
        self.rng: np.random.Generator
        self.start: Deployment
        self.angles: FloatArray | None = None  # directions in which stacks are separated; None without stacks
        self.in_stacks = False
        self.here: Deployment  # current deployment of the walk: stacks, later all landmarks
        self.mean_places: MeanPlaces | None = None  # mean places of the walk of single landmarks on samples
        self.walked: Deployment | None = None  # last deployment of the walk on a surrogate
        self.ascent: Ascent | None = None

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        incremental(problem.objective)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger, count = self.ledger, problem.count
        began = clock() - ledger.seconds
        limit, share = budget.limit * count, self._climb_share(problem)
        walk_limit = limit if math.isinf(limit) else round(limit * (1.0 - share))
        surrogate = Surrogate(problem, self.walkers)

        def note(moved: int, deployment: Deployment | None) -> None:
            self.spent += moved
            self._record(problem, self.spent / count, deployment, began)

        if not self.spent:
            moved = self._begin(problem, surrogate.stack, limit, lambda: budget.used(0.0, clock() - began) >= 1.0)
            note(moved + count, self.start)

        def step(used: float) -> None:
            if self.spent < walk_limit and used < 1.0 - share:
                note(*self._walk(problem, surrogate, used, walk_limit - self.spent))
            else:
                note(*self._climb(problem, used, limit - self.spent))

        return self._spend(problem, budget, callback, step, lambda: self.spent / count)

    def _begin(self, problem: Problem, stack: int, limit: float, stop: Callable[[], bool]) -> int:
        """Set the landmarks or stacks with which the run starts.

        Places are chosen greedily if `_is_greedy` is True. Otherwise the run starts with stacks if the problem's start
        is random and the budget suffices for both stages, else with single landmarks.

        Args:
            problem: the problem.
            stack: number of landmarks in a stack; 0 if there are no stacks.
            limit: budget, as a number of moved landmarks.
            stop: function that returns True when the time limit is reached.

        Returns:
            cost of the start, as a number of moved landmarks.
        """
        count = problem.count
        self.rng = np.random.default_rng(self.seed)
        start, footprints = problem.draw(self.rng), problem.scene.footprints
        movable = problem.free(start).movable(footprints.room, flush=footprints.edge > 0.0)
        footprints.check(start)  # footprints in a file may overlap
        self.start = self.here = problem.complete(movable)
        if self._is_greedy(problem, stack):
            self.start, spent = greedy_start(problem, self.start, self.spacing, (limit - count) / 2, stop)
            self.here = self.start
            return spent
        least = 2 * (CHECK_EVALUATIONS + stack + 1) * count  # moves of two phases with their checks
        stacks = count_stacks(problem, stack)
        pays = stacks and self.stacked_share * limit > least and (1.0 - self.stacked_share) * limit > least
        self.in_stacks = problem.start.varies and bool(pays)
        if self.in_stacks:
            self.angles = self.rng.uniform(0.0, 2.0 * np.pi, stacks)
            self.here = movable[:stacks]
        return 0

    def _is_greedy(self, problem: Problem, stack: int) -> bool:
        """True if the run starts greedily; `stack` is the number of landmarks in a stack, 0 without stacks."""
        in_stacks = stack > 0 and count_stacks(problem, stack) <= MOST_STACKS
        return not in_stacks and problem.start.varies and isinstance(problem.objective, Selectable)

    def _walk(self, problem: Problem, surrogate: Surrogate, used: float, left: float) -> tuple[int, Deployment | None]:
        """Do one phase of the walk, that is, a number of moves under constant conditions.

        Args:
            problem: the problem.
            surrogate: surrogate of `problem`.
            used: fraction of the budget that is spent.
            left: number of landmarks that may still be moved before the walk ends.

        Returns:
            cost, as a number of moved landmarks, and the deployment to evaluate on the full problem. The deployment is
            None if the walk found no better one, or if the rest of the budget is too small for an evaluation.
        """
        count, stack = problem.count, surrogate.stack
        if self.in_stacks and used >= self.stacked_share:
            self.in_stacks, self.here = False, self._separated(problem, stack, SMALLEST_SIZE)
        conditions = self._conditions(problem, surrogate.stack, used)
        stretch = min(MAX_MOVES, max(1.0, (self.spent + left) / MIN_STRETCHES), left)
        if surrogate.is_true(len(self.here), conditions):
            self.here, found = surrogate.walk(self.here, self._known, conditions, int(stretch), self.rng)
            return int(stretch), found
        if left < count:  # too few landmarks are left for a check
            return int(left), None
        longer = CHECK_FACTOR_ON_SAMPLES if problem.objective.sampling else 1
        stretch = longer * max(stretch, CHECK_EVALUATIONS * count)
        # The last phase also spends the rest that is too small for another phase.
        stretch = stretch if left >= 2 * (stretch + count) else left - count
        each = stack if self.in_stacks else 1
        moves = int(stretch) // each
        self.here, _ = surrogate.walk(self.here, self._known, conditions, moves, self.rng)
        led_to = self._separated(problem, stack, 1.0) if self.in_stacks else self._mean(problem)
        self.walked = problem.separated(led_to)
        return moves * each + count, self.walked

    def _climb(self, problem: Problem, used: float, left: float) -> tuple[int, Deployment | None]:
        """Do some steps of the gradient ascent; see `ascent`.

        Args:
            problem: the problem.
            used: fraction of the budget that is spent.
            left: number of landmarks that may still be moved before the run ends.

        Returns:
            cost, as a number of moved landmarks, and the deployment to evaluate. The deployment is None if the rest of
            the budget is too small for a step.
        """
        count, each = problem.count, PLACES_TRIED * problem.free_count
        steps = int(min(ASCENT_STEPS, (left - count) / each))
        if steps < 1:
            return int(left), None
        if self.ascent is None:
            self.ascent, self.in_stacks, self.here = Ascent(count), False, self.walked or self._known
        share = self._climb_share(problem)
        done = max(0.0, (used - 1.0 + share) / share)
        for _ in range(steps):
            self.here = self.ascent.step(problem, self.here, done, self.walkers, self.rng)
        return steps * each + count, self.here

    def _conditions(self, problem: Problem, stack: int, used: float) -> Conditions:
        """Conditions of the walk when the fraction `used` of the budget is spent.

        `stack` is the number of landmarks in a stack; 0 if there are no stacks.
        """
        if self.in_stacks:
            done = used / self.stacked_share
            return Conditions(True, 1.0, done, self.stacked.settings(done, near=0.0))
        skipped = 0.0 if self.angles is None else self.stacked_share
        done = (used - skipped) / (1.0 - skipped - self._climb_share(problem))
        near, sampled = STACK_SPREAD * problem.scene.spacing, problem.objective.sampling is not None
        if self.angles is None:
            chosen = self.refining if stack else self.chosen
            only = chosen if self._is_greedy(problem, stack) else self.given
            smooth = self.sampled if sampled else only
            size, stage = 1.0, replace(only, width=smooth.width, share=smooth.share)
        else:
            grown = min(done / GROWTH, 1.0)
            size, stage = SMALLEST_SIZE + (1.0 - SMALLEST_SIZE) * grown, self.sampled if sampled else self.single
        return Conditions(False, size, done, stage.settings(done, near * size))

    def _climb_share(self, problem: Problem) -> float:
        """Fraction of the budget for the gradient ascent.

        The fraction is 0 for an objective that is evaluated on the grid instead of on random samples of poses, because
        the ascent would overfit the grid.
        """
        return 0.0 if problem.objective.sampling is None else self.climb_share

    @property
    def _known(self) -> Deployment:
        """Best deployment found until now."""
        assert self.best is not None, "the start was noted"
        return self.best

    def _mean(self, problem: Problem) -> Deployment:
        """Deployment that is evaluated after a phase of the walk of single landmarks.

        If the objective is evaluated on random samples, each landmark is at the mean of its places in the walk.
        Otherwise, or after a stage with stacks, each landmark is at its last place.
        """
        if problem.objective.sampling is None or self.angles is not None:
            return self.here
        self.mean_places = self.mean_places or MeanPlaces(self.here)
        return self.mean_places.add(self.here)

    def _separated(self, problem: Problem, stack: int, size: float) -> Deployment:
        """Deployment of all landmarks, in which those of each stack are moved apart.

        A stack is a group of `stack` coincident landmarks. In the result, footprints scaled by the factor `size` do not
        overlap. If some landmarks belong to no stack, the result has the places of these landmarks in `self.start`, the
        deployment with which the run starts.
        """
        assert self.angles is not None, "there are stacks"
        distance = STACK_SPREAD * size * problem.scene.spacing
        apart = problem.complete(pulled_apart(problem, self.here, self.angles, stack, distance))
        return apart if len(apart) == problem.count else apart + self.start[len(apart) :]

    @override
    def state(self) -> dict[str, Any]:
        history = super().state()
        if not self.spent:
            return history
        parts = {"mean_places": self.mean_places, "ascent": self.ascent}
        places = {name: getattr(self, name) for name in ("start", "here", "walked")}
        return {
            **history,
            **{name: None if part is None else part.state() for name, part in parts.items()},
            **{name: None if place is None else deployment_state(place) for name, place in places.items()},
            "rng": generator_state(self.rng),
            "angles": self.angles,
            "in_stacks": self.in_stacks,
        }

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        count = problem.count
        super().restore(state, problem)
        if not self.ledger.history:
            return
        self.spent = integer("moved landmarks", round(self.ledger.evaluations * count), low=1)
        self.rng = generator("rng", state["rng"])
        self.in_stacks = boolean("in_stacks", state["in_stacks"])
        if self.in_stacks or state["angles"] is not None:
            stacks = count_stacks(problem, stack_of(field_of(problem.objective, problem.fitness_evaluator)))
            self.angles = array("angles", state["angles"], np.float64, stacks)
        self.start = deployment("start", state["start"], problem, count)
        self.here = deployment("here", state["here"], problem, stacks if self.in_stacks else count)
        if state["walked"] is not None:
            self.walked = deployment("walked", state["walked"], problem, count)
        if state["mean_places"] is not None:
            self.mean_places = MeanPlaces(self.start)
            self.mean_places.restore(state["mean_places"], problem)
        if state["ascent"] is not None:
            if self.in_stacks:
                raise InputError("in_stacks must be false if ascent is given.", "in_stacks")
            self.ascent = Ascent(count)
            self.ascent.restore(state["ascent"])
