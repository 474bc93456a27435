"""Encodings (W in the paper), which convert deployments to genes in the unit box, and genes to deployments.

A black-box optimiser varies genes in [0, 1]; an encoding maps the genes to landmarks. The genes of one landmark follow
one another.
"""

from typing import TypeAlias

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, choice
from lmd.geometry.frames import landmark_normal, normal_angles
from lmd.problem import Problem, checked_genes
from lmd.scene.deployment import Deployment
from lmd.space.space import Space
from lmd.space.surface import SurfaceArrays

# Distances to two surfaces count as equal up to this difference, metres.
ON_SURFACE = 1e-6
# Least distance of an encoded point from the border between pieces, as a fraction of the piece.
BORDER_SHARE = 1e-12

KINDS = ("wall", "paper")


class PaperEncoding:
    """Encoding of the paper, with five genes for a landmark: x, y, z, and yaw rho and pitch eta of its normal.

    The point (x, y, z) is projected to the nearest surface that may carry landmarks. With `flush` the landmark has the
    normal of the surface, and the genes of yaw and pitch have no effect.
    """

    genes_per_landmark = 5

    def __init__(self, room: Space, flush: bool) -> None:
        self.room, self.flush = room, flush
        self.surfaces = SurfaceArrays.of(room.surfaces())
        self.low, high = room.bounds()
        self.size = high - self.low
        planes = np.column_stack([self.surfaces.normal, (self.surfaces.normal * self.surfaces.origin).sum(axis=1)])
        alike = np.abs(planes[:, None] - planes).max(axis=-1) <= ON_SURFACE
        # In a convex room with one surface per plane, the nearest plane belongs to the nearest surface.
        self.planes_tell = room.blockers() is None and not np.triu(alike, 1).any()

    def decode(self, genes: FloatArray) -> tuple[FloatArray, FloatArray, np.ndarray]:
        """Decode the genes `(B, K * genes_per_landmark)`, in [0, 1], of B deployments.

        Returns:
            positions and normals, `(B, K, 3)` each, and indices of surfaces, `(B, K)`.
        """
        g = genes.reshape(len(genes), genes.shape[1] // 5, 5)
        points = self.low + g[..., :3] * self.size
        surface = np.argmin(self._distance(points), axis=-1)
        positions = self.surfaces.points(surface, self.surfaces.coordinates(surface, points))
        if self.flush:
            return positions, self.surfaces.normal[surface], surface
        yaw, pitch = (2.0 * g[..., 3] - 1.0) * np.pi, (g[..., 4] - 0.5) * np.pi
        return positions, landmark_normal(yaw, pitch), surface

    def encode(self, deployment: Deployment) -> FloatArray:
        """Genes `(K * genes_per_landmark,)` that encode `deployment`.

        Raises:
            InputError: a landmark is on no surface that may carry it, or is tilted while the encoding is flush.
        """
        surface = deployment.movable(self.room, self.flush).surfaces
        points = np.clip(deployment.positions, self.low, self.low + self.size)
        # A point on an edge of two surfaces is moved away from the second surface, so that decoding finds the
        # landmark's surface.
        tied = (self._distance(points) <= ON_SURFACE) & (np.arange(len(self.surfaces.normal)) != surface[:, None])
        points = points + 2.0 * ON_SURFACE * (tied[..., None] * self.surfaces.normal).sum(axis=1)
        yaw, pitch = normal_angles(deployment.normals)
        angles = np.stack([yaw / (2.0 * np.pi) + 0.5, pitch / np.pi + 0.5], axis=1)
        return np.clip(np.hstack([(points - self.low) / self.size, angles]), 0.0, 1.0).reshape(-1)

    def _distance(self, points: FloatArray) -> FloatArray:
        """Distances `(..., W)` of the `points` `(..., 3)` from each of W surfaces, metres.

        In a convex room, distances are from the planes of surfaces, which suffice to find the nearest surface.
        """
        s, depth = self.surfaces, np.abs(self.surfaces.heights(points))
        if self.planes_tell:
            return depth
        every = np.arange(len(s.normal))
        at = s.coordinates(every, points[..., None, :])
        beside = at - s.nearest(np.broadcast_to(every, at.shape[:-1]), at)[0]
        return np.asarray(np.linalg.norm(np.concatenate([depth[..., None], beside], axis=-1), axis=-1))


class WallEncoding:
    """Encoding with two genes for a landmark: a horizontal coordinate and a height.

    The horizontal coordinate runs along all surfaces, laid side by side; the height is the coordinate up the surface.
    Each piece of a surface where landmarks may hang gets an interval of the first gene in proportion to the area of the
    piece. So uniform random genes give places that are uniform over all pieces. Without `flush`, two more genes turn
    the landmark's normal by up to 90 degrees towards u and v, the axes of the surface.
    """

    def __init__(self, room: Space, flush: bool) -> None:
        self.room, self.flush = room, flush
        self.surfaces = SurfaceArrays.of(room.surfaces())
        self.edges = np.append(0.0, self.surfaces.shares)
        self.edges[-1] = 1.0

    @property
    def genes_per_landmark(self) -> int:
        """Number of genes for a landmark: two if landmarks are flush, four otherwise."""
        return 2 if self.flush else 4

    def decode(self, genes: FloatArray) -> tuple[FloatArray, FloatArray, np.ndarray]:
        """See `PaperEncoding.decode`."""
        g, s = genes.reshape(len(genes), genes.shape[1] // (n := self.genes_per_landmark), n), self.surfaces
        piece = np.clip(np.searchsorted(self.edges, g[..., 0], side="right") - 1, 0, len(s.shares) - 1)
        along = (g[..., 0] - self.edges[piece]) / (self.edges[piece + 1] - self.edges[piece])
        surface = s.of_piece[piece]
        positions = s.points(surface, s.spread(piece, np.stack([along, g[..., 1]], axis=-1)))
        if self.flush:
            return positions, s.normal[surface], surface
        turn, tilt = (g[..., 2, None] - 0.5) * np.pi, (g[..., 3, None] - 0.5) * np.pi
        level = np.cos(turn) * s.normal[surface] + np.sin(turn) * s.u[surface]
        return positions, np.cos(tilt) * level + np.sin(tilt) * s.v[surface], surface

    def encode(self, deployment: Deployment) -> FloatArray:
        """See `PaperEncoding.encode`."""
        s, normals = self.surfaces, deployment.normals
        surface = deployment.movable(self.room, self.flush).surfaces
        at, piece = s.nearest(surface, s.coordinates(surface, deployment.positions))
        along, height = s.gathered(piece, at).T
        width = self.edges[piece + 1] - self.edges[piece]
        first = self.edges[piece] + np.clip(along, BORDER_SHARE, 1.0 - BORDER_SHARE) * width
        if self.flush:
            return np.stack([first, height], axis=1).reshape(-1)
        turn = np.arctan2((normals * s.u[surface]).sum(axis=1), (normals * s.normal[surface]).sum(axis=1))
        tilt = np.arcsin(np.clip((normals * s.v[surface]).sum(axis=1), -1.0, 1.0))
        genes = np.stack([first, height, turn / np.pi + 0.5, tilt / np.pi + 0.5], axis=1)
        return np.clip(genes, 0.0, 1.0).reshape(-1)


Encoding: TypeAlias = PaperEncoding | WallEncoding


def make_encoding(kind: str, room: Space, flush: bool) -> Encoding:
    """Make the encoding with the name `kind`, one of `KINDS`.

    Args:
        kind: name of the encoding.
        room: space with the surfaces that may carry landmarks.
        flush: True if landmarks lie flat on their surface.

    Raises:
        InputError: no encoding has this name.
    """
    choice("encoding", kind, KINDS)
    return PaperEncoding(room, flush) if kind == "paper" else WallEncoding(room, flush)


class LandmarkGenome:
    """Genes of the free landmarks of a problem (a `Genome`), and the fitness of candidates given by their genes.

    Tags that would overlap are pushed apart before a candidate is evaluated.

    Args:
        problem: the problem.
        kind: name of the encoding, see `make_encoding`.
        flush: True if landmarks lie flat on their surface.

    Raises:
        InputError: no encoding has this name, or `flush` is False for tags with a size.
    """

    def __init__(self, problem: Problem, kind: str, flush: bool) -> None:
        if problem.scene.footprints.edge and not flush:
            raise InputError("flush must be true if tags have a size: their papers lie flat on the wall.", "flush")
        self._problem, self._encoding = problem, make_encoding(kind, problem.scene.footprints.hanging, flush)

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
        """See `Genome.fitness_of_genes`; the fitness is -inf if the tags do not fit on the surfaces without overlap."""
        positions, normals, _, fits = self._placed(checked_genes(genes, "B", self.dim))
        return np.where(fits, self._problem.fitness(positions, normals), -np.inf)

    def deployment(self, genes: FloatArray) -> Deployment:
        """See `Genome.deployment`."""
        positions, normals, surfaces, _ = self._placed(checked_genes(genes, self.dim)[None])
        return Deployment(positions[0], normals[0], surfaces[0])

    def rig(self, genes: FloatArray) -> None:
        """See `Genome.rig`."""

    def reached(self, fitness: float) -> None:
        """See `Genome.reached`; does nothing, because a candidate's fitness does not depend on earlier candidates."""

    def _placed(self, genes: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
        """Decode genes `(B, dim)`, put the fixed landmarks first, and push overlapping footprints apart.

        Returns:
            positions and normals, `(B, K, 3)` each, indices of surfaces, `(B, K)`, and a mask `(B,)`: True for a
            candidate in which no footprints overlap any more.
        """
        problem = self._problem
        positions, normals, surfaces = self._encoding.decode(genes)
        if (fixed := problem.fixed) is not None:
            positions = _behind(fixed.positions, positions)
            normals = _behind(fixed.normals, normals)
            surfaces = _behind(fixed.surfaces, surfaces)
        return problem.scene.footprints.pushed(positions, normals, surfaces, problem.edges, fixed=problem.fixed_count)


def _behind(fixed: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Join the array `fixed` `(F, ...)` and the array `free` `(B, N, ...)`: each of the B rows begins with `fixed`."""
    return np.concatenate([np.broadcast_to(fixed, (len(free), *fixed.shape)), free], axis=1)
