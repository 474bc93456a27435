"""What every optimiser shares: the budget, the books, and the ask/tell loop."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lmd.checks import FloatArray, InputError, integer, real
from lmd.deployment import Deployment
from lmd.problem import CoverageProblem


@dataclass(frozen=True)
class Budget:
    """What a run may spend.

    Args:
        evaluations: full evaluations of a deployment; never exceeded.
        seconds: wall time after which no new evaluation starts; None for no limit.

    Raises:
        InputError: a limit is not positive.
    """

    evaluations: int
    seconds: float | None = None

    def __post_init__(self) -> None:
        integer("budget.evaluations", self.evaluations, low=1)
        if self.seconds is not None:
            real("budget.seconds", self.seconds, above=0.0)


@dataclass(frozen=True)
class Record:
    """The state of a run after some evaluations."""

    evaluations: float
    best_fitness: float
    wall_time: float


@dataclass
class Books:
    """What has been spent and found so far; survives in a checkpoint."""

    evaluations: int = 0
    seconds: float = 0.0
    best_fitness: float = -math.inf
    best_genes: FloatArray | None = None
    history: list[Record] = field(default_factory=list)

    def enter(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Book a batch: genes `(B, dim)` and their fitness `(B,)`."""
        self.evaluations += len(genes)
        best = int(np.argmax(fitness))
        if fitness[best] > self.best_fitness:
            self.best_fitness, self.best_genes = float(fitness[best]), genes[best].copy()
        self.history.append(Record(self.evaluations, self.best_fitness, self.seconds))


@dataclass(frozen=True)
class Result:
    """The outcome of a run.

    Args:
        deployment: the best deployment found.
        fitness: its fitness.
        evaluations: full evaluations spent.
        seconds: wall time spent, over all sittings of a resumed run.
        history: best fitness against evaluations and wall time.
        stopped: `budget` when the budget is used up, `interrupted` when the callback asked to stop.
    """

    deployment: Deployment
    fitness: float
    evaluations: float
    seconds: float
    history: tuple[Record, ...]
    stopped: str


# Called after every batch; returning True stops the run.
Callback = Callable[["Optimiser"], bool | None]


class Optimiser(ABC):
    """What a pipeline sees.

    Everything needed to go on lives in the instance, which can be pickled: calling `run` on an unpickled optimiser
    continues where it stopped.

    Args:
        seed: seeds the one random generator of the run.
    """

    def __init__(self, seed: int = 0) -> None:
        self.seed = integer("seed", seed, low=0)
        self.books = Books()

    @abstractmethod
    def run(self, problem: CoverageProblem, budget: Budget, callback: Callback | None = None) -> Result:
        """Maximise `problem` within `budget`; deterministic for a given seed and problem."""


class AskTell(Optimiser):
    """Optimisers that propose batches of genes and are told their fitness.

    Subclasses write `_ask` and `_tell` only. Before the first `_ask`, `run` sets

    - `self.dim`: number of genes,
    - `self.rng`: a `numpy.random.Generator`, the only source of randomness to use,
    - `self.start`: `(S, dim)` genes to start from, 1 <= S <= `self.start_size`.

    Args:
        seed: see `Optimiser`.
        encoding: how genes describe landmarks (`wall` or `paper`); None leaves the problem's own.
    """

    # How many starting deployments the method can use.
    start_size = 1
    dim: int
    rng: np.random.Generator
    start: FloatArray

    def __init__(self, seed: int = 0, encoding: str | None = None) -> None:
        super().__init__(seed)
        self.encoding = encoding

    @abstractmethod
    def _ask(self) -> FloatArray:
        """Propose genes `(B, dim)` in the unit box, B >= 1."""

    @abstractmethod
    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Learn the fitness `(B,)` of the genes just asked for; never NaN, a failed evaluation is -inf."""

    def ask(self) -> FloatArray:
        """The next batch, `(B, dim)`, clipped to the unit box."""
        genes = np.atleast_2d(np.asarray(self._ask(), dtype=np.float64))
        if genes.shape[1:] != (self.dim,) or not len(genes):
            raise InputError(f"{type(self).__name__} asked for genes of shape {genes.shape}, not (B, {self.dim}).")
        return np.clip(genes, 0.0, 1.0)

    def tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Book a batch and pass it on; NaN counts as -inf."""
        fitness = np.where(np.isnan(fitness), -np.inf, fitness)
        self.books.enter(genes, fitness)
        self._tell(genes, fitness)

    def run(self, problem: CoverageProblem, budget: Budget, callback: Callback | None = None) -> Result:
        """See `Optimiser.run`. A batch that would exceed the budget is cut short."""
        books = self.books
        if self.encoding is not None:
            problem.use_encoding(self.encoding)
        if not books.evaluations:
            self.dim = problem.dim
            self.rng = np.random.default_rng(self.seed)
            self.start = problem.starting_genes(self.start_size, self.rng)
        clock = time.perf_counter() - books.seconds
        stopped = "budget"
        while books.evaluations < budget.evaluations and not (budget.seconds and books.seconds >= budget.seconds):
            genes = self.ask()
            left = budget.evaluations - books.evaluations
            fitness = problem.evaluate(genes[:left])
            books.seconds = time.perf_counter() - clock
            if len(fitness) < len(genes):  # the method cannot learn from half a batch
                books.enter(genes[:left], np.where(np.isnan(fitness), -np.inf, fitness))
                if callback:
                    callback(self)
                break
            self.tell(genes, fitness)
            if callback and callback(self):
                stopped = "interrupted"
                break
        if books.best_genes is None:
            raise InputError(f"{type(self).__name__} found no deployment: every evaluation failed.")
        return Result(
            deployment=problem.decode(books.best_genes),
            fitness=books.best_fitness,
            evaluations=books.evaluations,
            seconds=books.seconds,
            history=tuple(books.history),
            stopped=stopped,
        )
