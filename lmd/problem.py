"""The one fitness interface: a scene and an objective as a problem every optimiser can take."""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lmd.checks import FloatArray, InputError, integer, real
from lmd.deployment import Deployment, DeploymentSource
from lmd.optimisers.encoding import make_encoding
from lmd.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.reference import cost, qualified

# Seeds every draw of a `Design`: the problem is the same for every seed of an optimiser.
DESIGN_STREAM = 0x64657369


@dataclass(frozen=True)
class Design:
    """Random positions and orientations for a fitness that the room's grid cannot fool.

    Args:
        positions: drawn in the cell of each position of the room's grid, whose relevance they share.
        divisions: orientations are drawn one in each of 2 `divisions` x `divisions` cells of equal probability, from
            the continuous distribution that the PDF stands for; a PDF from samples is taken as it is.

    Raises:
        InputError: a number is less than 1.
    """

    positions: int = 20
    divisions: int = 18

    def __post_init__(self) -> None:
        integer("objective.design.positions", self.positions, low=1)
        integer("objective.design.divisions", self.divisions, low=1)

    def evaluator(self, scene: Scene, repeats: int, rng: np.random.Generator, threads: int | None) -> Evaluator:
        """The evaluator at a draw of `repeats` positions in each cell, which go through the grid again and again."""
        positions = np.vstack([scene.room.jittered_grid(rng) for _ in range(repeats)])
        return Evaluator(replace(scene, pdf=scene.pdf.stratified(self.divisions, rng)), positions, threads)


@dataclass(frozen=True)
class Objective:
    """What a deployment is for.

    Args:
        n: landmarks the camera must see at the same time.
        thold_p: probability of that from which on a position is qualified.
        design: where the fitness is measured; None for the room's grid and the PDF itself.

    Raises:
        InputError: n < 1 or thold_p outside [0, 1].
    """

    n: int
    thold_p: float
    design: Design | None = None

    def __post_init__(self) -> None:
        integer("objective.n", self.n, low=1)
        object.__setattr__(self, "thold_p", real("objective.thold_p", self.thold_p, low=0.0, high=1.0))


class CoverageProblem:
    """Maximise the relevance-weighted share of positions whose P_n reaches thold_p (Eq. argmaxH, normalised).

    `evaluator` and `relevance` `(P,)` are those of the room's grid and the PDF, for every figure that is reported.
    `fitness_evaluator` and `fitness_relevance` are those an optimiser climbs: the same, or the objective's design.

    Args:
        scene: what stays fixed.
        objective: n and thold_p.
        start: deployments an optimiser may start from; they also fix the number of landmarks K.
        encoding: `wall` or `paper`, how genes describe landmarks.
        flush: landmarks lie flat on their wall.
        threads: worker threads, all processors by default; results do not depend on it.

    Raises:
        InputError: n exceeds K, or the start cannot be drawn.
    """

    def __init__(
        self,
        scene: Scene,
        objective: Objective,
        start: DeploymentSource,
        encoding: str = "wall",
        flush: bool = True,
        threads: int | None = None,
    ) -> None:
        self.scene = scene
        self.objective = objective
        self.start = start
        self.flush = flush
        self.count = len(start.draw(scene.room, np.random.default_rng(0)))
        if objective.n > self.count:
            raise InputError(f"objective.n = {objective.n} exceeds the number of landmarks, {self.count}.")
        if threads is not None:
            integer("threads", threads, low=1)
        self.evaluator = Evaluator(scene, threads=threads)
        self.relevance = scene.room.relevance.weights(self.evaluator.positions)
        self.fitness_evaluator, self.fitness_relevance = self.evaluator, self.relevance
        if objective.design is not None:
            rng, repeats = np.random.default_rng(DESIGN_STREAM), objective.design.positions
            self.fitness_evaluator = objective.design.evaluator(scene, repeats, rng, threads)
            self.fitness_relevance = np.tile(self.relevance, repeats)
        self.encoding = make_encoding(encoding, scene.room, flush)

    def encoded(self, kind: str) -> "CoverageProblem":
        """The same problem with landmarks described by the encoding called `kind`."""
        other = copy(self)
        other.encoding = make_encoding(kind, self.scene.room, self.flush)
        return other

    @property
    def dim(self) -> int:
        """Number of genes L."""
        return self.count * self.encoding.genes_per_landmark

    def evaluate(self, genes: FloatArray) -> FloatArray:
        """Fitness in [0, 1] of genes `(B, dim)` in the unit box, shape `(B,)`, to maximise."""
        positions, normals = self.encoding.decode(np.asarray(genes, dtype=np.float64))
        units = self.fitness_evaluator.units(positions, normals, self.objective.n)
        is_qualified = qualified(units / PROBABILITY_ONE, self.objective.thold_p)
        # A product and a sum over the last axis: each row is added in the same order whatever the batch.
        return np.asarray((is_qualified * self.fitness_relevance).sum(axis=1) / self.fitness_relevance.sum())

    def decode(self, genes: FloatArray) -> Deployment:
        """The deployment described by genes `(dim,)`."""
        positions, normals = self.encoding.decode(np.asarray(genes, dtype=np.float64)[None])
        return Deployment(positions[0], normals[0])

    def encode(self, deployment: Deployment) -> FloatArray:
        """Genes `(dim,)` that describe `deployment`."""
        return self.encoding.encode(deployment)

    def starting_genes(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Genes of up to `size` starting deployments, `(S, dim)`; one if the start does not vary."""
        draws = size if self.start.varies else 1
        return np.stack([self.encode(self.start.draw(self.scene.room, rng)) for _ in range(draws)])

    def resampled(self, share: float, rng: np.random.Generator) -> tuple[Evaluator, FloatArray] | None:
        """A fresh draw of the objective's design with a share of its positions, and their relevance, `(Q,)`.

        For methods that can change what they climb on the way: what is drawn anew cannot be learnt by heart.

        Args:
            share: of the design's positions in each cell, at least one of them.
            rng: draws them.

        Returns:
            None if the objective has no design.
        """
        design = self.objective.design
        if design is None:
            return None
        repeats = max(1, math.ceil(share * design.positions))
        evaluator = design.evaluator(self.scene, repeats, rng, threads=1)
        return evaluator, np.tile(self.relevance, repeats)

    def probabilities(self, deployment: Deployment) -> FloatArray:
        """P_n at every position of the grid, `(P,)`."""
        return self.evaluator.probabilities(deployment, self.objective.n)

    def fitness(self, deployment: Deployment) -> float:
        """Fitness in [0, 1] of `deployment`."""
        probability = self.fitness_evaluator.probabilities(deployment, self.objective.n)
        total = cost(qualified(probability, self.objective.thold_p), self.fitness_relevance)
        return total / float(self.fitness_relevance.sum())

    def metrics(self, deployment: Deployment) -> dict[str, float]:
        """The paper's three indices and H on the grid, and the fitness (fractions in [0, 1]; H is a sum)."""
        probability = self.probabilities(deployment)
        is_qualified = qualified(probability, self.objective.thold_p)
        return {
            "qualified_ratio": float(is_qualified.mean()),
            "average_coverage_probability": float(probability.mean()),
            "maximum_coverage_probability": float(probability.max()),
            "cost": cost(is_qualified, self.relevance),
            "fitness": self.fitness(deployment),
        }

    def settings(self) -> Mapping[str, Any]:
        """What the figures of `metrics` depend on, for the record."""
        room = self.scene.room
        return {
            **asdict(self.objective),
            "landmarks": self.count,
            "positions": len(self.evaluator.positions),
            "orientations": len(self.evaluator.axis_of),
            "pdf": self.scene.pdf.name,
            "room": asdict(room),
            "camera": asdict(self.scene.camera),
            **asdict(self.scene.visibility),
        }
