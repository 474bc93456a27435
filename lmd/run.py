"""Functions that find and score a deployment."""

from lmd.evaluation.validation import validation_metrics
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.base import Callback, Optimiser, Result
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment


def optimise(
    problem: Problem,
    evaluations: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    optimiser: Optimiser | None = None,
    callback: Callback | None = None,
) -> Result:
    """Find a deployment for a problem.

    Args:
        problem: problem whose fitness is maximised.
        evaluations: maximum number of full evaluations; an evaluation after a move of one of K landmarks counts as 1/K
            of a full one.
        seconds: wall time after which no new evaluation starts. At least one of `evaluations` and `seconds` is needed.
        seed: random seed of the optimiser; the same seed gives the same result.
        optimiser: optimiser, `Annealing` by default. `seed` does not affect an optimiser that is given.
        callback: function called after every batch of evaluations; the run stops if the function returns True.

    Raises:
        InputError: there is no limit, or the optimiser does not support the problem.
    """
    method = Annealing(seed=seed) if optimiser is None else optimiser
    return method.run(problem, Budget(evaluations, seconds), callback)


def evaluate(problem: Problem, deployment: Deployment, validate: bool = False, seed: int = 0) -> dict[str, float]:
    """Compute the metrics of a deployment, keyed by name; all are fractions in [0, 1].

    Args:
        problem: problem that defines the metrics.
        deployment: any number of landmarks in the problem's room.
        validate: True to compute metrics at positions off the problem's grid, too, see `lmd.evaluation.validation`;
            this takes about a second.
        seed: random seed of the sample of positions off the grid.

    Raises:
        InputError: a landmark lies outside the room, or footprints overlap.
    """
    deployment = deployment.with_surfaces(problem.scene.room)
    problem.scene.footprints.check(deployment)
    problem.objective.check(len(deployment))
    figures = problem.metrics(deployment)
    return figures | validation_metrics(problem, deployment, seed) if validate else figures
