"""Decorators of compiled code: kernels, which Python calls, and inner functions, which kernels call (docs/engine.md).

numba compiles a kernel when it is first called with arguments of some classes, and it is kept on disk. With
`NUMBA_DISABLE_JIT=1` all of them are plain Python.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba import types

from lmd.core.compile_clock import CLOCK, StrictCompiler, TimedCompiler

# Versions with which `lmd.core.inside_numba` was tried. With others kernels take longer to compile. With this variable
# in the environment, any version is treated so.
KNOWN = ("0.66", "0.67", "0.68")
PLAIN = "LMD_PLAIN_NUMBA"
PYTHON: bool = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined] # it is made of the environment


def _inside() -> Any:
    """`lmd.core.inside_numba`; None without the compiler, or where an unknown version has another inside."""
    if PYTHON:
        return None
    try:
        from lmd.core import inside_numba
    except (AttributeError, ImportError):
        CLOCK.kept = "it cannot be kept with this version of numba"
        return None
    return inside_numba


_numba = _inside()
LINKED = _numba is not None and numba.__version__.rpartition(".")[0] in KNOWN and not os.environ.get(PLAIN)

# A division by zero gives infinity or NaN instead of an exception, as in NumPy. Kernels are
# not called from C: a wrapper for that would take a twelfth of the time of compiling.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Options of inner functions. `forceinline` is set in any case: unset, a function inherits it from its first caller.
_CALLED: Any = _OPTIONS | {"no_cpython_wrapper": True, "forceinline": False}
# Arrays that are handed on need not be counted: the kernel holds them. Counting, by instructions that lock the memory,
# would take a seventh of a move, and more where two threads count the same array.
_UNCOUNTED: Any = {"_nrt": False}
_KERNEL, _INNER, _ALLOCATING = (
    (_numba.KernelCompiler, _numba.InnerCompiler, _numba.AllocatingCompiler)
    if LINKED
    else (StrictCompiler, StrictCompiler, TimedCompiler)
)
_INLINED = {"forceinline": True}
# For `numba.extending.overload`: what these resolve to counts arrays if what calls it does.
OVERLOAD: Any = _CALLED | {"pipeline_class": _ALLOCATING}
OVERLOAD_INLINED: Any = OVERLOAD | _INLINED

F = TypeVar("F", bound=Callable[..., Any])

clock = CLOCK.read
"""A clock like `time.perf_counter`, seconds, that stands still while kernels are compiled.

A run would else take longer if it is the first one of an installation.
"""


def is_compiling() -> bool:
    """True while this process waits for the compiler, which only a signal can interrupt."""
    return CLOCK.active


def kernel(function: F) -> F:
    """Compile a function when it is first called, without the GIL, and keep the result on disk.

    A kernel may return an array, but none in a tuple: see `inner`.
    """
    return _made_kernel(function, _OPTIONS)


def borrowing(function: F) -> F:
    """A kernel that makes no arrays and returns none: it need not count those that it takes."""
    return _made_kernel(function, _OPTIONS | _UNCOUNTED)


def _made_kernel(function: F, options: Any) -> F:
    if PYTHON:  # compiled code does not warn of a division by zero, either
        quiet: F = np.errstate(all="ignore")(function)
        return quiet
    compiled: Any = numba.njit(pipeline_class=_KERNEL, **options)(function)
    if _numba is not None:
        try:
            compiled._cache = _numba.Cache(function)  # as njit(cache=True) does with numba's own class
        except RuntimeError:  # numba has looked for a folder that it can write to
            CLOCK.kept = "it cannot be kept, as no folder can be written to; NUMBA_CACHE_DIR=DIR names one"
    made: F = compiled
    return made


def inner(function: F) -> F:
    """A function that kernels call, compiled within each of them. Python calls it as plain Python.

    With numba's own compiler, LLVM optimises and translates a function once for itself, once for each that calls it,
    and so on: most of the time of compiling, where functions are nested as deeply as here.

    It must make no arrays. It returns none, alone or in a tuple: they would not be counted, and be freed too early.
    """
    return _made_inner(function, _INNER, _UNCOUNTED)


def inlined(function: F) -> F:
    """As `inner`, inlined by LLVM at any size.

    Only so do loops over it vectorise, and what stays the same moves out of them. For what is called at every position,
    handing over a field, a state and a scratch, hundreds of numbers, would take longer than the work.
    """
    return _made_inner(function, _INNER, _UNCOUNTED | _INLINED)


def allocating(function: F) -> F:
    """As `inner`, for a function that makes arrays, which it may return."""
    return _made_inner(function, _ALLOCATING, {"_nrt": True})


def _made_inner(function: F, compiler: Any, options: Any) -> F:
    if not PYTHON:
        compiled: Any = numba.njit(pipeline_class=compiler, **(_CALLED | options))(function)
        # numba types a function that compiled code names by the first attribute; the second keeps the dispatcher alive.
        function._numba_type_, function.compiled = types.Dispatcher(compiled), compiled  # type: ignore[attr-defined]
    return function


def for_kernels(array: Any) -> Any:
    """A copy in C order that may be written: numba would compile a kernel anew for one that may only be read."""
    return np.array(array, order="C")


def load_compiler() -> None:
    """Load what numba else loads with the first kernel, be it compiled or kept: a third of a second."""
    if not PYTHON:
        numba.core.registry.cpu_target.target_context.refresh()
