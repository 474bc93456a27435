"""Planning session: the plan, its history and its metrics, independent of browsers.

Only one thread may use a session. A search works on a copy of the plan, and calls a function when the search ends.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

from lmd.core.checks import FloatArray, InputError
from lmd.optimisers.base import Optimiser
from lmd.optimisers.ledger import Budget
from lmd.planner.figures import Values, additions
from lmd.planner.plan import Plan, TagSearch
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

PATIENCE_SECONDS = 1.0  # maximum time to wait for the end of a stopped search, seconds; compilation may take longer


class Posed(NamedTuple):
    """Deployment of a plan, together with the problem for which it is evaluated."""

    problem: Problem
    """Scene and objective."""
    deployment: Deployment
    """The tags."""


class PlanningSession:
    """Plan of a user, and its changes. Each change is one step that can be undone; a refused change has no effect.

    Args:
        problem: scene and objective. The problem's fixed landmarks are always pinned.
        deployment: initial tags, with their surfaces.

    Raises:
        InputError: the objective has no field (incremental evaluator).
    """

    def __init__(self, problem: Problem, deployment: Deployment) -> None:
        self.problem = problem
        self.plan = self._saved = Plan.of(deployment, problem.fixed)
        self.posed = Posed(problem, self.plan.deployment)  # replaced at every change
        self._hung = self.plan.pinned
        self._values = Values(problem, deployment)
        self._opened = self.metrics()
        self._past: list[Plan] = []
        self._future: list[Plan] = []
        self._dragged: object = None
        self.search: TagSearch | None = None

    @property
    def deployment(self) -> Deployment:
        """Deployment with the tags of the present plan."""
        return self.plan.deployment

    @property
    def is_saved(self) -> bool:
        """True if the tags have not changed since the plan was last saved or, if it never was, since the
        session began.
        """
        return self.plan.deployment is self._saved.deployment

    def note_saved(self) -> None:
        """Record that the present plan was saved."""
        self._saved = self.plan

    def values(self) -> FloatArray:
        """Value of the objective at every position of the grid, `(P,)`."""
        return self._values.values()

    def metrics(self) -> dict[str, float]:
        """See `Problem.metrics`."""
        return self._values.metrics()

    def gains(self) -> dict[str, str]:
        """Text about the change of the fitness since the session began, keyed by its label in the panel."""
        gained = self.metrics()["fitness"] - self._opened["fitness"]
        return {"since opened": f"{100.0 * gained:+.2f} points of fitness"}

    def warm_up(self) -> None:
        """Compile all kernels, so that the user does not wait for compilation later."""
        deployment = self.deployment
        turned = replace(deployment, positions=deployment.positions[::-1], normals=deployment.normals[::-1])
        self._values.update(turned)
        self._values.update(deployment)
        self.problem.values(deployment)
        additions(self.problem, deployment, deployment[:1])

    def drag(self, number: int, surface: int, at: FloatArray) -> None:
        """Move a tag, see `Plan.moved`. All moves of a tag until `drop` form one step for undo.

        Raises:
            InputError: as for `Plan.moved`, or a search is running.
        """
        self._become(self.plan.moved(self.problem.scene.footprints, number, surface, at), number)

    def drop(self) -> None:
        """End the dragging of a tag, so that the next move starts a new step for undo."""
        self._dragged = None

    def add(self, surface: int, at: FloatArray, edge: float | None = None) -> int:
        """Add a tag, see `Plan.added`, and return its id.

        Raises:
            InputError: as for `Plan.added`, or a search is running.
        """
        plan, number = self.plan.added(self.problem.scene, surface, at, edge)
        self._become(plan)
        return number

    def delete(self, number: int) -> None:
        """Delete a tag, see `Plan.without`.

        Raises:
            InputError: as for `Plan.without`, or the objective needs the tag, or a search is running.
        """
        self.problem.objective.check(len(self.deployment) - 1)
        self._become(self.plan.without(number))

    def pin(self, number: int) -> None:
        """Pin a tag, or unpin it.

        Raises:
            InputError: there is no such tag, the tag is fixed by the problem, or a search is running.
        """
        if number in self._hung:
            raise InputError(f"tag {number} is fixed by the problem, so it stays pinned.")
        self._become(self.plan.toggled(number))

    def undo(self) -> None:
        """Undo the last step.

        Raises:
            InputError: there is no step to undo, or a search is running.
        """
        self._step(self._past, self._future, "undo")

    def redo(self) -> None:
        """Redo the step that was undone last.

        Raises:
            InputError: there is no step to redo, or a search is running.
        """
        self._step(self._future, self._past, "redo")

    def optimise(self, optimiser: Optimiser, budget: Budget, done: Callable[[], None] = lambda: None) -> TagSearch:
        """Start a search, see `TagSearch`; no other change is allowed until `take` is called.

        Raises:
            InputError: as for `TagSearch`, or a search is running.
        """
        self._check_idle()
        self.search = TagSearch(self.problem, self.plan, optimiser, budget, done)
        self.search.start()
        return self.search

    def take(self, patience: float | None = None) -> float:
        """Wait for the end of the search, and apply its best deployment as one step if it is better than the plan.

        Args:
            patience: maximum time to wait, seconds, after which the result is dropped; None to wait without a limit.

        Returns:
            increase of the fitness.

        Raises:
            InputError: the search failed.
        """
        search = self.search
        assert search is not None, "there is a search"
        search.join(patience)
        self.search, before = None, self.metrics()["fitness"]
        if search.error is not None:
            raise InputError(search.error)
        if search.progress is None or search.progress.fitness <= before:
            return 0.0
        self._become(replace(self.plan, deployment=search.progress.best))
        return search.progress.fitness - before

    def end_search(self) -> None:
        """Stop a running search, and apply its best deployment if it ends within `PATIENCE_SECONDS`."""
        if self.search is not None:
            self.search.stop()
            with suppress(InputError):
                self.take(PATIENCE_SECONDS)

    def _step(self, source: list[Plan], target: list[Plan], name: str) -> None:
        self._check_idle()
        if not source:
            raise InputError(f"there is nothing to {name}.")
        self._dragged = None
        self._follow(source[-1])
        target.append(self.plan)
        self.plan = source.pop()

    def _follow(self, plan: Plan) -> None:
        """Update the values and metrics so that they belong to the given plan."""
        self._values.update(plan.deployment)
        self.posed = Posed(self.problem, plan.deployment)

    def _become(self, plan: Plan, dragged: object = None) -> None:
        """Replace the present plan by `plan`. While one tag (`dragged`) is dragged, all changes belong to one step for
        undo.
        """
        self._check_idle()
        self._follow(plan)
        if dragged is None or dragged != self._dragged:
            self._past.append(self.plan)
        self._future.clear()
        self.plan, self._dragged = plan, dragged

    def _check_idle(self) -> None:
        if self.search is not None:
            raise InputError("the free tags are being optimised: stop the search first.")
