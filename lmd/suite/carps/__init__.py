"""Problems of the suite as tasks of CARP-S, a benchmark for optimisers that is configured by Hydra.

    python -m carps.run hydra.searchpath=[pkg://lmd.suite.carps] +task=lmd problem=tiny_mean \
        +optimizer/randomsearch=config loggers=[]

The costs that CARP-S minimises are the negative values.
"""

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.optional import optional
from lmd.suite.adapters import check_single
from lmd.suite.frozen import problem

if TYPE_CHECKING:
    import ConfigSpace


def space(name: str, seed: int) -> "ConfigSpace.ConfigurationSpace":
    """Return the unit box of a problem of the suite, with the parameters `x0`, `x1` and so on.

    Raises:
        InputError: ConfigSpace is not installed, or no problem has that name.
    """
    library: Any = optional("ConfigSpace", "suite")
    box: ConfigSpace.ConfigurationSpace = library.ConfigurationSpace(seed=seed)
    box.add([library.Float(f"x{i}", (0.0, 1.0)) for i in range(problem(name).dim)])
    return box


def objective_function(name: str, seed: int = 0, loggers: Any = None) -> Any:
    """Return a problem of the suite as a `carps.objective_functions.objective_function.ObjectiveFunction`.

    Args:
        name: name of the problem.
        seed: seed of the parameters that CARP-S draws.
        loggers: loggers of CARP-S.

    Raises:
        InputError: CARP-S is not installed, no problem has that name, or it has several objectives.
    """
    base = optional("carps.objective_functions.objective_function", "suite")
    trials = optional("carps.utils.trials", "suite")
    box = problem(name)
    check_single(box, "this task of CARP-S")

    class SuiteFunction(base.ObjectiveFunction):  # type: ignore[misc,name-defined] # a base that is loaded here
        """Negative values of the problem."""

        configspace = space(name, seed)

        def _evaluate(self, trial_info: Any) -> Any:
            began = time.time()
            values = trial_info.config
            cost = -box(np.array([values[f"x{i}"] for i in range(box.dim)]))
            ended = time.time()
            return trials.TrialValue(cost=cost.tolist(), time=ended - began, starttime=began, endtime=ended)

    return SuiteFunction(loggers)
