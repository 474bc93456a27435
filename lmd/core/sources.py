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
ENGINE = ("lmd.core.compiled", "lmd.core.dispatch", "lmd.core.inside_numba")  # how code is compiled
CONSTANTS = (bool, int, float, complex, str, bytes, type(None), Enum, np.generic)


@cache
def package_digest() -> str:
    """A digest of all code of `lmd`."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(kernel: FunctionType, classes: Iterable[type]) -> str | None:
    """A digest of the code that a kernel is compiled from; None if some of it is in no module's file.

    It covers the kernel, the functions that it calls, directly or not, as they were loaded, the files that define them
    and the classes of its arguments, and the values of the constants that the functions use. All are found by the names
    in the code of the functions. Of a function that is `dispatched` those count that these classes registered.

    Args:
        kernel: the plain function.
        classes: of its arguments, see `classes_in`.
    """
    kinds, known = set(classes), -1
    while known != len(kinds):  # functions name further classes, for which others may be registered
        known = len(kinds)
        texts, functions, waiting = set[str](), set[FunctionType](), [kernel]
        while waiting:
            function = waiting.pop()
            if function in functions:
                continue
            functions.add(function)
            texts.add(f"{function.__module__}.{function.__qualname__}: {_text_of_code(function.__code__)}")
            for name, value in _used_by(function):
                if isinstance(value, type):
                    kinds |= {value} if _counts(value.__module__) else set()
                elif isinstance(value, FunctionType):
                    waiting += _resolved(value, kinds)
                else:
                    texts.add(f"{function.__module__}.{name} = {_text_of(value)}")
    digest = hashlib.sha256(repr(sorted(texts)).encode())
    for module in sorted({*ENGINE, *(each.__module__ for each in (*functions, *kinds))}):
        if _counts(module):
            source = None if module == "__main__" else _source_of(module)
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


def _counts(module: str) -> bool:
    return module.partition(".")[0] not in NOT_COUNTED


def _used_by(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """The names in the code of a function, and the values that they have there; functions as Python wrote them."""
    names = set(_names_in(function.__code__))
    spaces = [function.__globals__, inspect.getclosurevars(function).nonlocals]
    values = [("default", value) for value in function.__defaults__ or ()]
    for space in spaces:  # it grows by the modules that are named
        for name in names & space.keys():
            value = space[name]
            if not isinstance(value, ModuleType):
                values.append((name, value))
            elif _counts(value.__name__) and not any(vars(value) is other for other in spaces):
                spaces.append(vars(value))
    for name, value in values:
        for part in (value, *value) if type(value) is tuple else (value,):
            yield name, part if isinstance(part, type) else inspect.unwrap(part)


def _names_in(code: CodeType) -> Iterator[str]:
    yield from (*code.co_names, *code.co_freevars)
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _names_in(part)


def _text_of_code(code: CodeType) -> str:
    """The instructions of a function, and what they name; of nested functions too."""
    constants = [_text_of_code(each) if isinstance(each, CodeType) else _text_of(each) for each in code.co_consts]
    return f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"


def _resolved(function: FunctionType, kinds: set[type]) -> list[FunctionType]:
    """The function; one that is `dispatched`, with those that are registered for some of the classes."""
    table = getattr(function, "registered", {})
    return [function, *(inspect.unwrap(table[kind]) for kind in kinds & table.keys())]


def _text_of(value: Any) -> str:
    """A constant's value, as text; the type of what cannot be one."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, tuple | frozenset):
        return f"({', '.join(sorted(map(_text_of, value)) if isinstance(value, frozenset) else map(_text_of, value))})"
    return repr(value) if isinstance(value, CONSTANTS) else f"<{type(value).__name__}>"


@cache
def _source_of(module: str) -> bytes | None:
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_bytes() if file and Path(file).is_file() else None
