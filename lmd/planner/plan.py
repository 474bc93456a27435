"""Plan of a user: tags that are either pinned, or free to be moved by the user and by a search."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lmd.core.checks import LARGEST, FloatArray, InputError, IntArray
from lmd.optimisers.base import Optimiser
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment
from lmd.scene.footprints import COLUMN, Footprints
from lmd.scene.labels import Labels
from lmd.scene.scene import Scene
from lmd.space.surface import SurfaceArrays


@dataclass(frozen=True)
class Plan:
    """Tags, each pinned or free to be moved. A plan is immutable; every change returns a new plan."""

    deployment: Deployment
    """Tags with their ids and surfaces; `Plan.of` gives ids to landmarks that have none."""
    pinned: frozenset[int] = frozenset()
    """Ids of tags that do not move."""

    @classmethod
    def of(cls, deployment: Deployment, hung: Deployment | None = None) -> "Plan":
        """Make the plan of a deployment; tags with the ids of the tags in `hung`, which already hang, are pinned."""
        labels = deployment.labels or Labels(deployment.ids)
        pinned = frozenset() if hung is None else frozenset(hung.ids.tolist())
        return cls(replace(deployment, labels=labels), pinned)

    @property
    def free(self) -> IntArray:
        """Indices of the tags that are not pinned."""
        return np.flatnonzero(~np.isin(self.deployment.ids, list(self.pinned)))

    def index_of(self, number: int) -> int:
        """Index of the tag with the id `number`.

        Raises:
            InputError: there is no such tag.
        """
        found = np.flatnonzero(self.deployment.ids == number)
        if not found.size:
            raise InputError(f"there is no tag {number}.")
        return int(found[0])

    def described(self, number: int, scene: Scene) -> str:
        """Sentence about the pose and the size of the tag with the id `number`.

        Raises:
            InputError: there is no such tag.
        """
        k = self.index_of(number)
        surface = int(self.deployment.surfaces[k])
        x, y, z = self.deployment.positions[k]
        edge = self.deployment.edges_of(scene.tag)[k]
        size = f", {scene.tag.square} {edge:g} m" if edge else ""
        where = scene.room.surfaces()[surface].name if surface >= 0 else "free in the room"
        pinned = ", pinned" if number in self.pinned else ""
        return f"tag {number}: {where}, ({x:.3f}, {y:.3f}, {z:.3f}) m{size}{pinned}"

    def moved(self, footprints: Footprints, number: int, surface: int, at: FloatArray) -> "Plan":
        """Return the plan after a tag is moved to the free place nearest to a given place.

        Args:
            footprints: footprints of the tags, and the surfaces.
            number: id of the tag.
            surface: index of the surface with the given place.
            at: coordinates of the given place along u and v of the surface, `(2,)`, metres.

        Raises:
            InputError: there is no such tag, the tag is pinned, or there is no room for it with its white margin.
        """
        k = self._movable(number)
        rest = np.flatnonzero(np.arange(len(self.deployment)) != k)
        others = self.deployment[rest] if rest.size else None
        there = _nearest_free(footprints, others, surface, at, self.deployment.edges[k])
        return replace(self, deployment=self.deployment.put(slice(k, k + 1), there))

    def added(self, scene: Scene, surface: int, at: FloatArray, edge: float | None = None) -> tuple["Plan", int]:
        """Add a tag at the free place nearest to `at`; return the new plan and the tag's id, the least unused id.

        Args:
            scene: scene of the tags.
            surface: index of a surface.
            at: coordinates along u and v of the surface, `(2,)`, metres.
            edge: edge length of the tag, metres; None for the edge length of the scene's tag.

        Raises:
            InputError: there is no room for the tag with its white margin, or all ids of the tag family are used.
        """
        ids = self.deployment.ids
        number = int(np.setdiff1d(np.arange(len(ids) + 1), ids)[0])
        labels = self.deployment.labels
        assert labels is not None, "a plan's tags have ids"
        marks = {COLUMN: ["0"]} if COLUMN in labels.columns else {}
        more = labels + Labels(np.array([number]), marks)
        if not scene.tag.is_point:
            scene.tag.check_ids(more.ids)
        there = _nearest_free(scene.footprints, self.deployment, surface, at, np.nan if edge is None else edge)
        return replace(self, deployment=replace(self.deployment + there, labels=more)), number

    def without(self, number: int) -> "Plan":
        """Return the plan without the tag with the id `number`.

        Raises:
            InputError: there is no such tag, the tag is pinned, or the plan has no other tag.
        """
        k = self._movable(number)
        if len(self.deployment) == 1:
            raise InputError("the only tag of a plan cannot be deleted.")
        return replace(self, deployment=self.deployment[np.flatnonzero(np.arange(len(self.deployment)) != k)])

    def toggled(self, number: int) -> "Plan":
        """Return the plan after the tag with the id `number` is pinned if it was free, or freed if it was pinned.

        Raises:
            InputError: there is no such tag.
        """
        self.index_of(number)
        return replace(self, pinned=self.pinned ^ {number})

    def _movable(self, number: int) -> int:
        """Index of the tag with the id `number`, which must not be pinned.

        Raises:
            InputError: there is no such tag, or the tag is pinned.
        """
        k = self.index_of(number)
        if number in self.pinned:
            raise InputError(f"tag {number} is pinned: unpin it first.")
        return k


def _nearest_free(
    footprints: Footprints, others: Deployment | None, surface: int, at: FloatArray, edge: float = np.nan
) -> Deployment:
    """Deployment of one landmark at the free place nearest to a given place; the landmarks `others` do not move.

    The given place is at `at` `(2,)`, metres along u and v of a surface. `edge` is the edge length of the landmark's
    tag, metres; NaN for the edge length of the scene's tag.

    Raises:
        InputError: `at` is not a place on the surface, or no surface has room for the tag with its white margin.
    """
    surfaces, on = SurfaceArrays.of(footprints.hanging.surfaces()), np.array([surface])
    if not (np.abs(at) <= LARGEST).all():  # also refuses NaN
        raise InputError(f"the place ({at[0]:g}, {at[1]:g}) m is not on a surface.")
    one = Deployment(surfaces.points(on, np.asarray(at)[None]), surfaces.normal[on], on, edges=np.array([edge]))
    fixed = 0 if others is None else len(others)
    apart = footprints.separated(one if others is None else others + one, fixed=fixed)
    if apart is None:
        raise InputError(f"there is no free place for a tag of {footprints.papers(one)[0]:.4g} m (with white margin).")
    return apart[fixed:]


class SearchProgress(NamedTuple):
    """Progress of a search."""

    used: float
    """Fraction of the budget that is spent, 0 to 1."""
    fitness: float
    """Best fitness found until now."""
    best: Deployment
    """Deployment with the best fitness."""


class TagSearch:
    """Daemon thread in which an optimiser moves the free tags of a plan; pinned tags do not move.

    Args:
        problem: scene and objective.
        plan: initial plan, which is not changed.
        optimiser: optimiser that has not run yet.
        budget: budget of the search.
        done: function that is called in the thread of the search when the search has ended, also after an error.

    Raises:
        InputError: no tag is free, or the pinned tags cannot be fixed tags of a problem.
    """

    def __init__(
        self,
        problem: Problem,
        plan: Plan,
        optimiser: Optimiser,
        budget: Budget,
        done: Callable[[], None] = lambda: None,
    ) -> None:
        if not plan.free.size:
            raise InputError("all tags are pinned: unpin a tag first.")
        pinned = np.setdiff1d(np.arange(len(plan.deployment)), plan.free)
        self._problem = Problem(
            problem.scene,
            problem.objective,
            GivenDeployment(plan.deployment[plan.free]),
            problem.evaluator.threads,
            plan.deployment[pinned] if pinned.size else None,
        )
        self.plan, self._optimiser, self._budget, self._done = plan, optimiser, budget, done
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="search", daemon=True)
        self.progress: SearchProgress | None = None
        self.error: str | None = None

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the search to end after the present batch of evaluations."""
        self._stopped.set()

    def join(self, patience: float | None = None) -> None:
        """Wait until the search ends, at most `patience` seconds."""
        self._thread.join(patience)

    @property
    def running(self) -> bool:
        """True while the thread of the search runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._optimiser.run(self._problem, self._budget, self._note)
        except InputError as error:
            self.error = str(error)
        finally:
            self._done()

    def _note(self, optimiser: Optimiser) -> bool:
        """Record the progress of `optimiser`; return True to end the search.

        The optimiser calls this method as its callback.
        """
        ledger, before = optimiser.ledger, self.progress
        used = min(self._budget.used(ledger.evaluations, ledger.seconds), 1.0)
        if before is not None and ledger.best_fitness <= before.fitness:
            self.progress = before._replace(used=used)
        elif (found := optimiser.found(self._problem)) is not None:
            best = self.plan.deployment.put(self.plan.free, self._problem.free(found))  # in the order of the plan
            self.progress = SearchProgress(used, ledger.best_fitness, best)
        return self._stopped.is_set()
