"""Following a run: progress bar, curve, checkpoints, and stopping on Ctrl-C."""

import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

from tqdm import tqdm

from lmd.optimisers.base import Optimiser
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
        evaluations: the budget, where the bar ends.
        tracker: receives the curve.
        save: saves a checkpoint.
        every: seconds between checkpoints.
        stop: ends the run.
        done: the books of a run that goes on, whose curve is logged already.
    """

    def __init__(
        self,
        evaluations: int,
        tracker: Tracker,
        save: Callable[[], None],
        every: float,
        stop: StopOnSignal,
        resumed: Optimiser,
    ) -> None:
        self.evaluations, self.tracker, self.save, self.every, self.stop = evaluations, tracker, save, every, stop
        self.saved = time.monotonic()
        self.logged = len(resumed.books.history)
        # On a terminal the bar is live; in a log file a line now and then is enough.
        interval = 0.1 if sys.stderr.isatty() else 15.0
        self.bar = tqdm(
            total=evaluations, initial=resumed.books.evaluations, unit="eval", mininterval=interval, leave=False
        )

    def __call__(self, optimiser: Optimiser) -> bool:
        """See `lmd.optimisers.base.Callback`."""
        books = optimiser.books
        self.bar.set_postfix_str(f"best {books.best_fitness:.2%}", refresh=False)
        self.bar.update(books.evaluations - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return self.stop.requested

    def flush(self, optimiser: Optimiser) -> None:
        """Save a checkpoint and log what the curve has gained."""
        history = optimiser.books.history
        points = []
        for i in range(self.logged, len(history)):
            before = history[i - 1].evaluations if i else -1
            if _bucket(before, self.evaluations) != _bucket(history[i].evaluations, self.evaluations):
                points.append((int(history[i].evaluations), history[i].best_fitness, history[i].wall_time))
        self.tracker.log_curve("best_fitness", points)
        self.logged = len(history)
        self.save()
        self.saved = time.monotonic()

    def close(self) -> None:
        """Remove the bar."""
        self.bar.close()


def _bucket(evaluations: float, budget: int) -> int:
    return int(evaluations * CURVE_POINTS // budget)
