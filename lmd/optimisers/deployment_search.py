"""Base of optimisers that vary landmarks, not genes."""

import math
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from lmd.core.compiled import clock
from lmd.optimisers.base import Optimiser
from lmd.optimisers.ledger import Ledger
from lmd.optimisers.stored import deployment, deployment_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment


class DeploymentSearch(Optimiser):
    """Optimiser that evaluates one deployment at a time and keeps the best of them.

    Args:
        seed: see `Optimiser`.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.best: Deployment | None = None

    @override
    def state(self) -> dict[str, Any]:
        """See `Optimiser.state`; a subclass that keeps more adds it."""
        return {**self.ledger.state(), "best": None if self.best is None else deployment_state(self.best)}

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        self.ledger = Ledger.of(state)
        if self.ledger.history:
            self.best = deployment("best", state["best"], problem, problem.count)

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return self.best

    def _record(self, problem: Problem, evaluations: float, deployment: Deployment | None, began: float) -> None:
        """Evaluate a deployment and record it.

        Args:
            problem: problem of the run.
            evaluations: full evaluations spent in the whole run.
            deployment: the deployment; None for one that cannot be the best.
            began: time at which the run would have begun without a pause, see `clock`.
        """
        fitness = -math.inf if deployment is None else problem.fitness_of(deployment)
        self.ledger.seconds = clock() - began
        if self.ledger.note(evaluations, fitness):
            self.best = deployment
