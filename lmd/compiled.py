"""How kernels are compiled, and when what was compiled before may be used again."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit, types
from numba.core.caching import FunctionCache, IndexDataCacheFile

# Folders with code that is compiled, below this one.
_FOLDERS = ("geometry", "sight", "objectives", "optimisers/annealing")


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function when it is first called, without the GIL, and keep the result on disk.

    A division by zero gives infinity or NaN instead of an exception, as in NumPy.
    """
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    compiled._cache = _Cache(function)  # what njit(cache=True) does with its own class
    return compiled


@cache
def _sources() -> str:
    """A digest of all code that kernels may be made of."""
    here, digest = Path(__file__).parent, hashlib.sha256()
    for folder in _FOLDERS:
        for path in sorted((here / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


class _Cache(FunctionCache):
    """numba's, but safe in two ways.

    - numba looks at a kernel's own file only, and would go on with old copies of what other files contributed.
    - The index on disk names the classes of the arguments. One that another process cannot import, such as a criterion
      in a folder of somebody's own, would make the whole index unreadable there: such kernels are not kept.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = (self._impl.locator.get_source_stamp(), _sources())
        self._cache_file = IndexDataCacheFile(self._cache_path, self._impl.filename_base, stamp)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, if all its arguments are of classes of this package."""
        if not any(_is_foreign(kind) for kind in getattr(sig, "args", sig)):
            super().save_overload(sig, data)


def _is_foreign(kind: Any) -> bool:
    """Whether a numba type is, or contains, a named tuple defined elsewhere."""
    named: Any = getattr(kind, "instance_class", None)  # of named tuples
    if named is not None and named.__module__.partition(".")[0] != "lmd":
        return True
    parts: Any = kind if isinstance(kind, types.BaseTuple) else ()
    return any(_is_foreign(part) for part in parts)
