"""Counts and probabilities of many deployments in one scene, on the fast exact path."""

import copy
import math
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.bits import in_words
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels
from lmd.core.memory import check_views
from lmd.core.threads import available_threads, in_parts
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight import kernels
from lmd.sight.blocks import BLOCK, in_blocks
from lmd.sight.directions import height_index, tables
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.mounts import Part, parts_of, with_sight
from lmd.sight.obstacles import obstacles_at
from lmd.sight.reference import ReferenceViews
from lmd.sight.rig_views import RigViews

SIZES = 16  # sets of edges whose evaluators are kept
COUNT_BYTES = 4  # of a view, twice two: the counts of axes, and of orientations of the PDF


def in_units(probability: FloatArray) -> IntArray:
    """Probabilities `(N, D)` in whole units; what rounding leaves over in a row goes to its heaviest axis."""
    weights = np.rint(probability * PROBABILITY_ONE).astype(np.int64)
    rows = np.arange(len(weights))
    weights[rows, weights.argmax(axis=1)] += PROBABILITY_ONE - weights.sum(axis=1)
    return weights


def averaged(values: FloatArray | BoolArray, probability: FloatArray) -> FloatArray:
    """The mean over axes of `values` `(P, D)` with the probabilities `(1, D)` or `(P, D)`, `(P,)`."""
    if len(probability) == 1:
        return np.asarray(values @ probability[0])
    return np.asarray(np.einsum("pd,pd->p", values, probability))


class Evaluator:
    """Evaluates deployments at every position of a scene.

    Args:
        scene: what stays fixed.
        positions: `(P, 3)` camera positions, metres; the room's grid by default.
        threads: worker threads; all available processors by default. Results do not depend on it.
        by_reference: whether NumPy decides instead of kernels; so it is where criteria have no compiled half.
    """

    def __init__(
        self,
        scene: Scene,
        positions: FloatArray | None = None,
        threads: int | None = None,
        by_reference: bool = False,
    ) -> None:
        self.scene = scene
        self.positions = for_kernels(scene.room.grid() if positions is None else positions)
        self._low, self._high = self.positions.min(axis=0), self.positions.max(axis=0)
        self.threads = threads or available_threads()
        axes, self.axis_of, _ = scene.orientations
        self.axes = in_words(axes.T)
        self.bands = height_index(axes[:, 2])
        self.weights = in_units(in_words(scene.probability(self.positions)))
        self._sized: dict[tuple[float, ...], Evaluator] = {}
        self.parts: tuple[Part, ...] = ()
        self.views: RigViews | ReferenceViews | None = None  # instead of the kernels for a single camera
        if by_reference or not scene.is_compiled:
            self.views = ReferenceViews(scene, self.positions)
            return
        blockers, self.parts = scene.room.blockers(), parts_of(scene)
        if self.parts:
            self.views = RigViews(self.parts, blockers, self.positions, self.threads)
        else:
            self.sight, self.obstacles = scene.sight, obstacles_at(blockers, self.positions)

    def sized(self, edges: FloatArray) -> "Evaluator":
        """The same for landmarks with these edges, see `Scene.sized`."""
        scene = self.scene.sized(edges)
        if scene is self.scene:
            return self
        key = scene.edges or ()
        if len(self._sized) >= SIZES:
            self._sized.clear()
        if key not in self._sized and scene.largest_edge > self.scene.largest_edge:
            # What is looked up is made for the largest.
            self._sized[key] = Evaluator(scene, self.positions, self.threads)
        elif key not in self._sized:
            other = copy.copy(self)
            other.scene, other._sized = scene, {}
            if self.by_reference:
                other.views = ReferenceViews(scene, self.positions)
            elif isinstance(self.views, RigViews):
                kinds = dict.fromkeys(scene.cameras)
                sights = (scene.visibility.sight(kind) for kind in kinds)
                other.parts = tuple(with_sight(part, sight) for part, sight in zip(self.parts, sights, strict=True))
                other.views = RigViews(other.parts, self.views.blockers, self.positions, self.threads)
            else:
                other.sight = scene.sight
            self._sized[key] = other
        return self._sized[key]

    @property
    def by_reference(self) -> bool:
        """True if NumPy decides instead of kernels."""
        return isinstance(self.views, ReferenceViews)

    @property
    def probability(self) -> FloatArray:
        """Of each axis, `(1, 64 W)` where it is the same at all positions, else `(P, 64 W)`."""
        return np.asarray(self.weights / PROBABILITY_ONE)

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Which axes surely cover, and may cover, a landmark in each direction (`lmd.sight.directions.tables`)."""
        return tables(self.sight, self.axes)

    @cached_property
    def blocks(self) -> tuple[IntArray, IntArray]:
        """The positions by blocks of neighbours, see `in_blocks`."""
        return in_blocks(self.positions)

    def check_memory(self, each: float) -> None:
        """Raise `InputError` if `each` bytes of every position and axis do not fit into memory."""
        check_views(each, len(self.positions), self.axes.shape[1])

    def counts(self, deployment: Deployment) -> np.ndarray:
        """Landmarks covered at every position and orientation of the PDF, `(P, A)` int16."""
        landmarks = deployment.positions[None], deployment.normals[None]
        _, counts = self.sized(deployment.edges)._evaluate(*landmarks, 1, keep=True)
        return np.asarray(counts[0][:, self.axis_of])

    def units(self, positions: FloatArray, normals: FloatArray, n: int) -> np.ndarray:
        """P_n at every position in units of 1 / `PROBABILITY_ONE`.

        Args:
            positions, normals: `(B, K, 3)` landmarks of B deployments.
            n: landmarks that must be covered.

        Returns:
            `(B, P)` int64.
        """
        return self._evaluate(positions, normals, n, keep=False)[0]

    def probabilities(self, deployment: Deployment, n: int) -> FloatArray:
        """P_n at every position, `(P,)`."""
        landmarks = deployment.positions[None], deployment.normals[None]
        units = self.sized(deployment.edges).units(*landmarks, n)
        return np.asarray(units[0] / PROBABILITY_ONE)

    def _evaluate(
        self, positions: FloatArray, normals: FloatArray, n: int, keep: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """P_n in units `(B, P)`, and with `keep` the counts `(B, P, D)`; positions are shared between threads."""
        size, axes = len(self.positions), self.axes.shape[1]
        if keep:
            self.check_memory(COUNT_BYTES * len(positions))
        units = np.empty((len(positions), size), dtype=np.int64)
        counts = np.zeros((len(positions), size, axes) if keep else (0, 0, 0), dtype=np.int16)
        if self.views is not None:
            self.scene.check_count(positions.shape[1])
            for b, (landmarks, facing) in enumerate(zip(positions, normals, strict=True)):
                kept = counts[b] if keep else counts[0:0].reshape(0, 0)
                units[b] = self.views.evaluate(landmarks, facing, self.weights, n, kept)
            return units, counts
        self.by_blocks(kernels.evaluate_range, (*self.batch(positions, normals), n, units, counts, keep))
        return units, counts

    def batch(self, positions: FloatArray, normals: FloatArray) -> tuple[Any, ...]:
        """What kernels take of the scene and of B deployments `(B, K, 3)`: `order` to `weights` of `evaluate_range`."""
        self.scene.check_count(positions.shape[1])
        landmarks = tuple(for_kernels(v.transpose(0, 2, 1)) for v in (positions, normals))
        sight = self.sight.among(self._low, self._high, *landmarks)
        tables = self.tables if self.sight.tabulated else None
        seen = (sight, horizon_of(sight), self.obstacles, self.axes, self.bands, tables, self.weights)
        return self.blocks[0][: len(self.positions)], self.positions, *landmarks, *seen

    def by_blocks(self, kernel: Any, fixed: tuple[Any, ...], each: int = 1) -> None:
        """Run `kernel(first, last, *fixed)` over blocks of positions, so many parts for each thread."""
        size = len(self.positions)

        def job(first: int, last: int) -> None:
            kernel(first * BLOCK, min(last * BLOCK, size), *fixed)

        in_parts(self.threads, job, math.ceil(size / BLOCK), self.threads * each)
