"""Following a run: progress bar, curve, checkpoints, and stopping on Ctrl-C."""

import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

from tqdm import tqdm

from lmd.optimisers.base import Budget, Optimiser, Record

from .tracking import Tracker

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


def thinned(history: Sequence[Record], most: int = CURVE_POINTS) -> list[tuple[int, float, float]]:
    """At most `most` points (evaluations, best fitness, seconds), evenly chosen, the last record among them."""
    stride = -(-len(history) // most) or 1
    kept = reversed(history[::-1][::stride])
    return [(int(r.evaluations), r.best_fitness, r.wall_time) for r in kept]


def bar(total: int | None, unit: str, initial: int = 0) -> "tqdm[Any]":
    """A progress bar: live on a terminal; in a log file a line now and then is enough."""
    interval = 0.1 if sys.stderr.isatty() else 15.0
    return tqdm(total=total, initial=initial, unit=f" {unit}", mininterval=interval, leave=False)


class Progress:
    """The callback of a run: shows the best fitness, logs the curve and saves checkpoints as it goes.

    Args:
        budget: where the bar ends.
        tracker: receives the curve.
        save: saves a checkpoint.
        every: seconds between checkpoints.
        stop: ends the run.
        resumed: the optimiser before the run; what is in its ledger is logged already.
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
        self.used = budget.used(resumed.ledger.evaluations, resumed.ledger.seconds)
        self.saved = time.monotonic()
        self.logged = len(resumed.ledger.history)
        self.bar = bar(budget.evaluations, "evaluations", int(resumed.ledger.evaluations))

    def __call__(self, optimiser: Optimiser) -> bool:
        """See `lmd.optimisers.base.Callback`."""
        ledger = optimiser.ledger
        self.bar.set_postfix_str(f"best {ledger.best_fitness:.2%}", refresh=False)
        self.bar.update(int(ledger.evaluations) - self.bar.n)
        if time.monotonic() - self.saved >= self.every:
            self.flush(optimiser)
        return self.stop.requested

    def flush(self, optimiser: Optimiser) -> None:
        """Save a checkpoint and log what the curve has gained."""
        ledger = optimiser.ledger
        used = self.budget.used(ledger.evaluations, ledger.seconds)
        new = ledger.history[self.logged :]
        self.save()
        self.tracker.log_curve("best_fitness", thinned(new, 1 + int(CURVE_POINTS * (used - self.used))))
        self.logged, self.used = len(ledger.history), used
        self.saved = time.monotonic()

    def close(self) -> None:
        """Remove the bar."""
        self.bar.close()
