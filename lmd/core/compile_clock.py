"""The compiler of `lmd`'s own functions, which numba takes as an option: it is timed and says what it compiles.

Functions that others compile are not timed.
"""

import gc
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
            self._compiling += 1
            if outermost := self._compiling == 1:
                self._began, self._thresholds = time.perf_counter(), gc.get_threshold()
                if self._thresholds[0]:
                    gc.set_threshold(*map(max, self._thresholds, GARBAGE_THRESHOLDS))
        try:
            if outermost:
                self._tell(function)
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
        lines.append(
            f"compiling kernel {self._kernels}, {self._spent:.0f} s so far: {name_of(function).partition(' (')[0]}"
        )
        with suppress(OSError):  # standard error is closed
            tqdm.write("\n".join(lines), file=sys.stderr)  # above a progress bar

    @property
    def active(self) -> bool:
        """True while the compiler is at work."""
        return self._compiling > 0

    def read(self) -> float:
        """The time without what was spent, seconds."""
        with self._lock:
            return (self._began if self._compiling else time.perf_counter()) - self._spent


CLOCK = CompileClock()


class TimedCompiler(Compiler):
    """numba's compiler, which stops `CLOCK`."""

    returns_arrays = True  # also in tuples, and where they are not counted

    def compile_extra(self, func: Any) -> Any:
        """Compile a function.

        Raises:
            TypeError: it returns arrays, or other memory, and may not.
        """
        counted, models = self.state.flags.nrt, self.state.targetctx.data_model_manager
        with CLOCK.stopped(func):
            result = super().compile_extra(func)
        returned = result.signature.return_type
        held = counted and not isinstance(returned, types.BaseTuple)
        if not (self.returns_arrays or held) and models[returned].contains_nrt_meminfo():
            raise TypeError(
                f"{name_of(func)} returns arrays that nothing would hold: write to arrays that it is given, or return "
                "numbers."
            )
        return result


class StrictCompiler(TimedCompiler):
    """Refuses functions that return arrays which nothing would hold."""

    returns_arrays = False


def name_of(function: Any) -> str:
    """The name of a function for messages, with its module, file and line."""
    code, module = function.__code__, (function.__module__ or "").removeprefix("lmd.")
    return f"{module}.{function.__qualname__} ({code.co_filename}, line {code.co_firstlineno})"
