"""Budget of a run, and the run's ledger, which records the spent evaluations and time, and the best fitness."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from lmd.core.checks import Checked, Count, FloatArray, InputError, Positive
from lmd.optimisers.stored import array

ROUNDING = 1e-6  # evaluations are sums of parts 1/K


@dataclass(frozen=True)
class Budget(Checked):
    """Limits on the number of evaluations and on the time of a run.

    Raises:
        InputError: a limit is not positive, or no limit is given.
    """

    evaluations: Count | None = None
    """Greatest number of full evaluations; a moved landmark counts 1/K. None for no limit."""
    seconds: Positive | None = None
    """Wall time after which no further evaluation starts, seconds, without compilation; None for no limit."""

    def _validate(self) -> None:
        if self.evaluations is None and self.seconds is None:
            raise InputError("evaluations or seconds must be given.", "evaluations")

    @property
    def limit(self) -> float:
        """Greatest number of evaluations; infinity for no limit."""
        return math.inf if self.evaluations is None else self.evaluations

    def used(self, evaluations: float, seconds: float) -> float:
        """Fraction of the budget that is spent: the larger of the spent fractions of evaluations and of time; 1 or more
        if the budget is used up.
        """
        return max(evaluations / self.limit, seconds / (self.seconds or math.inf))


@dataclass(frozen=True)
class Record:
    """One point in the progress of a run."""

    evaluations: float
    """Number of full evaluations spent."""
    best_fitness: float
    """Best fitness at this point."""
    wall_time: float
    """Wall time spent, seconds. All records of a batch have the end time of the batch, because its candidates are
    evaluated together.
    """


@dataclass
class Ledger:
    """Progress of a run until now."""

    evaluations: float = 0
    """Number of full evaluations spent."""
    seconds: float = 0.0
    """Wall time spent, seconds."""
    best_fitness: float = -math.inf
    """Best fitness; -inf before the first successful evaluation."""
    history: list[Record] = field(default_factory=list)
    """Records in the order of time."""

    def note(self, evaluations: float, fitness: float) -> bool:
        """Record that `evaluations` have been spent in total, and that the last evaluation gave `fitness`.

        Return True if `fitness` is higher than the best fitness before.
        """
        is_best = fitness > self.best_fitness
        self.evaluations, self.best_fitness = evaluations, fitness if is_best else self.best_fitness
        self.history.append(Record(evaluations, self.best_fitness, self.seconds))
        return is_best

    def note_batch(self, fitness: FloatArray) -> int | None:
        """Record a batch of evaluations with `fitness` `(B,)` as if they were made one after the other.

        The history gets a record at each improvement and one at the end of the batch. So the number of evaluations
        needed to reach a fitness does not depend on the size of batches.

        Returns:
            index of the best fitness in the batch; None if the batch does not improve on the best fitness before.
        """
        spent, best = self.evaluations, np.maximum.accumulate(np.append(self.best_fitness, fitness))
        improved = np.flatnonzero(best[1:] > best[:-1]).tolist()
        for index in dict.fromkeys([*improved, len(fitness) - 1]):
            self.note(spent + index + 1, float(fitness[index]))
        return improved[-1] if improved else None

    def state(self) -> dict[str, Any]:
        """Return the N records of the history as arrays `(N,)`, one for each field of `Record`, for a checkpoint; the
        other attributes of the ledger follow from the history.
        """
        return {f.name: np.array([getattr(r, f.name) for r in self.history], dtype=float) for f in fields(Record)}

    @classmethod
    def of(cls, state: Mapping[str, Any]) -> "Ledger":
        """Make a ledger from the data that the `state` of another ledger returned.

        Raises:
            InputError: `state` is not the state of a ledger.
        """
        evaluations = array("evaluations", state["evaluations"], np.float64, None, low=0.0)
        best = array("best_fitness", state["best_fitness"], np.float64, len(evaluations), low=-math.inf)
        seconds = array("wall_time", state["wall_time"], np.float64, len(evaluations), low=0.0)
        if (evaluations[1:] < evaluations[:-1]).any() or (best[1:] < best[:-1]).any():
            raise InputError("the best fitness must not fall.")
        ledger = cls()
        for spent, fitness, by_then in zip(evaluations.tolist(), best.tolist(), seconds.tolist(), strict=True):
            ledger.seconds = by_then
            ledger.note(spent, fitness)
        return ledger


def columns_of(history: Sequence[Record]) -> dict[str, list[float]]:
    """Columns of a table with the history of a run: a column for each field of `Record`, keyed by the field's name.

    The table begins with the first successful evaluation.
    """
    known = [record for record in history if math.isfinite(record.best_fitness)]
    return {key.name: [getattr(record, key.name) for record in known] for key in fields(Record)}


def curve(history: Sequence[Record], budget: Budget, until: float = math.inf) -> list[tuple[int, float, float]]:
    """Points (step, best fitness, seconds) of the curve of a run, up to the step `until`, for example for mlflow.

    A step is a number of evaluations, or of whole seconds if only seconds are limited. Steps are 1, 2, 5, 10, 20, ...
    and each hundredth of the budget. So all runs with equal budgets have points at equal steps, and the mean curve of
    several runs, as mlflow draws it, never falls.

    A point has the best fitness of the last record up to its step, and the seconds of the first record from its step
    on. Points before the first record have its fitness; points after the last record have its seconds.
    """
    in_seconds = budget.evaluations is None
    most = math.ceil(budget.evaluations or budget.seconds or 0)
    steps = {digit * 10**power for power in range(len(str(most))) for digit in (1, 2, 5)}
    steps |= {-(-most * share // 100) for share in range(1, 101)}
    known = [record for record in history if math.isfinite(record.best_fitness)]
    spent = [record.wall_time if in_seconds else record.evaluations for record in known]
    points = []
    for step in sorted(step for step in steps if known and step <= min(most, until)):
        last = known[max(bisect_right(spent, step + ROUNDING) - 1, 0)]
        reached = known[min(bisect_left(spent, step - ROUNDING), len(known) - 1)]
        points.append((step, last.best_fitness, reached.wall_time))
    return points
