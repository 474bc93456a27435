"""Free landmarks as genes in the unit box, which black boxes search."""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.optimisers.encoding import make_encoding
from lmd.problem import Problem
from lmd.scene.deployment import Deployment


class LandmarkGenome:
    """The free landmarks of a problem as genes; plates are pushed apart before they are evaluated.

    Args:
        problem: the problem.
        kind: of the encoding, see `make_encoding`.
        flush: whether landmarks lie flat on their surface.

    Raises:
        InputError: there is no such encoding, or tags with a size are not flush.
    """

    def __init__(self, problem: Problem, kind: str, flush: bool) -> None:
        if problem.scene.plates.edge and not flush:
            raise InputError("flush must be true where tags have a size: their papers lie flat on the wall.", "flush")
        self._problem, self._encoding = problem, make_encoding(kind, problem.scene.plates.hanging, flush)

    @property
    def dim(self) -> int:
        """See `Genome.dim`."""
        return self._problem.free_count * self._encoding.genes_per_landmark

    @property
    def varies(self) -> bool:
        """See `Genome.varies`."""
        return self._problem.start.varies

    def draw_genes(self, rng: np.random.Generator) -> FloatArray:
        """See `Genome.draw_genes`."""
        return self._encoding.encode(self._problem.free(self._problem.draw(rng)))

    def fitness_of_genes(self, genes: FloatArray) -> FloatArray:
        """See `Genome.fitness_of_genes`: -inf where plates find no room."""
        positions, normals, _, fits = self._placed(genes)
        return np.where(fits, self._problem.fitness(positions, normals), -np.inf)

    def deployment(self, genes: FloatArray) -> Deployment:
        """See `Genome.deployment`."""
        positions, normals, surfaces, _ = self._placed(genes[None])
        return Deployment(positions[0], normals[0], surfaces[0])

    def rig(self, genes: FloatArray) -> None:
        """See `Genome.rig`."""

    def reached(self, fitness: float) -> None:
        """See `Genome.reached`: no fitness depends on earlier ones."""

    def _placed(self, genes: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
        """The landmarks that genes `(B, dim)` mean, the fixed ones before them; see `Plates.pushed`."""
        problem = self._problem
        positions, normals, surfaces = self._encoding.decode(genes)
        if (fixed := problem.fixed) is not None:
            positions = _behind(fixed.positions, positions)
            normals = _behind(fixed.normals, normals)
            surfaces = _behind(fixed.surfaces, surfaces)
        return problem.scene.plates.pushed(positions, normals, surfaces, problem.edges, fixed=problem.fixed_count)


def _behind(fixed: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The arrays `free` `(B, N, ...)`, each with `fixed` `(F, ...)` before it."""
    return np.concatenate([np.broadcast_to(fixed, (len(free), *fixed.shape)), free], axis=1)
