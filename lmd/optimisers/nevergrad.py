"""Adapter that makes any optimiser of nevergrad an `AskTell` optimiser."""

import difflib
import math
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, integer, real
from lmd.core.optional import optional
from lmd.optimisers.wrapped import LibraryOptimiser, Wrapped

PLANNED = 10_000  # evaluations that a method plans if their number is unknown; after these it restarts


class Nevergrad(Wrapped):
    """Optimiser of nevergrad on the unit box, to which the problem's start is suggested.

    Args:
        name: name of a registered optimiser, e.g. `TwoPointsDE`, `NGOpt`, `RLSOnePlusOne`.
        workers: number of candidates that the method proposes at a time; 1 for methods that must be told each fitness
            before they propose again.
        budget: number of evaluations for which the method plans its search; if None, the method plans for `PLANNED`
            evaluations, and is restarted after these.
        step: standard deviation of a random step of a gene in [0, 1]; None for nevergrad's default, 1/6.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: nevergrad has no optimiser of that name, or a parameter is out of range.
    """

    def __init__(
        self,
        name: str,
        workers: int = 1,
        budget: int | None = None,
        step: float | None = None,
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(seed, encoding)
        self.name = name
        self.workers = self.start_size = integer("workers", workers, low=1)
        self.budget = None if budget is None else integer("budget", budget, low=1)
        self.step = None if step is None else real("step", step, above=0.0)
        self.method()

    @property
    @override
    def called(self) -> str:
        return f"nevergrad's {self.name}"

    def method(self) -> Callable[..., Any]:
        """Return nevergrad's function that makes the optimiser.

        Raises:
            InputError: nevergrad has no optimiser of that name.
        """
        optional("nevergrad", "nevergrad")
        from nevergrad.optimization import registry

        if self.name not in registry:
            close = ", ".join(difflib.get_close_matches(str(self.name), sorted(registry), n=5, cutoff=0.3))
            told = f"name = {self.name!r} is not an optimiser of nevergrad; similar: {close or 'none'}."
            raise InputError(told, "name")
        return registry[self.name]  # type: ignore[no-any-return]

    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        return _Running(self, start, rng)


class _Running:
    """Running optimiser of nevergrad, with the settings of `Nevergrad`."""

    def __init__(self, settings: Nevergrad, start: FloatArray, rng: np.random.Generator) -> None:
        import nevergrad

        box = nevergrad.p.Array(init=start[0], lower=0.0, upper=1.0)
        if settings.step is not None:
            box.set_mutation(sigma=settings.step)
        box.random_state = np.random.RandomState(rng.integers(2**32))
        method = settings.method()
        self.workers = 1 if getattr(method, "no_parallelization", False) else settings.workers
        self.optimiser = method(box, budget=settings.budget or PLANNED, num_workers=self.workers)
        self.most_asked = math.inf if settings.budget else PLANNED
        if not self.optimiser.recast:  # recast optimisers take no suggestions; they begin at the first start
            for genes in start[::-1]:  # nevergrad asks for the last suggestion first
                self.optimiser.suggest(genes)
        self.asked: list[Any] = []

    def ask(self) -> FloatArray | None:
        from nevergrad.common.errors import FinishedUnderlyingOptimizerWarning

        if self.optimiser.num_ask >= self.most_asked:
            return None
        category = FinishedUnderlyingOptimizerWarning  # after this warning the proposals are random
        with warnings.catch_warnings(record=True, action="always", category=category) as ended:
            try:
                self.asked = [self.optimiser.ask() for _ in range(self.workers)]
            except StopIteration:
                return None
        if ended:
            return None
        return np.array([candidate.value for candidate in self.asked])

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        from nevergrad.common.errors import TellNotAskedNotSupportedError

        for candidate, loss in zip(self.asked, losses, strict=True):
            with suppress(TellNotAskedNotSupportedError):  # some methods do not learn from a suggestion
                self.optimiser.tell(candidate, float(loss))
