"""What the wrapped libraries share: seeding, silence and restarts."""

import inspect
import io
import random
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from typing import Any, Protocol
from unittest.mock import patch

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.optimisers.base import AskTell

# Libraries minimise finite losses: what a failed evaluation costs them; fitness lies in [0, 1].
LOSS_OF_FAILURE = 1e3
# Fitness is a share of positions, so many deployments tie. Later ones count as this much better: most libraries turn
# ties down, and then never cross a plateau. Far less than one position is worth.
TIE_BONUS = 1e-12


class Session(Protocol):
    """One optimiser of a library at work; it minimises."""

    def ask(self) -> FloatArray | None:
        """The next genes `(B, dim)`, or None when the optimiser considers itself done."""

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        """The losses `(B,)` of the genes asked for, which are now inside the unit box."""


class Wrapped(AskTell):
    """Library optimisers behind `AskTell`; subclasses write `_open` only.

    - An optimiser that ends before the budget does is followed by a fresh one with a new seed that starts from the
      best genes so far.
    - Libraries draw from the global random generators. They get their own, and the caller's are put back.
    """

    def __init__(self, seed: int = 0, encoding: str | None = None) -> None:
        super().__init__(seed, encoding)
        self.session: Session | None = None

    @abstractmethod
    def _open(self, start: FloatArray, rng: np.random.Generator) -> Session:
        """A session that begins with `start` `(S, dim)`, if it can use a start, and draws from `rng`."""

    def _ask(self) -> FloatArray:
        if self.session is None:
            self.session_rng = np.random.default_rng(self.seed)
            self.global_state = _global_state_of(self.seed)
            self.best: tuple[float, FloatArray] = (np.inf, self.start)
            with self._own_world():
                self.session = self._open(self.start, self.session_rng)
        return self._next()

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        age = self.ledger.evaluations - np.arange(len(genes), 0, -1)
        losses = np.where(np.isfinite(fitness), -fitness, LOSS_OF_FAILURE) - TIE_BONUS * age
        least = int(np.argmin(losses))
        if losses[least] < self.best[0]:
            self.best = (float(losses[least]), genes[least : least + 1].copy())
        assert self.session is not None, "it was asked"
        with self._own_world():
            self.session.tell(genes, losses)

    def _next(self) -> FloatArray:
        assert self.session is not None
        with self._own_world():
            genes = self.session.ask()
            if genes is None:
                self.session = self._open(self.best[1], self.session_rng)
                genes = self.session.ask()
        if genes is None:
            raise InputError(f"{self.called}: the library's optimiser ended before its first proposal.")
        return genes

    @contextmanager
    def _own_world(self) -> Iterator[None]:
        """Global random generators for the library alone, all seeded, and neither prints nor warnings from it."""
        outside = _global_state()
        _set_global_state(self.global_state)
        default_rng = np.random.default_rng

        def seeded(seed: Any = None) -> np.random.Generator:
            return default_rng(self.session_rng.integers(2**63) if seed is None else seed)

        try:
            with (
                patch("numpy.random.default_rng", seeded),
                warnings.catch_warnings(action="ignore"),
                redirect_stdout(io.StringIO()),
            ):
                yield
        finally:
            self.global_state = _global_state()
            _set_global_state(outside)


def _inner(call: Callable[..., Any]) -> Callable[..., Any]:
    """The function that a node with `_partial_: true` names."""
    while isinstance(call, partial):
        call = call.func
    return call


def name_of(call: Callable[..., Any]) -> str:
    """The name of a function or a class of a library in messages."""
    return str(getattr(_inner(call), "__qualname__", call))


def with_tuples(call: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a library with tuples for lists where its defaults are tuples: configurations have lists alone."""
    if not isinstance(call, partial):
        return call
    parameters = inspect.signature(call).parameters
    originals = inspect.signature(_inner(call)).parameters
    lists = {
        key: tuple(value)
        for key, value in call.keywords.items()
        if isinstance(value, list) and key in parameters and isinstance(originals[key].default, tuple)
    }
    return partial(call, **lists)


def _global_state() -> tuple[Any, Any]:
    return random.getstate(), np.random.get_state()  # noqa: NPY002


def _set_global_state(state: tuple[Any, Any]) -> None:
    random.setstate(state[0])
    np.random.set_state(state[1])  # noqa: NPY002


def _global_state_of(seed: int) -> tuple[Any, Any]:
    """The global state that seeding with `seed` would give."""
    legacy = np.random.RandomState(seed % 2**32)
    return random.Random(seed).getstate(), legacy.get_state()
