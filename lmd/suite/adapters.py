"""Adapter that converts problems of the suite to problems of pymoo.

Other libraries need a single line of code each, see docs/suite.md.

The suite maximises the fitness; libraries that minimise get the fitness with the opposite sign.
"""

from typing import TYPE_CHECKING, Any

from lmd.core.checks import FloatArray
from lmd.core.optional import optional
from lmd.suite.black_box import BlackBox

if TYPE_CHECKING:
    pass


def pymoo_problem(problem: BlackBox) -> Any:
    """Return a `pymoo.core.problem.Problem` that evaluates a whole population at once, with one or more objectives.

    Raises:
        InputError: pymoo is not installed.
    """
    core = optional("pymoo.core.problem", "optimisers")

    class PymooProblem(core.Problem):  # type: ignore[misc,name-defined] # pymoo has no types
        """Problem of pymoo that minimises the negative values of a `BlackBox`."""

        def __init__(self) -> None:
            super().__init__(n_var=problem.dim, n_obj=len(problem.objectives), xl=problem.lower, xu=problem.upper)

        def _evaluate(self, x: FloatArray, out: dict[str, FloatArray], *_: Any, **__: Any) -> None:
            out["F"] = -problem(x).reshape(len(x), -1)

    return PymooProblem()
