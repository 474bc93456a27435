"""Adapter that makes any single-objective algorithm of pymoo an `AskTell` optimiser."""

from collections.abc import Callable
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, integer
from lmd.optimisers.genetic import filled_up
from lmd.optimisers.wrapped import LibraryOptimiser, Wrapped, name_of


class Pymoo(Wrapped):
    """Algorithm of pymoo on the unit box.

    The first population is the start, filled up with uniform random genes. pymoo's default termination is replaced by
    the budget. Local searches keep their own termination, and are restarted from the best genes when they end.

    Args:
        algorithm: function that makes the algorithm; in YAML a node with `_target_` (the class), `_partial_: true` and
            the parameters of the class, operators included.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: `algorithm` does not make a pymoo algorithm.
    """

    def __init__(self, algorithm: Callable[[], Any], encoding: str | None = None, seed: int = 0) -> None:
        super().__init__(seed, encoding)
        self.algorithm = algorithm
        self.start_size = _size(_made(algorithm))

    @property
    @override
    def called(self) -> str:
        return name_of(self.algorithm)

    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        return _Running(self.algorithm(), start, rng)


def _made(make: Callable[[], Any]) -> Any:
    """Make an algorithm.

    Raises:
        InputError: `make` is not a function, fails, or returns an object that is not an algorithm.
    """
    from pymoo.core.algorithm import Algorithm

    if not callable(make):
        raise InputError(f"algorithm must be a function of no arguments, got {make!r}.", "algorithm")
    try:
        made = make()
    except Exception as error:  # algorithms raise different errors
        raise InputError(f"algorithm cannot be made: {error}", "algorithm") from error
    if not isinstance(made, Algorithm):
        raise InputError(f"algorithm makes a {type(made).__name__}, not a pymoo algorithm.", "algorithm")
    return made


def _size(algorithm: Any) -> int:
    """Number of candidates with which the algorithm begins.

    A local search continues from the best of these candidates.
    """
    from pymoo.core.variable import get

    size = getattr(algorithm, "n_sample_points", None) or getattr(algorithm, "pop_size", None) or 1
    return integer("algorithm.pop_size", get(size), low=1)  # some algorithms store the size as a variable of pymoo


class _Running:
    """Running algorithm of pymoo on the unit box."""

    def __init__(self, algorithm: Any, start: FloatArray, rng: np.random.Generator) -> None:
        from pymoo.algorithms.base.local import LocalSearch
        from pymoo.core.mixed import MixedVariableSampling
        from pymoo.core.population import Population
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination
        from pymoo.core.variable import Real

        dim = start.shape[1]
        # For algorithms of variables of several kinds, whose candidates are mappings.
        named = {str(gene): Real(bounds=(0.0, 1.0)) for gene in range(dim)}
        if begins := getattr(algorithm, "initialization", None):
            first: Any = filled_up(start, _size(algorithm), rng)
            if isinstance(begins.sampling, MixedVariableSampling):
                first = Population.new(X=[dict(zip(named, genes, strict=True)) for genes in first])
            begins.sampling = first
        settings: dict[str, Any] = {"seed": int(rng.integers(2**31))}
        if not isinstance(algorithm, LocalSearch):
            settings["termination"] = NoTermination()
        self.problem = Problem(n_var=dim, n_obj=1, xl=np.zeros(dim), xu=np.ones(dim))
        self.problem.vars = named
        self.algorithm = algorithm.setup(self.problem, **settings)
        self.asked: Any = None  # a population, or an individual

    def ask(self) -> FloatArray | None:
        while self.algorithm.has_next():
            self.asked = self.algorithm.ask()
            if self.asked is not None:
                found = np.atleast_1d(self.asked.get("X"))
                if found.dtype == object:
                    found = np.array([[mapping[name] for name in self.problem.vars] for mapping in found])
                return np.atleast_2d(found)
            self.algorithm.advance()  # between two phases an algorithm may have nothing to evaluate
        return None

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        from pymoo.core.population import Population
        from pymoo.problems.static import StaticProblem

        asked = self.asked if isinstance(self.asked, Population) else Population.create(self.asked)
        if not isinstance(asked[0].X, dict):
            asked.set("X", genes)
        # Some algorithms read the number of evaluations from their evaluator.
        static = StaticProblem(self.problem, F=losses[:, None])
        self.algorithm.evaluator.eval(static, asked, skip_already_evaluated=False)
        self.algorithm.tell(infills=self.asked)
