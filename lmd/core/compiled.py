"""Decorators of compiled code: kernels, which Python calls, and inner functions, which kernels call (docs/engine.md).

numba compiles a kernel at the first call for each combination of argument types; the result is cached on disk. With
`NUMBA_DISABLE_JIT=1` all functions are plain Python.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba import types

from lmd.core.compile_clock import CLOCK, StrictCompiler, TimedCompiler

# Versions of numba with which `lmd.core.inside_numba` is tested; with other versions kernels take longer to compile. If
# the environment variable `PLAIN` is set, every version counts as untested.
KNOWN = ("0.66", "0.67", "0.68")
PLAIN = "LMD_PLAIN_NUMBA"
PYTHON: bool = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined] # numba defines it from the environment


def _inside() -> Any:
    """Module `lmd.core.inside_numba`; None if numba's compiler is disabled, or if the installed numba does not fit."""
    if PYTHON:
        return None
    try:
        from lmd.core import inside_numba
    except (AttributeError, ImportError):
        CLOCK.cache_note = "they cannot be cached with this version of numba"
        return None
    return inside_numba


_numba = _inside()
LINKED = _numba is not None and numba.__version__.rpartition(".")[0] in KNOWN and not os.environ.get(PLAIN)

# Division by zero gives infinity or NaN, as in NumPy. No wrapper for calls from C: it would take a twelfth of the
# compilation time.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Options of inner functions. `forceinline` is always set, as a function without the option inherits it from its first
# caller.
_CALLED: Any = _OPTIONS | {"no_cpython_wrapper": True, "forceinline": False}
# No reference counts for arguments: the caller holds the arrays. Atomic counting would take a seventh of the time of
# a move, and more if two threads count one array.
_UNCOUNTED: Any = {"_nrt": False}
_KERNEL, _INNER, _ALLOCATING = (
    (_numba.KernelCompiler, _numba.InnerCompiler, _numba.AllocatingCompiler)
    if LINKED
    else (StrictCompiler, StrictCompiler, TimedCompiler)
)
_INLINED = {"forceinline": True}
# For `numba.extending.overload`: the chosen function counts references if its caller does.
OVERLOAD: Any = _CALLED | {"pipeline_class": _ALLOCATING}
OVERLOAD_INLINED: Any = OVERLOAD | _INLINED

F = TypeVar("F", bound=Callable[..., Any])

clock = CLOCK.read
"""Clock like `time.perf_counter`, seconds, that stops while kernels are compiled.

With this clock, time limits do not depend on the cache of kernels.
"""


def is_compiling() -> bool:
    """True while this process compiles; only a signal can stop a run during this time."""
    return CLOCK.active


def kernel(function: F) -> F:
    """Make a kernel, which is compiled at its first call, is cached on disk, and runs without the GIL.

    A kernel may return an array, but not a tuple with an array: such an array would be freed too early.
    """
    return _made_kernel(function, _OPTIONS)


def borrowing(function: F) -> F:
    """Make a kernel from a function that neither allocates nor returns arrays.

    For such a kernel, numba need not count references to the arguments.
    """
    return _made_kernel(function, _OPTIONS | _UNCOUNTED)


def _made_kernel(function: F, options: Any) -> F:
    if PYTHON:  # compiled code does not warn of a division by zero either
        quiet: F = np.errstate(all="ignore")(function)
        return quiet
    compiled: Any = numba.njit(pipeline_class=_KERNEL, **options)(function)
    if _numba is not None:
        try:
            compiled._cache = _numba.Cache(function)  # as njit(cache=True), with another cache class
        except RuntimeError:  # no folder is writable
            CLOCK.cache_note = "they cannot be cached, as no cache folder is writable; set NUMBA_CACHE_DIR to a folder"
    made: F = compiled
    return made


def inner(function: F) -> F:
    """Mark a function that kernels call; it is compiled as a part of each kernel. In Python it is a plain function.

    numba's own compiler has LLVM optimise a function alone, and again within each caller, at every level of nesting.
    For nested calls this takes most of the compilation time. Here LLVM optimises a function fully only within the
    kernel.

    The function must neither allocate nor return arrays, alone or in a tuple: without reference counts the arrays would
    be freed too early.
    """
    return _made_inner(function, _INNER, _UNCOUNTED)


def inlined(function: F) -> F:
    """Like `inner`, but LLVM copies the function into its callers regardless of its size.

    Then LLVM vectorises loops that call the function, and moves invariant terms out of the loops. A copied function
    also gets its arguments at no cost. An argument such as an objective's state is a named tuple of hundreds of
    numbers. To pass this tuple at each position of the camera would take longer than the function's work.
    """
    return _made_inner(function, _INNER, _UNCOUNTED | _INLINED)


def allocating(function: F) -> F:
    """Like `inner`, for a function that allocates arrays and may return these arrays."""
    return _made_inner(function, _ALLOCATING, {"_nrt": True})


def _made_inner(function: F, compiler: Any, options: Any) -> F:
    if not PYTHON:
        compiled: Any = numba.njit(pipeline_class=compiler, **(_CALLED | options))(function)
        # numba reads the type of a global function from the first attribute; the second keeps the dispatcher alive.
        function._numba_type_, function.compiled = types.Dispatcher(compiled), compiled  # type: ignore[attr-defined]
    return function


def for_kernels(array: Any) -> Any:
    """Writable copy of an array in C order; numba would compile further kernels for read-only arrays."""
    return np.array(array, order="C")


def load_compiler() -> None:
    """Initialise numba's compiler now, in a third of a second, instead of at the first kernel."""
    if not PYTHON:
        numba.core.registry.cpu_target.target_context.refresh()
