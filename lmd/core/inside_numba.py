"""The parts of numba's inside that kernels rely on: libraries, compilers and a cache (docs/engine.md).

They are subclasses for `lmd`'s own functions alone. Nothing of numba or llvmlite is changed.
"""

import glob
import hashlib
import pickle
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from llvmlite.binding import Linkage
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags

from lmd.core.compile_clock import StrictCompiler, name_of
from lmd.core.sources import classes_in, digest_of

UNREADABLE = AttributeError, EOFError, ImportError, pickle.UnpicklingError  # the disk was full, or a class is gone
PATIENCE_SECONDS = 60.0  # to wait for another process that compiles the same kernel: longer than any takes
LOCKS: dict[Any, dict[str, FileLock]] = {}  # of the kernels that this process compiles, by function and signature
FLAGS_HASH = hash(Flags())  # of the names of all options, so the same for all flags
PYTHON_WRAPPER = "_ZN7cpython"  # how numba's names of the functions begin through which Python calls compiled code


class _Library(JITCodeLibrary):
    """The code of a function."""

    def _optimize_functions(self, module: Any) -> None:
        """As numba's, at level 1: the whole kernel is optimised again. Level 0 takes longer, as more is linked."""
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            passes, builder = self._codegen._function_pass_manager(opt=1)
            passes.run(function, builder)

    def _linked_into(self, module: Any) -> Any:
        """A module, linked with each library that this calls, after all that call it: LLVM drops what none calls."""
        for library in reversed(_called_by(self, {})):
            self._reload_init.update(library._reload_init)
            inner = isinstance(library, _InnerLibrary)
            module.link_in(library._final_module if inner else library._get_module_for_linking(), preserve=True)
        return module


class _KernelLibrary(_Library):
    """The code of a kernel. Its wrapper for Python is not optimised: it has no loops, and hundreds of arguments."""

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if function.name.startswith(PYTHON_WRAPPER) and not function.is_declaration:
                function.add_function_attribute("noinline")
                function.add_function_attribute("optnone")
        self._linked_into(self._final_module)
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = "internal"  # LLVM inlines what is called once, and drops arguments that are not used
        self._linking_libraries.clear()
        super().finalize()


class _InnerLibrary(_Library):
    """The code of an inner function, for LLVM: machine code is made of the kernels that are linked with it."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"  # dropped where nothing calls it any more
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        return self._linked_into(self._final_module.clone())  # for a numba function of somebody's own

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    codegen = property(lambda self: self)  # numba calls its `set_env`

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing: what machine code would need of Python."""


def _called_by(library: Any, found: dict[Any, None]) -> list[Any]:
    """The libraries that one calls, directly or through inner functions, each after all that it calls."""
    for called in library._linking_libraries:
        if called not in found:
            if isinstance(called, _InnerLibrary):
                _called_by(called, found)
            found[called] = None
    return list(found)


class _Flags(Flags):
    """numba's, compared by the options that are set, as this is asked for each item that is read of an array."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Flags):
            return False
        names = self._values.keys() | other._values.keys()
        return self._values == other._values or all(getattr(self, name) == getattr(other, name) for name in names)

    def __hash__(self) -> int:
        return FLAGS_HASH


class KernelCompiler(StrictCompiler):
    """Compiles kernels; inner functions are linked with them once."""

    library: type[_Library] = _KernelLibrary

    def __init__(self, typing: Any, target: Any, _: None, *others: Any) -> None:
        library = self.library(target.codegen(), "lmd")
        library.enable_object_caching()
        super().__init__(typing, target, library, *others)
        self.state.flags = _Flags(self.state.flags)

    def compile_extra(self, func: Any) -> Any:
        """See `TimedCompiler`; what cannot be compiled holds up no other process."""
        try:
            return super().compile_extra(func)
        except BaseException:
            locks = LOCKS.get(func, {})
            while locks:
                locks.popitem()[1].release()
            raise


class InnerCompiler(KernelCompiler):
    """Compiles inner functions, unless they use objects of Python, as `print` does: these are not linked."""

    library = _InnerLibrary

    def compile_extra(self, func: Any) -> Any:
        """See `TimedCompiler`.

        Raises:
            TypeError: it uses objects of Python.
        """
        result = super().compile_extra(func)
        if any("missing Environment" in str(each) for each in result.library._final_module.global_variables):
            raise TypeError(f"{name_of(func)} prints, or uses objects of Python, which a kernel alone may do.")
        return result


class AllocatingCompiler(InnerCompiler):
    """Compiles inner functions that count their arrays, or that count them if what calls them does."""

    returns_arrays = True


class Cache(FunctionCache):
    """Keeps kernels on disk, each while the code that it is made of has the same digest.

    An index holds what was compiled for classes of the same modules: to read another would import modules. Of several
    processes that need the same kernel one compiles it for all.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._locks = LOCKS.setdefault(function, {})

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel that was kept; where another process is about to compile it, once that has."""
        classes = classes_in(getattr(sig, "args", sig))
        names = sorted({kind.__module__ for kind in classes})
        base = f"{self._impl.filename_base}-{hashlib.sha256(repr(names).encode()).hexdigest()[:8]}"
        digest = digest_of(self._py_func, classes)
        self._enabled = digest is not None
        if digest is None:
            return None
        self._cache_file = _Index(self._cache_path, base, digest)
        found = super().load_overload(sig, target_context)
        if found is None and str(sig) not in self._locks:
            name = hashlib.sha256(str(sig).encode()).hexdigest()[:16]
            lock = FileLock(f"{self._cache_file._index_path}.{name}.lock")
            try:
                self._impl.locator.ensure_cache_path()
                lock.acquire(timeout=PATIENCE_SECONDS)
            except (OSError, Timeout):
                return None
            found = super().load_overload(sig, target_context)
            if found is None:
                self._locks[str(sig)] = lock
            else:
                lock.release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel."""
        try:
            super().save_overload(sig, data)
        finally:
            if lock := self._locks.pop(str(sig), None):
                lock.release()


class _Index(IndexDataCacheFile):
    """Written by one process at a time; files that cannot be read are as if they were not there.

    Files of kernels have the digest in their name: one that was written before is never taken for another.
    """

    def __init__(self, folder: str, base: str, digest: str) -> None:
        super().__init__(folder, base, digest)
        self._data_name_pattern = f"{base}.{digest[:16]}.{{number:d}}.nbc"

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except UNREADABLE:
            return {}

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name)
        except UNREADABLE as error:
            raise OSError(f"{name} cannot be read") from error  # for numba, it is not there

    def save(self, key: Any, data: Any) -> None:
        with FileLock(f"{self._index_path}.lock"):
            if not self._load_index():  # what there is was made of other code
                for old in Path(self._cache_path).glob(f"{glob.escape(self._index_name.removesuffix('nbi'))}*.nbc"):
                    old.unlink(missing_ok=True)
            super().save(key, data)
