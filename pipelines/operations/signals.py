"""Signals that stop a process: Ctrl-C, a closed terminal, `kill`."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
CODES = tuple(128 + number for number in SIGNALS)  # exit codes after these signals, as in shells


class Stopped(KeyboardInterrupt):
    """Exception raised when a signal stops the process.

    Args:
        number: number of the signal.
        why: reason of the signal if this process sent it itself, else empty.
    """

    def __init__(self, number: int, why: str = "") -> None:
        super().__init__(why or f"told to stop by {signal.Signals(number).name}")
        self.code = 128 + number


class Stop:
    """Handling of SIGINT, SIGTERM and SIGHUP in this process; the current `with` block decides the effect of a signal.

    Outside all blocks a signal ends the process immediately, because the process has no results yet. Within `raising`,
    the first signal raises `Stopped`, and later signals are ignored while the process cleans up. Within `deferred`, the
    first signal sets `requested` and the second signal raises `Stopped`. Within `shielded`, a signal only sets
    `requested`. Within `postponed`, signals wait.

    A library, or the clean-up, may fail with another error when a signal interrupts it. This error is printed in one
    line, and `Stopped` is raised in its place.
    """

    def __init__(self) -> None:
        self.why = ""  # reason of the signal, if this process sent it
        self._number = 0  # number of the signal that was received
        self._is_under_way = False  # True from raising `Stopped` until the innermost block is left
        self._terminals: tuple[int, ...] = ()
        self._act: Callable[[int], None] = lambda number: os._exit(128 + number)

    @property
    def requested(self) -> bool:
        """True if a signal has been received."""
        return self._number != 0

    @property
    def code(self) -> int:
        """Exit code of a process that the signal ends."""
        return 128 + self._number

    def listen(self) -> None:
        """Begin to handle the signals.

        A hang-up that the process already ignores, as under `nohup`, stays ignored.
        """
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._handle)
        self._terminals = tuple(stream for stream in (1, 2) if os.isatty(stream))  # isatty fails on a closed stream
        sys.unraisablehook = _unless_stopped

    def raising(self) -> AbstractContextManager[None]:
        """Context in which the first signal raises `Stopped`."""
        return self._acting(self._raise)

    def deferred(self, worth_waiting: Callable[[], bool], step: str = "this batch") -> AbstractContextManager[None]:
        """Context in which the first signal sets `requested` and the second signal raises `Stopped`.

        Args:
            worth_waiting: function that returns False if there is no unfinished step to wait for; the first signal then
                raises `Stopped`.
            step: name of the step to wait for.
        """

        def act(number: int) -> None:
            if self.requested or not worth_waiting():
                self._raise(number)
            self._number = number
            tell(f"stopping after {step}; interrupt again to stop at once")

        return self._acting(act)

    def shielded(self) -> AbstractContextManager[None]:
        """Context in which a signal only sets `requested`; it is meant for short work that must not be interrupted."""
        return self._acting(partial(setattr, self, "_number"))

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """Context in which signals are held back; they take effect at the end of the context."""
        waiting: list[int] = []
        try:
            with self._acting(waiting.append):
                yield
        finally:
            for number in waiting:
                self._act(number)

    @contextmanager
    def _acting(self, act: Callable[[int], None]) -> Iterator[None]:
        before, self._act = self._act, act
        try:
            yield
        except (Stopped, Exception) as error:
            if not (self._is_under_way or isinstance(error, Stopped)):
                raise
            before, self._is_under_way = _ignore, False  # no second `Stopped` while the outer blocks clean up
            if isinstance(error, Stopped):
                raise
            tell(f"while stopping: {type(error).__name__}: {error}")
            raise Stopped(self._number) from error
        finally:
            self._act = before

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP:  # writing to the closed terminal would fail
            silent = os.open(os.devnull, os.O_WRONLY)
            for stream in self._terminals:
                os.dup2(silent, stream)
        self._act(number)

    def _raise(self, number: int) -> None:
        self._number, self._act, self._is_under_way = number, _ignore, True
        os.environ["HYDRA_FULL_ERROR"] = "1"  # otherwise Hydra would print the library's error and exit with 1
        tell("stopping")
        raise Stopped(number, self.why)


def tell(text: str) -> None:
    """Write a line to stderr without Python's buffer, as the signal may have interrupted a write to this buffer."""
    with suppress(OSError):  # the reader may have ended
        os.write(2, f"\n{text}\n".encode())


def _ignore(number: int) -> None:
    pass


def _unless_stopped(unraisable: "sys.UnraisableHookArgs") -> None:
    """Ignore `Stopped` where Python cannot pass an exception on, as in a destructor; report other exceptions.

    The signal is not lost, because `Stop.requested` stays True.
    """
    if not isinstance(unraisable.exc_value, Stopped):
        sys.__unraisablehook__(unraisable)


stop = Stop()  # the only instance in a process
