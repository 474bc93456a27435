"""Fiducial tags: the families, the size of a tag, and its picture.

A tag is a square of N x N modules with a black outer ring, on paper with a white margin (the quiet zone). Up is the top
of the published picture: of `cv2.aruco.generateImageMarker` for the ArUco families, of AprilTag's own picture for the
AprilTag families, which OpenCV shows rotated by 180 degrees.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, check_fields, choice, integer, real, vector
from lmd.core.optional import optional


@dataclass(frozen=True)
class Family:
    """Family of tags.

    Args:
        modules: N, number of modules along an edge, including the black border.
        ids: number of tags.
        dictionary: name of the dictionary in `cv2.aruco`.
        apriltag: name in the AprilTag library; None if the library lacks the family.
    """

    modules: int
    ids: int
    dictionary: str
    apriltag: str | None = None


FAMILIES = {
    "36h11": Family(8, 587, "DICT_APRILTAG_36h11", "tag36h11"),
    "25h9": Family(7, 35, "DICT_APRILTAG_25h9", "tag25h9"),
    "16h5": Family(6, 30, "DICT_APRILTAG_16h5", "tag16h5"),
} | {
    f"{bits}x{bits}_{ids}": Family(bits + 2, ids, f"DICT_{bits}X{bits}_{ids}")
    for bits in (4, 5, 6, 7)
    for ids in (50, 100, 250, 1000)
}


@dataclass(frozen=True)
class Tag:
    """Tag at the landmarks of a deployment; landmarks are points if it has no edge.

    Args:
        edge: edge of the outer black square, metres. None or 0 for landmarks that are points, as in the paper; with
            `edges`, None for the largest of them. Landmarks of a file without sizes have this edge.
        family: one of `FAMILIES`.
        quiet_zone: q, width of the white margin on each side, modules.
        edges: edges of tags of several sizes, metres; None for one size, `edge`. Placed landmarks are assigned these
            edges cyclically unless `counts` is given.
        counts: number of placed landmarks with each of `edges`, in order of the landmarks; None for the cyclic
            assignment.
        paper: total area of paper of the placed landmarks, square metres, for which the number of each size is
            optimised; None if the number of landmarks is given.
        costs: cost of a tag of each of `edges`, in any unit.
        budget: total cost of the placed landmarks, instead of `paper`.

    Raises:
        InputError: the edge or the quiet zone is negative, the family is unknown, a value of `edges` is not positive or
            repeated, counts or costs are not one for each of `edges`, paper is given without edges, or budget without
            costs or with paper.
    """

    edge: float | None = None
    family: str = "36h11"
    quiet_zone: float = 1.0
    edges: tuple[float, ...] | None = None
    counts: tuple[int, ...] | None = None
    paper: float | None = None
    costs: tuple[float, ...] | None = None
    budget: float | None = None

    def __post_init__(self) -> None:
        if self.edge is not None and real("edge", self.edge) < 0.0:
            raise InputError(
                f"edge must be positive, in metres, or null for landmarks that are points, got {self.edge!r}.",
                "edge",
            )
        object.__setattr__(self, "edge", float(self.edge) if self.edge else None)
        choice("family", self.family, tuple(FAMILIES))
        check_fields(self, real, "quiet_zone", low=0.0)
        if self.edges is not None:
            edges = vector("edges", self.edges, None, above=0.0)
            if len(set(edges)) < len(edges):
                raise InputError(f"edges must be different, got {list(edges)}.", "edges")
            object.__setattr__(self, "edges", edges)
            object.__setattr__(self, "edge", self.edge or max(edges))
        if self.counts is not None:
            counts = tuple(integer("counts", count, low=0) for count in self.counts)
            if len(counts) != len(self.edges or ()) or not any(counts):
                raise InputError(
                    f"counts = {list(counts)} must say how many tags have each of edges = {list(self.edges or ())}.",
                    "counts",
                )
            object.__setattr__(self, "counts", counts)
        if self.paper is not None and (real("paper", self.paper, above=0.0) and self.edges is None):
            raise InputError(
                f"paper = {self.paper:g} square metres needs edges: the sizes that it may go into.", "paper"
            )
        if self.costs is not None:
            costs = vector("costs", self.costs, None, above=0.0)
            if len(costs) != len(self.edges or ()):
                raise InputError(
                    f"costs = {list(costs)} must be one for each of edges = {list(self.edges or ())}.", "costs"
                )
            object.__setattr__(self, "costs", costs)
        if self.budget is not None and (real("budget", self.budget, above=0.0) and self.costs is None):
            raise InputError(f"budget = {self.budget:g} needs costs: what a tag of each of edges costs.", "budget")
        if self.budget is not None and self.paper is not None:
            raise InputError(
                "budget and paper must not both be given: one of them says how many tags there are.", "budget"
            )

    def in_turn(self, count: int) -> FloatArray:
        """Edges of `count` placed landmarks, metres, `(count,)`; NaN if all have the edge of the tag.

        Raises:
            InputError: the sum of `counts` is not `count`.
        """
        if self.edges is None or self.counts is None:
            return np.resize(np.nan if self.edges is None else self.edges, count)
        if sum(self.counts) != count:
            raise InputError(f"counts = {list(self.counts)} are not {count} tags.", "counts")
        return np.repeat(self.edges, self.counts)

    def filled(self, edges: FloatArray) -> FloatArray:
        """Replace NaN in edges `(K,)`, metres, by the edge of the tag; zeros for points."""
        return np.zeros(len(edges)) if self.edge is None else np.where(np.isnan(edges), self.edge, edges)

    def of_size(self, edge: float) -> "Tag":
        """Tag of the single size `edge`, metres."""
        return replace(self, edge=edge, edges=None, counts=None, paper=None, costs=None, budget=None)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Edges of placed tags, metres; empty for points."""
        return self.edges or (() if self.edge is None else (self.edge,))

    @property
    def limit(self) -> float | None:
        """Limit on the total paper, square metres, or on the total cost; None if the number of landmarks is given."""
        return self.budget if self.paper is None else self.paper

    @property
    def is_point(self) -> bool:
        """True if the landmarks have no size."""
        return self.edge is None

    @property
    def own_family(self) -> str | None:
        """Family of the tags; None for points."""
        return None if self.is_point else self.family

    def check_edge(self) -> None:
        """Raise `InputError` if the tag is a point."""
        if self.is_point:
            raise InputError("edge must be given, in metres: a detector cannot read a point.", "edge").within("tag")

    @property
    def modules(self) -> int:
        """N, modules along the edge."""
        return FAMILIES[self.family].modules

    @property
    def ids(self) -> int:
        """Number of different tags in the family."""
        return FAMILIES[self.family].ids

    @property
    def size(self) -> float:
        """Edge of the black square, metres.

        Raises:
            InputError: the tag is a point.
        """
        if self.edge is None:
            raise InputError("edge must be given, in metres: a point has no size.")
        return self.edge

    @property
    def module(self) -> float:
        """Edge of one module, metres."""
        return self.size / self.modules

    @property
    def paper_edge(self) -> float:
        """Edge of the paper with its quiet zone, s (1 + 2 q / N), metres."""
        return self.size * self.paper_share

    @property
    def paper_share(self) -> float:
        """Ratio of the edges of paper and tag, 1 + 2 q / N."""
        return 1.0 + 2.0 * self.quiet_zone / self.modules

    def check_ids(self, ids: IntArray) -> None:
        """Raise `InputError` if the family has fewer than K tags, or lacks one of the `ids` `(K,)`, all different."""
        if len(ids) > self.ids:
            raise InputError(f"family {self.family} has {self.ids} different tags, too few for {len(ids)}.", "family")
        if ids.max() >= self.ids:
            message = f"family {self.family} has the tags 0 to {self.ids - 1}, but a landmark has the id {ids.max()}."
            raise InputError(message, "family")

    def picture(self, number: int) -> BoolArray:
        """Modules of tag `number`, `(N, N)`, row 0 at the top; True for white.

        Raises:
            InputError: the family has no such tag.
        """
        integer("tag id", number, low=0, high=self.ids - 1)
        family = FAMILIES[self.family]
        aruco = optional("cv2", "detection").aruco
        picture = aruco.generateImageMarker(dictionary(self.family), int(number), family.modules) > 0
        return np.asarray(picture[::-1, ::-1] if family.apriltag else picture)


def dictionary(family: str) -> Any:
    """Dictionary of `cv2.aruco` for a family."""
    aruco = optional("cv2", "detection").aruco
    return aruco.getPredefinedDictionary(getattr(aruco, FAMILIES[family].dictionary))
