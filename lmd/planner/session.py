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
        """True if the tags have not changed since the plan was last saved.

        Before the first save, the beginning of the session counts instead.
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
        """Move a tag to the free place nearest to a given place; all moves of a tag until `drop` are one step for undo.

        Args:
            number: id of the tag.
            surface: index of the surface with the given place.
            at: coordinates of the given place along u and v of the surface, `(2,)`, metres.

        Raises:
            InputError: as for `Plan.moved`, or a search is running.
        """
        self._become(self.plan.moved(self.problem.scene.footprints, number, surface, at), number)

    def drop(self) -> None:
        """End the dragging of a tag, so that the next move starts a new step for undo."""
        self._dragged = None

    def add(self, surface: int, at: FloatArray, edge: float | None = None) -> int:
        """Add a tag at the free place nearest to a given place; return the tag's id.

        Args:
            surface: index of the surface with the given place.
            at: coordinates of the given place along u and v of the surface, `(2,)`, metres.
            edge: edge length of the tag, metres; None for the edge length of the scene's tag.

        Raises:
            InputError: as for `Plan.added`, or a search is running.
        """
        plan, number = self.plan.added(self.problem.scene, surface, at, edge)
        self._become(plan)
        return number

    def delete(self, number: int) -> None:
        """Delete the tag with the id `number`.

        Raises:
            InputError: as for `Plan.without`, or too few tags would be left for the objective, or a search is running.
        """
        self.problem.objective.check(len(self.deployment) - 1)
        self._become(self.plan.without(number))

    def pin(self, number: int) -> None:
        """Pin the tag with the id `number`, or unpin it if it is pinned.

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
        """Start a search, see `TagSearch`, and return it.

        No other change is allowed until `take` is called.

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
            patience: maximum time to wait, seconds; None to wait without a limit. If the search has not ended by then,
                its best deployment until then is applied.

        Returns:
            increase of the fitness; 0 if no better deployment was found.

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
        """Stop a running search, wait for at most `PATIENCE_SECONDS`, and apply its best deployment found by then."""
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
        """Update the values, the metrics and `posed` to the given plan; `plan` itself is not replaced."""
        self._values.update(plan.deployment)
        self.posed = Posed(self.problem, plan.deployment)

    def _become(self, plan: Plan, dragged: object = None) -> None:
        """Replace the present plan by `plan`, as a new step for undo.

        If `dragged` is the id of the tag whose drag is under way, the change belongs to the step of that drag.
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
