"""Footprints: the squares that the papers of tags cover on a surface.

A footprint must lie wholly on its surface, and must not overlap another footprint. Tags hang upright
(`lmd.geometry.squares.upright`), so the edges of a footprint are parallel to u and v of its surface. Two footprints
with the edge lengths e and f do not overlap if and only if their centres are at least (e + f) / 2 apart along u or v.
Landmarks that are points have no footprints. A file may contain tags that are tilted or on no surface; these tags are
not checked.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, said_of
from lmd.scene.deployment import FLUSH, Deployment
from lmd.scene.deployment_sources import DeploymentSource, ExistingDeployment, GivenDeployment
from lmd.scene.labels import Labels
from lmd.scene.pushing import TOUCHING, push
from lmd.scene.tag import Tag
from lmd.space.changed import Inset
from lmd.space.space import Space
from lmd.space.surface import FILE_TOLERANCE, NEAR_SURFACE, SurfaceArrays

COLUMN = "fixed"  # column in a file of landmarks: 1 for fixed landmarks, 0 for others


def beside(fixed: Deployment, others: Deployment) -> Deployment:
    """Deployment of the fixed landmarks, followed by the other landmarks.

    Ids and further columns are kept. The column `COLUMN` is added; it has 1 for fixed landmarks and 0 for others. Other
    landmarks without labels get the smallest unused ids. If `others` also contains fixed landmarks, recognised by their
    ids, they are left out of `others`.

    Args:
        fixed: F landmarks with known surfaces; an optimiser does not move them.
        others: N landmarks with known surfaces.

    Raises:
        InputError: a fixed landmark and another landmark have equal ids but different positions, or all `others` are
            fixed.
    """
    if others.labels is None:
        unused = np.setdiff1d(np.arange(len(fixed) + len(others)), fixed.ids)[: len(others)]
        others = replace(others, labels=Labels(unused))
    again, of, among = np.intersect1d(fixed.ids, others.ids, return_indices=True)
    away = np.linalg.norm(fixed.positions[of] - others.positions[among], axis=1)
    if (elsewhere := np.flatnonzero(away > NEAR_SURFACE)).size:
        first = elsewhere[0]
        raise InputError(
            f"fixed and the start both have a landmark {again[first]}, at places {away[first]:.4g} m apart; give them "
            "different ids (a file without the column id numbers its landmarks from 0).",
            "fixed",
        )
    if len(again) == len(others):
        raise InputError(f"fixed has all {len(fixed)} landmarks, which leaves none to place.", "fixed")
    others = others[np.setdiff1d(np.arange(len(others)), among)]
    assert others.labels is not None, "they were given some"
    labels = (fixed.labels or Labels(fixed.ids)) + others.labels
    marks = ["1"] * len(fixed) + ["0"] * len(others)
    labels = replace(labels, columns={**labels.columns, COLUMN: marks})
    return replace(fixed + others, labels=labels, note=others.note)


AT_ONCE = 64  # footprints that one call of the kernel, which no signal interrupts, pushes apart


@dataclass(frozen=True)
class Footprints:
    """Footprints of the tags in a room.

    Args:
        room: room of the tags.
        tag: family and sizes of the tags.
    """

    room: Space
    tag: Tag

    @cached_property
    def edge(self) -> float:
        """Edge length of the smallest footprint to place, metres; 0 for landmarks that are points."""
        return 0.0 if self.tag.is_point else self.tag.paper_share * min(self.tag.sizes)

    @cached_property
    def hanging(self) -> Space:
        """Room whose surfaces are reduced to the allowed centres of the smallest footprints.

        Raises:
            InputError: a surface is narrower than a footprint.
        """
        return self.inset(self.edge)

    def inset(self, paper: float) -> Space:
        """Room whose surfaces are reduced to the allowed centres of footprints with the edge length `paper`, metres.

        Raises:
            InputError: a surface is narrower than a footprint.
        """
        if not paper:
            return self.room
        with said_of("edge is too large", "edge"):
            return cast(Space, Inset(self.room, paper / 2.0))

    @cached_property
    def _surfaces(self) -> SurfaceArrays:
        return SurfaceArrays.of(self.hanging.surfaces())

    def surfaces_of(self, paper: float) -> SurfaceArrays:
        """Surfaces reduced to the allowed centres of footprints with the edge length `paper`, metres.

        Coordinates along u and v are measured from the origins of the surfaces of `hanging`, for every `paper`.

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
        """Allowed centres of footprints with each of the S edge lengths `papers` `(S,)`, metres.

        Returns:
            pieces: T trapezoids that contain the allowed centres, `(T, 6)`; `lmd.space.allowed` explains the six
                numbers of a trapezoid.
            first: `(S, W + 1)` for W surfaces; rows `first[c, w]` to `first[c, w + 1] - 1` of `pieces` are the
                trapezoids for edge length c on surface w.
        """
        sizes = [self.surfaces_of(paper) for paper in papers.tolist()]
        before = np.cumsum([0, *(len(own.pieces) for own in sizes[:-1])])
        first = np.array([start + own.first for start, own in zip(before, sizes, strict=True)])
        return np.concatenate([own.pieces for own in sizes]), first

    @cached_property
    def _others(self) -> dict[float, SurfaceArrays]:
        return {}

    def papers(self, deployment: Deployment) -> FloatArray:
        """Edge lengths of the footprints of a deployment's tags, metres, `(K,)`; 0 for points."""
        return self.tag.paper_share * deployment.edges_of(self.tag)

    def capacity(self, paper: float) -> float:
        """Upper bound on the number of footprints that the surfaces hold; infinite if `paper` is 0.

        `paper` is the edge length of the footprints, metres. The bound is the number of footprints in a dense grid on
        each surface.
        """
        if not paper:
            return np.inf
        extent = self.surfaces_of(paper).extent
        return float(np.floor(extent / paper * (1.0 + TOUCHING) + 1.0).prod(axis=1).sum())

    def checked_fixed(self, fixed: Deployment, beside: DeploymentSource) -> Deployment:
        """Assign surfaces to existing landmarks, check the landmarks, and return them as a new deployment.

        Positions are measured by hand, so a tag slightly in front of or behind a surface is assigned to the surface.
        The tag's footprint is at the tag's projection to the surface.

        Args:
            fixed: existing landmarks.
            beside: source of the other landmarks; if these landmarks are not checked (`as_they_are`), `fixed` is not
                checked either.

        Raises:
            InputError: a landmark lies outside the room, is on no surface or faces into its surface, or a footprint
                overlaps another or is not wholly on its surface.
        """
        with said_of("fixed", "fixed"):
            hung = fixed.with_surfaces(self.room, as_they_are(beside), self.papers(fixed))
            if as_they_are(beside):
                return hung.before(self.hanging)
            if fault := hung.fault(self.room, near=True):
                raise InputError(f"{fault}.")
            hung = hung.before(self.hanging)
            self.check(hung)
        return hung

    def draw(self, source: DeploymentSource, rng: np.random.Generator, fixed: Deployment | None = None) -> Deployment:
        """Draw a deployment with valid footprints; footprints that may overlap are pushed apart (`pushed`).

        Footprints may overlap if the draw is random, has tags of several sizes, or has fixed landmarks. Landmarks from
        a file are never pushed, only checked. If the source has `ExistingDeployment.free`, nothing is checked.

        Args:
            source: source of the deployment.
            rng: random generator.
            fixed: fixed landmarks from `checked_fixed`, which come first in the result and are not moved.

        Raises:
            InputError: the source fails, a footprint overlaps another or is not wholly on its surface, or there is no
                room for all footprints.
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
                f"count = {len(drawn)} tags do not fit: the surfaces hold at most {most:g} papers of "
                f"{papers.min():.4g} m.",
                "count",
            )
        several = placed and drawn.has_own_edges
        if source.varies or several or (fixed is not None and not isinstance(source, ExistingDeployment)):
            apart = self.separated(drawn, fixed=0 if fixed is None else len(fixed))
            if apart is None:
                raise InputError(
                    f"count = {len(drawn)} tags with papers of {_named(papers)} m are too many to be placed at random.",
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
        """Raise `InputError` if footprints overlap or are not wholly on the surfaces of their landmarks."""
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
                f"landmark {ids[first]} has a paper {paper[first]:.4g} m wide, which extends beyond "
                f"{names[surface[first]]} or beyond the part of this surface where tags may hang."
            )
        distance = np.abs(at[:, None] - at[None]).max(axis=-1)
        close = (distance < (paper[:, None] + paper) / 2.0 - FILE_TOLERANCE) & (surface[:, None] == surface)
        if (pairs := np.argwhere(np.triu(close, 1))).size:
            i, j = pairs[0]
            raise InputError(
                f"landmarks {ids[i]} and {ids[j]} on {names[surface[i]]} overlap: their papers are "
                f"{_named(paper[pairs[0]])} m wide, their centres {distance[i, j]:.4g} m apart along the edges."
            )

    def separated(self, deployment: Deployment, size: float = 1.0, fixed: int = 0) -> Deployment | None:
        """Copy of a deployment with the footprints pushed apart (see `pushed`); None if there is no room for all.

        Args:
            deployment: deployment of flush landmarks.
            size: factor on the edge lengths of the footprints.
            fixed: number of landmarks at the beginning that are not moved.
        """
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
        """Push the footprints of B deployments apart, until none overlaps another or leaves the allowed region.

        The fixed footprints stay. The others are placed one after another, the largest first. A footprint is moved if
        it overlaps an earlier footprint or extends beyond the allowed region. The new place is the nearest free place
        on its surface; if this surface is full, the next surface with a free place is used. The result is
        deterministic, so a search need not store it.

        Landmarks that are points are moved to the nearest allowed place.

        Args:
            positions: positions of flush landmarks, metres, `(B, K, 3)`.
            normals: unit normals, `(B, K, 3)`.
            surfaces: indices of the surfaces, `(B, K)`.
            edges: edge lengths of the tags as in `Deployment.edges`, metres, `(K,)`.
            size: factor on the edge lengths of the footprints.
            fixed: number of landmarks at the beginning that are not moved.

        Returns:
            new positions, normals and surfaces, with the shapes of the arguments; mask of the deployments with room for
                all footprints, `(B,)`.
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
            edge, parts = size * papers[order], range(fixed, len(order), AT_ONCE)  # a signal may act between parts
            fits[b] = all(push(k, on, at[: k + AT_ONCE], pieces, first, of, edge, moved) for k in parts)
            for c, own in enumerate(sizes):
                those = moved & (of == c)
                positions[b, order[those]] = own.points(on[those], at[those])
            surfaces[b, order], normals[b, order[moved]] = on, s.normal[on[moved]]
        return positions, normals, surfaces, fits

    def touched(self, poses: Deployment, pose: Deployment) -> BoolArray:
        """Mask `(N,)` of the landmarks `poses` whose footprint overlaps the footprint of the single landmark `pose`."""
        s, surface = self._surfaces, poses.surfaces
        away = s.coordinates(surface, poses.positions) - s.coordinates(surface, pose.positions)
        near = np.abs(away).max(axis=1) < (self.papers(poses) + self.papers(pose)) / 2.0 * (1.0 - TOUCHING)
        return np.asarray(near & (surface == pose.surfaces))

    def _lies_flat(self, normals: FloatArray, surfaces: IntArray) -> BoolArray:
        """Mask `(K,)` of the tags that are flush with their surface; a tag without a surface (index -1) is not."""
        deviation = np.linalg.norm(normals - self._surfaces.normal[surfaces], axis=1)
        return np.asarray((surfaces >= 0) & (deviation <= FLUSH))


def as_they_are(source: DeploymentSource) -> bool:
    """True if the placement of the landmarks from `source` is not checked (`ExistingDeployment.free`)."""
    return isinstance(source, ExistingDeployment) and source.free


def _named(papers: FloatArray) -> str:
    """Distinct edge lengths among `papers`, metres, as text for messages."""
    return " and ".join(f"{paper:.4g}" for paper in np.unique(papers))
