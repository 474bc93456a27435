"""Progress of a run: bar, curve, checkpoints."""

import math
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
    from lmd.survey.survey import SurveyStage

CURVE_POINTS = 500  # points of the tracked curve of a whole run
PATIENCE = 5.0  # time that an optimiser may take to end before a message, seconds
LOOK_SECONDS = 0.2  # time between two looks at the optimiser, seconds
LOG_SECONDS = 15.0  # time between two lines of progress in a file, seconds
SHOWN_AFTER = 2.0  # time after which the stages of a survey are shown, seconds


def thinned(history: Sequence[Record], most: int = CURVE_POINTS) -> list[tuple[int, float, float]]:
    """At most `most` points (evaluations, best fitness, seconds) of a history, the last record among them.

    A longer history is reduced to its improvements, and these evenly if they are too many. Records before the first
    successful evaluation are left out.
    """
    history = [record for record in history if math.isfinite(record.best_fitness)]
    if len(history) > most:
        last = len(history) - 1
        rises = (i for i in range(1, last) if history[i].best_fitness > history[i - 1].best_fitness)
        history = [history[i] for i in (0, *rises, last)]
    stride = -(-len(history) // most) or 1
    kept = reversed(history[::-1][::stride])
    return [(int(r.evaluations), r.best_fitness, r.wall_time) for r in kept]


def bar(total: int | None, unit: str, initial: int = 0) -> "tqdm[Any]":
    """A progress bar, live on a terminal, every `LOG_SECONDS` in a file."""
    interval = 0.1 if sys.stderr.isatty() else LOG_SECONDS
    return tqdm(total=total, initial=initial, unit=f" {unit}", mininterval=interval, leave=False)


class Progress:
    """The callback of a run: shows the best fitness, logs the curve and saves checkpoints.

    An optimiser that cannot be checkpointed gets a warning at once.

    Args:
        budget: budget of the run, the end of the bar.
        tracker: tracker of the curve.
        checkpoint: checkpoint of the optimiser.
        directory: folder of the checkpoint.
        every: time between checkpoints, seconds.
        logged: the tracked run has the history in the optimiser's ledger already.
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
        """Show progress, and return whether the run is to stop; see `lmd.optimisers.base.Callback`."""
        ledger = optimiser.ledger
        with suppress(OSError):  # the terminal may be closed
            self.bar.set_postfix_str(f"best {ledger.best_fitness:.2%}", refresh=False)
            self.bar.update(int(ledger.evaluations) - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return stop.requested

    def flush(self, optimiser: Optimiser) -> None:
        """Save a checkpoint and log the new part of the curve."""
        ledger = optimiser.ledger
        used = self.budget.used(ledger.evaluations, ledger.seconds)
        new = ledger.history[self.logged :]
        self._warning_of(self.save)
        self.tracker.log_curve("best_fitness", thinned(new, 1 + int(CURVE_POINTS * (used - self.used))))
        self.logged, self.used = len(ledger.history), used
        self.saved = time.monotonic()

    def _warning_of(self, save: Callable[[], None]) -> None:
        """Call a function, and warn once if it fails: the run goes on without checkpoints."""
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
    """Prints that a run which is to end waits for its optimiser; from then on a signal ends it at once.

    An optimiser checks the budget between batches, and one of another library may take any time to propose a batch.

    Args:
        optimiser: optimiser of the run.
        budget: budget of the run.
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
    """Shows the stage of a survey, its progress and its longest remaining time; a `lmd.survey.survey.Observer`.

    Shows nothing of a survey that ends within `SHOWN_AFTER` seconds.
    """

    def __init__(self) -> None:
        self.interrupted: SurveyStage | None = None
        self._now: tuple[SurveyStage, int, int] | None = None
        self._began = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __call__(self, stage: "SurveyStage", done: int = 0, most: int = 0) -> bool:
        """Note the stage, and return whether the survey is to stop; see `lmd.survey.survey.Observer`."""
        if stop.requested and self.interrupted is None and self._now is not None:
            self.interrupted = self._now[0]
        if self._now is None or stage is not self._now[0]:
            self._began = time.time()
        self._now = stage, done, most
        return stop.requested

    @property
    def doing(self) -> str:
        """Name of the stage."""
        return "reading photographs or detections" if self._now is None else self._now[0].value

    @property
    def has_map(self) -> bool:
        """True when a map is worth writing."""
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
