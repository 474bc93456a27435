"""Progress of a run: the progress bar, the curve of the best fitness, and checkpoints."""

import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from lmd.core.checks import InputError
from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import ROUNDING, Budget, Ledger, curve

from . import app
from .operations.signals import stop
from .operations.tracking import Tracker

if TYPE_CHECKING:
    from lmd.survey.survey import SurveyStage

LOG_SECONDS = 15.0  # time between lines of progress in a file, seconds

tqdm.set_lock(threading.RLock())  # tqdm's own lock has a semaphore, which a process that is killed would leave behind


def bar(total: int | None, unit: str, initial: int = 0) -> "tqdm[Any]":
    """Make a progress bar.

    On a terminal the bar is updated in place. In a file, a new line is written every `LOG_SECONDS`.

    Args:
        total: value at which the bar is full; None if unknown.
        unit: name of the unit.
        initial: value at the beginning.
    """
    interval = 0.1 if sys.stderr.isatty() else LOG_SECONDS
    return tqdm(total=total, initial=initial, unit=f" {unit}", mininterval=interval, leave=False)


class Progress:
    """Callback of a run: it shows the best fitness, records its curve, and saves checkpoints.

    A warning is printed at the beginning if the optimiser cannot be checkpointed.

    Args:
        budget: budget of the run; the progress bar ends when the budget is used up.
        tracker: tracker that records the curve.
        checkpoint: checkpoint of the optimiser.
        directory: folder of the checkpoint.
        every: time between checkpoints, seconds.
        logged: True if the tracker already has the curve up to the present state, as in a resumed run.
    """

    def __init__(
        self, budget: Budget, tracker: Tracker, checkpoint: Checkpoint, directory: Path, every: float, logged: bool
    ) -> None:
        self.budget, self.tracker, self.every = budget, tracker, every
        ledger, self.save = checkpoint.optimiser.ledger, partial(checkpoint.save, directory)
        self.logged = len(self._curve(ledger)) if logged else 0
        self.saved, self.warned = time.monotonic(), False
        self._warning_of(checkpoint.check)
        self.bar = bar(budget.evaluations, "evaluations", int(ledger.evaluations))

    def __call__(self, optimiser: Optimiser) -> bool:
        """Show progress, and save a checkpoint if one is due; return True if the run is to stop."""
        ledger = optimiser.ledger
        with suppress(OSError):  # the terminal may be closed
            self.bar.set_postfix_str(f"best fitness {ledger.best_fitness:.2%}", refresh=False)
            self.bar.update(int(ledger.evaluations) - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return stop.requested

    def flush(self, optimiser: Optimiser, ended: bool = False) -> None:
        """Save a checkpoint, and record the new part of the curve.

        If `ended` is True, the search has ended, and the curve is extended to the end of the budget.
        """
        self._warning_of(self.save)
        points = curve(optimiser.ledger.history, self.budget) if ended else self._curve(optimiser.ledger)
        self.tracker.log_curve("best_fitness", points[self.logged :])
        self.logged = len(points)
        self.saved = time.monotonic()

    def _curve(self, ledger: Ledger) -> list[tuple[int, float, float]]:
        """Points (step, best fitness, seconds) of the run's curve from the start to the present, see `ledger.curve`."""
        spent = ledger.seconds if self.budget.evaluations is None else ledger.evaluations
        return curve(ledger.history, self.budget, spent + ROUNDING)

    def _warning_of(self, save: Callable[[], None]) -> None:
        """Call the function `save`; if it fails, warn once, and continue the run without checkpoints."""
        try:
            save()
        except (OSError, InputError) as error:
            if not self.warned:
                reason = error.strerror if isinstance(error, OSError) else error
                print(f"warning: no checkpoint can be written ({reason}); the run goes on", file=sys.stderr)
            self.warned = True

    def close(self) -> None:
        """Remove the progress bar."""
        with suppress(OSError):
            self.bar.close()


class Stages:
    """Progress of the stages of a survey, with the interface `lmd.survey.survey.Observer`."""

    def __init__(self) -> None:
        self.interrupted: SurveyStage | None = None
        self._stage: SurveyStage | None = None
        self._bar: tqdm[Any] | None = None

    def __call__(self, stage: "SurveyStage", done: int = 0, most: int = 0) -> bool:
        """Show that `done` of the `most` steps of a stage are done; return True if the survey is to stop.

        `most` is 0 if the number of steps is unknown.
        """
        if stop.requested and self.interrupted is None:
            self.interrupted = self._stage
        if self._bar is None or stage != self._stage:
            self.close()
            self._bar, self._stage = tqdm(desc=stage.value, unit=" steps", delay=app.SHOWN_AFTER, leave=False), stage
        with suppress(OSError):  # the terminal may be closed
            self._bar.total = most or None
            self._bar.update(done - self._bar.n)
        return stop.requested

    def close(self) -> None:
        """Remove the progress bar."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.close()

    @property
    def doing(self) -> str:
        """Name of the present stage of the survey."""
        return "reading photographs or detections" if self._stage is None else self._stage.value

    @property
    def has_map(self) -> bool:
        """True if the survey has reached a map that is worth writing."""
        return self._stage is not None and self._stage.has_map
