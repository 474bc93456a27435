"""Digests of source code, for caches that expire when the code changes."""

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

# Top-level packages that are not part of a digest; numba's cache checks the version of numba itself.
NOT_COUNTED = (sys.stdlib_module_names - {"__main__"}) | {"llvmlite", "numba", "numpy"}
ENGINE = ("lmd.core.compiled", "lmd.core.dispatch", "lmd.core.inside_numba")  # modules that decide how code is compiled
CONSTANTS = (bool, int, float, complex, str, bytes, type(None), Enum, np.generic)


@cache
def package_digest() -> str:
    """Digest of all Python files of `lmd`."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(kernel: FunctionType, classes: Iterable[type]) -> str | None:
    """Digest of the code from which a kernel is compiled; None if a part of this code is not in a module's file.

    The digest covers

    - the kernel and all functions that it calls, directly or indirectly, as loaded.
    - the files that define these functions and the classes of the arguments.
    - the values of the constants that the functions use.

    Functions, classes and constants are found by their names in the code. If a called function is `dispatched`, only
    the functions registered for the classes of the arguments count.

    Args:
        kernel: the plain Python function.
        classes: classes of its arguments, see `classes_in`.
    """
    kinds, known = set(classes), -1
    while known != len(kinds):  # functions may use further classes, for which further functions are registered
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
    """Classes of all named tuples in a sequence of numba types, including named tuples inside other tuples."""
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
    """Yield name and value of each global or nonlocal variable in the code of a function, and of its default arguments.

    A default argument is named `default`. After a tuple, its entries are yielded under the name of the tuple. In place
    of a decorated function, the original function is yielded.
    """
    names = set(_names_in(function.__code__))
    spaces = [function.__globals__, inspect.getclosurevars(function).nonlocals]
    values = [("default", value) for value in function.__defaults__ or ()]
    for space in spaces:  # the loop appends modules that are named in the code
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
    """Bytecode, names and constants of a function and of its nested functions, as text."""
    constants = [_text_of_code(each) if isinstance(each, CodeType) else _text_of(each) for each in code.co_consts]
    return f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"


def _resolved(function: FunctionType, kinds: set[type]) -> list[FunctionType]:
    """List of the function itself and, if it is `dispatched`, of the functions registered for the classes `kinds`."""
    table = getattr(function, "registered", {})
    return [function, *(inspect.unwrap(table[kind]) for kind in kinds & table.keys())]


def _text_of(value: Any) -> str:
    """Value of a constant as text; for an object that is not a constant, the name of its type."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, tuple | frozenset):
        return f"({', '.join(sorted(map(_text_of, value)) if isinstance(value, frozenset) else map(_text_of, value))})"
    return repr(value) if isinstance(value, CONSTANTS) else f"<{type(value).__name__}>"


@cache
def _source_of(module: str) -> bytes | None:
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_bytes() if file and Path(file).is_file() else None
