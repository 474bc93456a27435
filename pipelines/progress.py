"""Following a run: progress bar, curve, checkpoints, and stopping on Ctrl-C."""

import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

from tqdm import tqdm

from lmd.optimisers.base import Budget, Optimiser
from lmd.tracking import Tracker

CURVE_POINTS = 500  # points of a whole run kept in the tracked curve


class StopOnSignal:
    """While entered, the first SIGINT or SIGTERM sets `requested`; a second one acts as usual."""

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "StopOnSignal":
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._request)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()

    def _request(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True
        self._restore()
        print("\nstopping after this batch; once more to stop at once", file=sys.stderr)

    def _restore(self) -> None:
        while self._before:
            number, handler = self._before.popitem()
            signal.signal(number, handler)


class Progress:
    """The callback of a run: shows the best fitness, logs the curve and saves checkpoints as it goes.

    Args:
        budget: where the bar ends.
        tracker: receives the curve.
        save: saves a checkpoint.
        every: seconds between checkpoints.
        stop: ends the run.
        resumed: the optimiser before the run; what is in its books is logged already.
    """

    def __init__(
        self,
        budget: Budget,
        tracker: Tracker,
        save: Callable[[], None],
        every: float,
        stop: StopOnSignal,
        resumed: Optimiser,
    ) -> None:
        self.budget, self.tracker, self.save, self.every, self.stop = budget, tracker, save, every, stop
        self.bucket = -1
        self.saved = time.monotonic()
        self.logged = len(resumed.books.history)
        # On a terminal the bar is live; in a log file a line now and then is enough.
        interval = 0.1 if sys.stderr.isatty() else 15.0
        self.bar = tqdm(
            total=budget.evaluations,
            initial=int(resumed.books.evaluations),
            unit=" evaluations",
            mininterval=interval,
            leave=False,
        )

    def __call__(self, optimiser: Optimiser) -> bool:
        """See `lmd.optimisers.base.Callback`."""
        books = optimiser.books
        self.bar.set_postfix_str(f"best {books.best_fitness:.2%}", refresh=False)
        self.bar.update(int(books.evaluations) - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return self.stop.requested

    def flush(self, optimiser: Optimiser) -> None:
        """Save a checkpoint and log what the curve has gained."""
        history = optimiser.books.history
        points = []
        for record in history[self.logged :]:
            bucket = int(CURVE_POINTS * self.budget.used(record.evaluations, record.wall_time))
            if bucket != self.bucket:
                points.append((int(record.evaluations), record.best_fitness, record.wall_time))
                self.bucket = bucket
        self.tracker.log_curve("best_fitness", points)
        self.logged = len(history)
        self.save()
        self.saved = time.monotonic()

    def close(self) -> None:
        """Remove the bar."""
        self.bar.close()
