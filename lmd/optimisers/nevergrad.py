"""Any registered optimiser of nevergrad behind `AskTell`."""

import difflib
import warnings
from typing import Any

import numpy as np

from lmd.checks import FloatArray, InputError, integer, real
from lmd.optimisers.wrapped import Session, Wrapped


class Nevergrad(Wrapped):
    """A nevergrad optimiser on the unit box, told the start.

    Args:
        name: what nevergrad registers it as, e.g. `TwoPointsDE`, `NGOpt`, `DiscreteLenglerOnePlusOne`.
        workers: deployments asked for before any of them is told; 1 where the method can do no more.
        budget: evaluations the method plans with, which some need to know; None leaves it in the dark.
        step: standard deviation of an initial step (genes span 1); None for nevergrad's own, 1/6.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: there is no such optimiser, it does not work here, or a parameter is out of range.
    """

    def __init__(
        self,
        name: str = "NGOpt",
        workers: int = 1,
        budget: int | None = None,
        step: float | None = None,
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        from nevergrad.optimization import registry

        super().__init__(seed, encoding)
        self.name = name
        self.workers = integer("optimiser.workers", workers, low=1)
        self.budget = None if budget is None else integer("optimiser.budget", budget, low=1)
        self.step = None if step is None else real("optimiser.step", step, above=0.0)
        if name not in registry:
            close = difflib.get_close_matches(str(name), sorted(registry), n=5, cutoff=0.4)
            raise InputError(
                f"optimiser.name = {name!r} is not in nevergrad" + (f"; close: {', '.join(close)}." if close else ".")
            )
        self.start_size = self.workers

    def _open(self, start: FloatArray, rng: np.random.Generator) -> Session:
        return _Session(self, start, rng)


class _Session:
    def __init__(self, settings: Nevergrad, start: FloatArray, rng: np.random.Generator) -> None:
        import nevergrad

        box = nevergrad.p.Array(init=start[0], lower=0.0, upper=1.0)
        if settings.step is not None:
            box.set_mutation(sigma=settings.step)
        box.random_state = np.random.RandomState(rng.integers(2**32))
        method = nevergrad.optimizers.registry[settings.name]
        self.name = settings.name
        self.workers = settings.workers
        try:
            try:
                self.optimiser = method(box, budget=settings.budget, num_workers=self.workers)
            except ValueError:  # it cannot work in parallel
                self.workers = 1
                self.optimiser = method(box, budget=settings.budget, num_workers=1)
        except Exception as error:  # missing extras, a missing budget: each says it in its own way
            raise InputError(f"nevergrad's {self.name} cannot be made: {error}") from error
        if not self.optimiser.no_parallelization:
            for genes in start[::-1]:  # the last one suggested is asked first
                self.optimiser.suggest(genes)
        self.asked: list[Any] = []

    def ask(self) -> FloatArray | None:
        from nevergrad.common.errors import FinishedUnderlyingOptimizerWarning

        with warnings.catch_warnings(action="error", category=FinishedUnderlyingOptimizerWarning):
            try:
                self.asked = [self.optimiser.ask() for _ in range(self.workers)]
            except (FinishedUnderlyingOptimizerWarning, StopIteration):
                return None
            except Exception as error:
                raise InputError(f"nevergrad's {self.name} failed: {error}") from error
        return np.array([candidate.value for candidate in self.asked])

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        for candidate, loss in zip(self.asked, losses, strict=True):
            self.optimiser.tell(candidate, float(loss))
