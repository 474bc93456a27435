"""Problems: a scene, an objective and a source of start deployments; optimisers maximise the fitness of a problem."""

import math
import reprlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Protocol

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, returned
from lmd.core.threads import MOST_THREADS
from lmd.objectives.base import Objective
from lmd.objectives.crowd import describe_crowd, over_states, seeks_worst, worst_figures
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import DeploymentSource
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

# Seeds every draw of an objective's `Sampling`: the problem does not depend on the seed of an optimiser.
SAMPLING_STREAM = 0x64657369
# Greatest product of landmarks, positions and axes in one call of compiled code, which no signal interrupts.
AT_ONCE = 5 * 10**8


class Genome(Protocol):
    """Encoding of candidates that an optimiser tries (deployments or rigs) as genes: vectors with entries in [0, 1]."""

    @property
    def dim(self) -> int:
        """Number of genes of a candidate."""

    @property
    def varies(self) -> bool:
        """True if `draw_genes` is random, so that two calls can give different genes."""

    def draw_genes(self, rng: np.random.Generator) -> FloatArray:
        """Draw the genes of a candidate to start from, `(dim,)`."""

    def fitness_of_genes(self, genes: FloatArray) -> FloatArray:
        """Fitness `(B,)` of B candidates with the genes `genes` `(B, dim)`; -inf for impossible candidates.

        Raises:
            InputError: the genes have another shape, or lie outside [0, 1].
        """

    def deployment(self, genes: FloatArray) -> Deployment:
        """Landmarks that the genes `(dim,)` of a candidate encode."""

    def rig(self, genes: FloatArray) -> Rig | None:
        """Cameras that the genes `(dim,)` of a candidate encode; None if the scene's camera is fixed."""

    def reached(self, fitness: float) -> None:
        """Receive the best fitness of a checkpoint when a run is resumed.

        An encoding that tests only new best candidates needs this fitness, so that the run goes on as if uninterrupted.
        """


def checked_genes(genes: FloatArray, *shape: int | str) -> FloatArray:
    """Return the genes of one candidate or several as an array.

    Args:
        genes: the genes.
        shape: required length of each axis; a letter for any length.

    Raises:
        InputError: `genes` have another shape, are not numbers, or lie outside [0, 1].
    """
    try:
        if np.iscomplexobj(genes):  # NumPy would drop the imaginary part
            raise TypeError
        given = np.asarray(genes, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"genes must be real numbers, got {reprlib.repr(genes)}.", "genes") from None
    if given.ndim != len(shape) or any(n != m for n, m in zip(shape, given.shape, strict=True) if isinstance(n, int)):
        wanted = ", ".join(map(str, shape)) + "," * (len(shape) == 1)
        raise InputError(f"genes must have the shape ({wanted}), got {given.shape}.", "genes")
    if (wrong := given[~((given >= 0.0) & (given <= 1.0))]).size:
        raise InputError(f"genes must be in [0, 1], got {wrong[0]:g}.", "genes")
    return given


class Problem:
    """Problem of maximising an objective's fitness over deployments of K landmarks.

    `evaluator` evaluates the views from the P positions of the room's grid, with the orientations of the PDF;
    `relevance` `(P,)` has the weights of these positions. With a crowd (people who hide landmarks, in S arrangements or
    states), P counts each position of the grid S times. All reported metrics are computed with these two attributes.
    Optimisers use `fitness_evaluator` and `fitness_relevance`, which are for the objective's random sample of poses.
    Without a sample, they equal `evaluator` and `relevance`.

    Args:
        scene: scene, which is constant.
        objective: objective whose fitness is maximised.
        start: source of the deployments from which an optimiser may start; the source also fixes the number of
            landmarks K.
        threads: number of worker threads, all processors by default; results do not depend on this number.
        fixed: existing landmarks that stay where they are, first in every deployment; the start draws, and optimisers
            move, only the other landmarks. None if no landmark is fixed.

    Raises:
        InputError: K landmarks cannot serve the objective, or the start cannot be drawn. Also if
            `Footprints.checked_fixed` refuses the fixed landmarks, an id occurs twice, or a camera of a rig would be
            outside the room.
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
        weights = scene.room.relevance.weights(scene.room.grid())
        self.relevance = np.tile(weights, len(self.evaluator.positions) // len(weights))
        self.fitness_evaluator, self.fitness_relevance = self.evaluator, self.relevance
        if objective.sampling is not None:
            rng, repeats = np.random.default_rng(SAMPLING_STREAM), self._repeats(1.0)
            self.fitness_evaluator = objective.sampling.evaluator(self.scene, repeats, rng, threads)
            self.fitness_relevance = np.tile(weights, len(self.fitness_evaluator.positions) // len(weights))

    def with_rig(self, rig: Rig, start: DeploymentSource | None = None) -> "Problem":
        """Copy of the problem with the cameras of `rig`, and with the source of starts `start` if one is given.

        Raises:
            InputError: a camera would be outside the room.
        """
        scene = replace(self.scene, camera=rig)
        return Problem(scene, self.objective, start or self.start, self.evaluator.threads, self.fixed)

    @property
    def genome(self) -> Genome | None:
        """Encoding of a problem that varies something other than landmarks, such as cameras; else None.

        For landmarks, each optimiser has its own encoding.
        """
        return None

    @property
    def fixed_count(self) -> int:
        """Number of the K landmarks that are fixed."""
        return 0 if self.fixed is None else len(self.fixed)

    @property
    def free_count(self) -> int:
        """Number of the K landmarks that are to be placed."""
        return self.count - self.fixed_count

    @property
    def sizes(self) -> FloatArray:
        """Edge lengths of all landmarks, `(K,)`, metres; zeros for points."""
        return self.scene.tag.filled(self.edges)

    @property
    def fixed_with_edges(self) -> Deployment | None:
        """The fixed landmarks, each with its edge length; None if no landmark is fixed."""
        if self.fixed is None or self.scene.tag.is_point:
            return self.fixed
        return replace(self.fixed, edges=self.sizes[: self.fixed_count])

    @property
    def free_edges(self) -> FloatArray:
        """Edge lengths of the N landmarks to be placed, `(N,)`, metres, with N = `free_count`.

        NaN stands for the edge of the scene's tag.
        """
        return self.edges[self.fixed_count :]

    @property
    def free_sizes(self) -> FloatArray:
        """Edge lengths of the N landmarks to be placed, `(N,)`, metres, with N = `free_count`; zeros for points."""
        return self.sizes[self.fixed_count :]

    def draw(self, rng: np.random.Generator) -> Deployment:
        """Draw a deployment to start from; each landmark is assigned to a surface, and footprints do not overlap."""
        return self.scene.footprints.draw(self.start, rng, self.fixed)

    def free(self, deployment: Deployment) -> Deployment:
        """The landmarks of a deployment that are to be placed."""
        return deployment[self.fixed_count :]

    def complete(self, free: Deployment) -> Deployment:
        """Concatenate the fixed landmarks, if there are any, and the `free` landmarks."""
        return free if self.fixed is None else self.fixed + free

    def separated(self, deployment: Deployment, size: float = 1.0) -> Deployment | None:
        """Copy of the deployment in which overlapping footprints of landmarks are pushed apart; fixed landmarks stay.

        Args:
            deployment: the deployment; its edge lengths are replaced by those of the problem.
            size: factor on the edge lengths of the footprints.

        Returns:
            the copy; None if the footprints cannot be placed without overlap.
        """
        return self.scene.footprints.separated(replace(deployment, edges=self.edges), size, self.fixed_count)

    def labelled(self, deployment: Deployment) -> Deployment:
        """Copy of an optimised deployment with the labels and edge lengths of the start's landmarks of equal index.

        Landmarks that an optimiser did not move also keep their surveyed poses.
        """
        return replace(deployment, labels=self.labels, surveyed=self.surveyed, edges=self.edges)

    def fitness(self, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """The fitness in [0, 1] of B deployments, `(B,)`; positions and normals are `(B, K, 3)`."""
        each = len(self.fitness_evaluator.positions) * self.fitness_evaluator.axes.shape[1] * positions.shape[1]
        parts, step = [], max(1, AT_ONCE // each)
        for first in range(0, len(positions) or 1, step):
            batch = positions[first : first + step], normals[first : first + step]
            parts.append(self.fitness_from(self._values_of(self.fitness_evaluator, *batch)))
        return np.concatenate(parts)

    def fitness_of(self, deployment: Deployment) -> float:
        """The fitness of one deployment."""
        return float(self.fitness_from(self._values(self.fitness_evaluator, deployment)))

    def fitness_from(self, values: FloatArray) -> FloatArray:
        """Fitness `(...)` computed from the objective's values `(..., Q)` at the Q positions of `fitness_evaluator`."""
        fitness = over_states(self.objective, values, self.fitness_evaluator, self.fitness_relevance)
        return np.asarray(returned(self.objective, "fitness", fitness, *values.shape[:-1]))

    def values(self, deployment: Deployment) -> FloatArray:
        """The objective's value in [0, 1] at every position of the grid, `(P,)`.

        With a crowd of S states (arrangements of people), the array has all positions in the first state, then all
        positions in the second state, and so on.
        """
        return self._values(self.evaluator, deployment)

    @property
    def places(self) -> FloatArray:
        """Positions of the grid, metres, `(P / S, 3)`, not repeated for the S crowd states (arrangements of people)."""
        return np.asarray(self.evaluator.positions[: len(self.relevance) // self.state_count])

    @property
    def state_count(self) -> int:
        """Number S of crowd states, the arrangements of people who hide landmarks; 1 without a crowd."""
        return 1 if self.scene.crowd is None else len(self.scene.crowd)

    def by_place(self, values: FloatArray) -> FloatArray:
        """Mean of `values` `(P,)` over the S crowd states, at each position of the grid, `(P / S,)`.

        `values` has all positions in the first state (arrangement of people), then in the second. Without a crowd, the
        result equals `values`.
        """
        return np.asarray(values.reshape(self.state_count, -1).mean(axis=0))

    def _values(self, evaluator: Evaluator, deployment: Deployment) -> FloatArray:
        """The objective's value at each position of an evaluator, `(P,)`, for a deployment with its edge lengths."""
        sized, landmarks = evaluator.sized(deployment.edges), (deployment.positions[None], deployment.normals[None])
        return np.asarray(self._values_of(sized, *landmarks)[0])

    def _values_of(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """The objective's values of B deployments `(B, K, 3)` at each position of an evaluator, `(B, P)`."""
        values = self.objective.values(evaluator, positions, normals)
        return np.asarray(returned(self.objective, "values", values, len(positions), len(evaluator.positions)))

    def metrics(self, deployment: Deployment) -> dict[str, float]:
        """The objective's metrics at the positions of the room's grid, and the fitness, keyed by name."""
        return self.figures(self.values(deployment), self.fitness_of(deployment))

    def figures(self, values: FloatArray, fitness: float) -> dict[str, float]:
        """Metrics as returned by `metrics`, for a deployment that has been evaluated already.

        Args:
            values: the objective's values at the positions of the grid, `(P,)`.
            fitness: fitness of the deployment.
        """
        figures = self.objective.figures(values, self.relevance)
        return {**figures, **worst_figures(self.objective, values, self.evaluator), "fitness": fitness}

    def describe(self, figures: Mapping[str, float], count: int) -> dict[str, str]:
        """Describe results of `metrics` as sentences for displays, keyed by label; the fitness comes first.

        Args:
            figures: metrics as returned by `metrics`.
            count: number of landmarks.
        """
        drawn = " at the random poses of the search" if self.objective.sampling is not None else ""
        crowds = " of the worst crowds" if seeks_worst(self.evaluator) else ""
        weighted = ", in which positions count by their relevance" * bool(np.ptp(self.relevance))
        fitness = f"{figures['fitness']:.2%}, the {self.objective.headline.label}{drawn}{crowds}{weighted}"
        described = self.objective.describe(figures, len(self.relevance), count)
        return {"fitness": fitness, **described, **describe_crowd(self.objective, figures, self.evaluator)}

    def resampled(self, share: float, rng: np.random.Generator) -> tuple[Evaluator, FloatArray] | None:
        """Draw a new random sample of positions, as the objective's sampling does.

        Some optimisers change the sample during a run, so that the deployment is not fitted to one sample.

        Args:
            share: fraction of the usual number of positions in each cell of the grid, see `Sampling`; at least one
                position is drawn in each cell.
            rng: random generator of the draw.

        Returns:
            evaluator at the Q positions, and their relevance, `(Q,)`; None if the objective has no sampling.
        """
        sampling = self.objective.sampling
        if sampling is None:
            return None
        evaluator, cells = sampling.evaluator(self.scene, self._repeats(share), rng, threads=1), len(self.places)
        return evaluator, np.tile(self.relevance[:cells], len(evaluator.positions) // cells)

    def _repeats(self, share: float) -> int:
        """Number of random positions to draw in each cell of the grid: `share` of that in `Sampling`, at least one."""
        assert self.objective.sampling is not None, "there is a sampling"
        most = self.objective.sampling.positions
        return max(1, math.ceil(share * (max(most, self.state_count) if seeks_worst(self.evaluator) else most)))

    def settings(self) -> Mapping[str, Any]:
        """Settings that determine the results of `metrics`, keyed by name, for files of results.

        Infinite numbers are replaced by None, because JSON has none.
        """
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
            **({} if scene.crowd is None else {"crowd": _fields(scene.crowd.crowd)}),
            **({} if np.isnan(self.edges).all() else {"edges": _finite(self.edges.tolist())}),
        }


def _fields(part: Any) -> dict[str, Any]:
    """Fields of a dataclass, keyed by name; for another object, its `repr` with the key `name`."""
    return _finite(asdict(part)) if hasattr(part, "__dataclass_fields__") else {"name": repr(part)}


def _finite(value: Any) -> Any:
    """Copy of `value` for JSON: None stands for infinity and NaN, and a text with its shape for an array."""
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}"
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
