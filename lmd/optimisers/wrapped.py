"""Base class of adapters for optimisers of other libraries, which are seeded, restarted, and kept from printing."""

import inspect
import io
import random
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from typing import Any, Protocol, TypeVar
from unittest.mock import patch

import numpy as np

from lmd.core.checks import FloatArray, InputError, failure
from lmd.core.threads import in_daemon
from lmd.optimisers.base import AskTell

T = TypeVar("T")

# Loss of a failed evaluation, finite as libraries require; fitness lies in [0, 1].
LOSS_OF_FAILURE = 1e3
# Amount by which the loss of equal fitness decreases with each evaluation, far less than one position contributes. Many
# deployments have equal fitness, and most libraries reject ties; the decrease lets them cross plateaus.
TIE_BONUS = 1e-12


class LibraryOptimiser(Protocol):
    """Interface of a running optimiser of another library, which minimises the loss.

    The loss is the negative fitness, with a tiny bonus for late candidates.
    """

    def ask(self) -> FloatArray | None:
        """Return the next genes `(B, dim)`, or None when the optimiser has ended by its own criterion."""

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        """Tell the optimiser the `losses` `(B,)` of `genes` `(B, dim)`.

        These are the genes of the last `ask`, clipped to the unit box.
        """


class Wrapped(AskTell):
    """Base class of adapters that make optimisers of other libraries `AskTell` optimisers.

    Subclasses write `_open` only.

    - If an optimiser ends before the budget is used up, a new optimiser with another seed starts from the best genes.
    - Libraries draw from the global random generators of Python and NumPy. During a call of a library, the state of
      these generators follows from the optimiser's seed. After the call, their former state is restored.
    """

    def __init__(self, seed: int = 0, encoding: str | None = None) -> None:
        super().__init__(seed, encoding)
        self.session: LibraryOptimiser | None = None

    @abstractmethod
    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        """Make an optimiser of the library that draws from `rng`.

        The optimiser begins with the candidates `start` `(S, dim)` if the library supports this.
        """

    def _ask(self) -> FloatArray:
        if self.session is None:
            self.session_rng = np.random.default_rng(self.seed)
            self.global_state = _global_state_of(self.seed)
            self.best: tuple[float, FloatArray] = (np.inf, self.start)
            self.session = self._in_library(self._open, self.start, self.session_rng)
        return self._next()

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        age = self.ledger.evaluations - np.arange(len(genes), 0, -1)
        losses = np.where(np.isfinite(fitness), -fitness, LOSS_OF_FAILURE) - TIE_BONUS * age
        least = int(np.argmin(losses))
        if losses[least] < self.best[0]:
            self.best = (float(losses[least]), genes[least : least + 1].copy())
        assert self.session is not None, "it was asked"
        self._in_library(self.session.tell, genes, losses)

    def _next(self) -> FloatArray:
        assert self.session is not None
        genes = self._in_library(self.session.ask)
        if genes is None:
            self.session = self._in_library(self._open, self.best[1], self.session_rng)
            genes = self._in_library(self.session.ask)
        if genes is None:
            raise InputError(f"{self.called}: the library's optimiser ended before its first proposal.")
        return genes

    def _in_library(self, work: Callable[..., T], *arguments: Any) -> T:
        """Call `work`, a function of a library, in a daemon thread; return the function's result.

        Some libraries leave behind a thread that never ends. As a daemon, such a thread does not keep the process
        alive.

        Raises:
            InputError: the library fails.
        """
        with self._own_world():
            try:
                return in_daemon(work, *arguments).result()
            except InputError:
                raise
            except Exception as error:  # libraries raise different errors
                raise InputError(f"{self.called} failed: {failure(error)}.") from error

    @contextmanager
    def _own_world(self) -> Iterator[None]:
        """Context of a call of the library: random numbers follow from the seed, prints and warnings are suppressed."""
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
    """Return the function that is wrapped by nested `functools.partial` objects."""
    while isinstance(call, partial):
        call = call.func
    return call


def name_of(call: Callable[..., Any]) -> str:
    """Name of a library's function or class, for messages."""
    return str(getattr(_inner(call), "__qualname__", call))


def with_tuples(call: Callable[..., Any]) -> Callable[..., Any]:
    """Copy a `functools.partial`, and convert bound lists to tuples for parameters whose default is a tuple.

    The conversion is needed because configurations can only contain lists. Any other function is returned unchanged.
    """
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
    """State that the global random generators have after they are seeded with `seed`."""
    legacy = np.random.RandomState(seed % 2**32)
    return random.Random(seed).getstate(), legacy.get_state()
