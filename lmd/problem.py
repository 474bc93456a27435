"""The one fitness interface: a scene, an objective and a start as a problem that every optimiser can take."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Protocol

import numpy as np

from lmd.core.checks import FloatArray, integer
from lmd.core.threads import MOST_THREADS
from lmd.objectives.base import Objective
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import DeploymentSource
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

# Seeds every draw of an objective's `Sampling`: every seed of an optimiser gives one problem.
SAMPLING_STREAM = 0x64657369


class Genome(Protocol):
    """Candidates of a problem, such as deployments or the cameras of a rig, as vectors in the unit box."""

    @property
    def dim(self) -> int:
        """Number of genes of a candidate."""

    @property
    def varies(self) -> bool:
        """True if two draws differ."""

    def draw_genes(self, rng: np.random.Generator) -> FloatArray:
        """Draw the genes of a candidate to start from, `(dim,)`."""

    def fitness_of_genes(self, genes: FloatArray) -> FloatArray:
        """Fitness of candidates `(B, dim)`, `(B,)`; -inf for those that are impossible."""

    def deployment(self, genes: FloatArray) -> Deployment:
        """Landmarks of a candidate `(dim,)`."""

    def rig(self, genes: FloatArray) -> Rig | None:
        """Cameras of a candidate `(dim,)`; None where the scene's camera is fixed."""

    def reached(self, fitness: float) -> None:
        """Take over the best fitness of an earlier part of the run, so that going on repeats its decisions."""


class Problem:
    """Maximise the objective's fitness over deployments of K landmarks.

    `evaluator` and `relevance` `(P,)` belong to the room's grid and the PDF; reported figures use them. Optimisers use
    `fitness_evaluator` and `fitness_relevance`, which belong to that grid or to the objective's sampling.

    Args:
        scene: scene, which stays fixed.
        objective: objective, which is maximised.
        start: deployments an optimiser may start from; they also fix the number of landmarks K.
        threads: worker threads, all processors by default; results do not depend on it.
        fixed: landmarks that hang already and stay where they are. They are the first of every deployment; the start
            only draws the others, and optimisers only move those. None for none.

    Raises:
        InputError: K landmarks cannot serve the objective, the start cannot be drawn, the fixed landmarks do not hang
            properly or have the ids of others, or a camera of a rig would be outside the room.
    """

    def __init__(
        self,
        scene: Scene,
        objective: Objective,
        start: DeploymentSource,
        threads: int | None = None,
        fixed: Deployment | None = None,
    ) -> None:
        if threads is not None:
            threads = integer("threads", threads, low=1, high=MOST_THREADS)
        self.scene, self.objective, self.start = scene, objective, start
        self.fixed = None if fixed is None else scene.footprints.checked_fixed(fixed, start)
        first = self.draw(np.random.default_rng(0))
        self.count, self.labels, self.surveyed = len(first), first.labels, first.surveyed
        self.edges, self.scene = first.edges, scene.sized(first.edges_of(scene.tag))
        if not scene.tag.is_point:
            scene.tag.check_ids(first.ids)
        objective.check(self.count)
        self.evaluator = Evaluator(self.scene, threads=threads)
        scene.check_inside(self.evaluator.positions)
        self.relevance = scene.room.relevance.weights(self.evaluator.positions)
        self.fitness_evaluator, self.fitness_relevance = self.evaluator, self.relevance
        if objective.sampling is not None:
            rng, repeats = np.random.default_rng(SAMPLING_STREAM), objective.sampling.positions
            self.fitness_evaluator = objective.sampling.evaluator(self.scene, repeats, rng, threads)
            self.fitness_relevance = np.tile(self.relevance, repeats)

    def with_rig(self, rig: Rig, start: DeploymentSource | None = None) -> "Problem":
        """The problem of landmarks with a rig in place of the cameras, and another start if one is given.

        Raises:
            InputError: a camera would be outside the room.
        """
        scene = replace(self.scene, camera=rig)
        return Problem(scene, self.objective, start or self.start, self.evaluator.threads, self.fixed)

    @property
    def genome(self) -> Genome | None:
        """Own genome of a problem that varies something else than landmarks; None: optimisers encode landmarks."""
        return None

    @property
    def fixed_count(self) -> int:
        """Number of landmarks, of K, that are fixed."""
        return 0 if self.fixed is None else len(self.fixed)

    @property
    def free_count(self) -> int:
        """Number of landmarks, of K, that are to be placed."""
        return self.count - self.fixed_count

    @property
    def sizes(self) -> FloatArray:
        """Edges of all landmarks, `(K,)`, metres; zeros for points."""
        return self.scene.tag.filled(self.edges)

    @property
    def fixed_with_edges(self) -> Deployment | None:
        """The fixed landmarks, each with its edge; None for none."""
        if self.fixed is None or self.scene.tag.is_point:
            return self.fixed
        return replace(self.fixed, edges=self.sizes[: self.fixed_count])

    @property
    def free_edges(self) -> FloatArray:
        """Own edges of the landmarks that are to be placed, `(N,)`, metres, see `Deployment.edges`."""
        return self.edges[self.fixed_count :]

    @property
    def free_sizes(self) -> FloatArray:
        """Edges of the landmarks that are to be placed, `(N,)`, metres; zeros for points."""
        return self.sizes[self.fixed_count :]

    def draw(self, rng: np.random.Generator) -> Deployment:
        """A deployment to start from, its landmarks with their surfaces, its footprints apart."""
        return self.scene.footprints.draw(self.start, rng, self.fixed)

    def free(self, deployment: Deployment) -> Deployment:
        """The landmarks of a deployment that are to be placed."""
        return deployment[self.fixed_count :]

    def complete(self, free: Deployment) -> Deployment:
        """The fixed landmarks, if there are any, and then the `free` ones."""
        return free if self.fixed is None else self.fixed + free

    def separated(self, deployment: Deployment, size: float = 1.0) -> Deployment | None:
        """The deployment with the free footprints pushed out of the way, see `Footprints.separated`."""
        return self.scene.footprints.separated(replace(deployment, edges=self.edges), size, self.fixed_count)

    def labelled(self, deployment: Deployment) -> Deployment:
        """The deployment that an optimiser made of the start: landmark k keeps its label and its edge.

        What stays where it was keeps what was measured of it, too.
        """
        return replace(deployment, labels=self.labels, surveyed=self.surveyed, edges=self.edges)

    def fitness(self, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """The fitness in [0, 1] of B deployments, `(B,)`; landmarks are `(B, K, 3)`. Optimisers maximise it."""
        values = self.objective.values(self.fitness_evaluator, positions, normals)
        return self.objective.fitness(values, self.fitness_relevance)

    def fitness_of(self, deployment: Deployment) -> float:
        """The fitness of one deployment."""
        return float(self.objective.fitness(self._values(self.fitness_evaluator, deployment), self.fitness_relevance))

    def values(self, deployment: Deployment) -> FloatArray:
        """The objective's value at every position of the grid, in [0, 1], `(P,)`."""
        return self._values(self.evaluator, deployment)

    def _values(self, evaluator: Evaluator, deployment: Deployment) -> FloatArray:
        """The objective's value at each position of an evaluator, for the edges of the deployment."""
        sized, landmarks = evaluator.sized(deployment.edges), (deployment.positions[None], deployment.normals[None])
        return np.asarray(self.objective.values(sized, *landmarks)[0])

    def metrics(self, deployment: Deployment) -> dict[str, float]:
        """The objective's figures on the grid, and the fitness."""
        figures = self.objective.figures(self.values(deployment), self.relevance)
        return {**figures, "fitness": self.fitness_of(deployment)}

    def resampled(self, share: float, rng: np.random.Generator) -> tuple[Evaluator, FloatArray] | None:
        """A fresh draw of the objective's sampling with a share of its positions, and their relevance, `(Q,)`.

        For methods that can change what they climb on the way: what is drawn anew cannot be learnt by heart.

        Args:
            share: share of the positions that is drawn in each cell, at least one position.
            rng: draws them.

        Returns:
            None if the objective has no sampling.
        """
        sampling = self.objective.sampling
        if sampling is None:
            return None
        repeats = max(1, math.ceil(share * sampling.positions))
        evaluator = sampling.evaluator(self.scene, repeats, rng, threads=1)
        return evaluator, np.tile(self.relevance, repeats)

    def settings(self) -> Mapping[str, Any]:
        """Settings that the figures of `metrics` depend on, for the record; infinite numbers are None, as in JSON."""
        scene = self.scene
        return {
            "objective": type(self.objective).__name__,
            **_fields(self.objective),
            "landmarks": self.count,
            **({} if self.fixed is None else {"fixed_landmarks": self.fixed_count}),
            "positions": len(self.evaluator.positions),
            "orientations": len(self.evaluator.axis_of),
            "pdf": scene.pdf.name,
            "room": _fields(scene.room),
            "camera": _fields(scene.camera),
            **({} if scene.tag.is_point else {"tag": _fields(scene.tag)}),
            **{key: value for key, value in _fields(scene.visibility).items() if key != "edges"},
            **({} if np.isnan(self.edges).all() else {"edges": self.edges.tolist()}),
        }


def _fields(part: Any) -> dict[str, Any]:
    """The values of a dataclass, or what it says of itself."""
    return _finite(asdict(part)) if hasattr(part, "__dataclass_fields__") else {"name": repr(part)}


def _finite(value: Any) -> Any:
    """A value as JSON takes it: None for infinite numbers, such as a focus at infinity; the shape for arrays."""
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}"
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
