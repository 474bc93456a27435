"""Simulated annealing on the walls: our own method, and the strongest here.

Landmarks that serve a threshold of n organise themselves in clusters of about n. So from a random start the method
first anneals K/n *stacks* of n landmarks on one point as if nothing hid anything, which is the problem for n = 1 with
K/n landmarks: smaller, smoother and faster to evaluate. Then it pulls each stack apart, and anneals single landmarks
coolly. To pull a stack apart by the whole distance at which plates no longer hide each other would throw away a part of
what the stacks covered: landmarks of a stack no longer see the same. So plates are small at first and *grow* to their
size, and the landmarks make room for each other little by little, while the walk keeps them where they are worth most.

The walk then climbs a *stand-in* for the true problem: stacks, plates that are too small, or, for an objective with a
design, positions and orientations drawn anew for each stretch of the walk, which nothing can be fitted to. Where a
stand-in leads is looked at on the true problem now and then. On samples a run ends with an ascent of the slopes of all
landmarks at once (`ascent`), which finds what is best nearby where a walk is lost in what samples err.
"""

import math
from collections.abc import Mapping
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
from lmd.optimisers.annealing.stacks import STACK_SPREAD, count_stacks, pulled_apart
from lmd.optimisers.annealing.stage import Stage, changed
from lmd.optimisers.annealing.surrogate import Surrogate
from lmd.optimisers.annealing.trail import Trail
from lmd.optimisers.annealing.walk import Settings
from lmd.optimisers.base import Callback, Optimiser, Result
from lmd.optimisers.ledger import Budget, Ledger
from lmd.optimisers.selection import GRID_SPACING, greedy_start
from lmd.optimisers.stored import array, deployment, deployment_state, generator, generator_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

MOST_MOVES = 2000  # moved landmarks between two looks at the clock and the keyboard, at most
LEAST_CHUNKS = 500  # and at least this many in a run, so that the schedule is smooth
LOOK_EVALUATIONS = 10  # evaluations' worth of moves between two looks, an evaluation each, at where a stand-in leads
LOOK_FACTOR_ON_SAMPLES = 2  # times as far is it from look to look on samples, which are drawn and laid out each time
ASCENT_STEPS = 10  # of the ascent between two looks
SMALLEST_PLATE = 0.2  # of their virtual diameter: the size of plates when stacks are pulled apart

STACKED_STAGE = Stage(temperature=(2e-3, 1e-5), width=(0.06, 0.003), step=(1.0, 0.1), jump=0.1, join=0.0)
SINGLE_STAGE = Stage(
    temperature=(2e-5, 2e-6), width=(0.006, 0.002), step=(0.1, 0.01), jump=0.03, join=0.05, together=0.3
)
SAMPLED_STAGE = replace(SINGLE_STAGE, width=(0.02, 0.004), share=0.2)
STAGE_FROM_GIVEN = replace(SINGLE_STAGE, temperature=(1e-4, 2e-6), width=(0.02, 0.002), step=(0.3, 0.01))


class Annealing(Optimiser):
    """Simulated annealing of stacks, then of single landmarks; landmarks it moves are flush on a wall.

    A start that does not vary (`uniform`, `file`) is improved as it is, under conditions of its own and with plates of
    their size from the beginning. A flush landmark is never worse than a tilted one inside a cuboid.

    Args:
        stacked: conditions of the stage that moves stacks; for n = 1 these are single landmarks.
        single: conditions of the stage that moves the landmarks of stacks pulled apart.
        sampled: the same for an objective with a design, whose samples the walk must not follow too closely.
        given: conditions of the only stage there is if the start is given: warmer, as it may be far from good, and on
            samples as smooth as `sampled`. Each of the four is a `Stage`, or a mapping of what differs from the default
            one.
        stacked_share: share of the budget spent on stacks.
        climb_share: share of the budget spent on the ascent at the end, for an objective with a design.
        growth: share of the single stage in which plates grow to their size, nu or the paper of tags.
        spread: distance between the landmarks of a stack pulled apart, in virtual diameters, or papers if larger.
        largest: share of the positions of an objective's design that the samples at the end of a stage have. Twice the
            share takes twice the time, and makes fewer mistakes in the end.
        walkers: groups of landmarks that are moved at the same time; see `Surrogate`.
        seed: see `Optimiser`.

    Raises:
        InputError: a value is out of range.
    """

    def __init__(
        self,
        stacked: Stage | Mapping[str, Any] = STACKED_STAGE,
        single: Stage | Mapping[str, Any] = SINGLE_STAGE,
        sampled: Stage | Mapping[str, Any] = SAMPLED_STAGE,
        given: Stage | Mapping[str, Any] = STAGE_FROM_GIVEN,
        stacked_share: float = 0.5,
        climb_share: float = 0.2,
        growth: float = 0.8,
        spread: float = STACK_SPREAD,
        largest: float = 0.35,
        walkers: int = 2,
        seed: int = 0,
    ) -> None:
        super().__init__(seed)
        self.stacked, self.single = changed("stacked", STACKED_STAGE, stacked), changed("single", SINGLE_STAGE, single)
        self.sampled, self.given = changed("sampled", SAMPLED_STAGE, sampled), changed("given", STAGE_FROM_GIVEN, given)
        self.stacked_share = real("stacked_share", stacked_share, low=0.0, high=0.9)
        self.climb_share = real("climb_share", climb_share, low=0.0, high=1.0 - self.stacked_share)
        self.growth = real("growth", growth, low=0.0, high=1.0)
        self.spread = real("spread", spread, low=0.0)
        self.largest = real("largest", largest, above=0.0, high=1.0)
        self.walkers = integer("walkers", walkers, low=1)
        self.spent = 0  # moved landmarks: K make an evaluation
        self.in_stacks = False
        self.rng: np.random.Generator
        self.start: Deployment
        self.angles: FloatArray | None = None  # direction in which each stack is pulled apart; None without stacks
        self.here: Deployment  # where the walk is: stacks first, then landmarks
        self.best: Deployment | None = None
        self.trail: Trail | None = None  # of single landmarks on samples
        self.ascent: Ascent | None = None  # of all landmarks, at the end
        self.led_to: Deployment | None = None  # by the walk

    @property
    def skipped(self) -> float:
        """Share of the budget before the single stage."""
        return 0.0 if self.angles is None else self.stacked_share

    @override
    def state(self) -> dict[str, Any]:
        history = self.ledger.state()
        if not self.spent:
            return history
        parts = {"trail": self.trail, "ascent": self.ascent}
        places = {name: getattr(self, name) for name in ("start", "here", "best", "led_to")}
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
        self.ledger = Ledger.of(state)
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
        self.best = deployment("best", state["best"], problem, count)
        if state["led_to"] is not None:
            self.led_to = deployment("led_to", state["led_to"], problem, count)
        if state["trail"] is not None:
            self.trail = Trail(self.start)
            self.trail.restore(state["trail"], problem)
        if state["ascent"] is not None:
            if self.in_stacks:
                raise InputError("in_stacks must be false where there is an ascent.", "in_stacks")
            self.ascent = Ascent(count)
            self.ascent.restore(state["ascent"])

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        incremental(problem.objective)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        self.check(problem)
        ledger, count = self.ledger, problem.count
        began = clock() - ledger.seconds
        limit = budget.limit * count
        share = self._climb_share(problem)
        to_walk = limit if math.isinf(limit) else round(limit * (1.0 - share))
        surrogate = Surrogate(problem, self.walkers, self.largest)

        def note(moved: int, deployment: Deployment | None) -> None:
            """Note moves that led to `deployment`, or to nothing better than what is known."""
            self.spent += moved
            fitness = -math.inf if deployment is None else problem.fitness_of(deployment)
            ledger.seconds = clock() - began
            if ledger.note(self.spent / count, fitness) and deployment is not None:
                self.best = deployment

        if not self.spent:
            spent = self._begin(problem, surrogate.stack, limit)
            note(spent + count, self.start)
        stopped = "budget"
        while (used := budget.used(self.spent / count, ledger.seconds)) < 1.0:
            if self.spent < to_walk and used < 1.0 - share:
                note(*self._walk(problem, surrogate, used, to_walk - self.spent))
            else:
                note(*self._climb(problem, used, limit - self.spent))
            if callback and callback(self):
                stopped = "interrupted"
                break
        return self.result(problem, stopped)

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return self.best

    def _walk(self, problem: Problem, surrogate: Surrogate, used: float, left: float) -> tuple[int, Deployment | None]:
        """Walk a stretch; returns the landmarks moved and where that led, if it may be better than what is known.

        Args:
            used: share of the budget.
            left: landmarks that may be moved until the walk ends.
        """
        count, stack = problem.count, surrogate.stack
        if self.in_stacks and used >= self.stacked_share:
            self.in_stacks, self.here = False, self._apart(problem, stack, SMALLEST_PLATE if self.growth else 1.0)
        done, size, settings = self._conditions(problem, used)
        surrogate.prepare(self.here, self._known, self.in_stacks, size, done, self.rng)
        stretch = min(MOST_MOVES, max(1.0, (self.spent + left) / LEAST_CHUNKS), left)
        if surrogate.is_true:
            improved = surrogate.walk(int(stretch), settings, self.rng)
            self.here = surrogate.here()
            return int(stretch), surrogate.best() if improved else None
        if left < count:  # too little for a look
            return int(left), None
        longer = LOOK_FACTOR_ON_SAMPLES if problem.objective.sampling else 1
        stretch = longer * max(stretch, LOOK_EVALUATIONS * count)
        # The last stretch takes what would be too little for one more.
        stretch = stretch if left >= 2 * (stretch + count) else left - count
        each = stack if self.in_stacks else 1
        moves = int(stretch) // each
        surrogate.walk(moves, settings, self.rng)
        self.here = surrogate.here()
        led_to = self._apart(problem, stack, 1.0) if self.in_stacks else self._mean(problem)
        self.led_to = problem.apart(led_to)
        return moves * each + count, self.led_to

    def _climb(self, problem: Problem, used: float, left: float) -> tuple[int, Deployment | None]:
        """Ascend some steps; arguments and result as of `_walk`, but `left` until the end of the run."""
        count, each = problem.count, PLACES_TRIED * problem.free_count
        steps = int(min(ASCENT_STEPS, (left - count) / each))
        if steps < 1:
            return int(left), None
        if self.ascent is None:
            self.ascent, self.in_stacks, self.here = Ascent(count), False, self.led_to or self._known
        share = self._climb_share(problem)
        done = max(0.0, (used - 1.0 + share) / share)
        for _ in range(steps):
            self.here = self.ascent.step(problem, self.here, done, self.walkers, self.rng)
        return steps * each + count, self.here

    def _begin(self, problem: Problem, stack: int, limit: float) -> int:
        """Draw the start, and stack it if that pays; returns the landmarks moved to find the start."""
        count = problem.count
        self.rng = np.random.default_rng(self.seed)
        start, plates = problem.draw(self.rng), problem.scene.plates
        movable = problem.free(start).movable(plates.room, flush=plates.edge > 0.0)
        plates.check(start)  # a file may be taken as it is, with papers that overlap
        self.start = self.here = problem.complete(movable)
        if not stack and problem.start.varies and isinstance(problem.objective, Selectable):
            self.start, spent = greedy_start(problem, self.start, GRID_SPACING, (limit - count) / 2)
            self.here = self.start
            return spent
        looks = 2 * (LOOK_EVALUATIONS + stack + 1) * count  # the cost of two looks at the stacks
        stacks = count_stacks(problem, stack)
        pays = stacks and self.stacked_share * limit > looks and (1.0 - self.stacked_share) * limit > looks
        self.in_stacks = problem.start.varies and bool(pays)
        if self.in_stacks:
            self.angles = self.rng.uniform(0.0, 2.0 * np.pi, stacks)
            self.here = movable[:stacks]
        return 0

    @property
    def _known(self) -> Deployment:
        """The best deployment so far."""
        assert self.best is not None, "the start was noted"
        return self.best

    def _climb_share(self, problem: Problem) -> float:
        """The share of the budget for the ascent: none where it would learn the grid by heart."""
        return 0.0 if problem.objective.sampling is None else self.climb_share

    def _conditions(self, problem: Problem, used: float) -> tuple[float, float, Settings]:
        """The share of the stage that is done after a share `used` of the budget, the size of plates, and settings."""
        if self.in_stacks:
            done = used / self.stacked_share
            return done, 1.0, self.stacked.settings(done, near=0.0)
        done = (used - self.skipped) / (1.0 - self.skipped - self._climb_share(problem))
        near = self.spread * problem.scene.spacing
        sampled = problem.objective.sampling is not None
        if not self.skipped:
            smooth = self.sampled if sampled else self.given
            stage = replace(self.given, width=smooth.width, share=smooth.share)
            return done, 1.0, stage.settings(done, near)
        grown = min(done / self.growth, 1.0) if self.growth else 1.0
        size = SMALLEST_PLATE + (1.0 - SMALLEST_PLATE) * grown
        stage = self.sampled if sampled else self.single
        return done, size, stage.settings(done, near * size)

    def _mean(self, problem: Problem) -> Deployment:
        """Where single landmarks are: on average, if they walk on samples and no plates that grow drive them."""
        if problem.objective.sampling is None or self.skipped:
            return self.here
        self.trail = self.trail or Trail(self.here)
        return self.trail.add(self.here)

    def _apart(self, problem: Problem, stack: int, size: float) -> Deployment:
        """Each stack as so many plates of this size, pulled apart; landmarks in no stack stay where they began."""
        assert self.angles is not None, "there are stacks"
        distance = self.spread * size * problem.scene.spacing
        apart = problem.complete(pulled_apart(problem, self.here, self.angles, stack, distance))
        return apart if len(apart) == problem.count else apart + self.start[len(apart) :]
