"""Surrogates of a problem for simulated annealing, and the conversion of their solutions to deployments of the problem.

A surrogate simplifies the problem in one or both of two ways: by *stacks*, groups of n coincident landmarks that hide
no other landmark, or by footprints smaller than their true size. If the objective is evaluated on random samples of
poses, new samples are drawn for each phase (a number of moves with constant settings).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.layers import layer, layers
from lmd.core.threads import at_once
from lmd.incremental.field import Field, Places, Stacking, placed, places_of, runner, stack_of, total_fitness
from lmd.objectives.crowd import target_of
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing.moves import FootprintArrays, Settings
from lmd.optimisers.annealing.walk import Best, Walker, walk
from lmd.optimisers.stored import array, points
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.pushing import TOUCHING
from lmd.sight.evaluator import Evaluator
from lmd.space.surface import SurfaceArrays

STACK_SPREAD = 1.6  # distance of separated landmarks, in virtual diameters, at which they do not hide each other
# Decay eta of the averaging: at any time the last quarter of a walk has at least half of the weight in the mean.
AVERAGING_ETA = 3
RESTART_M = 0.5  # distance of a landmark from its mean beyond which the mean restarts, metres
# Size of the samples at the end of a stage, as a share of the positions of the objective's sampling. Twice the share
# takes twice the time, and wrong decisions at the end of the run become rarer.
LARGEST = 0.35
NOWHERE = Places(np.empty((6, 0)), np.empty(0, dtype=np.int64))


@dataclass(frozen=True)
class Conditions:
    """Settings of one phase of simulated annealing: how the problem is simplified, and the settings of the moves."""

    in_stacks: bool
    """True if each moved landmark is a stack."""
    size: float
    """Ratio of the assumed size of the footprints to their true size."""
    done: float
    """Completed fraction of the stage, in [0, 1]."""
    settings: Settings
    """Settings of the moves."""


class Surrogate:
    """Simplified form (surrogate) of a problem, and the walks of simulated annealing on this surrogate.

    Walks run in parallel. Each walk moves its own landmarks while all other landmarks keep their places; then the moves
    of all walks are combined. A walk has the landmarks in one slice of the room, because distant landmarks are rarely
    seen together; slices are perpendicular to a random direction. The number of walks, and so the result, does not
    depend on the machine.

    Args:
        problem: the problem without simplification.
        walkers: largest number of walks. There are fewer walks if a walk would have fewer landmarks than one move can
            change.
    """

    def __init__(self, problem: Problem, walkers: int) -> None:
        self._problem, self._most_walkers = problem, walkers
        self._threads = problem.evaluator.threads
        self._surfaces = SurfaceArrays.of(problem.scene.footprints.hanging.surfaces())
        self._lay_out(problem.fitness_evaluator, problem.fitness_relevance)
        self._climbed: tuple[bool, float] | None = None  # `in_stacks` and `size` of the last walk
        self._footprints: FootprintArrays
        self._field: Field
        self._walkers: list[Walker]

    def _lay_out(self, evaluator: Evaluator, relevance: FloatArray) -> None:
        """Set the incremental evaluator (field), and the functions that compute the fitness from its values (target).

        Both use the P camera positions of `evaluator`, which have the weights `relevance` `(P,)` in the fitness.
        """
        objective = self._problem.objective
        self._true = field_of(objective, evaluator)
        self._target = target_of(objective, self._true, evaluator, relevance)

    @property
    def stack(self) -> int:
        """Number of landmarks in a stack; 0 if the objective allows no stacks."""
        return stack_of(self._true)

    def is_true(self, count: int, conditions: Conditions) -> bool:
        """True if the fitness that a walk records is the exact fitness of a deployment.

        This holds if the problem is not simplified, is not evaluated on random samples, and there is a single walk.

        Args:
            count: number of landmarks or stacks.
            conditions: settings of the walk.
        """
        exact = self._problem.objective.sampling is None and not conditions.in_stacks and conditions.size == 1.0
        return exact and self._shared_out(count, conditions.in_stacks)[1] == 1

    def walk(
        self, here: Deployment, best: Deployment, conditions: Conditions, moves: int, rng: np.random.Generator
    ) -> tuple[Deployment, Deployment | None]:
        """Make moves that begin at the deployment `here`, in several walks at the same time.

        Args:
            here: deployment at the beginning: the stacks, or all landmarks.
            best: best deployment found until now.
            conditions: settings of the walks.
            moves: number of moved landmarks, or stacks, after which the walks end.
            rng: random generator for all random numbers.

        Returns:
            the last deployment, and the best deployment of the walks; None instead of the latter if it is not better
            than `best`, or if its fitness is not exact (`is_true`).
        """
        places = self._prepare(here, best, conditions, rng)
        before, number = self._walkers[0].best.fitness[0], len(self._walkers)
        rngs = [rng] if number == 1 else [np.random.default_rng(seed) for seed in rng.integers(2**63, size=number)]
        shares, run = np.diff(np.linspace(0, moves, number + 1).astype(int)), runner(self._field, walk)

        def go(walker: Walker, share: int, own: np.random.Generator) -> None:
            room = self._surfaces, self._footprints
            run(share, places, walker, self._field, self._target, room, conditions.settings, own)

        at_once(self._threads, go, self._walkers, shares, rngs)
        first = self._walkers[0].best
        found = self.is_true(len(here), conditions) and first.fitness[0] > before
        return self._together(), first.places.deployment() if found else None

    def _prepare(self, here: Deployment, best: Deployment, conditions: Conditions, rng: np.random.Generator) -> Places:
        """Prepare the walks, and return the places of all landmarks at which the walks must begin.

        `NOWHERE`, without places, is returned if the walks are there already. If the objective is evaluated on random
        samples, a new sample is drawn. The sample's size grows with the square of the completed fraction of the stage,
        because the gains of late moves are smaller than the error of a small sample.
        """
        in_stacks, size = conditions.in_stacks, conditions.size
        redrawn = self._problem.resampled(LARGEST * conditions.done**2, rng)
        together, number = self._shared_out(len(here), in_stacks)
        same = redrawn is None and self._climbed == (in_stacks, size)
        if same and number == 1:
            return NOWHERE
        if redrawn is not None:
            self._lay_out(*redrawn)
        self._climbed = in_stacks, size
        if not in_stacks:
            pushed = self._problem.separated(here, size)
            here = best if pushed is None else pushed  # None: the room is too small for larger footprints
        self._footprints = self._footprints_of(len(here), 0.0 if in_stacks else size)
        slices = self._slices(here, self._first_movable(in_stacks), number, rng)
        if same:
            walkers = zip(self._walkers, slices, strict=True)
            self._walkers = [walker._replace(members=members) for walker, members in walkers]
            return places_of(here)
        self._field = self._true
        if isinstance(self._true, Stacking):
            self._field = self._true.stacked(self._problem.fixed) if in_stacks else self._true.shrunk(size)
        state = self._field.state(here)
        others = layers(state, number - 1)
        states = [state, *(layer(others, i) for i in range(number - 1))]
        true_best = best if self.is_true(len(here), conditions) else None
        self._walkers = at_once(self._threads, partial(self._walker, true_best, together), slices, states)
        return NOWHERE

    def _first_movable(self, in_stacks: bool) -> int:
        """Return the index of the first landmark after the fixed ones; 0 with stacks, which contain no fixed ones."""
        return 0 if in_stacks else self._problem.fixed_count

    def _shared_out(self, count: int, in_stacks: bool) -> tuple[int, int]:
        """Largest number of landmarks that one move changes, and number of simultaneous walks.

        Both are for `count` landmarks, or for `count` stacks if `in_stacks` is True.
        """
        movable = count - self._first_movable(in_stacks)
        together = 1 if in_stacks else max(1, min(self.stack, movable))
        return together, max(1, min(self._most_walkers, movable // together))

    def _walker(self, best: Deployment | None, together: int, members: IntArray, state: Any) -> Walker:
        """Make a walk that begins with the deployment in `state` and moves the landmarks `members`.

        Args:
            best: best deployment found until now; if None, the walk records the deployment in `state` as the best.
            together: largest number of landmarks that move together with unchanged offsets.
            members: indices of the landmarks that the walk moves, `(M,)`.
            state: state of the incremental evaluator (field), which contains a deployment.
        """
        exchanged = 2 if len(self._footprints.first) > 1 else 1
        scratches = layers(self._field.scratch(state), max(together, exchanged))
        known = state if best is None else self._true.state(best)
        reached = np.array([total_fitness(self._target, known.units)])
        met = Best(reached, Places(placed(known).poses.copy(), placed(known).surfaces.copy()))
        return Walker(members, np.empty(together, dtype=np.int64), state, scratches, met)

    def _footprints_of(self, count: int, size: float) -> FootprintArrays:
        """Footprints of `count` landmarks, with edges of `size` times their true length.

        Stacks have no footprints; for stacks, `size` is 0.
        """
        footprints, sizes = self._problem.scene.footprints, self._problem.sizes
        papers = footprints.tag.paper_share * sizes if size else np.full(count, footprints.edge)
        found, of = np.unique(papers, return_inverse=True)
        pieces, first = footprints.pieces_of(found)
        return FootprintArrays(size * papers * (1.0 - TOUCHING), of.astype(np.int64), pieces, first)

    def _slices(self, here: Deployment, first: int, number: int, rng: np.random.Generator) -> list[IntArray]:
        """Cut the room into `number` slices perpendicular to a random direction; return the landmarks in each slice.

        Landmarks are returned as indices. Landmarks before index `first` are in no slice.
        """
        movable = np.arange(first, len(here))
        if number == 1:
            return [movable]
        across = movable[np.argsort(here.positions[movable] @ rng.normal(size=3), kind="stable")]
        return [np.sort(part) for part in np.array_split(across, number)]

    def _together(self) -> Deployment:
        """Deployment that combines the moves of all walks: each walk contributes the places of its own landmarks."""
        known = placed(self._walkers[0].state)
        poses, surfaces = known.poses.copy(), known.surfaces.copy()
        for walker in self._walkers[1:]:
            mine, known = walker.members, placed(walker.state)
            poses[:, mine], surfaces[mine] = known.poses[:, mine], known.surfaces[mine]
        return Places(poses, surfaces).deployment()


def count_stacks(problem: Problem, stack: int) -> int:
    """Number of stacks, with `stack` landmarks each, that can be formed from the free landmarks of the problem; the
    remaining free landmarks are in no stack.
    """
    return problem.free_count // stack if stack else 0


def pulled_apart(problem: Problem, stacks: Deployment, angles: FloatArray, stack: int, distance: float) -> Deployment:
    """Separate the landmarks of each stack: spread them evenly on a circle around the place of the stack.

    Args:
        problem: problem with the surfaces.
        stacks: places of S stacks.
        angles: direction from the centre of the circle to the first landmark of each stack, `(S,)`, radians.
        stack: number of landmarks in each stack.
        distance: distance of neighbours on the circle, metres.

    Returns:
        deployment of S * `stack` landmarks.
    """
    surfaces = SurfaceArrays.of(problem.scene.footprints.hanging.surfaces())
    radius = 0.0 if stack == 1 else distance / (2.0 * math.sin(math.pi / stack))
    angle = angles[:, None] + 2.0 * np.pi * np.arange(stack) / stack
    offsets = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = surfaces.coordinates(stacks.surfaces, stacks.positions)[:, None] + offsets
    of = np.repeat(stacks.surfaces, stack)
    return Deployment(surfaces.points(of, at.reshape(-1, 2)), surfaces.normal[of], of)


class MeanPlaces:
    """Running mean of each landmark's places, for K landmarks, in simulated annealing on random samples of poses.

    Landmarks never come to rest, because each random sample has another optimum. The mean of a landmark's places is
    closer to the optimum over all samples than any single place. Later places have a larger weight, because the walk
    still improves: averaging with polynomial decay (Shamir and Zhang, 2013). The mean of a landmark starts again when
    the landmark changes its surface, or moves farther than `RESTART_M` from its mean.

    Args:
        start: initial places of the K landmarks.
    """

    def __init__(self, start: Deployment) -> None:
        self._mean: FloatArray = start.positions.copy()
        self._surfaces = start.surfaces
        self._places = np.zeros(len(start))

    def add(self, here: Deployment) -> Deployment:
        """Update the mean places with the deployment `here`; return them as a deployment on the surfaces of `here`."""
        away = here.positions - self._mean
        jumped = (here.surfaces != self._surfaces) | (np.linalg.norm(away, axis=1) > RESTART_M)
        self._places = np.where(jumped, 1.0, self._places + 1.0)
        self._surfaces = here.surfaces
        self._mean = self._mean + ((AVERAGING_ETA + 1.0) / (self._places + AVERAGING_ETA))[:, None] * away
        return Deployment(self._mean, here.normals, here.surfaces)

    def state(self) -> dict[str, Any]:
        """Return the running mean as plain data, for a checkpoint."""
        return {"mean": self._mean, "surfaces": self._surfaces, "places": self._places}

    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        """Take over the `state` of another mean of K landmarks in the room of `problem`.

        Raises:
            InputError: `state` is not the state of a mean of K landmarks in that room.
        """
        count = len(self._places)
        self._mean = points("mean_places.mean", state["mean"], problem, count)
        self._surfaces = array("mean_places.surfaces", state["surfaces"], np.int64, count)
        self._places = array("mean_places.places", state["places"], np.float64, count, low=0.0)
