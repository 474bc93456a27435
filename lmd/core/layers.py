"""Stacks of equal named tuples of arrays: one named tuple whose arrays have an additional first axis.

A kernel is compiled once for stacks of any height; for a tuple of n named tuples it would be compiled for each n.
"""

from typing import Any, TypeVar

import numpy as np
from numba import types
from numba.extending import overload

from lmd.core.compiled import OVERLOAD_INLINED

Bundle = TypeVar("Bundle")


def layers(bundle: Bundle, number: int) -> Bundle:
    """Stack `number` copies of a named tuple of arrays along a new first axis.

    An array that occurs several times in the tuple is copied only once, so it stays shared.
    """
    made: Bundle = _copied(bundle, number, {})
    return made


def _copied(part: Any, number: int, copies: dict[int, np.ndarray]) -> Any:
    """Stack `number` copies of `part` along a new first axis; `part` is an array or a nested tuple of arrays.

    `copies` receives each finished stack, keyed by the `id()` of its array, so that shared arrays stay shared. This
    function is no closure in `layers`, as a recursive closure is a reference cycle and delays the release of arrays.
    """
    if isinstance(part, tuple):
        return _made(type(part), [_copied(inner, number, copies) for inner in part])
    if id(part) not in copies:
        copies[id(part)] = np.repeat(part[None], number, axis=0)
    return copies[id(part)]


def layer(bundle: Any, number: Any) -> Any:
    """Named tuple at the index `number` of a stack made by `layers`; its arrays are views. The function also works in
    kernels.
    """
    if isinstance(bundle, tuple):
        return _made(type(bundle), (layer(part, number) for part in bundle))
    return bundle[number]


def _made(kind: type, parts: Any) -> Any:
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


@overload(layer, jit_options=OVERLOAD_INLINED)
def _layer(bundle, number):  # type: ignore[no-untyped-def] # noqa: ARG001 # numba compares names and annotations
    # numba cannot map over tuples of mixed types, so source code that indexes each array is generated.
    kinds: dict[str, Any] = {}
    lines: list[str] = []
    picked = _written(bundle, "bundle", kinds, lines)
    exec("\n    ".join(["def pick(bundle, number):", *lines, f"return {picked}"]), kinds)
    return kinds["pick"]


def _written(part: Any, name: str, kinds: dict[str, Any], lines: list[str]) -> str:
    """Source code of an expression that picks the element `number` of each array in a nested named tuple.

    Nested tuples are assigned to variables first; otherwise LLVM takes half a minute for a large tuple.

    Args:
        part: numba type of the tuple.
        name: name of the variable that holds the tuple.
        kinds: receives the classes of named tuples that the expression uses, keyed by name.
        lines: receives the assignments that precede the expression.
    """
    if isinstance(part, types.Array):
        return f"{name}[number]"
    taken = []
    for i, inner in enumerate(part):
        within = f"{name}[{i}]"
        if not isinstance(inner, types.Array):
            within, path = f"{name}_{i}", within
            lines.append(f"{within} = {path}")
        taken.append(_written(inner, within, kinds, lines))
    kind = getattr(part, "instance_class", None)
    if kind is None:
        return f"({', '.join(taken)},)"
    kinds[kind.__name__] = kind
    return f"{kind.__name__}({', '.join(taken)})"
