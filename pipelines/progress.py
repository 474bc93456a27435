"""Following a run: progress bar, curve, checkpoints."""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from lmd.core.checks import InputError
from lmd.core.compiled import clock, is_compiling
from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget, Record

from .operations.signals import stop, tell
from .operations.tracking import Tracker

if TYPE_CHECKING:
    from lmd.survey.survey import Stage

CURVE_POINTS = 500  # points of a whole run kept in the tracked curve
PATIENCE = 5.0  # seconds after which it is said that an optimiser is waited for
LOOK_SECONDS = 0.2  # between two looks at whether it is
LOG_SECONDS = 15.0  # between two lines of progress in a file
SHOWN_AFTER = 2.0  # seconds from which on a survey says what it is doing


def thinned(history: Sequence[Record], most: int = CURVE_POINTS) -> list[tuple[int, float, float]]:
    """At most `most` points (evaluations, best fitness, seconds), evenly chosen, the last record among them."""
    stride = -(-len(history) // most) or 1
    kept = reversed(history[::-1][::stride])
    return [(int(r.evaluations), r.best_fitness, r.wall_time) for r in kept]


def bar(total: int | None, unit: str, initial: int = 0) -> "tqdm[Any]":
    """A progress bar: live on a terminal; in a log file a line now and then is enough."""
    interval = 0.1 if sys.stderr.isatty() else LOG_SECONDS
    return tqdm(total=total, initial=initial, unit=f" {unit}", mininterval=interval, leave=False)


class Progress:
    """The callback of a run: shows the best fitness, logs the curve and saves checkpoints as it goes.

    An optimiser that cannot be checkpointed gets a warning at once.

    Args:
        budget: where the bar ends.
        tracker: receives the curve.
        checkpoint: of the optimiser before the run.
        directory: where checkpoints are saved.
        every: seconds between them.
        logged: whether the tracked run has what is in its ledger already.
    """

    def __init__(
        self,
        budget: Budget,
        tracker: Tracker,
        checkpoint: Checkpoint,
        directory: Path,
        every: float,
        logged: bool,
    ) -> None:
        self.budget, self.tracker, self.every = budget, tracker, every
        self.save = partial(checkpoint.save, directory)
        ledger = checkpoint.optimiser.ledger
        self.used = budget.used(ledger.evaluations, ledger.seconds) if logged else 0.0
        self.logged = len(ledger.history) if logged else 0
        self.saved = time.monotonic()
        self.warned = False
        self._warning_of(checkpoint.check)
        self.bar = bar(budget.evaluations, "evaluations", int(ledger.evaluations))

    def __call__(self, optimiser: Optimiser) -> bool:
        """See `lmd.optimisers.base.Callback`."""
        ledger = optimiser.ledger
        with suppress(OSError):  # the terminal may be closed
            self.bar.set_postfix_str(f"best {ledger.best_fitness:.2%}", refresh=False)
            self.bar.update(int(ledger.evaluations) - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return stop.requested

    def flush(self, optimiser: Optimiser) -> None:
        """Save a checkpoint and log what the curve has gained."""
        ledger = optimiser.ledger
        used = self.budget.used(ledger.evaluations, ledger.seconds)
        new = ledger.history[self.logged :]
        self._warning_of(self.save)
        self.tracker.log_curve("best_fitness", thinned(new, 1 + int(CURVE_POINTS * (used - self.used))))
        self.logged, self.used = len(ledger.history), used
        self.saved = time.monotonic()

    def _warning_of(self, save: Callable[[], None]) -> None:
        """Do what may fail, for the run is worth more than its checkpoint; warn once."""
        try:
            save()
        except (OSError, InputError) as error:
            if not self.warned:
                reason = error.strerror if isinstance(error, OSError) else error
                print(f"warning: no checkpoint can be written ({reason}); the run goes on", file=sys.stderr)
            self.warned = True

    def close(self) -> None:
        """Remove the bar."""
        with suppress(OSError):
            self.bar.close()


class Watch:
    """Says that a run that is to end, by a signal or by its seconds, waits for its optimiser; then a signal ends it.

    An optimiser looks at the budget between batches, and one of another library may take any time to propose one.

    Args:
        optimiser: that runs.
        budget: of the run.
    """

    def __init__(self, optimiser: Optimiser, budget: Budget) -> None:
        self.optimiser, self.budget = optimiser, budget
        self.is_overdue = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended.set()

    def _look(self) -> None:
        ledger = self.optimiser.ledger
        began, done, due = clock() - ledger.seconds, ledger.evaluations, None
        while not self._ended.wait(LOOK_SECONDS):
            if ledger.evaluations != done or is_compiling():
                done, due, self.is_overdue = ledger.evaluations, None, False
            is_late = self.budget.seconds is not None and clock() - began > self.budget.seconds
            if not (is_late or stop.requested) or self.is_overdue:
                continue
            due = due or time.monotonic() + PATIENCE
            if time.monotonic() > due:
                self.is_overdue = True
                why = "told to stop" if stop.requested else f"budget.seconds = {self.budget.seconds:g} is over"
                again = "once more" if stop.requested else "Ctrl-C"
                waited = f"{self.optimiser.called} has been waited for {PATIENCE:g} s"
                tell(f"{why}, {waited}; {again} to stop at once with the best so far")


class Stages:
    """Says on stderr what a survey is doing, how much of that is done, and how long it will take at most.

    A survey that ends within `SHOWN_AFTER` seconds says nothing. It is the `lmd.survey.survey.Observer` of one.
    """

    def __init__(self) -> None:
        self.interrupted: Stage | None = None
        self._now: tuple[Stage, int, int] | None = None
        self._began = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __call__(self, stage: "Stage", done: int = 0, most: int = 0) -> bool:
        """See `lmd.survey.survey.Observer`."""
        if stop.requested and self.interrupted is None and self._now is not None:
            self.interrupted = self._now[0]
        if self._now is None or stage is not self._now[0]:
            self._began = time.time()
        self._now = stage, done, most
        return stop.requested

    @property
    def doing(self) -> str:
        """The stage, in words."""
        return "reading photographs or detections" if self._now is None else self._now[0].value

    @property
    def has_map(self) -> bool:
        """True once there is something that is worth keeping."""
        return self._now is not None and self._now[0].has_map

    def __enter__(self) -> "Stages":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if stop.requested and self.interrupted is None and self._now is not None:
            self.interrupted = self._now[0]
        self._ended.set()
        self._thread.join()

    def _show(self) -> None:
        shown: tqdm[Any] | None = None
        wait = SHOWN_AFTER
        while not self._ended.wait(wait):
            wait = LOOK_SECONDS if sys.stderr.isatty() else LOG_SECONDS
            if self._now is None:
                continue
            stage, done, most = self._now
            look = None if most else "{desc} [{elapsed}]"
            with suppress(OSError):  # the terminal may be closed
                if shown is None:
                    shown = tqdm(desc=stage.value, total=most or None, unit=" steps", bar_format=look, leave=False)
                shown.start_t, shown.n, shown.total, shown.bar_format = self._began, done, most or None, look
                shown.set_description_str(f"{stage.value}, {most} steps at most: " if most else stage.value)
        if shown is not None:
            with suppress(OSError):
                shown.close()
