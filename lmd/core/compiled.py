"""How kernels are compiled, and when what was compiled before may be used again."""

import gc
import hashlib
import os
import sys
import threading
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.event import Event, Listener, register

from lmd.core.checks import InputError

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined] # it is made of the environment
    raise InputError("NUMBA_DISABLE_JIT is set, but lmd's kernels are for the compiler: unset it.", "NUMBA_DISABLE_JIT")

# Packages and modules with code that is compiled, or constants of it.
SOURCES = (
    *("core/bits", "core/compiled", "core/dispatch", "core/inside_numba", "core/layers", "geometry"),
    *("space/allowed", "space/triangles", "scene/criteria", "scene/pushing", "sight", "incremental", "objectives"),
    *("optimisers/annealing", "planner/additions"),
)

# A division by zero gives infinity or NaN instead of an exception, as in NumPy. Nobody calls kernels from C: a wrapper
# for that would take a twelfth of the time of compiling.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Of what is called by kernels alone. Without `forceinline` numba takes what goes for the first that calls it.
_CALLED: Any = _OPTIONS | {"nopython": True, "no_cpython_wrapper": True, "forceinline": False}
# Arrays that are handed on need not be counted: the kernel holds them. Counting, by instructions that lock the memory,
# would take a seventh of a move, and more where two threads count the same array.
_INNER: Any = _CALLED | {"_nrt": False}
_INLINED: Any = _INNER | {"forceinline": True}

# Versions whose inside `lmd.core.inside_numba` knows. With others, everything works, compiles for longer, and nothing
# that was compiled is kept. With this variable in the environment, any version is treated so.
KNOWN = ("0.68",)
PLAIN = "LMD_PLAIN_NUMBA"


def _known_inside() -> Any:
    """`lmd.core.inside_numba`, None where numba's inside is not known."""
    if os.environ.get(PLAIN) or ".".join(numba.__version__.split(".")[:2]) not in KNOWN:
        return None
    from lmd.core import inside_numba

    return inside_numba


_inside = _known_inside()
# For `numba.extending.overload`: options of what LLVM inlines, and of what is long.
# What they resolve to counts arrays if what calls it does.
OVERLOAD: Any = _CALLED | ({} if _inside is None else _inside.OVERLOAD)
OVERLOAD_INLINED: Any = OVERLOAD | {"forceinline": True}


# When Python looks for garbage while it compiles: most of what that makes stays, and looking as often as it does by
# default would take a twelfth of the time.
_SELDOM = (20_000, 50, 1_000)


class _Compiling(Listener):
    """How long this process has waited for the compiler, in any of its threads; says what it waits for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._compiling = 0  # kernels, of which most are parts of others
        self._began = self._spent = 0.0
        self._kernels = 0  # whose compiling has begun
        self._thresholds = gc.get_threshold()
        self.homeless = False  # whether no folder can be written to in which kernels could be kept

    def on_start(self, event: Event) -> None:
        """The compiler begins with a kernel that is not in the cache, or with a part of one."""
        with self._lock:
            if not self._compiling:
                self._began = time.perf_counter()
                self._thresholds = gc.get_threshold()
                gc.set_threshold(*map(max, self._thresholds, _SELDOM))
                self._tell(event.data["dispatcher"].py_func)
            self._compiling += 1

    def _tell(self, function: Any) -> None:
        """Say which kernel comes, and how far this process is."""
        if not self._kernels:
            nowhere = "cannot be kept, as no folder can be written to; NUMBA_CACHE_DIR=DIR names one"
            kept = "" if _inside is None else f"; it {nowhere if self.homeless else 'is kept for the next time'}"
            _say(f"compiling what this needs{kept}")
        self._kernels += 1
        name = f"{function.__module__.removeprefix('lmd.')}.{function.__name__}"
        _say(f"compiling kernel {self._kernels}, {self._spent:.0f} s so far: {name}")

    def on_end(self, event: Event) -> None:
        """Note that numba has ended a compilation."""
        with self._lock:
            self._compiling -= 1
            if not self._compiling:
                self._spent += time.perf_counter() - self._began
                gc.set_threshold(*self._thresholds)

    @property
    def active(self) -> bool:
        """Whether it is at work."""
        return self._compiling > 0

    def clock(self) -> float:
        """The time without what was spent, seconds."""
        with self._lock:
            return (self._began if self._compiling else time.perf_counter()) - self._spent


def _say(text: str) -> None:
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)  # above a progress bar


_compiling = _Compiling()
register("numba:compile", _compiling)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function when it is first called, without the GIL, and keep the result on disk."""
    return _made_kernel(function, _OPTIONS)


def borrowing(function: Callable[..., Any]) -> Any:
    """The same for what makes no arrays and returns none: it need not count those that it takes."""
    return _made_kernel(function, _OPTIONS if _inside is None else _OPTIONS | {"_nrt": False})


def _made_kernel(function: Callable[..., Any], options: Any) -> Any:
    compiled: Any = numba.njit(**options)(function)
    if _inside is not None and not _inside.keep(compiled, sources(*SOURCES)):
        _compiling.homeless = True
    return compiled


def inner(function: Callable[..., Any]) -> Any:
    """A function that kernels, and other such functions, call: compiled within each kernel.

    With numba's own, LLVM optimises and translates whatever a function calls once for that function, once for each that
    calls it, and so on: most of the time of compiling, where functions are nested as deeply as here.

    It must not make arrays, nor return any to a kernel, not even in a tuple: what it returns is not counted.
    """
    return _made_inner(function, _INNER)


def allocating(function: Callable[..., Any]) -> Any:
    """As `inner`, for a function that makes arrays, which `inner` refuses."""
    return _made_inner(function, _CALLED | {"_nrt": True})


def _made_inner(function: Callable[..., Any], options: Any) -> Any:
    return numba.njit(**_OPTIONS)(function) if _inside is None else _inside.Inner(function, options, kernel)


def inlined(function: Callable[..., Any]) -> Any:
    """As `inner`, inlined by LLVM whatever its size.

    Only so do loops over it vectorise, and what stays the same moves out of them. For what is called at every position,
    handing over a field, a state and a scratch, hundreds of numbers, would take longer than the work. Nor does it make
    arrays or return them.
    """
    return _made_inlined(function, _INLINED)


def arithmetic(function: Callable[..., Any]) -> Any:
    """As `inner`, for formulas on numbers that Python calls with arrays, too."""
    return _made_inlined(function, _INLINED | {"_nrt": True})


def _made_inlined(function: Callable[..., Any], options: Any) -> Any:
    if _inside is None:
        return numba.njit(**_OPTIONS, forceinline=True)(function)
    return _inside.Inner(function, options, kernel)


def for_kernels(array: Any) -> Any:
    """A copy in C order that may be written: numba would compile a kernel anew for one that may only be read."""
    return np.array(array, order="C")


def load_compiler() -> None:
    """Load what numba else loads with the first kernel, be it compiled or kept: a third of a second."""
    if _inside is not None:
        _inside.load_compiler()


def clock() -> float:
    """A clock like `time.perf_counter`, seconds, that stands still while kernels are compiled.

    What a run takes would else depend on whether it is the first one of an installation.
    """
    return _compiling.clock()


def is_compiling() -> bool:
    """Whether this process waits for the compiler, which nothing but a signal can interrupt."""
    return _compiling.active


@cache
def sources(*names: str) -> str:
    """A digest of the code in packages and modules of `lmd` with these names, as in `SOURCES`; of all for none."""
    here, digest = Path(__file__).parents[1], hashlib.sha256()
    for source in (here / name for name in names or ("",)):
        for path in sorted(source.rglob("*.py")) or [source.with_suffix(".py")]:
            digest.update(path.read_bytes())
    return digest.hexdigest()
