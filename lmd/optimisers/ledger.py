"""What a run may spend, and what it has spent and found so far."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from lmd.core.checks import InputError, check_fields, integer, real
from lmd.optimisers.stored import array


@dataclass(frozen=True)
class Budget:
    """What a run may spend.

    Args:
        evaluations: full evaluations of a deployment, never exceeded; one moved landmark counts 1/K. None for no
            limit.
        seconds: wall time after which no new evaluation starts, not counting what the compiler takes; None for no
            limit.

    Raises:
        InputError: a limit is not positive, or there is none.
    """

    evaluations: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        if self.evaluations is None and self.seconds is None:
            raise InputError("evaluations or seconds must be given.", "evaluations")
        if self.evaluations is not None:
            check_fields(self, integer, "evaluations", low=1)
        if self.seconds is not None:
            real("seconds", self.seconds, above=0.0)

    @property
    def limit(self) -> float:
        """Evaluations allowed, infinity for no limit."""
        return math.inf if self.evaluations is None else self.evaluations

    def used(self, evaluations: float, seconds: float) -> float:
        """Share of the budget that is spent, by whichever limit is nearer; 1 or more when it is used up."""
        return max(evaluations / self.limit, seconds / (self.seconds or math.inf))


@dataclass(frozen=True)
class Record:
    """The state of a run after some evaluations."""

    evaluations: float
    best_fitness: float
    wall_time: float


@dataclass
class Ledger:
    """What has been spent and found so far; survives in a checkpoint."""

    evaluations: float = 0
    seconds: float = 0.0
    best_fitness: float = -math.inf
    history: list[Record] = field(default_factory=list)

    def note(self, evaluations: float, fitness: float) -> bool:
        """Note that `evaluations` are spent by now and the last of them reached `fitness`; True if that is the best."""
        is_best = fitness > self.best_fitness
        self.evaluations, self.best_fitness = evaluations, fitness if is_best else self.best_fitness
        self.history.append(Record(evaluations, self.best_fitness, self.seconds))
        return is_best

    def state(self) -> dict[str, Any]:
        """The history as arrays `(N,)`, for a checkpoint; it says all the rest."""
        return {f.name: np.array([getattr(r, f.name) for r in self.history], dtype=float) for f in fields(Record)}

    @classmethod
    def of(cls, state: Mapping[str, Any]) -> "Ledger":
        """The ledger with the `state` of another.

        Raises:
            InputError: it is none.
        """
        evaluations = array("evaluations", state["evaluations"], np.float64, None, low=0.0)
        best = array("best_fitness", state["best_fitness"], np.float64, len(evaluations), low=-math.inf)
        seconds = array("wall_time", state["wall_time"], np.float64, len(evaluations), low=0.0)
        if (evaluations[1:] < evaluations[:-1]).any() or (best[1:] < best[:-1]).any():
            raise InputError("the history must not fall.")
        ledger = cls()
        for spent, fitness, by_then in zip(evaluations.tolist(), best.tolist(), seconds.tolist(), strict=True):
            ledger.seconds = by_then
            ledger.note(spent, fitness)
        return ledger
