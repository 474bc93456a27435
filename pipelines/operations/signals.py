"""Being told to stop: by Ctrl-C, by the terminal that closes, or by whoever manages the machine."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
CODES = tuple(128 + number for number in SIGNALS)  # exit codes of a process that was told to stop, as shells have them


class Stopped(KeyboardInterrupt):
    """The process was told to stop.

    Args:
        number: the signal that told it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"told to stop by {signal.Signals(number).name}")
        self.code = 128 + number


class Stop:
    """What SIGINT, SIGTERM and SIGHUP do, depending on where the process is.

    At first the process ends on the spot: it has nothing to lose yet. While `raising`, the first signal raises
    `Stopped`, once; what follows cleans up and is not disturbed. While `deferred`, the first one only sets
    `requested`, and the second one raises. While `postponed`, they wait.

    A library may be hit where it cannot leave things as they were, and fail by an error of its own, and so may what
    cleans up. Such an error is reported in a line and leaves as `Stopped`, too.
    """

    def __init__(self) -> None:
        self._number = 0  # the signal that was heard
        self._is_under_way = False  # `Stopped` was raised, and has not got out of where it hit
        self._terminals: tuple[int, ...] = ()
        self._act: Callable[[int], None] = _leave

    @property
    def requested(self) -> bool:
        """Whether a signal was heard."""
        return self._number != 0

    @property
    def code(self) -> int:
        """The exit code of a process that ends because of it."""
        return 128 + self._number

    def listen(self) -> None:
        """Begin to handle the signals, but no hang-up that is ignored already: that is what `nohup` is for."""
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._handle)
        self._terminals = tuple(stream for stream in (1, 2) if os.isatty(stream))  # a closed one does not say so
        sys.unraisablehook = _say_unless_stopped

    @contextmanager
    def raising(self) -> Iterator[None]:
        """While entered, the first signal raises `Stopped`."""
        with self._acting(self._raise):
            yield

    @contextmanager
    def deferred(self, worth_waiting: Callable[[], bool], step: str = "this batch") -> Iterator[None]:
        """While entered, the first signal is noted and the second raises `Stopped`.

        Args:
            worth_waiting: whether there is something to wait for; where not, the first one raises.
            step: what is waited for.
        """

        def act(number: int) -> None:
            if self.requested or not worth_waiting():
                self._raise(number)
            self._number = number
            tell(f"stopping after {step}; once more to stop at once")

        with self._acting(act):
            yield

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """While entered, a signal is noted and no more: for what takes a moment and must not be left half done."""

        def act(number: int) -> None:
            self._number = number

        with self._acting(act):
            yield

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """While entered, signals wait; at its end they do what they would have done."""
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
        except Stopped:
            before, self._is_under_way = _ignore, False  # no second one while what is around cleans up
            raise
        except Exception as error:
            if not self._is_under_way:
                raise
            before, self._is_under_way = _ignore, False
            tell(f"while stopping: {type(error).__name__}: {error}")
            raise Stopped(self._number) from error
        finally:
            self._act = before

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP:  # nobody reads any more, and writing would fail
            silent = os.open(os.devnull, os.O_WRONLY)
            for stream in self._terminals:
                os.dup2(silent, stream)
        self._act(number)

    def _raise(self, number: int) -> None:
        self._number, self._act, self._is_under_way = number, _ignore, True
        os.environ["HYDRA_FULL_ERROR"] = "1"  # or Hydra would print what a library made of it, and exit with 1
        tell("stopping")
        raise Stopped(number)


def tell(text: str) -> None:
    """Write a line past Python's own buffers, which the signal may have found half full."""
    with suppress(OSError):  # whoever read it may be gone
        os.write(2, f"\n{text}\n".encode())


def _leave(number: int) -> None:
    os._exit(128 + number)


def _ignore(number: int) -> None:
    pass


def _say_unless_stopped(unraisable: "sys.UnraisableHookArgs") -> None:
    """A signal may arrive where an exception cannot be raised; `requested` has it all the same."""
    if not isinstance(unraisable.exc_value, Stopped):
        sys.__unraisablehook__(unraisable)


stop = Stop()  # a process has one
