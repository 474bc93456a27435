"""Adapter that makes a global optimiser of SciPy an `AskTell` optimiser.

SciPy's optimisers are functions that call the objective, so such a function runs in a thread of its own.
"""

import inspect
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError
from lmd.core.memory import check_memory
from lmd.core.threads import in_daemon
from lmd.optimisers.wrapped import LibraryOptimiser, Wrapped, name_of, with_tuples
from lmd.problem import Problem

# shgo begins with the corners of the unit box and their neighbours, which takes 88, 1017 and 3968 MB with 10, 12 and 13
# genes.
BYTES_OF_PAIR = 60.0  # memory of a pair of corners
MOST_GENES = 400  # genes beyond which a float cannot hold the number of pairs


class Scipy(Wrapped):
    """Optimisation on the unit box by a function such as `scipy.optimize.dual_annealing`.

    If the function has an argument `x0`, it begins at the problem's start. Whenever the function ends by its own
    criterion before the budget is used up, the function is called again.

    Args:
        minimise: function of SciPy that minimises an objective within `bounds`; in YAML a node with `_target_` (the
            function), `_partial_: true` and the function's parameters.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: `minimise` is not a function of an objective and bounds.
    """

    def __init__(self, minimise: Callable[..., Any], encoding: str | None = None, seed: int = 0) -> None:
        super().__init__(seed, encoding)
        if not callable(minimise) or "bounds" not in inspect.signature(minimise).parameters:
            raise InputError(f"minimise must be a function of an objective and bounds, got {minimise!r}.", "minimise")
        self.minimise = with_tuples(minimise)

    @property
    @override
    def called(self) -> str:
        return name_of(self.minimise)

    @override
    def check(self, problem: Problem) -> None:
        """See `Optimiser.check`; shgo is also refused if there is too little memory for the corners of the unit box."""
        super().check(problem)
        if self.called == "shgo":
            dim = self._genome(problem).dim
            corners = f"minimise: shgo, which begins with the 2^{dim} corners of a box of {dim} genes,"
            check_memory(BYTES_OF_PAIR * 4.0 ** min(dim, MOST_GENES), corners, "minimise")

    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        return Call(self.minimise, start[0], rng)


class Call:
    """Call of SciPy's function in a thread of its own. The thread works only while `ask` waits for it."""

    def __init__(self, minimise: Callable[..., Any], start: FloatArray, rng: np.random.Generator) -> None:
        taken = inspect.signature(minimise).parameters
        given = {"x0": start, "rng": np.random.default_rng(rng.integers(2**63))}
        arguments = {"bounds": [(0.0, 1.0)] * len(start)} | {key: given[key] for key in given if key in taken}
        self.asked: SimpleQueue[FloatArray | None] = SimpleQueue()
        self.told: SimpleQueue[float] = SimpleQueue()
        self.loss = np.nan  # loss of the genes asked for last
        self.call = partial(minimise, self._objective, **arguments)
        self.outcome: Future[None] | None = None

    def _minimise(self) -> None:
        try:
            self.call()
        finally:
            self.asked.put(None)

    def _objective(self, genes: FloatArray) -> float:
        self.asked.put(np.array(genes, dtype=np.float64))
        return self.told.get()

    def ask(self) -> FloatArray | None:
        """See `LibraryOptimiser.ask`."""
        if self.outcome is None:
            self.outcome = in_daemon(self._minimise)
        else:
            self.told.put(self.loss)
        genes = self.asked.get()
        return self.outcome.result() if genes is None else genes[None]

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        """See `LibraryOptimiser.tell`."""
        self.loss = float(losses[0])
