"""Digests of code: what was compiled, or kept otherwise, is stale when the code that made it has changed."""

import hashlib
import inspect
import sys
from collections.abc import Iterable, Iterator
from enum import Enum
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import types

# Top-level packages whose files do not count. numba's own cache knows its version.
NOT_COUNTED = (sys.stdlib_module_names - {"__main__"}) | {"llvmlite", "numba", "numpy"}
CONSTANTS = (bool, int, float, complex, str, bytes, type(None), Enum, np.generic)


@cache
def package_digest() -> str:
    """A digest of all code of `lmd`."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(kernel: FunctionType, classes: Iterable[type]) -> str | None:
    """A digest of the code that a kernel is compiled from; None if some of it is in no file.

    It covers the files that define the kernel, the functions that it calls, directly or not, and the classes of its
    arguments; and the values of the constants that these functions use. They are found by their names in the code of
    the functions. Of a function that is `dispatched` those count that these classes registered.

    Args:
        kernel: the plain function.
        classes: of its arguments, see `classes_in`.
    """
    kinds, constants = frozenset(classes), set[str]()
    functions, waiting, modules = set[FunctionType](), [kernel], {kind.__module__ for kind in kinds}
    while waiting:
        function = waiting.pop()
        if function in functions:
            continue
        functions.add(function)
        modules.add(function.__module__)
        for name, value in _used_by(function):
            if isinstance(value, type):
                modules.add(value.__module__)
            elif isinstance(value, FunctionType):
                waiting += _resolved(value, kinds)
            else:
                constants.add(f"{function.__module__}.{name} = {_text_of(value)}")
    digest = hashlib.sha256(repr(sorted(constants)).encode())
    for module in sorted(modules):
        if module.partition(".")[0] not in NOT_COUNTED:
            source = _source_of(module)
            if source is None:
                return None
            digest.update(source)
    return digest.hexdigest()


def classes_in(kinds: Any) -> set[type]:
    """The classes of the named tuples in a sequence of numba types, and in their members."""
    found = set[type]()
    for kind in kinds:
        if named := getattr(kind, "instance_class", None):
            found.add(named)
        if isinstance(kind, types.BaseTuple):
            found |= classes_in(kind)
    return found


def _used_by(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """The names in the code of a function, and the values that they have there; functions as Python wrote them."""
    names = set(_names_in(function.__code__))
    known = [function.__globals__, inspect.getclosurevars(function).nonlocals]
    modules = [space[name] for space in known for name in names & space.keys() if isinstance(space[name], ModuleType)]
    known += [vars(module) for module in modules if module.__name__.partition(".")[0] not in NOT_COUNTED]
    for space in known:
        for name in names & space.keys():
            value = space[name]
            if not isinstance(value, ModuleType):
                yield name, value if isinstance(value, type) else inspect.unwrap(value)


def _names_in(code: CodeType) -> Iterator[str]:
    yield from (*code.co_names, *code.co_freevars)
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _names_in(part)


def _resolved(function: FunctionType, kinds: frozenset[type]) -> list[FunctionType]:
    """The function; one that is `dispatched`, with those that are registered for some of the classes."""
    table = getattr(function, "registered", {})
    return [function, *(inspect.unwrap(table[kind]) for kind in kinds & table.keys())]


def _text_of(value: Any) -> str:
    """A constant's value, as text; the type of what cannot be one."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text_of, value))})"
    return repr(value) if isinstance(value, CONSTANTS) else f"<{type(value).__name__}>"


@cache
def _source_of(module: str) -> bytes | None:
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_bytes() if file and Path(file).is_file() else None
