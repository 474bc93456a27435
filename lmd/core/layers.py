"""Several named tuples of arrays as one, along a first axis: so how many there are is no part of a compiled type.

A tuple of n named tuples would be: kernels would be compiled anew for every n.
"""

from typing import Any, TypeVar

import numpy as np
from numba import types
from numba.extending import overload

from lmd.core.compiled import OVERLOAD_INLINED

Bundle = TypeVar("Bundle")


def layers(bundle: Bundle, number: int) -> Bundle:
    """So many copies of a named tuple of arrays, along a new first axis; an array that it has twice stays one."""
    made: Bundle = _copied(bundle, number, {})
    return made


def _copied(part: Any, number: int, copies: dict[int, np.ndarray]) -> Any:
    """`copies` are those made already; not a function within `layers`, which would keep them as garbage in a circle."""
    if isinstance(part, tuple):
        return _made(type(part), [_copied(inner, number, copies) for inner in part])
    if id(part) not in copies:
        copies[id(part)] = np.repeat(part[None], number, axis=0)
    return copies[id(part)]


def layer(bundle: Any, number: Any) -> Any:
    """One of `layers`, as views; in kernels, too."""
    if isinstance(bundle, tuple):
        return _made(type(bundle), (layer(part, number) for part in bundle))
    return bundle[number]


def _made(kind: type, parts: Any) -> Any:
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


@overload(layer, jit_options=OVERLOAD_INLINED)
def _layer(bundle, number):  # type: ignore[no-untyped-def] # noqa: ARG001 # numba compares names and annotations
    # numba has no map over tuples of different types: what is taken of each array is written down.
    kinds: dict[str, Any] = {}
    lines: list[str] = []
    picked = _written(bundle, "bundle", kinds, lines)
    exec("\n    ".join(["def pick(bundle, number):", *lines, f"return {picked}"]), kinds)
    return kinds["pick"]


def _written(part: Any, name: str, kinds: dict[str, Any], lines: list[str]) -> str:
    """The layer of what has this name, as Python.

    A tuple within a tuple gets a name of its own, since LLVM takes half a minute over all paths through a large one.

    Args:
        part: its type.
        name: of a variable.
        kinds: gets the classes of named tuples that it names.
        lines: gets the assignments that come before.
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
