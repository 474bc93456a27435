"""Adapters of the suite's problems to other libraries: pymoo, nevergrad, ioh, Optuna and SciPy.

Values are maximised here; libraries that minimise get values with the opposite sign.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.optional import optional
from lmd.suite.black_box import BlackBox

if TYPE_CHECKING:
    import optuna


def pymoo_problem(problem: BlackBox) -> Any:
    """Return a `pymoo.core.problem.Problem` that evaluates a whole population at once, with one or more objectives.

    Raises:
        InputError: pymoo is not installed.
    """
    core = optional("pymoo.core.problem", "optimisers")

    class PymooProblem(core.Problem):  # type: ignore[misc,name-defined] # pymoo has no types
        """Minimise the negative values."""

        def __init__(self) -> None:
            super().__init__(n_var=problem.dim, n_obj=len(problem.objectives), xl=problem.lower, xu=problem.upper)

        def _evaluate(self, x: FloatArray, out: dict[str, FloatArray], *_: Any, **__: Any) -> None:
            out["F"] = -problem(x).reshape(len(x), -1)

    return PymooProblem()


def nevergrad_function(problem: BlackBox) -> Any:
    """Return a `nevergrad.functions.ExperimentFunction` whose loss is the negative fitness, a list for several values.

    Raises:
        InputError: nevergrad is not installed.
    """
    nevergrad = optional("nevergrad", "nevergrad")
    functions = optional("nevergrad.functions", "nevergrad")
    genes = nevergrad.p.Array(init=problem.start(), lower=0.0, upper=1.0)

    def loss(x: FloatArray) -> float | list[float]:
        return _number(-problem(x))

    return functions.ExperimentFunction(loss, nevergrad.p.Instrumentation(x=genes).set_name(problem.name))


def ioh_problem(problem: BlackBox) -> Any:
    """Return a maximisation problem of IOHexperimenter, named like `problem`; its loggers write IOHprofiler's format.

    Raises:
        InputError: ioh is not installed, or the problem has several objectives.
    """
    ioh = optional("ioh", "suite")
    check_single(problem, "ioh")
    largest = {"optimization_type": ioh.OptimizationType.MAX, "lb": 0.0, "ub": 1.0}
    return ioh.wrap_problem(lambda x: float(problem(x)), name=problem.name, dimension=problem.dim, **largest)


def optuna_objective(problem: BlackBox) -> "Callable[[optuna.Trial], float | list[float]]":
    """Return an objective for Optuna to maximise; genes are the parameters `x0`, `x1` and so on.

    A study of several objectives needs `directions=["maximize"] * len(problem.objectives)`.
    """

    def objective(trial: "optuna.Trial") -> float | list[float]:
        return _number(problem(np.array([trial.suggest_float(f"x{i}", 0.0, 1.0) for i in range(problem.dim)])))

    return objective


def scipy_function(problem: BlackBox) -> Callable[[FloatArray], FloatArray]:
    """Return the negative fitness as a function for SciPy's optimisers of `(d,)`, or `(d, B)` with `vectorized=True`.

    Raises:
        InputError: the problem has several objectives.
    """
    check_single(problem, "SciPy")
    return lambda x: -problem(np.asarray(x).T)


def _number(values: FloatArray) -> float | list[float]:
    """One value as a Python number; several values as a list."""
    return values.tolist()  # type: ignore[no-any-return]


def check_single(problem: BlackBox, library: str) -> None:
    """Raise `InputError` if a problem has several objectives."""
    if len(problem.objectives) > 1:
        raise InputError(f"{problem.name} has {len(problem.objectives)} objectives; {library} takes one.", "problem")
