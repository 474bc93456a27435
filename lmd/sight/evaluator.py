"""Counts of covered landmarks and probabilities P_n of deployments at every position of a scene."""

import copy
import math
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.bits import in_words
from lmd.core.checks import BoolArray, FloatArray, IntArray, returned
from lmd.core.compiled import for_kernels
from lmd.core.memory import check_views
from lmd.core.threads import available_threads, in_parts
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight import kernels
from lmd.sight.blocks import BLOCK, in_blocks
from lmd.sight.crowd import obstacles_of
from lmd.sight.directions import height_index, tables
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.mounts import MountGroup, mount_groups, with_sight
from lmd.sight.reference import ReferenceViews
from lmd.sight.rig_views import RigViews

SIZES = 16  # greatest number of cached evaluators, one per set of tag sizes; a further set clears the cache
COUNT_BYTES = 4  # memory of a view: two int16 counts, for the axis and for the orientation of the PDF


def quantised(probability: FloatArray) -> IntArray:
    """Round each row of probabilities `(N, D)` to integers with the sum `PROBABILITY_ONE`, `(N, D)`.

    The rounding remainder of a row is added to its largest entry.
    """
    weights = np.rint(probability * PROBABILITY_ONE).astype(np.int64)
    rows = np.arange(len(weights))
    weights[rows, weights.argmax(axis=1)] += PROBABILITY_ONE - weights.sum(axis=1)
    return weights


def averaged(values: FloatArray | BoolArray, probability: FloatArray) -> FloatArray:
    """Mean of `values` `(P, D)` over D orientations of the camera, for each of P positions, `(P,)`.

    The weights are `probability`: a row for all positions, `(1, D)`, or a row for each position, `(P, D)`.
    """
    if len(probability) == 1:
        return np.asarray(values @ probability[0])
    return np.asarray(np.einsum("pd,pd->p", values, probability))


class Evaluator:
    """Computes numbers of covered landmarks and the probability P_n of deployments at every position of a scene.

    P_n is the probability that a randomly oriented camera covers at least n landmarks of the deployment.

    Args:
        scene: room, cameras, orientations and criteria.
        positions: `(P, 3)` camera positions, metres; the room's grid by default.
        threads: worker threads; all available processors by default. Results do not depend on the number.
        by_reference: True to use the NumPy reference instead of kernels. Criteria without a compiled model of sight
            always use the reference.
        states: crowd state at each position, `(P,)`; by default each position is repeated for all crowd states, in the
            order of the states.
    """

    def __init__(
        self,
        scene: Scene,
        positions: FloatArray | None = None,
        threads: int | None = None,
        by_reference: bool = False,
        states: IntArray | None = None,
    ) -> None:
        self.scene = scene
        places = returned(scene.room, "grid", scene.room.grid(), None, 3) if positions is None else positions
        if scene.crowd is not None and states is None:
            states = np.repeat(np.arange(len(scene.crowd)), len(places))
            places = np.tile(places, (len(scene.crowd), 1))
        self.positions, self.states = for_kernels(places), states
        self._low, self._high = self.positions.min(axis=0), self.positions.max(axis=0)
        self.threads = threads or available_threads()
        axes, self.axis_of, _ = scene.orientations
        self.axes = in_words(axes.T)
        self.bands = height_index(axes[:, 2])
        self.weights = quantised(in_words(scene.probability(self.positions)))
        self._sized: dict[tuple[float, ...], Evaluator] = {}
        self.groups: tuple[MountGroup, ...] = ()
        self.views: RigViews | ReferenceViews | None = None  # None for a single camera, whose kernels this class calls
        if by_reference or not scene.is_compiled:
            self.views = ReferenceViews(scene, self.positions, states)
            return
        blockers, self.groups = scene.room.blockers(), mount_groups(scene)
        if self.groups:
            self.views = RigViews(self.groups, blockers, self.positions, self.threads)
        else:
            self.sight, self.obstacles = scene.sight, obstacles_of(scene, self.positions, states)

    def sized(self, edges: FloatArray) -> "Evaluator":
        """Evaluator of the scene for tags with the edge lengths `edges` `(K,)`, metres, see `Scene.sized`.

        Recent evaluators are cached.
        """
        scene = self.scene.sized(edges)
        if scene is self.scene:
            return self
        key = scene.edges or ()
        if len(self._sized) >= SIZES:
            self._sized.clear()
        if key not in self._sized and scene.largest_edge > self.scene.largest_edge:
            # Tables and obstacles are made for the largest tag.
            self._sized[key] = Evaluator(scene, self.positions, self.threads, states=self.states)
        elif key not in self._sized:
            other = copy.copy(self)
            other.scene, other._sized = scene, {}
            if self.by_reference:
                other.views = ReferenceViews(scene, self.positions, self.states)
            elif isinstance(self.views, RigViews):
                kinds = dict.fromkeys(scene.cameras)
                sights = (scene.visibility.sight(kind) for kind in kinds)
                other.groups = tuple(with_sight(group, sight) for group, sight in zip(self.groups, sights, strict=True))
                other.views = RigViews(other.groups, self.views.blockers, self.positions, self.threads)
            else:
                other.sight = scene.sight
            self._sized[key] = other
        return self._sized[key]

    @property
    def by_reference(self) -> bool:
        """True if the NumPy reference is used instead of kernels."""
        return isinstance(self.views, ReferenceViews)

    def scene_at(self, p: int) -> Scene:
        """Scene reduced to the crowd state of position p if the NumPy reference is used, else the whole scene."""
        return self.views.scene_at(p) if isinstance(self.views, ReferenceViews) else self.scene

    @property
    def probability(self) -> FloatArray:
        """Probability of each axis: one row `(1, 64 W)` for all positions, or a row for each position, `(P, 64 W)`.

        An axis is a distinct orientation of the camera. Zeros pad each row to the 64 W bits of W words.
        """
        return np.asarray(self.weights / PROBABILITY_ONE)

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Tables of the axes that certainly and that possibly have a landmark in view, see `directions.tables`."""
        return tables(self.sight, self.axes)

    @cached_property
    def blocks(self) -> tuple[IntArray, IntArray]:
        """Order of the positions in blocks of neighbours: the results `order` and `index_of` of `in_blocks`."""
        return in_blocks(self.positions)

    def check_memory(self, each: float) -> None:
        """Raise `InputError` if `each` bytes for every pair of position and axis do not fit into memory."""
        check_views(each, len(self.positions), self.axes.shape[1])

    def by_place(self, weight: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
        """Join the S rows that an array has for one camera position, one for each crowd state, to one row.

        The P rows of the arguments are the camera positions, repeated for each crowd state. The columns are D
        orientations. Probabilities `weight`, `(1, D)` or `(P, D)`, are divided by S and become `(P / S, S D)`. `values`
        `(P, D)` become `(P / S, S D)`. Without a crowd, the arguments are returned unchanged.
        """
        if self.scene.crowd is None:
            return weight, *values
        states = len(self.scene.crowd)
        alike = np.broadcast_to(weight, values[0].shape) / states
        return tuple(np.concatenate(np.split(each, states), axis=1) for each in (alike, *values))

    def counts(self, deployment: Deployment) -> np.ndarray:
        """Number of landmarks covered at each of P positions and A orientations of the scene's PDF, `(P, A)` int16."""
        landmarks = deployment.positions[None], deployment.normals[None]
        _, counts = self.sized(deployment.edges)._evaluate(*landmarks, 1, keep=True)
        return np.asarray(counts[0][:, self.axis_of])

    def units(self, positions: FloatArray, normals: FloatArray, n: int) -> np.ndarray:
        """Probability P_n that at least n landmarks are covered, at each position, in units of 1 / `PROBABILITY_ONE`.

        Args:
            positions, normals: landmarks of B deployments, metres and unit vectors, `(B, K, 3)`.
            n: number of landmarks that must be covered.

        Returns:
            int64, a row for each deployment and a column for each position, `(B, P)`.
        """
        return self._evaluate(positions, normals, n, keep=False)[0]

    def _evaluate(
        self, positions: FloatArray, normals: FloatArray, n: int, keep: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate B deployments on the threads; arguments as in `units`.

        Returns:
            quantised P_n, `(B, P)`, and number of landmarks covered at each position and axis, `(B, P, 64 W)`. The
            axes are padded to W words of 64 bits. The second array is empty unless `keep` is True.
        """
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
        self.run_over_blocks(kernels.evaluate_range, (*self.batch(positions, normals), n, units, counts))
        return units, counts

    def batch(self, positions: FloatArray, normals: FloatArray) -> tuple[kernels.Batch, Any]:
        """Make the arguments `batch` and `tables` of `kernels.evaluate_range` for B deployments.

        `positions`, metres, and unit `normals` are those of the landmarks, `(B, K, 3)` each.
        """
        self.scene.check_count(positions.shape[1])
        landmarks = tuple(for_kernels(v.transpose(0, 2, 1)) for v in (positions, normals))
        sight = self.sight.among(self._low, self._high, *landmarks)
        seen = (sight, horizon_of(sight), self.obstacles, self.axes, self.bands, self.weights)
        batch = self.blocks[0][: len(self.positions)], self.positions, *landmarks, *seen
        return batch, self.tables if getattr(self.sight, "tabulated", False) else None

    def run_over_blocks(self, kernel: Any, fixed: tuple[Any, ...], each: int = 1) -> None:
        """Run `kernel(first, last, *fixed)` over all positions on the threads, in `each` chunks per thread.

        A chunk consists of whole blocks.
        """
        size = len(self.positions)

        def job(first: int, last: int) -> None:
            kernel(first * BLOCK, min(last * BLOCK, size), *fixed)

        in_parts(self.threads, job, math.ceil(size / BLOCK), self.threads * each)
