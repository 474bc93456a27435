"""What the walk of simulated annealing climbs: the true problem, or a surrogate of it."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.layers import layer, layers
from lmd.core.threads import at_once
from lmd.incremental.field import Field, Places, Stacking, in_order, placed, places_of, runner, stack_of, total_worth
from lmd.objectives.base import incremental
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing.proposals import Papers
from lmd.optimisers.annealing.walk import Best, Settings, walk
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.pushing import TOUCHING
from lmd.sight.evaluator import Evaluator
from lmd.space.surface import SurfaceArrays

NOWHERE = Places(np.empty((6, 0)), np.empty(0, dtype=np.int64))


@dataclass(frozen=True)
class Walker:
    """What one walk changes: where its `members` `(M,)` are, the best it met if it walks alone, and working memory.

    `group` `(n,)` holds the landmarks that move together, `scratches` as many `layers`. The next walk begins at
    `places`, or where the last one ended if there are none.
    """

    places: Places
    members: IntArray
    group: IntArray
    state: Any
    scratches: Any
    best: Best


class Surrogate:
    """A problem in the arrays of the walk, and where on it the walk is.

    The surrogates are stacks, which nothing hides; plates that are smaller than they are; and, if the objective has a
    sampling, a sample drawn anew at every `prepare`.

    Several walkers climb at once, on all processors. Each moves landmarks of its own, the others staying where they
    are; then all moves are put together. Walkers share out the room by slices across a random direction, as landmarks
    far apart are hardly ever seen together. How many there are does not depend on the machine, and so neither does the
    result. `is_true` says whether one walker alone climbs the problem itself: what several have found is known when
    their moves are put together.

    Args:
        problem: the true problem.
        walkers: at most; each has landmarks enough to move together.
        largest: share of the positions of an objective's sampling that the samples at the end of a stage have.
    """

    def __init__(self, problem: Problem, walkers: int, largest: float) -> None:
        self._problem, self.walkers, self._largest = problem, walkers, largest
        self._threads = problem.evaluator.threads
        self._surfaces = SurfaceArrays.of(problem.scene.plates.hanging.surfaces())
        self._survey(problem.fitness_evaluator, problem.fitness_relevance)
        self._papers: Papers
        self._climbed: tuple[bool, float] | None = None  # in stacks, size of plates
        self._field: Field
        self._walkers: list[Walker]
        self.is_true: bool

    def _survey(self, evaluator: Evaluator, relevance: FloatArray) -> None:
        """Lay out positions, orientations and relevance for the walk."""
        objective = self._problem.objective
        self._true = field_of(objective, evaluator)
        self._target = incremental(objective).target(in_order(self._true, relevance))

    @property
    def stack(self) -> int:
        """Landmarks in a stack, see `stack_of`."""
        return stack_of(self._true)

    def prepare(
        self, here: Deployment, best: Deployment, in_stacks: bool, size: float, done: float, rng: np.random.Generator
    ) -> None:
        """Make ready to walk on from `here`.

        Args:
            here: stacks or single landmarks.
            best: what single landmarks have to beat on the true problem.
            in_stacks: whether `here` is stacks.
            size: of the plates; 1 is the truth.
            done: share of the stage. Samples for an objective with a sampling grow with its square: a rough
                direction will do for the first moves, but the last ones are lost in what a small sample errs.
        """
        redrawn = self._problem.resampled(self._largest * done**2, rng)
        movable = np.arange(0 if in_stacks else self._problem.fixed_count, len(here))
        together = 1 if in_stacks else max(1, min(self.stack, len(movable)))
        number = max(1, min(self.walkers, len(movable) // together))
        same = redrawn is None and self._climbed == (in_stacks, size)
        if same and number == 1:
            return
        if redrawn is not None:
            self._survey(*redrawn)
        self._climbed = in_stacks, size
        self.is_true = number == 1 and redrawn is None and not in_stacks and size == 1.0
        if not in_stacks:
            pushed = self._problem.apart(here, size)
            here = best if pushed is None else pushed  # where there is no room for the plates, the best found has it
        self._papers = self._papers_of(len(here), 0.0 if in_stacks else size)
        slices = self._slices(here, movable, number, rng)
        if same:
            places = places_of(here)
            self._walkers = [
                replace(walker, places=places, members=members)
                for walker, members in zip(self._walkers, slices, strict=True)
            ]
            return
        self._field = self._true
        if isinstance(self._true, Stacking):
            self._field = self._true.stacked(self._problem.fixed) if in_stacks else self._true.shrunk(size)
        state = self._field.state(here)
        others = layers(state, number - 1)
        states = [state, *(layer(others, i) for i in range(number - 1))]
        self._walkers = at_once(self._threads, partial(self._walker, best, together), slices, states)

    def _walker(self, best: Deployment, together: int, members: IntArray, state: Any) -> Walker:
        """A walker that begins with `state`; so many of its landmarks can move together."""
        exchanged = 2 if len(self._papers.first) > 1 else 1
        scratches = layers(self._field.scratch(state), max(together, exchanged))
        known = self._true.state(best) if self.is_true else state
        reached = np.array([total_worth(self._target, known.units)])
        met = Best(reached, Places(placed(known).poses.copy(), placed(known).surfaces.copy()))
        return Walker(NOWHERE, members, np.empty(together, dtype=np.int64), state, scratches, met)

    def _papers_of(self, count: int, size: float) -> Papers:
        """The papers of so many landmarks, `size` times as large as they are; 0 for stacks, which have none."""
        plates, sizes = self._problem.scene.plates, self._problem.sizes
        papers = plates.tag.paper_share * sizes if size else np.full(count, plates.edge)
        found, of = np.unique(papers, return_inverse=True)
        pieces, first = plates.pieces_of(found)
        return Papers(size * papers * (1.0 - TOUCHING), of.astype(np.int64), pieces, first)

    def _slices(self, here: Deployment, movable: IntArray, number: int, rng: np.random.Generator) -> list[IntArray]:
        """The landmarks that may move, in so many slices of the room."""
        if number == 1:
            return [movable]
        across = movable[np.argsort(here.positions[movable] @ rng.normal(size=3), kind="stable")]
        return [np.sort(part) for part in np.array_split(across, number)]

    def walk(self, moves: int, settings: Settings, rng: np.random.Generator) -> bool:
        """Try `moves` moves; True if one led to a better deployment than any before."""
        before = self._walkers[0].best.fitness[0]
        number = len(self._walkers)
        rngs = [rng] if number == 1 else [np.random.default_rng(seed) for seed in rng.integers(2**63, size=number)]
        shares = np.diff(np.linspace(0, moves, number + 1).astype(int))

        step = runner(self._field, walk)

        def go(walker: Walker, share: int, own: np.random.Generator) -> None:
            w, place = walker, (self._target, self._surfaces, self._papers)
            step(share, w.places, w.members, w.group, self._field, w.state, w.scratches, *place, settings, own, w.best)

        at_once(self._threads, go, self._walkers, shares, rngs)
        self._walkers = [replace(walker, places=NOWHERE) for walker in self._walkers]  # the next one goes on from there
        return bool(self._walkers[0].best.fitness[0] > before)

    def here(self) -> Deployment:
        """Where the walkers are."""
        known = placed(self._walkers[0].state)
        poses, surfaces = known.poses.copy(), known.surfaces.copy()
        for walker in self._walkers[1:]:
            mine, known = walker.members, placed(walker.state)
            poses[:, mine], surfaces[mine] = known.poses[:, mine], known.surfaces[mine]
        return Places(poses, surfaces).deployment()

    def best(self) -> Deployment:
        """The best deployment met on the true problem since `prepare`, or the one given to it."""
        return self._walkers[0].best.places.deployment()
