"""Single dispatch in compiled code: the class of the first argument (a named tuple or None) selects the function.

This is `functools.singledispatch` for numba. A kernel calls the dispatched function. The kernel is compiled for each
class of arguments, with the function that is registered for the class. So a criterion or an objective can be added in
one new file, which no kernel imports. Compiled code stays cached on disk; functions passed as arguments would prevent
caching.

    @dispatched
    def area(shape): ...

    @area.register(Square)
    def _area_of_square(square):
        return square.side * square.side
"""

from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from numba import types
from numba.extending import overload

from lmd.core.compiled import OVERLOAD, OVERLOAD_INLINED

Function = Callable[..., Any]
F = TypeVar("F", bound=Function)
P = ParamSpec("P")
R_co = TypeVar("R_co", covariant=True)


class Dispatched(Protocol[P, R_co]):
    """Interface of a function that `dispatched` returns."""

    def __call__(self, *arguments: P.args, **_: P.kwargs) -> R_co:
        """Call the function that is registered for the class of the first argument; positional arguments only."""

    def register(self, kind: type) -> Callable[[F], F]:
        """Decorator that registers a function for a class; the function must have the arguments of the dispatched
        function.
        """


def dispatched(declaration: Callable[P, R_co]) -> Dispatched[P, R_co]:
    """Make a function that calls the function registered for the class of its first argument.

    The function is called like `declaration`, whose body is not used. Calls are inlined, see `compiled.inlined`.
    """
    return _dispatched(declaration, None, OVERLOAD_INLINED)


def dispatched_call(declaration: Callable[P, R_co]) -> Dispatched[P, R_co]:
    """Like `dispatched`, but calls are not inlined; meant for long functions."""
    return _dispatched(declaration, None, OVERLOAD)


def overridable(declaration: Callable[P, R_co]) -> Dispatched[P, R_co]:
    """Like `dispatched`, but the body of `declaration` is the function for classes without a registered function."""
    return _dispatched(declaration, declaration, OVERLOAD_INLINED)


def _dispatched(declaration: Callable[P, R_co], otherwise: Function | None, options: Any) -> Dispatched[P, R_co]:
    table: dict[type, Function] = {}

    def call(first: Any, *others: Any) -> Any:
        function = table.get(type(first), otherwise)
        if function is None:
            raise KeyError(type(first))
        return function(first, *others)

    def register(kind: type) -> Callable[[F], F]:
        def remember(function: F) -> F:
            table[kind] = function
            return function

        return remember

    def resolve(first: Any, *_: Any) -> Function | None:
        return table.get(type(None) if first is types.none else getattr(first, "instance_class", object), otherwise)

    call.__name__, call.__doc__, call.__module__ = declaration.__name__, declaration.__doc__, declaration.__module__
    call.register, call.registered = register, table  # type: ignore[attr-defined]
    overload(call, strict=False, jit_options=options)(resolve)
    return cast("Dispatched[P, R_co]", call)


def entry(column: Any, k: Any) -> Any:
    """Element k of `column`: an array `(K,)`, or a single number that stands for K equal elements.

    The function also works in kernels.
    """
    return column[k] if isinstance(column, np.ndarray) else column


def _entry_of_column(column: Any, k: Any) -> Any:
    return column[k]


def _number(column: Any, k: Any) -> Any:  # noqa: ARG001 # arguments of `entry`
    return column


@overload(entry, strict=False, jit_options=OVERLOAD_INLINED)
def _entry(column: Any, k: Any) -> Function:  # noqa: ARG001 # arguments of `entry`
    return _entry_of_column if isinstance(column, types.Array) else _number
