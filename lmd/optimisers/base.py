"""Base classes of optimisers: the interface that pipelines use, and a base class for black-box optimisers.

Black-box optimisers propose candidates as vectors of *genes*, numbers in [0, 1] that encode a deployment.
"""

import math
import sys
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, seed_number
from lmd.core.compiled import clock
from lmd.core.memory import check_memory
from lmd.optimisers.encoding import LandmarkGenome
from lmd.optimisers.ledger import Budget, Ledger, Record
from lmd.optimisers.stored import array, deployment, deployment_state
from lmd.problem import Genome, Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig

GENE_BYTES = 8  # memory of a gene
AT_ONCE = 1000  # largest number of evaluations between two checks of the time limit


@dataclass(frozen=True)
class Result:
    """Outcome of an optimiser's run."""

    deployment: Deployment
    """Best deployment found."""
    fitness: float
    """Fitness of `deployment`."""
    evaluations: float
    """Number of full evaluations spent."""
    seconds: float
    """Wall time spent, seconds, summed over all parts of a resumed run, without compilation."""
    history: tuple[Record, ...]
    """Best fitness against evaluations and wall time: a record for each improvement and each end of a batch."""
    stopped: str
    """Reason of the end: `budget` (used up), `interrupted` (by the callback) or `proven` (the result is optimal)."""
    rig: Rig | None = None
    """Best cameras found, if cameras are placed and the deployment is given; otherwise None."""


# Called after every batch; stops the run by returning True.
Callback = Callable[["Optimiser"], bool | None]


class Optimiser(ABC):
    """Interface of optimisers, which pipelines use.

    The object holds the whole state of a run: a second call of `run`, or a call after `restore`, continues the run.

    Args:
        seed: seed of the random generator of the run.
    """

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed_number(seed)
        self.ledger = Ledger()

    @property
    def called(self) -> str:
        """Display name of this optimiser, for messages."""
        return type(self).__name__

    def state(self) -> dict[str, Any]:
        """Return the state of the run as plain data, for a checkpoint; the optimiser's settings are not part of it.

        Plain data are None, numbers, texts, NumPy arrays, and lists and mappings of these; `lmd.optimisers.stored` has
        functions for generators and deployments.

        Raises:
            InputError: the optimiser cannot be checkpointed. This method always raises; subclasses that can be
                checkpointed override it.
        """
        raise InputError("it has no state to be saved")

    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        """Continue from the `state` of another optimiser with equal settings; this optimiser must not have run before.

        Args:
            state: plain data read from a file. The file may be malicious, so each value has to be checked.
            problem: problem of the run.

        Raises:
            InputError: `state` is not valid.
        """
        raise InputError(f"{type(self).__name__} cannot be checkpointed.")

    def check(self, problem: Problem) -> None:
        """Raise `InputError` if this optimiser cannot handle a problem; called before a run writes anything."""
        if problem.genome is not None and type(self).found_rig is Optimiser.found_rig:
            raise InputError(f"{type(self).__name__} places landmarks, not cameras; use a black box.")

    def figures(self) -> Mapping[str, float]:
        """Further metrics of the run, keyed by name, which are recorded in addition to the fitness; none by default."""
        return {}

    @abstractmethod
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        """Maximise the fitness of `problem` within `budget`.

        Unless the budget limits the time, the result depends only on the settings, the seed, the problem and the
        budget.
        """

    @abstractmethod
    def found(self, problem: Problem) -> Deployment | None:
        """Best deployment found until now; None before the first deployment is found."""

    def found_rig(self, problem: Problem) -> Rig | None:
        """Best cameras found until now; None if the optimiser places no cameras, or has found none yet."""
        return None

    def _spend(
        self, problem: Problem, budget: Budget, callback: Callback | None, step: Callable[[float], None],
        spent: Callable[[], float],
    ) -> Result:  # fmt: skip
        """Call `step` until the budget is used up or `callback` stops the run; return the result of the run.

        `step` is called with the spent fraction of the budget. `spent` returns the exact number of evaluations spent,
        because `ledger.evaluations` may have rounding errors.
        """
        while (used := budget.used(spent(), self.ledger.seconds)) < 1.0:
            step(used)
            if callback and callback(self):
                return self.result(problem, "interrupted")
        return self.result(problem, "budget")

    def result(self, problem: Problem, stopped: str) -> Result:
        """Make the result of a run from the ledger and the best deployment; the run may have been interrupted.

        Args:
            problem: problem of the run.
            stopped: reason of the end, see `Result.stopped`.

        Raises:
            InputError: no deployment was found.
        """
        ledger, history, deployment = self.ledger, tuple(self.ledger.history), self.found(problem)
        if deployment is None:
            raise InputError(f"{type(self).__name__} found no deployment: every evaluation failed.")
        labelled, rig = problem.labelled(deployment), self.found_rig(problem)
        return Result(labelled, ledger.best_fitness, ledger.evaluations, ledger.seconds, history, stopped, rig)


class AskTell(Optimiser):
    """Base of optimisers that propose batches of genes (`ask`) and are then told the fitness of these genes (`tell`).

    Genes are numbers in [0, 1] that encode a candidate, that is, a deployment or the mounts of cameras. Overlapping
    tags of a candidate are pushed apart before its evaluation (`lmd.scene.footprints`), without a change of the genes.
    If there is no room for all tags, the evaluation fails.

    Subclasses write `_ask` and `_tell` only. `run` sets three attributes before the first `_ask`:

    - `self.dim`: number of genes.
    - `self.rng`: a `numpy.random.Generator`, the only source of randomness to use.
    - `self.start`: `(S, dim)` genes of S >= 1 candidates to start from, at most `self.start_size` and at most as many
      as the budget can evaluate.

    Args:
        seed: see `Optimiser`.
        encoding: encoding of landmarks, `wall` or `paper` (`lmd.optimisers.encoding`); None for `wall`, unless the
            caller sets the attribute `encoding` before `run`.

    A checkpoint holds the fitness of all batches, but no genes. `restore` repeats all calls of `_ask` and `_tell` with
    this fitness, but evaluates nothing. This reproduces the state of any subclass.
    """

    start_size = 1
    """Largest number of starting candidates that the optimiser can use."""
    flush = True
    """True if landmarks lie flat on their surface; a caller may set it before `run`."""
    dim: int
    rng: np.random.Generator
    start: FloatArray

    def __init__(self, seed: int = 0, encoding: str | None = None) -> None:
        super().__init__(seed)
        self.encoding = encoding
        self.best_genes: FloatArray | None = None
        self.told: list[tuple[int, FloatArray, float]] = []  # of each batch: checksum of genes, fitness, seconds spent

    @abstractmethod
    def _ask(self) -> FloatArray:
        """Return the genes, `(B, dim)`, in the unit box, of the next B >= 1 candidates to evaluate."""

    @abstractmethod
    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Take the fitness `(B,)` of the genes of the last `_ask`; -inf for a failed evaluation, never NaN."""

    def ask(self) -> FloatArray:
        """Return the genes of the next batch, `(B, dim)`, clipped to the unit box.

        Raises:
            InputError: `_ask` did not return genes of the right shape.
        """
        asked = self._ask()
        try:
            genes = np.atleast_2d(np.asarray(asked, dtype=np.float64))
        except (TypeError, ValueError):
            raise InputError(f"{self.called} proposed {asked!r}, not an array of genes (B, {self.dim}).") from None
        if genes.shape[1:] != (self.dim,) or not len(genes):
            raise InputError(f"{self.called} proposed genes of shape {genes.shape}, not (B, {self.dim}).")
        if missing := int(np.isnan(genes).sum()):
            when = f"after {self.ledger.evaluations:g} evaluations"
            raise InputError(f"{self.called} proposed NaN for {missing} of {genes.size} genes, {when}.")
        return np.clip(genes, 0.0, 1.0)

    def tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Record the `fitness` `(B,)` of `genes` `(B, dim)`, and pass both to `_tell`; NaN counts as -inf."""
        self._tell(genes, self._note(genes, fitness))

    def _note(self, genes: FloatArray, fitness: FloatArray) -> FloatArray:
        """Record the fitness of a batch without passing it to `_tell`; return the fitness with NaN replaced by -inf."""
        fitness = np.where(np.isnan(fitness), -np.inf, fitness)
        self.told.append((_checksum(genes), fitness.copy(), self.ledger.seconds))
        if (best := self.ledger.note_batch(fitness)) is not None:
            self.best_genes = genes[best].copy()
        return fitness

    def _note_or_tell(self, genes: FloatArray, fitness: FloatArray, asked: int) -> None:
        """Record a batch of evaluated candidates, and pass the batch to `_tell` if it is complete.

        `asked` is the number of candidates that were proposed. At the end of the budget only a part of them is
        evaluated.
        """
        if len(genes) == asked:
            self.tell(genes, fitness)
        else:  # `_tell` needs a complete batch
            self._note(genes, fitness)

    @override
    def state(self) -> dict[str, Any]:
        return {
            "checksums": np.array([checksum for checksum, _, _ in self.told], dtype=np.uint32),
            "batches": np.array([len(fitness) for _, fitness, _ in self.told], dtype=np.int64),
            "fitness": np.concatenate([np.empty(0), *(fitness for _, fitness, _ in self.told)]),
            "wall_time": np.array([seconds for _, _, seconds in self.told], dtype=np.float64),
            "starts": np.array([len(self.start) if self.told else 0], dtype=np.int64),
        }

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        """See `Optimiser.restore`. All calls of `_ask` and `_tell` are repeated, which takes their computing time."""
        checksums = array("checksums", state["checksums"], np.uint32, None)
        seconds = array("wall_time", state["wall_time"], np.float64, len(checksums), low=0.0)
        batches = array("batches", state["batches"], np.int64, len(checksums), low=1)
        fitness = array("fitness", state["fitness"], np.float64, int(batches.sum()), low=-math.inf)
        if not len(checksums):
            return
        starts = array("starts", state["starts"], np.int64, 1, low=1, high=self.start_size)
        self._draw_start(problem, Budget(int(starts[0])))
        told = np.split(fitness, np.cumsum(batches))[:-1]
        for checksum, known, by_then in zip(checksums.tolist(), told, seconds.tolist(), strict=True):
            genes = self.ask()
            asked, genes = len(genes), genes[: len(known)]
            if len(genes) < len(known) or _checksum(genes) != checksum:
                raise InputError(
                    f"{type(self).__name__} cannot be resumed: it proposes other genes than the checkpoint has, as may "
                    "happen after a change of its library, or if random numbers are not from self.rng."
                )
            self.ledger.seconds = by_then
            self._note_or_tell(genes, known, asked)
        self._genome(problem).reached(self.ledger.best_fitness)

    def _draw_start(self, problem: Problem, budget: Budget) -> None:
        """Set `dim` (number of genes), `rng` (random generator) and `start` (genes of the first candidates).

        There are at most as many first candidates as the budget can evaluate.
        """
        genome = self._genome(problem)
        self.dim = genome.dim
        taken = f"optimiser: {self.start_size} candidates of {self.dim} genes at a time"
        check_memory(GENE_BYTES * self.start_size * self.dim, taken)
        self.rng = np.random.default_rng(self.seed)
        began, start = clock(), [genome.draw_genes(self.rng)]
        while genome.varies and len(start) < self.start_size and budget.used(len(start), clock() - began) < 1.0:
            start.append(genome.draw_genes(self.rng))
        self.start = np.stack(start)

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        """Propose genes, evaluate them and record their fitness, until the budget is used up.

        A batch that would exceed the budget is cut short.
        """
        ledger, genome = self.ledger, self._genome(problem)
        began = clock() - ledger.seconds
        if not ledger.evaluations:
            self._draw_start(problem, budget)
            if genome.varies and len(self.start) < self.start_size:
                drawn = f"the budget allows {len(self.start)} of its {self.start_size} start candidates"
                print(f"note: {self.called}: {drawn}; no generation will be complete", file=sys.stderr)

        def step(_: float) -> None:
            genes = self.ask()
            asked = len(genes)
            genes = genes[: int(min(asked, budget.limit - ledger.evaluations))]
            parts = []
            for first in range(0, len(genes), AT_ONCE):
                parts.append(genome.fitness_of_genes(genes[first : first + AT_ONCE]))
                ledger.seconds = clock() - began
                if budget.used(0, ledger.seconds) >= 1.0:
                    break
            fitness = np.concatenate(parts)
            self._note_or_tell(genes[: len(fitness)], fitness, asked)

        return self._spend(problem, budget, callback, step, lambda: ledger.evaluations)

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return None if self.best_genes is None else self._genome(problem).deployment(self.best_genes)

    @override
    def found_rig(self, problem: Problem) -> Rig | None:
        return None if self.best_genes is None else self._genome(problem).rig(self.best_genes)

    def _genome(self, problem: Problem) -> Genome:
        return problem.genome or LandmarkGenome(problem, self.encoding or "wall", self.flush)


def _checksum(genes: FloatArray) -> int:
    return zlib.crc32(genes.tobytes())


class DeploymentSearch(Optimiser):
    """Optimiser that evaluates one deployment at a time and keeps the best deployment."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.best: Deployment | None = None

    @override
    def state(self) -> dict[str, Any]:
        """See `Optimiser.state`; the data are the history and the best deployment. Subclasses add their own data."""
        return {**self.ledger.state(), "best": None if self.best is None else deployment_state(self.best)}

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        self.ledger = Ledger.of(state)
        if self.ledger.history:
            self.best = deployment("best", state["best"], problem, problem.count)

    @override
    def found(self, problem: Problem) -> Deployment | None:
        return self.best

    def _record(self, problem: Problem, evaluations: float, deployment: Deployment | None, began: float) -> None:
        """Evaluate a deployment, and record its fitness and the evaluations and time spent until now.

        Args:
            problem: problem of the run.
            evaluations: number of full evaluations spent since the beginning of the run.
            deployment: deployment to be evaluated; None to evaluate nothing.
            began: time of `clock`, seconds, at which the run would have begun if it had never been paused.
        """
        fitness = -math.inf if deployment is None else problem.fitness_of(deployment)
        self.ledger.seconds = clock() - began
        if self.ledger.note(evaluations, fitness):
            self.best = deployment
