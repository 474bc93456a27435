"""Compiler for `lmd`'s functions that prints its progress, and a clock that stops during compilation.

The clock does not stop for functions of other packages.
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

# Thresholds of Python's garbage collector during compilation. Most objects of the compiler stay alive; collections at
# the default thresholds would take a twelfth of the time.
GARBAGE_THRESHOLDS = (20_000, 50, 1_000)


class CompileClock:
    """Clock that stops while any thread of this process compiles, so that it measures the time without compilation."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._compiling = 0  # number of functions being compiled; most are nested in others
        self._began = self._spent = 0.0
        self._kernels = 0  # number of kernels whose compilation has begun
        self._thresholds = gc.get_threshold()
        self.cache_note = "they are cached for the next run"  # part of the message about the first compilation

    @contextmanager
    def stopped(self, function: Any) -> Iterator[None]:
        """Context manager that stops the clock while a function is compiled.

        The manager prints the name of the function unless the compilation is nested in another compilation.
        """
        with self._lock:
            self._compiling += 1
            if outermost := self._compiling == 1:
                self._began, self._thresholds = time.perf_counter(), gc.get_threshold()
                if self._thresholds[0]:
                    gc.set_threshold(*map(max, self._thresholds, GARBAGE_THRESHOLDS))
        try:
            if outermost:
                self._print_progress(function)
            yield
        finally:
            with self._lock:
                self._compiling -= 1
                if not self._compiling:
                    self._spent += time.perf_counter() - self._began
                    gc.set_threshold(*self._thresholds)

    def _print_progress(self, function: Any) -> None:
        self._kernels += 1
        text = f"compiling kernel {self._kernels}, {self._spent:.0f} s so far: {name_of(function).partition(' (')[0]}"
        text = text if self._kernels > 1 else f"compiling kernels; {self.cache_note}\n{text}"
        # Above a progress bar, if there may be one. A worker loads no tqdm, whose semaphore would outlive it.
        write = sys.modules["tqdm"].tqdm.write if "tqdm" in sys.modules else print
        with suppress(OSError):  # standard error is closed
            write(text, file=sys.stderr)

    @property
    def active(self) -> bool:
        """True while the compiler is at work."""
        return self._compiling > 0

    def read(self) -> float:
        """Seconds since an arbitrary origin, without the time of compilation."""
        with self._lock:
            return (self._began if self._compiling else time.perf_counter()) - self._spent


CLOCK = CompileClock()


class TimedCompiler(Compiler):
    """numba's compiler, which stops `CLOCK`, the process-wide `CompileClock`, while it works."""

    returns_arrays = True  # False: a function may return an array with a reference count, but no tuple with an array

    def compile_extra(self, func: Any) -> Any:
        """Compile a function of Python; return numba's result of the compilation.

        Raises:
            TypeError: the compiler's attribute `returns_arrays` is False, and the function returns a tuple with arrays,
                or an array without a reference count. Such arrays would be freed too early.
        """
        counted, models = self.state.flags.nrt, self.state.targetctx.data_model_manager
        with CLOCK.stopped(func):
            result = super().compile_extra(func)
        returned = result.signature.return_type
        held = counted and not isinstance(returned, types.BaseTuple)
        if not (self.returns_arrays or held) and models[returned].contains_nrt_meminfo():
            raise TypeError(
                f"{name_of(func)} returns arrays, which would be freed too early: write to arrays given as arguments, "
                "or return numbers."
            )
        return result


class StrictCompiler(TimedCompiler):
    """Compiler that refuses functions that return a tuple with arrays, or an array without a reference count.

    Such arrays would be freed too early.
    """

    returns_arrays = False


def name_of(function: Any) -> str:
    """Name of a function for messages, with module, file and line."""
    code, module = function.__code__, (function.__module__ or "").removeprefix("lmd.")
    return f"{module}.{function.__qualname__} ({code.co_filename}, line {code.co_firstlineno})"
