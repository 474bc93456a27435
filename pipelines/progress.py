"""Following a run: progress bar, curve, checkpoints."""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lmd.core.checks import InputError
from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget, Record

from .operations.signals import stop
from .operations.tracking import Tracker

CURVE_POINTS = 500  # points of a whole run kept in the tracked curve


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
