"""Tag search: an optimiser that moves the free tags of a plan, in a thread of its own."""

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lmd.core.checks import InputError
from lmd.optimisers.base import Optimiser
from lmd.optimisers.ledger import Budget
from lmd.planner.plan import Plan
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment


class SearchProgress(NamedTuple):
    """Progress of a search."""

    used: float
    """Share of the budget that is used, 0 to 1."""
    fitness: float
    """Best fitness."""
    best: Deployment
    """Deployment with the best fitness."""


class TagSearch:
    """A daemon thread in which an optimiser moves the free tags of a plan; pinned tags are fixed.

    Args:
        problem: scene and objective.
        plan: initial plan, which is not changed.
        optimiser: optimiser that has not run yet.
        budget: budget of the search.
        done: called in the thread of the search after the search has ended, also after an error.

    Raises:
        InputError: no tag is free, or the pinned tags are refused as fixed tags.
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
            raise InputError("all tags are pinned, so there is none to move.")
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
        """End the search after the present batch of evaluations."""
        self._stopped.set()

    def join(self, patience: float | None = None) -> None:
        """Wait for the end of the search, at most `patience` seconds."""
        self._thread.join(patience)

    @property
    def running(self) -> bool:
        """True while the thread runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._optimiser.run(self._problem, self._budget, self._note)
        except InputError as error:
            self.error = str(error)
        finally:
            self._done()

    def _note(self, optimiser: Optimiser) -> bool:
        """Record the progress; the callback of the optimiser."""
        ledger, before = optimiser.ledger, self.progress
        used = min(self._budget.used(ledger.evaluations, ledger.seconds), 1.0)
        if before is not None and ledger.best_fitness <= before.fitness:
            self.progress = before._replace(used=used)
        elif (found := optimiser.found(self._problem)) is not None:
            best = self.plan.deployment.put(self.plan.free, self._problem.free(found))  # in the order of the plan
            self.progress = SearchProgress(used, ledger.best_fitness, best)
        return self._stopped.is_set()
