"""An optimiser at work on the free tags of a plan, beside whoever looks at it."""

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


class Progress(NamedTuple):
    """How far a search is: the share of the budget that is used, the best fitness, and the deployment that has it."""

    used: float
    fitness: float
    best: Deployment


class Search:
    """Moves the free tags of a plan in a thread of its own, which ends with the process; the pinned ones are fixed.

    Args:
        problem: what the tags are for.
        plan: what is improved. It is not changed.
        optimiser: the method, one that has not run yet.
        budget: what it may spend.
        done: called in that thread when it has ended, for whatever reason.

    Raises:
        InputError: no tag is free, or the pinned ones do not hang properly.
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
        self._told = threading.Event()
        self._thread = threading.Thread(target=self._run, name="search", daemon=True)
        self.progress: Progress | None = None
        self.error: str | None = None

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End with what is found by then, after the batch that is being evaluated."""
        self._told.set()

    def join(self, patience: float | None = None) -> None:
        """Wait for the end, at most for some seconds."""
        self._thread.join(patience)

    @property
    def running(self) -> bool:
        """Whether it has begun and not ended."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._optimiser.run(self._problem, self._budget, self._note)
        except InputError as error:
            self.error = str(error)
        finally:
            self._done()

    def _note(self, optimiser: Optimiser) -> bool:
        """The callback of the optimiser."""
        ledger, before = optimiser.ledger, self.progress
        used = min(self._budget.used(ledger.evaluations, ledger.seconds), 1.0)
        if before is not None and ledger.best_fitness <= before.fitness:
            self.progress = before._replace(used=used)
        elif (found := optimiser.found(self._problem)) is not None:
            best = self.plan.deployment.put(self.plan.free, self._problem.free(found))  # in the order of the plan
            self.progress = Progress(used, ledger.best_fitness, best)
        return self._told.is_set()
