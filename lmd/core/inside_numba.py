"""What reaches into numba's inside to save time: how functions are linked, and how kernels are kept on disk.

Only `lmd.core.compiled` uses this, and only with versions of numba for which it was tried; it works without.
"""

import hashlib
import pickle
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

from filelock import FileLock, Timeout
from llvmlite.binding import Linkage
from llvmlite.binding.ffi import lib
from numba import types
from numba.core import errors
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.callwrapper import PyCallWrapper
from numba.core.codegen import CPUCodegen, CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.targetconfig import TargetConfig

PATIENCE_SECONDS = 60.0  # to wait for another process that compiles the same kernel: longer than any takes


class Inner(CPUDispatcher):
    """An inner function for kernels; Python, which tests call it from, gets it as a kernel of its own.

    Args:
        function: what it does.
        options: of numba.
        kernel: makes a kernel.
    """

    def __init__(self, function: Callable[..., Any], options: Any, kernel: Callable[..., Any]) -> None:
        super().__init__(function, targetoptions=options, pipeline_class=_InnerCompiler)
        self._make = kernel

    @cached_property
    def _kernel(self) -> Any:
        return self._make(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        """What the function returns."""
        return self._kernel(*arguments)


class _InnerLibrary(JITCodeLibrary):
    """The code of an inner function for LLVM, which tidies it up by itself.

    Kernels are linked with it, and with what it calls: if that were linked into it, there would be a copy of each
    function for every one that calls it, and so on.
    """

    def finalize(self) -> None:
        """Note what kernels are linked with."""
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"  # dropped where nobody calls it any more
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        return self._final_module

    def get_pointer_to_function(self, name: str) -> int:
        """None: there is no machine code."""
        return 0

    @property
    def codegen(self) -> "_InnerLibrary":
        """The object whose `set_env` numba calls: this one."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Where machine code finds what it needs of Python: there is none."""


_add_library = CPUCodeLibrary.add_linking_library


def _add_with_what_it_calls(self: CPUCodeLibrary, library: CPUCodeLibrary) -> None:
    """As numba's; what an inner function calls comes with it, after all that call it: LLVM leaves out the rest."""
    _add_library(self, library)
    called = library._linking_libraries if isinstance(library, _InnerLibrary) else []
    self._linking_libraries = list(dict.fromkeys([*self._linking_libraries, *called][::-1]))[::-1]


CPUCodeLibrary.add_linking_library = _add_with_what_it_calls  # type: ignore[method-assign]


class _InnerCompiler(Compiler):
    """How numba compiles inner functions."""

    def __init__(self, typingctx: Any, targetctx: Any, _: None, *others: Any) -> None:
        super().__init__(typingctx, targetctx, _InnerLibrary(targetctx.codegen(), "inner"), *others)


OVERLOAD = {"pipeline_class": _InnerCompiler}  # for `numba.extending.overload`


def _are_equal(one: Any, other: Any) -> Any:
    """As numba's, which reads each of forty options of both: those that neither sets are as by default."""
    return type(one) is type(other) and (
        one._values == other._values
        or all(getattr(one, name) == getattr(other, name) for name in one._values.keys() | other._values.keys())
    )


@cache
def _hash_of(kind: type[TargetConfig]) -> int:
    """As numba's, which sorts the names of the options for every look-up."""
    return hash(tuple(sorted(kind.options)))


# numba asks for both whenever it looks up a function for the types of its arguments: a fourteenth of compiling.
TargetConfig.__eq__ = _are_equal  # type: ignore[method-assign]
TargetConfig.__hash__ = lambda self: _hash_of(type(self))  # type: ignore[method-assign]

# Every function that does not fit the types of its arguments, until one does, is an error whose message would be set
# in bold where colorama is installed, which looks at the terminal each time; every call of LLVM would tell two events
# that nobody listens to. Both are another twentieth.
if scheme := getattr(errors, "HighlightColorScheme", None):
    scheme._markup = lambda _, message, *__, **___: message
lib._lock._cblist.clear()

_function_passes = CPUCodegen._function_pass_manager


def _cheap_function_passes(self: CPUCodegen, **options: Any) -> Any:
    """As numba's, at level 1: what is linked into a kernel is optimised with it again. At level 0 that takes longer."""
    return _function_passes(self, opt=1, **options)


CPUCodegen._function_pass_manager = _cheap_function_passes  # type: ignore[method-assign] # a tenth of compiling

_called_from_python = PyCallWrapper.build


def _left_as_written(self: PyCallWrapper) -> Any:
    """As numba's, but not optimised: hundreds of arrays are taken out of Python's objects once for many moves."""
    wrapper, api = _called_from_python(self)
    for attribute in ("noinline", "optnone"):
        wrapper.attributes.add(attribute)
    return wrapper, api


PyCallWrapper.build = _left_as_written  # type: ignore[method-assign] # an eighth of compiling what calls the others


def load_compiler() -> None:
    """Load what numba else loads with the first kernel, be it compiled or kept: a third of a second."""
    cpu_target.target_context.refresh()


def keep(compiled: Any, digest: str) -> bool:
    """Keep what a kernel compiles on disk, as long as the code has the same digest; False if there is no place."""
    try:
        compiled._cache = _Cache(compiled.py_func, digest)  # what njit(cache=True) does with its own class
    except RuntimeError:  # numba has looked for a folder that it can write to
        return False
    return True


class _Cache(FunctionCache):
    """numba's, but safe in three ways, and of processes that need the same kernel one compiles it for all.

    - numba looks at a kernel's own file only, and would go on with old copies of what other files contributed.
    - The index on disk names the classes of the arguments. One that another process cannot import, such as a criterion
      in a folder of somebody's own, would make the whole index unreadable there: such kernels are not kept.
    - Of two processes that keep the same kernel for other arguments at the same time, one could get the other's code.
    """

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        super().__init__(function)
        stamp = (self._impl.locator.get_source_stamp(), digest)
        self._cache_file = _Index(self._cache_path, self._impl.filename_base, stamp)
        self._locks: dict[str, FileLock] = {}  # of what this process compiles, or could not

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept; where another process is about to compile it, once that has."""
        found = super().load_overload(sig, target_context)
        if found is not None or _has_foreign(sig) or str(sig) in self._locks:
            return found
        name = hashlib.sha256(str(sig).encode()).hexdigest()[:16]
        lock = FileLock(f"{self._cache_file._index_path}.{name}.lock")
        try:
            self._impl.locator.ensure_cache_path()
            lock.acquire(timeout=PATIENCE_SECONDS)
        except (OSError, Timeout):
            return None
        found = super().load_overload(sig, target_context)
        if found is not None:
            lock.release()
        else:
            self._locks[str(sig)] = lock
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, if all its arguments are of classes of this package."""
        try:
            if not _has_foreign(sig):
                super().save_overload(sig, data)
        finally:
            if (lock := self._locks.pop(str(sig), None)) is not None:
                lock.release()


class _Index(IndexDataCacheFile):
    """numba's, but written by one process at a time, and empty where it cannot be read."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError):  # it names classes that lay elsewhere in an earlier version
            return {}
        except (EOFError, pickle.UnpicklingError):  # the disk was full, or went
            return {}

    def save(self, key: Any, data: Any) -> None:
        """Keep a compiled kernel, in a folder that exists."""
        with FileLock(f"{self._index_path}.lock"):
            super().save(key, data)


def _has_foreign(sig: Any) -> bool:
    """Whether a signature has a class of somebody's own."""
    return any(_is_foreign(kind) for kind in getattr(sig, "args", sig))


def _is_foreign(kind: Any) -> bool:
    """Whether a numba type is, or contains, a named tuple defined elsewhere."""
    named: Any = getattr(kind, "instance_class", None)  # of named tuples
    if named is not None and named.__module__.partition(".")[0] != "lmd":
        return True
    parts: Any = kind if isinstance(kind, types.BaseTuple) else ()
    return any(_is_foreign(part) for part in parts)
