"""Any object with `ask` and `tell` behind `AskTell`."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, choice, integer
from lmd.optimisers.wrapped import Session, Wrapped, name_of, with_tuples

STOP_METHODS = ("stop", "should_stop")  # methods that say whether an object has ended by its own rules


class AskAndTell(Wrapped):
    """An optimiser of another library that is asked for genes and told their losses, on the unit box.

    Args:
        make: makes the object; in YAML a node with `_target_` (the class), `_partial_: true` and its parameters. It is
            called with the start `(dim,)`, and with a `seed` and with `bounds` `(dim, 2)` where it takes these.
        start: the argument that takes the start, such as `x0` or `mean`.
        batch: how often it is asked before it is told, where it proposes one set of genes at a time.
        told: `arrays` where it is told genes and losses, `pairs` for a list of (genes, loss).
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: `make` is no function with that argument, or a parameter is out of range.
    """

    def __init__(
        self,
        make: Callable[..., Any],
        start: str = "x0",
        batch: int = 1,
        told: str = "arrays",
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(seed, encoding)
        if not callable(make):
            raise InputError(f"make must be a class or a function, got {make!r}.", "make")
        self.make, self.takes = with_tuples(make), inspect.signature(make).parameters
        self.starts_at = choice("start", start, list(self.takes))
        self.batch, self.pairs = integer("batch", batch, low=1), choice("told", told, ("arrays", "pairs")) == "pairs"

    @property
    @override
    def called(self) -> str:
        return name_of(self.make)

    def _open(self, start: FloatArray, rng: np.random.Generator) -> Session:
        given = {"seed": int(rng.integers(1, 2**31)), "bounds": np.tile([0.0, 1.0], (start.shape[1], 1))}
        arguments = {key: value for key, value in given.items() if key in self.takes}
        try:
            made = self.make(**{self.starts_at: start[0], **arguments})
        except Exception as error:  # each library refuses parameters in its own way
            raise InputError(f"make failed: {error}", "make") from error
        for method in ("ask", "tell"):
            if not callable(getattr(made, method, None)):
                raise InputError(f"make: {self.called} makes an object without the method {method}.", "make")
        return _Session(made, self.batch, self.pairs)


class _Session:
    def __init__(self, made: Any, batch: int, pairs: bool) -> None:
        self.made, self.batch, self.pairs = made, batch, pairs

    def ask(self) -> Any:
        if any(getattr(self.made, name, bool)() for name in STOP_METHODS):
            return None
        asked = self.made.ask()
        first = asked[0] if isinstance(asked, Sequence | np.ndarray) and len(asked) else asked
        if np.ndim(first):
            return asked
        return [asked, *(self.made.ask() for _ in range(self.batch - 1))] if self.batch > 1 else asked

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        if self.pairs:
            self.made.tell(list(zip(genes, losses.tolist(), strict=True)))
        else:
            self.made.tell(list(genes), losses.tolist())
