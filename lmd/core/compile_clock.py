"""The compiler of `lmd`'s own functions, which numba takes as an option: it is timed and says what it compiles.

Nothing is heard of what others compile.
"""

import gc
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba import types
from numba.core.compiler import Compiler

# How often Python looks for garbage while it compiles: most of what that makes stays, and looking as often as it does
# by default would take a twelfth of the time.
GARBAGE_THRESHOLDS = (20_000, 50, 1_000)


class CompileClock:
    """The time that this process has waited for the compiler, in any of its threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._compiling = 0  # functions, of which most are parts of others
        self._began = self._spent = 0.0
        self._kernels = 0  # whose compiling has begun
        self._thresholds = gc.get_threshold()
        self.kept = "it is kept for the next time"  # what becomes of what is compiled

    @contextmanager
    def stopped(self, function: Any) -> Iterator[None]:
        """Stop the clock while a function is compiled, and say which one it is unless it is a part of another."""
        with self._lock:
            if not self._compiling:
                self._began = time.perf_counter()
                self._thresholds = gc.get_threshold()
                gc.set_threshold(*map(max, self._thresholds, GARBAGE_THRESHOLDS))
                self._tell(function)
            self._compiling += 1
        try:
            yield
        finally:
            with self._lock:
                self._compiling -= 1
                if not self._compiling:
                    self._spent += time.perf_counter() - self._began
                    gc.set_threshold(*self._thresholds)

    def _tell(self, function: Any) -> None:
        from tqdm import tqdm

        lines = [] if self._kernels else [f"compiling what this needs; {self.kept}"]
        self._kernels += 1
        lines.append(f"compiling kernel {self._kernels}, {self._spent:.0f} s so far: {name_of(function)}")
        tqdm.write("\n".join(lines), file=sys.stderr)  # above a progress bar

    @property
    def active(self) -> bool:
        """Whether the compiler is at work."""
        return self._compiling > 0

    def read(self) -> float:
        """The time without what was spent, seconds."""
        with self._lock:
            return (self._began if self._compiling else time.perf_counter()) - self._spent


CLOCK = CompileClock()


class TimedCompiler(Compiler):
    """numba's compiler, which stops `CLOCK`."""

    returns_arrays = True  # whether what is compiled may return arrays in tuples, or such that are not counted

    def compile_extra(self, func: Any) -> Any:
        """Compile a function.

        Raises:
            TypeError: it returns arrays, and may not.
        """
        counted = self.state.flags.nrt
        with CLOCK.stopped(func):
            result = super().compile_extra(func)  # type: ignore[no-untyped-call]
        returned = result.signature.return_type
        if not self.returns_arrays and has_arrays(returned) and not (counted and isinstance(returned, types.Array)):
            code = func.__code__
            raise TypeError(
                f"{name_of(func)} ({code.co_filename}, line {code.co_firstlineno}) returns arrays that nothing would "
                "hold: write to arrays that it is given, or return numbers."
            )
        return result


class StrictCompiler(TimedCompiler):
    """Refuses functions that return arrays which nothing would hold."""

    returns_arrays = False


def has_arrays(kind: Any) -> bool:
    """Whether a numba type is an array, or has some as members."""
    if isinstance(kind, types.Optional):
        return has_arrays(kind.type)
    parts: Any = kind if isinstance(kind, types.BaseTuple) else ()
    return isinstance(kind, types.Array) or any(has_arrays(part) for part in parts)


def name_of(function: Any) -> str:
    """The name of a function for messages, with its module."""
    return f"{(function.__module__ or '').removeprefix('lmd.')}.{function.__qualname__}"
