"""How kernels are compiled, and when what was compiled before may be used again."""

import hashlib
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from numba import njit, types
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.event import Event, Listener, register
from numba.core.registry import CPUDispatcher, cpu_target

# Packages and modules with code that is compiled, or constants of it.
SOURCES = (
    *("compiled", "dispatch", "geometry", "space/allowed", "space/triangles", "sight", "objectives"),
    *("optimisers/annealing", "plates", "tag", "planner/additions"),
)


# A division by zero gives infinity or NaN instead of an exception, as in NumPy. Nobody calls kernels from C: a wrapper
# for that would take a twelfth of the time of compiling.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Of a function that `inner` makes, and of one that LLVM inlines. Where nothing is said, numba takes what goes for the
# first that calls it.
INNER: Any = _OPTIONS | {"nopython": True, "no_cpython_wrapper": True, "forceinline": False}
INLINED: Any = INNER | {"forceinline": True}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function when it is first called, without the GIL, and keep the result on disk."""
    compiled: Any = njit(**_OPTIONS)(function)
    compiled._cache = _Cache(function)  # what njit(cache=True) does with its own class
    return compiled


def inner(function: Callable[..., Any]) -> Any:
    """A function that kernels, and other such functions, call: compiled within each kernel.

    With numba's own, LLVM optimises and translates whatever a function calls once for that function, once for each that
    calls it, and so on: most of the time of compiling, where functions are nested as deeply as here.
    """
    return _Inner(function, targetoptions=INNER, pipeline_class=InnerCompiler)


def inlined(function: Callable[..., Any]) -> Any:
    """The same, inlined by LLVM whatever its size.

    Only so do loops over it vectorise, and what stays the same moves out of them. For what is called at every position,
    handing over a field, a state and a scratch, hundreds of numbers, would take longer than the work.
    """
    return _Inner(function, targetoptions=INLINED, pipeline_class=InnerCompiler)


class _Inner(CPUDispatcher):
    """An inner function for kernels; Python, which tests call it from, gets it as a kernel of its own."""

    @cached_property
    def _kernel(self) -> Any:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        """What the function returns."""
        return self._kernel(*arguments)


class _InnerLibrary(JITCodeLibrary):
    """The code of an inner function for LLVM, which tidies it up by itself, to be linked into that of kernels."""

    def finalize(self) -> None:
        """Link what the function calls, and leave it at that."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None: there is no machine code."""
        return 0

    @property
    def codegen(self) -> "_InnerLibrary":
        """Who is told of the environment, see `set_env`."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Where machine code finds what it needs of Python: there is none."""


class InnerCompiler(Compiler):
    """How numba compiles inner functions."""

    def __init__(self, typingctx: Any, targetctx: Any, _: None, *others: Any) -> None:
        super().__init__(typingctx, targetctx, _InnerLibrary(targetctx.codegen(), "inner"), *others)


def load_compiler() -> None:
    """Load what numba else loads with the first kernel, be it compiled or kept: a third of a second."""
    cpu_target.target_context.refresh()


class _Compiling(Listener):
    """How long this process has waited for the compiler, in any of its threads; says so when it first does."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._compiling = 0  # kernels, of which most are parts of others
        self._began = self._spent = 0.0
        self._said = False

    def on_start(self, event: Event) -> None:
        """The compiler begins with a kernel that is not in the cache, or with a part of one."""
        if not self._said:
            self._said = True
            _say("compiling, which takes up to a minute; what is compiled is kept for the next time")
        with self._lock:
            if not self._compiling:
                self._began = time.perf_counter()
            self._compiling += 1

    def on_end(self, event: Event) -> None:
        """It is done with it."""
        with self._lock:
            self._compiling -= 1
            if not self._compiling:
                self._spent += time.perf_counter() - self._began

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
    here, digest = Path(__file__).parent, hashlib.sha256()
    for source in (here / name for name in names or ("",)):
        for path in sorted(source.rglob("*.py")) or [source.with_suffix(".py")]:
            digest.update(path.read_bytes())
    return digest.hexdigest()


class _Cache(FunctionCache):
    """numba's, but safe in three ways.

    - numba looks at a kernel's own file only, and would go on with old copies of what other files contributed.
    - The index on disk names the classes of the arguments. One that another process cannot import, such as a criterion
      in a folder of somebody's own, would make the whole index unreadable there: such kernels are not kept.
    - Of two processes that keep the same kernel for other arguments at the same time, one could get the other's code.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = (self._impl.locator.get_source_stamp(), sources(*SOURCES))
        self._cache_file = _Index(self._cache_path, self._impl.filename_base, stamp)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, if all its arguments are of classes of this package."""
        if not any(_is_foreign(kind) for kind in getattr(sig, "args", sig)):
            super().save_overload(sig, data)


class _Index(IndexDataCacheFile):
    """numba's, but written by one process at a time."""

    def save(self, key: Any, data: Any) -> None:
        """Keep a compiled kernel, in a folder that exists."""
        from filelock import FileLock

        with FileLock(f"{self._index_path}.lock"):
            super().save(key, data)


def _is_foreign(kind: Any) -> bool:
    """Whether a numba type is, or contains, a named tuple defined elsewhere."""
    named: Any = getattr(kind, "instance_class", None)  # of named tuples
    if named is not None and named.__module__.partition(".")[0] != "lmd":
        return True
    parts: Any = kind if isinstance(kind, types.BaseTuple) else ()
    return any(_is_foreign(part) for part in parts)
