"""Simulated annealing on the walls: our own method, and the strongest here.

Landmarks that serve a threshold of n organise themselves in clusters of about n. So from a random start the method
first anneals K/n *stacks* of n landmarks on one point as if nothing hid anything, which is the problem for n = 1 with
K/n landmarks: smaller, smoother and faster to evaluate. Then it pulls each stack apart by a little more than the
distance at which plates hide each other and anneals single landmarks on the true objective.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmd.checks import FloatArray, real, vector
from lmd.coverage.incremental import state_of
from lmd.coverage.kernels import PROBABILITY_ONE
from lmd.coverage.state import fixed_of, scratch_of
from lmd.deployment import Deployment
from lmd.optimisers.base import Budget, Callback, Optimiser, Result
from lmd.optimisers.walk import Best, Climate, Goal, walk, walls_of
from lmd.problem import CoverageProblem
from lmd.visibility import TOLERANCE

CHUNK = 2000  # moved landmarks between two looks at the clock and the keyboard, at most
CHUNKS = 500  # and at least this many in a run, so that the schedule is smooth
LOOK = 10  # evaluations' worth of moves between two evaluations of the stacks pulled apart


@dataclass(frozen=True)
class Stage:
    """The conditions of one stage; pairs run geometrically from the first to the second value.

    Args:
        temperature: loss in the smoothed objective (a mean over positions) accepted with probability 1/e.
        width: of the smooth step around the threshold, in probability.
        step: standard deviation of a local move, metres.
        margin: how far above thold_p the middle of the smooth step lies.
        share: weight of the average P_n beside the smooth step.
        jump: probability that a move goes anywhere on the walls.
        join: probability that a move goes next to another landmark.
        together: probability that a landmark takes its n - 1 nearest neighbours along.

    Raises:
        InputError: a value is out of range.
    """

    temperature: Sequence[float]
    width: Sequence[float]
    step: Sequence[float]
    margin: float = 0.0
    share: float = 0.1
    jump: float = 0.1
    join: float = 0.1
    together: float = 0.0

    def __post_init__(self) -> None:
        for name in ("temperature", "width", "step"):
            object.__setattr__(self, name, vector(f"optimiser.{name}", getattr(self, name), 2, above=0.0))
        real("optimiser.margin", self.margin)
        real("optimiser.share", self.share, low=0.0)
        real("optimiser.jump", self.jump, low=0.0, high=1.0)
        real("optimiser.join", self.join, low=0.0, high=1.0 - self.jump)
        real("optimiser.together", self.together, low=0.0, high=1.0)

    def climate(self, progress: float, near: float) -> Climate:
        """The conditions after a share `progress` in [0, 1] of the stage."""

        def now(values: Sequence[float]) -> float:
            first, last = values
            return float(first * (last / first) ** max(0.0, min(progress, 1.0)))

        return Climate(
            temperature=now(self.temperature),
            width=now(self.width),
            margin=self.margin,
            share=self.share,
            step=now(self.step),
            jump=self.jump,
            join=self.join,
            near=near,
            together=self.together,
        )


class Annealing(Optimiser):
    """Simulated annealing of stacks, then of single landmarks; landmarks it moves are flush on a wall.

    A start that does not vary (`uniform`, `file`) is improved as it is: the stacked stage is left out, as it is for
    n = 1. A flush landmark is never worse than a tilted one inside a cuboid.

    Args:
        stacked: conditions of the stage that moves stacks.
        single: conditions of the stage that moves single landmarks.
        stacked_share: share of the budget spent on stacks.
        spread: distance between the landmarks of a stack pulled apart, in virtual diameters nu.
        seed: see `Optimiser`.

    Raises:
        InputError: a value is out of range.
    """

    def __init__(
        self, stacked: Stage, single: Stage, stacked_share: float = 0.3, spread: float = 1.6, seed: int = 0
    ) -> None:
        super().__init__(seed)
        self.stacked, self.single = stacked, single
        self.stacked_share = real("optimiser.stacked_share", stacked_share, low=0.0, high=0.9)
        self.spread = real("optimiser.spread", spread, low=0.0)
        self.spent = 0  # moved landmarks: K make an evaluation
        self.in_stacks = False
        self.rng: np.random.Generator
        self.start: Deployment
        self.angles: FloatArray  # direction in which each stack is pulled apart
        self.here: Deployment  # where the walk is: stacks first, then landmarks
        self.best: Deployment

    def run(self, problem: CoverageProblem, budget: Budget, callback: Callback | None = None) -> Result:
        """See `Optimiser.run`."""
        books, count, n = self.books, problem.count, problem.objective.n
        clock = time.perf_counter() - books.seconds
        limit = budget.limit * count
        ground = _Ground(problem)

        def enter(moved: int, deployment: Deployment | None) -> None:
            """Book moves that led to `deployment`, or to nothing better than what is known."""
            self.spent += moved
            fitness = -math.inf if deployment is None else problem.fitness(deployment)
            books.seconds = time.perf_counter() - clock
            if books.enter(self.spent / count, fitness) and deployment is not None:
                self.best = deployment

        if not self.spent:
            spent = self._begin(problem, limit)
            enter(spent + count, self.start)
        ground.enter(self.here, self.in_stacks, self.best)
        stopped = "budget"
        while (used := budget.used(self.spent / count, books.seconds)) < 1.0:
            chunk = int(min(CHUNK, max(1.0, limit / CHUNKS), limit - self.spent))
            if self.in_stacks:
                # A look at where the stacks lead costs an evaluation: worth it only now and then.
                moves = max(chunk, LOOK * count) // n
                ground.walk(moves, self.stacked.climate(used / self.stacked_share, near=0.0), self.rng)
                self.here = ground.here()
                apart = self._apart(problem)
                enter(moves * n + count, apart)
                if budget.used(self.spent / count, books.seconds) >= self.stacked_share:
                    self.in_stacks, self.here = False, apart
                    ground.enter(self.here, self.in_stacks, self.best)
            else:
                done = (used - self.skipped) / (1.0 - self.skipped)
                near = self.spread * problem.scene.visibility.nu
                improved = ground.walk(chunk, self.single.climate(done, near), self.rng)
                self.here = ground.here()
                enter(chunk, ground.best() if improved else None)
            if callback and callback(self):
                stopped = "interrupted"
                break
        return self._result(self.best, stopped)

    def _begin(self, problem: CoverageProblem, limit: float) -> int:
        """Draw the start, and stack it if that pays; returns the landmarks moved to find the start."""
        n, count = problem.objective.n, problem.count
        self.rng = np.random.default_rng(self.seed)
        self.start = self.here = problem.start.draw(problem.scene.room, self.rng)
        looks = (LOOK + n + 1) * count  # the cost of one look at the stacks
        stacked = self.stacked_share * limit > looks and (1.0 - self.stacked_share) * limit > looks
        self.in_stacks = problem.start.varies and n > 1 and stacked
        self.skipped = self.stacked_share if self.in_stacks else 0.0
        if self.in_stacks:
            stacks = count // n
            self.angles = self.rng.uniform(0.0, 2.0 * np.pi, stacks)
            self.here = Deployment(self.start.positions[:stacks], self.start.normals[:stacks])
        return 0

    def _apart(self, problem: CoverageProblem) -> Deployment:
        """The stacks pulled apart into n landmarks each; landmarks that fill no stack stay where they started."""
        n, room = problem.objective.n, problem.scene.room
        walls = walls_of(room)
        wall = np.argmax(self.here.normals @ walls.normal.T, axis=1)
        # Neighbours on the circle are `spread` apart.
        radius = self.spread * problem.scene.visibility.nu / (2.0 * math.sin(math.pi / n))
        angle = self.angles[:, None] + 2.0 * np.pi * np.arange(n) / n
        offset = np.cos(angle)[..., None] * walls.u[wall][:, None] + np.sin(angle)[..., None] * walls.v[wall][:, None]
        positions = np.clip(self.here.positions[:, None] + radius * offset, 0.0, room.size).reshape(-1, 3)
        rest = slice(len(positions), problem.count)
        return Deployment(
            np.vstack([positions, self.start.positions[rest]]),
            np.vstack([np.repeat(self.here.normals, n, axis=0), self.start.normals[rest]]),
        )


class _Ground:
    """A problem in the arrays of the walk, and where on it the walk is."""

    def __init__(self, problem: CoverageProblem) -> None:
        objective = problem.objective
        self.single = fixed_of(problem.fitness_evaluator, objective.n)
        # A stack of n that nothing hides is seen whenever one landmark in its place is.
        self.stacked = self.single._replace(n=1, mode=0)
        threshold = math.ceil((objective.thold_p - TOLERANCE) * PROBABILITY_ONE)
        relevance = np.zeros(self.single.positions.shape[1])
        relevance[self.single.place] = problem.fitness_relevance / problem.fitness_relevance.sum()
        self.goal = Goal(threshold, relevance)
        self.walls = walls_of(problem.scene.room)

    def enter(self, here: Deployment, in_stacks: bool, best: Deployment) -> None:
        """Go to `here`, stacks or single landmarks; `best` is what single landmarks have to beat."""
        self.fixed = self.stacked if in_stacks else self.single
        self.state = state_of(self.fixed, here)
        self.scratch = scratch_of(self.state)
        known = self.state if in_stacks else state_of(self.single, best)
        reached = (known.units >= self.goal.threshold) @ self.goal.relevance
        self._best = Best(np.array([float(reached)]), known.landmarks.copy(), known.normals.copy())

    def walk(self, moves: int, climate: Climate, rng: np.random.Generator) -> bool:
        """Try `moves` moves; True if one led to a better deployment than any before."""
        before = self._best.fitness[0]
        walk(moves, self.fixed, self.state, self.scratch, self.goal, self.walls, climate, rng, self._best)
        return bool(self._best.fitness[0] > before)

    def here(self) -> Deployment:
        """Where the walk is."""
        return Deployment(self.state.landmarks.T, self.state.normals.T)

    def best(self) -> Deployment:
        """The best deployment met."""
        return Deployment(self._best.landmarks.T, self._best.normals.T)
