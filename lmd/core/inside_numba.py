"""Subclasses of numba's internal classes: code libraries, compilers and a cache of kernels (docs/engine.md).

A code library is numba's object for the LLVM code of one compiled function. Only `lmd`'s functions use these
subclasses; numba and llvmlite are not patched.
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

# Errors of truncated cache files, or of removed classes.
UNREADABLE = AttributeError, EOFError, ImportError, pickle.UnpicklingError
PATIENCE_SECONDS = 60.0  # greatest wait for another process that compiles the kernel; then this process does
LOCKS: dict[Any, dict[str, FileLock]] = {}  # locks of the kernels that this process compiles, by function and signature
FLAGS_HASH = hash(Flags())  # equal hash for all flags, so that only equality is tested
PYTHON_WRAPPER = "_ZN7cpython"  # prefix of the names of numba's wrappers that Python calls


class _Library(JITCodeLibrary):
    """Code library, numba's object for the LLVM code of one compiled function; base of the two classes below."""

    def _optimize_functions(self, module: Any) -> None:
        """Optimise each function at level 1 only, because the whole kernel is optimised again after linking. At level
        0, linking would take longer.
        """
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            passes, builder = self._codegen._function_pass_manager(opt=1)
            passes.run(function, builder)

    def _linked_into(self, module: Any) -> Any:
        """Add to an LLVM `module` the code of all functions that this function calls, directly or indirectly.

        A function is added before the functions that it calls, so that LLVM drops functions without a caller. Returns
        `module`.
        """
        for library in reversed(_called_by(self, {})):
            self._reload_init.update(library._reload_init)
            inner = isinstance(library, _InnerLibrary)
            module.link_in(library._final_module if inner else library._get_module_for_linking(), preserve=True)
        return module


class _KernelLibrary(_Library):
    """LLVM code of a kernel, with the code of the functions that it calls.

    numba's wrapper, through which Python calls the kernel, is not optimised: it has hundreds of arguments and no loops.
    """

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if function.name.startswith(PYTHON_WRAPPER) and not function.is_declaration:
                function.add_function_attribute("noinline")
                function.add_function_attribute("optnone")
        self._linked_into(self._final_module)
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = "internal"  # lets LLVM inline functions with one caller, and drop unused arguments
        self._linking_libraries.clear()
        super().finalize()


class _InnerLibrary(_Library):
    """LLVM code of an inner function; it becomes machine code only as a part of the kernels that call it."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"  # dropped once all calls are inlined
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        return self._linked_into(self._final_module.clone())  # for a numba function outside of `lmd`

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    codegen = property(lambda self: self)  # numba calls `codegen().set_env`

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: an environment is for machine code, and an inner function has no machine code of its own."""


def _called_by(library: Any, found: dict[Any, None]) -> list[Any]:
    """List the functions that a compiled function calls, directly or through inner functions.

    Each function is represented by its `_Library`, numba's object for its LLVM code.

    Args:
        library: the calling function.
        found: collects the called functions as its keys; pass an empty dictionary.

    Returns:
        the called functions; each is listed before the functions that call it.
    """
    for called in library._linking_libraries:
        if called not in found:
            if isinstance(called, _InnerLibrary):
                _called_by(called, found)
            found[called] = None
    return list(found)


class _Flags(Flags):
    """Compiler flags with a fast comparison, which considers only the options that are set. The speed matters, because
    numba compares flags each time it compiles the reading of an array element.
    """

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Flags):
            return False
        names = self._values.keys() | other._values.keys()
        return self._values == other._values or all(getattr(self, name) == getattr(other, name) for name in names)

    def __hash__(self) -> int:
        return FLAGS_HASH


class KernelCompiler(StrictCompiler):
    """Compiler that puts into each kernel a copy of the code of all inner functions that the kernel calls.

    An inner function gets no copies of the inner functions that it calls, so a kernel has each code only once.
    """

    library: type[_Library] = _KernelLibrary

    def __init__(self, typing: Any, target: Any, _: None, *others: Any) -> None:
        library = self.library(target.codegen(), "lmd")
        library.enable_object_caching()
        super().__init__(typing, target, library, *others)
        self.state.flags = _Flags(self.state.flags)

    def compile_extra(self, func: Any) -> Any:
        """Compile a kernel, see `TimedCompiler.compile_extra`.

        After an error the kernel's locks in the disk cache are released, so that no other process waits for the kernel.
        """
        try:
            return super().compile_extra(func)
        except BaseException:
            locks = LOCKS.get(func, {})
            while locks:
                locks.popitem()[1].release()
            raise


class InnerCompiler(KernelCompiler):
    """Compiler of inner functions; functions that use Python objects, as `print` does, are refused."""

    library = _InnerLibrary

    def compile_extra(self, func: Any) -> Any:
        """Compile an inner function; return numba's result of the compilation.

        Raises:
            TypeError: the function uses Python objects, or returns arrays that would be freed too early.
        """
        result = super().compile_extra(func)
        if any("missing Environment" in str(each) for each in result.library._final_module.global_variables):
            raise TypeError(f"{name_of(func)} prints or uses Python objects, which only a kernel may do.")
        return result


class AllocatingCompiler(InnerCompiler):
    """Compiler of inner functions that may return arrays.

    Such functions are made by `allocating`, and then count references to arrays; or are registered by numba's
    `overload`, and then count references if their callers do.
    """

    returns_arrays = True


class Cache(FunctionCache):
    """Disk cache of compiled kernels; a kernel is valid while the digest of its source code is unchanged.

    To read an index file, numba imports the modules that define the classes of all arguments in it. So each set of such
    modules has an index file of its own, and no other modules are imported. If several processes need a kernel, one of
    them compiles it.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._locks = LOCKS.setdefault(function, {})

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a kernel, for arguments of the types `sig`, from the cache; None if it must be compiled here.

        If another process is compiling the kernel, wait for that process.
        """
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
        """Store a compiled kernel, and release its lock."""
        try:
            super().save_overload(sig, data)
        finally:
            if lock := self._locks.pop(str(sig), None):
                lock.release()


class _Index(IndexDataCacheFile):
    """Index of the disk cache of kernels, written by one process at a time; unreadable files count as missing.

    The names of kernel files contain the digest of the source code, so a kernel of older code is never loaded.
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
            raise OSError(f"{name} cannot be read") from error  # numba interprets this error as a missing file

    def save(self, key: Any, data: Any) -> None:
        with FileLock(f"{self._index_path}.lock"):
            if not self._load_index():  # existing files have another digest in their names
                for old in Path(self._cache_path).glob(f"{glob.escape(self._index_name.removesuffix('nbi'))}*.nbc"):
                    old.unlink(missing_ok=True)
            super().save(key, data)
