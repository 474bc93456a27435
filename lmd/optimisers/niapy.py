"""Any algorithm of NiaPy behind `AskTell`; its algorithms call the objective, so they run in a thread of their own."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, choice, integer
from lmd.core.optional import optional
from lmd.optimisers.operators import filled_up
from lmd.optimisers.scipy import Call
from lmd.optimisers.wrapped import LibraryOptimiser, Wrapped, algorithm_of, name_of


class NiaPy(Wrapped):
    """A NiaPy algorithm on the unit box.

    Its first population is the start, filled up with uniform genes. When an algorithm has used up its evaluations, a
    new algorithm starts from the best genes.

    Args:
        algorithm: makes the algorithm; in YAML a node with `_target_` (the class), `_partial_: true` and its
            parameters.
        evaluations: number of evaluations that the algorithm plans with (L-SHADE reduces its population over this
            number); None for no end.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: `algorithm` does not make a NiaPy algorithm, or a parameter is out of range.
    """

    def __init__(
        self, algorithm: Callable[[], Any], evaluations: int | None = None, encoding: str | None = None, seed: int = 0
    ) -> None:
        _import_silently()
        from niapy.algorithms import Algorithm

        super().__init__(seed, encoding)
        self.evaluations = None if evaluations is None else integer("evaluations", evaluations, low=1)
        self.algorithm = algorithm
        made = algorithm_of(algorithm, Algorithm, "NiaPy")
        for key, value in getattr(algorithm, "keywords", {}).items():  # NiaPy ignores parameters that it does not know
            if value is not None:  # such as the default of an argument that is no parameter
                choice(f"parameter of {self.called}", key, list(made.get_parameters()))
        self.start_size = integer("algorithm.population_size", made.population_size, low=1)

    @property
    def called(self) -> str:
        """See `Optimiser.called`."""
        return name_of(self.algorithm)

    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        return Call(_Minimise(self.algorithm(), start, self.evaluations), start[0], rng)


def _import_silently() -> None:
    """Import NiaPy, which adds a handler to the root logger; the handler is removed."""
    before = list(logging.root.handlers)
    optional("niapy", "optimisers")
    logging.root.handlers[:] = before


class _Minimise:
    """Run of an algorithm as a function of an objective."""

    def __init__(self, algorithm: Any, start: FloatArray, evaluations: int | None) -> None:
        self.algorithm, self.start, self.evaluations = algorithm, start, evaluations

    def __call__(
        self, objective: Callable[[FloatArray], float], bounds: list[tuple[float, float]], rng: np.random.Generator
    ) -> None:
        from niapy.problems import Problem
        from niapy.task import Task

        class Genes(Problem):  # type: ignore[misc] # NiaPy has no types
            def _evaluate(self, x: FloatArray) -> float:
                return objective(x)

        self.algorithm.rng, self.algorithm.initialization_function = rng, self._first
        box = Genes(len(bounds), 0.0, 1.0)
        self.algorithm.run(Task(box, max_evals=np.inf if self.evaluations is None else self.evaluations))
        if self.algorithm.exception is not None:  # outside the main thread NiaPy keeps the error to itself
            raise self.algorithm.exception

    def _first(
        self, task: Any, population_size: int, rng: np.random.Generator, individual_type: Any = None, **_: Any
    ) -> tuple[Any, FloatArray]:
        """Return the first population and its losses, as NiaPy's own functions of initialisation do."""
        genes = filled_up(self.start, population_size, rng)
        if individual_type is None:
            return genes, np.array([task.eval(each) for each in genes])
        population = np.empty(len(genes), dtype=object)
        for i, each in enumerate(genes):
            population[i] = individual_type(x=each, task=task, rng=rng, e=True)
        return population, np.array([individual.f for individual in population])
