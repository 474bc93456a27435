"""Footprints: the squares that the papers of tags take up. They lie wholly on their surface, and never overlap.

Tags hang upright (`lmd.geometry.squares.upright`), so footprints are squares along the u and v of their surface: two do
not overlap if, and only if, their centres are at least half the sum of their edges apart along u or along v. Points
have no footprints, and nothing here changes them. Tags that are tilted or hang on no surface, which only files have,
are left out.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, said_of
from lmd.scene.deployment import FLUSH, Deployment
from lmd.scene.deployment_sources import DeploymentSource, ExistingDeployment, GivenDeployment
from lmd.scene.fixed import beside
from lmd.scene.pushing import TOUCHING, push
from lmd.scene.tag import Tag
from lmd.space.changed import Inset
from lmd.space.space import Space
from lmd.space.surface import FILE_TOLERANCE, SurfaceArrays


@dataclass(frozen=True)
class Footprints:
    """The footprints of the tags in a room.

    Args:
        room: the room.
        tag: what hangs at each landmark.
    """

    room: Space
    tag: Tag

    @cached_property
    def edge(self) -> float:
        """Of the smallest papers that are placed here, metres; 0 for landmarks that are points."""
        return 0.0 if self.tag.is_point else self.tag.paper_share * min(self.tag.sizes)

    @cached_property
    def hanging(self) -> Space:
        """The room with what the centres of the smallest tags may use of its surfaces.

        Raises:
            InputError: a surface is narrower than a footprint.
        """
        return self.inset(self.edge)

    def inset(self, paper: float) -> Space:
        """The room with what the centres of tags on papers with this edge, metres, may use; see `hanging`."""
        if not paper:
            return self.room
        with said_of("edge is too large", "edge"):
            return Inset(self.room, paper / 2.0)

    @cached_property
    def _surfaces(self) -> SurfaceArrays:
        return SurfaceArrays.of(self.hanging.surfaces())

    def surfaces_of(self, paper: float) -> SurfaceArrays:
        """Surfaces for the centres of tags on papers with this edge, metres, in the coordinates of `hanging`.

        Raises:
            InputError: a surface is narrower than a footprint.
        """
        if paper == self.edge:
            return self._surfaces
        if paper not in self._others:
            own, s = SurfaceArrays.of(self.inset(paper).surfaces()), self._surfaces
            shift = s.coordinates(np.arange(len(s.origin)), own.origin)[own.of_piece]
            pieces = own.pieces + shift[:, [0, 0, 1, 1, 1, 1]]
            self._others[paper] = own._replace(origin=s.origin, pieces=pieces)
        return self._others[paper]

    def pieces_of(self, papers: FloatArray) -> tuple[FloatArray, IntArray]:
        """Pieces `(T, 6)` for tags on papers of S sizes, `(S,)` metres, and the `first` `(S, W + 1)` of each surface.

        See `SurfaceArrays`.
        """
        sizes = [self.surfaces_of(paper) for paper in papers.tolist()]
        before = np.cumsum([0, *(len(own.pieces) for own in sizes[:-1])])
        first = np.array([start + own.first for start, own in zip(before, sizes, strict=True)])
        return np.concatenate([own.pieces for own in sizes]), first

    @cached_property
    def _others(self) -> dict[float, SurfaceArrays]:
        return {}

    def papers(self, deployment: Deployment) -> FloatArray:
        """The edges of the papers of tags, `(K,)`, metres; 0 for points."""
        return self.tag.paper_share * deployment.edges_of(self.tag)

    def capacity(self, paper: float) -> float:
        """Maximum number of papers with this edge, metres: squares in rows and columns are the densest packing."""
        if not paper:
            return np.inf
        extent = self.surfaces_of(paper).extent
        return float(np.floor(extent / paper * (1.0 + TOUCHING) + 1.0).prod(axis=1).sum())

    def hung(self, fixed: Deployment, beside: DeploymentSource) -> Deployment:
        """Landmarks that hang already, with their surfaces.

        They were measured by hand: a tag a little before or behind a surface belongs to it, and its footprint is taken
        there.

        Args:
            beside: where the others come from. If these are taken as they are (`free`), so are those.

        Raises:
            InputError: one lies outside the room, hangs on no surface or faces into its own, or footprints overlap or
                are not wholly on their surface.
        """
        with said_of("fixed", "fixed"):
            hung = fixed.hung(self.room, as_they_are(beside), self.papers(fixed))
            if as_they_are(beside):
                return hung.before(self.hanging)
            if fault := hung.fault(self.room, near=True):
                raise InputError(f"{fault}.")
            hung = hung.before(self.hanging)
            self.check(hung)
        return hung

    def draw(self, source: DeploymentSource, rng: np.random.Generator, fixed: Deployment | None = None) -> Deployment:
        """A deployment from `source` whose footprints hang properly; a random one is pushed apart.

        What a file has is taken as it is if it says so, see `ExistingDeployment.free`.

        Args:
            source: what is drawn from.
            fixed: landmarks that hang already (`hung`). They come first, and whatever is not from a file is pushed out
                of their way.

        Raises:
            InputError: the source cannot be drawn from, or footprints overlap, are not wholly on their surface or too
                many.
        """
        placed = not isinstance(source, ExistingDeployment | GivenDeployment)
        drawn = source.draw(self.room if isinstance(source, ExistingDeployment) else self.hanging, rng, self.tag)
        if fixed is not None:
            drawn = beside(fixed, drawn)
        if not self.edge or as_they_are(source):
            return drawn
        papers = self.papers(drawn)
        if len(drawn) > (most := self.capacity(papers.min())):
            raise InputError(
                f"count = {len(drawn)} tags do not fit: {most:g} papers of {papers.min():.4g} m are all that the "
                "surfaces hold.",
                "count",
            )
        several = placed and drawn.has_own_edges
        if source.varies or several or (fixed is not None and not isinstance(source, ExistingDeployment)):
            apart = self.apart(drawn, fixed=0 if fixed is None else len(fixed))
            if apart is None:
                raise InputError(
                    f"count = {len(drawn)} tags with papers of {_named(papers)} m are too many to be hung at random.",
                    "count",
                )
            return apart
        try:
            self.check(drawn)
        except InputError as error:
            raise InputError(
                f"{source.path}: {error}" if isinstance(source, ExistingDeployment) else str(error)
            ) from None
        return drawn

    def check(self, deployment: Deployment) -> None:
        """Raise `InputError` if footprints overlap or are not wholly on the surfaces that the landmarks name."""
        if not self.edge:
            return
        flat = np.flatnonzero(self._lies_flat(deployment.normals, deployment.surfaces))
        surface, paper = deployment.surfaces[flat], self.papers(deployment)[flat]
        at = self._surfaces.coordinates(surface, deployment.positions[flat])
        names = [surface.name for surface in self.room.surfaces()]
        ids = deployment.ids[flat]
        over = np.zeros(len(flat), dtype=np.bool_)
        for edge in np.unique(paper):
            own = paper == edge
            over[own] = ~self.surfaces_of(edge).allow(surface[own], at[own], FILE_TOLERANCE)
        if over.any():
            first = np.argmax(over)
            raise InputError(
                f"landmark {ids[first]} hangs over the edge of {names[surface[first]]}, or of where tags may hang "
                f"there: its paper is {paper[first]:.4g} m wide."
            )
        distance = np.abs(at[:, None] - at[None]).max(axis=-1)
        close = (distance < (paper[:, None] + paper) / 2.0 - FILE_TOLERANCE) & (surface[:, None] == surface)
        if (pairs := np.argwhere(np.triu(close, 1))).size:
            i, j = pairs[0]
            raise InputError(
                f"landmarks {ids[i]} and {ids[j]} on {names[surface[i]]} overlap: their papers are "
                f"{_named(paper[pairs[0]])} m wide, their centres {distance[i, j]:.4g} m apart along the edges."
            )

    def apart(self, deployment: Deployment, size: float = 1.0, fixed: int = 0) -> Deployment | None:
        """The deployment with footprints pushed apart, None where there is no room for all; see `pushed`."""
        parts = deployment.positions[None], deployment.normals[None], deployment.surfaces[None]
        positions, normals, surfaces, fits = self.pushed(*parts, deployment.edges, size, fixed)
        apart = replace(deployment, positions=positions[0], normals=normals[0], surfaces=surfaces[0])
        return apart if fits[0] else None

    def pushed(
        self,
        positions: FloatArray,
        normals: FloatArray,
        surfaces: IntArray,
        edges: FloatArray,
        size: float = 1.0,
        fixed: int = 0,
    ) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
        """Deployments whose footprints are pushed apart, one after the other; what hangs properly stays as it is.

        A footprint that overlaps an earlier one is moved to the nearest free place on its surface, or else to one
        on the next surface that has. The largest come first. Deterministic, so that a search may work with the places
        before the push.

        Landmarks that are points only go to the nearest place where they may hang.

        Args:
            positions, normals: `(B, K, 3)`, flush.
            surfaces: `(B, K)`.
            edges: `(K,)`, see `Deployment.edges`.
            size: of the footprints, as a share of their true size.
            fixed: number of landmarks at the beginning that stay where they are.

        Returns:
            positions, normals, surfaces, and whether there was room for all, `(B,)`.
        """
        fits = np.ones(len(positions), dtype=np.bool_)
        s = self._surfaces
        if not self.edge:
            at = s.coordinates(surfaces, positions)
            moved = ~s.allow(surfaces, at)[..., None]
            moved[:, :fixed] = False
            return np.where(moved, s.points(surfaces, at), positions), normals, surfaces, fits
        positions, normals, surfaces = positions.copy(), normals.copy(), surfaces.copy()
        papers = self.tag.paper_share * self.tag.filled(edges)
        order = np.append(np.arange(fixed), fixed + np.argsort(-papers[fixed:], kind="stable"))
        found, of = np.unique(papers[order], return_inverse=True)
        sizes, (pieces, first) = [self.surfaces_of(paper) for paper in found.tolist()], self.pieces_of(found)
        for b in range(len(positions)):
            on = surfaces[b, order]
            at, moved = s.coordinates(on, positions[b, order]), np.zeros(len(order), dtype=np.bool_)
            fits[b] = push(fixed, on, at, pieces, first, of, size * papers[order], moved)
            for c, own in enumerate(sizes):
                those = moved & (of == c)
                positions[b, order[those]] = own.points(on[those], at[those])
            surfaces[b, order], normals[b, order[moved]] = on, s.normal[on[moved]]
        return positions, normals, surfaces, fits

    def touched(self, poses: Deployment, pose: Deployment) -> BoolArray:
        """Mask of the poses whose footprint overlaps that of the single `pose`, `(N,)`; all know their surfaces."""
        s, surface = self._surfaces, poses.surfaces
        away = s.coordinates(surface, poses.positions) - s.coordinates(surface, pose.positions)
        near = np.abs(away).max(axis=1) < (self.papers(poses) + self.papers(pose)) / 2.0 * (1.0 - TOUCHING)
        return np.asarray(near & (surface == pose.surfaces))

    def _lies_flat(self, normals: FloatArray, surfaces: IntArray) -> BoolArray:
        """Mask of the tags that lie flat on a surface, `(K,)`."""
        deviation = np.linalg.norm(normals - self._surfaces.normal[surfaces], axis=1)
        return np.asarray((surfaces >= 0) & (deviation <= FLUSH))


def as_they_are(source: DeploymentSource) -> bool:
    """True if landmarks from `source` are taken as they are."""
    return isinstance(source, ExistingDeployment) and source.free


def _named(papers: FloatArray) -> str:
    """The edges of papers, metres, each once."""
    return " and ".join(f"{paper:.4g}" for paper in np.unique(papers))
