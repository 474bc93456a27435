"""Placement of cameras as a problem for black-box optimisers, in which the tags are given and the mounts of the cameras
are optimised.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from typing_extensions import override

from lmd.cameras.mounts import MountSpace
from lmd.core.bits import packed
from lmd.core.checks import FloatArray, InputError
from lmd.core.threads import in_parts
from lmd.geometry.camera import Camera
from lmd.objectives.coverage import Coverage
from lmd.problem import Genome, Problem, checked_genes
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Mount, Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.views import visible

MOST_BYTES = 1 << 28  # greatest memory of cached views, bytes; above it, the least recently used views are dropped
PARTS_PER_THREAD = 4  # number of chunks per thread


class CameraViews:
    """Cache of the tags that single cameras see: a mount (a camera with its pose) in the cache is not evaluated again.

    Args:
        evaluator: evaluator of a rig, with the positions and orientations of the body.
        deployment: K tags.
    """

    def __init__(self, evaluator: Evaluator, deployment: Deployment) -> None:
        self._evaluator, self._deployment = evaluator, deployment
        axes = evaluator.scene.orientations.axes
        weights = np.broadcast_to(evaluator.weights[:, : len(axes)], (len(evaluator.positions), len(axes)))
        self._position, self._orientation = np.nonzero(weights)  # poses with a positive probability, (N,) each
        self._weights = weights[self._position, self._orientation]
        self._axes = axes
        self._of_camera: dict[Camera, Evaluator] = {}
        self._kept: OrderedDict[Mount, np.ndarray] = OrderedDict()

    def _alone(self, camera: Camera) -> Evaluator:
        """Evaluator of the scene with one `camera` in place of the rig; callers give it the poses to evaluate."""
        if camera not in self._of_camera:
            scene = replace(self._evaluator.scene, camera=camera)
            self._of_camera[camera] = Evaluator(scene, self._evaluator.positions[:1], threads=1)
        return self._of_camera[camera]

    def knows(self, mount: Mount) -> bool:
        """True if the views of a mount are cached."""
        return mount in self._kept

    def visible_tags(self, mount: Mount) -> np.ndarray:
        """Tags that a camera with the given mount sees from each of the N poses of the body.

        Returns:
            bit mask for each pose, `(N, W)` 64-bit integers: bit k % 64 of integer k // 64 is 1 if tag k is seen.
        """
        if mount not in self._kept:
            self._kept[mount] = self._look(mount)
            size = 8 * (1 + (len(self._deployment) - 1) // 64) * len(self._position)
            while len(self._kept) > max(MOST_BYTES // size, 8):
                self._kept.popitem(last=False)
        self._kept.move_to_end(mount)
        return self._kept[mount]

    def _look(self, mount: Mount) -> np.ndarray:
        (offsets,), (turned,) = Rig((mount,)).views(self._axes)
        alone, n = self._alone(mount.camera), len(self._position)
        places = self._evaluator.positions[self._position] + offsets[self._orientation]
        axes, found = turned[self._orientation], np.empty((n, len(self._deployment)), dtype=np.bool_)

        def look(first: int, last: int) -> None:
            found[first:last] = visible(alone, self._deployment, places[first:last], axes[first:last])

        in_parts(self._evaluator.threads, look, n, PARTS_PER_THREAD * self._evaluator.threads)
        return packed(found)

    def units(self, mounts: Sequence[Mount], n: int) -> np.ndarray:
        """Probability P_n that a rig with all `mounts` sees at least n tags, at each of the body's P positions, `(P,)`.

        A probability is stored as an integer, its product with `PROBABILITY_ONE`.
        """
        union = np.uint64(0)
        for mount in mounts:
            union = union | self.visible_tags(mount)  # type: ignore[assignment] # an array from the first on
        enough = np.bitwise_count(union).sum(axis=-1) >= n
        # Sums of integers up to 2^52 are exact in float64.
        summed = np.bincount(self._position, self._weights * enough, len(self._evaluator.positions))
        return summed.astype(np.int64)


class CameraProblem(Problem):
    """Problem of placing the cameras of a rig on a body for the greatest fitness; the poses of the tags are given.

    The fitness is bit-identical to that of a `Problem` with the rig. If the objective only counts landmarks in view,
    the views of each camera are evaluated once and cached; otherwise every rig is evaluated again.

    Args:
        problem: problem with the objective and with the scene, in which a rig replaces the camera.
        tags: the landmarks, whose poses do not change.
        space: admissible mounts of the cameras.
        start: cameras with which the search starts; random cameras by default.

    Raises:
        InputError: the body would leave the room, the cameras of `start` are not in `space`, or the objective does not
            support a rig.
    """

    def __init__(self, problem: Problem, tags: Deployment, space: MountSpace, start: Rig | None = None) -> None:
        self.tags, self.space = tags, space
        self.first = None if start is None else space.genes(start)
        corners = self._corners()
        try:
            replace(problem.scene, camera=Rig(corners)).check_inside(problem.evaluator.positions)
        except InputError as error:
            if error.argument != "rig":
                raise
            raise InputError(f"boxes: the body is not inside the room: {error}", "boxes") from None
        # The orientations of a rig's problem include a roll if a roll of the body moves a camera.
        farthest = max(corners, key=lambda mount: float(np.linalg.norm(mount.translation[1:])))
        scene = replace(problem.scene, camera=Rig((farthest,)))
        super().__init__(scene, problem.objective, problem.start, problem.evaluator.threads, problem.fixed)
        self.views = CameraViews(self.fitness_evaluator, tags)
        self._most = -np.inf  # best fitness found for cameras that are in the room at all positions
        if not self.counts:  # an objective that does not support a rig raises an error here
            self.values_of(space.mounts(space.draw(np.random.default_rng(0))) or ())

    @property
    def counts(self) -> bool:
        """True if the objective only counts the landmarks in view, so that cameras can be evaluated one by one."""
        return isinstance(self.objective, Coverage)

    def _corners(self) -> tuple[Mount, ...]:
        """Mounts at the corners of the body's boxes and of the rectangles in which cameras may be placed.

        The body counts as inside the room if all these corners are.
        """
        boxes = [np.array(corner) for box in np.dstack(self.space.body.corners) for corner in product(*box)]
        places = [
            face.point(a, b) + self.space.body.standoff * face.normal
            for face in self.space.body.surfaces()
            for a, b in product(*([0.0, side] for side in face.extent))
        ]
        return tuple(Mount(self.space.lenses[0], tuple(place.tolist())) for place in (*places, *boxes))

    def stay(self, mounts: Sequence[Mount]) -> bool:
        """True if all cameras are inside the room at every position of the body.

        The test takes as long as an evaluation, and nearly always succeeds, as the corners of the body are in the room.
        """
        try:
            replace(self.scene, camera=Rig(tuple(mounts))).check_inside(self.evaluator.positions)
        except InputError:
            return False
        return True

    def values_of(self, mounts: Sequence[Mount]) -> FloatArray:
        """Values of the objective for the rig with these mounts, `(Q,)`.

        There is one value for each of the Q positions from which the fitness is computed.
        """
        if self.counts:
            return np.asarray(self.views.units(mounts, self.objective.n) / PROBABILITY_ONE)
        measured = self.fitness_evaluator
        evaluator = Evaluator(replace(measured.scene, camera=Rig(tuple(mounts))), measured.positions, measured.threads)
        landmarks = self.tags.positions[None], self.tags.normals[None]
        return np.asarray(self.objective.values(evaluator, *landmarks)[0])

    def fitness_of_cameras(self, mounts: Sequence[Mount] | None) -> float:
        """Fitness of the rig with these mounts; -inf if `mounts` is None, or if a new best rig leaves the room.

        The test of the room, `stay`, is slow, so it is made only if the fitness is a new best.
        """
        if mounts is None:
            return -np.inf
        fitness = float(self.objective.fitness(self.values_of(mounts), self.fitness_relevance))
        if fitness > self._most:
            if not self.stay(mounts):
                return -np.inf
            self._most = fitness
        return fitness

    def reached(self, fitness: float) -> None:
        """Receive the best fitness of a checkpoint, see `Genome.reached`.

        From now on, only rigs with a higher fitness are tested for staying inside the room.
        """
        self._most = max(self._most, fitness)

    @property
    @override
    def genome(self) -> Genome:
        return self

    @property
    def dim(self) -> int:
        """See `Genome.dim`; genes are ordered camera by camera."""
        return self.space.count * len(self.space.names)

    @property
    def varies(self) -> bool:
        """See `Genome.varies`."""
        return self.first is None

    def draw_genes(self, rng: np.random.Generator) -> FloatArray:
        """See `Genome.draw_genes`."""
        return (self.space.draw(rng) if self.first is None else self.first).reshape(-1)

    def fitness_of_genes(self, genes: FloatArray) -> FloatArray:
        """See `Genome.fitness_of_genes`."""
        given = checked_genes(genes, "B", self.dim)
        return np.array([self.fitness_of_cameras(self._mounts(row)) for row in given])

    def deployment(self, genes: FloatArray) -> Deployment:
        """See `Genome.deployment`."""
        return self.tags

    def rig(self, genes: FloatArray) -> Rig:
        """See `Genome.rig`."""
        mounts = self._mounts(checked_genes(genes, self.dim))
        assert mounts is not None, "it has a fitness"
        return Rig(mounts)

    def _mounts(self, genes: FloatArray) -> tuple[Mount, ...] | None:
        return self.space.mounts(genes.reshape(self.space.count, -1))
