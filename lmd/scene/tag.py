"""Fiducial tags: the size of a tag and of its paper.

A tag is a square of N x N modules between the corners that detectors find (see `lmd.scene.families`), on paper with a
white margin, the quiet zone.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import (
    BoolArray,
    Checked,
    FloatArray,
    InputError,
    IntArray,
    NotNegative,
    Positive,
    choice,
    entries,
    integer,
    real,
    vector,
)
from lmd.scene.families import FAMILIES, Family, family_named, picture


def edge_or_point(name: str, value: Any) -> float | None:
    """Return `value` as the edge length of a tag, metres; None for a point (no value or 0).

    Raises:
        InputError: the value is negative or not a number.
    """
    if value is not None and real(name, value) < 0.0:
        raise InputError(
            f"{name} must be positive, in metres, or null for landmarks that are points, got {value!r}.", name
        )
    return float(value) if value else None


def known_family(name: str, value: Any) -> str:
    """Convert a library's name of a family to its name in `FAMILIES`; raise `InputError` if the family is unknown."""
    return choice(name, family_named(value), tuple(FAMILIES))


@dataclass(frozen=True)
class Tag(Checked):
    """Tag at the landmarks of a deployment; without an edge length, landmarks are points.

    Args:
        edge: edge length, which is the distance between adjacent detected corners, metres. None or 0 for landmarks that
            are points, as in the paper; with `edges`, None for the largest of `edges`. Landmarks of a file without
            sizes have this edge length.
        family: one of `lmd.scene.families.FAMILIES`, or a library's name of the family.
        quiet_zone: q, width of the white margin on each side, modules.
        edges: edge lengths of tags of several sizes, metres; None for one size, `edge`. Placed landmarks are assigned
            these lengths cyclically unless `counts` is given.
        counts: number of placed landmarks for each edge length in `edges`; the lengths are assigned in the order of the
            landmarks. None for the cyclic assignment.
        paper: limit on the total area of paper of the placed landmarks, square metres. The number of tags of each size
            is optimised within this limit. None if the number of landmarks is given.
        costs: cost of a tag for each edge length in `edges`, in any unit.
        budget: limit on the total cost of the placed landmarks, in the unit of `costs`, instead of `paper`.

    Raises:
        InputError: the edge length or the quiet zone is negative, or the family is unknown. Also if a value of `edges`
            is not positive or is repeated, or `counts` or `costs` do not have one value for each of `edges`. Also if
            `paper` is given without `edges`, or `budget` is given without `costs` or with `paper`.
    """

    edge: Annotated[float | None, edge_or_point] = None
    family: Annotated[str, known_family] = "36h11"
    quiet_zone: NotNegative = 1.0
    edges: Annotated[tuple[float, ...], partial(vector, size=None, above=0.0)] | None = None
    counts: Annotated[tuple[int, ...], partial(entries, check=partial(integer, low=0))] | None = None
    paper: Positive | None = None
    costs: Annotated[tuple[float, ...], partial(vector, size=None, above=0.0)] | None = None
    budget: Positive | None = None

    def _validate(self) -> None:
        sizes = list(self.edges or ())
        if sizes:
            if len(set(sizes)) < len(sizes):
                raise InputError(f"edges must be different, got {sizes}.", "edges")
            object.__setattr__(self, "edge", self.edge or max(sizes))
        if self.counts is not None and (len(self.counts) != len(sizes) or not any(self.counts)):
            told = f"counts = {list(self.counts)} must have a number of tags for each length in edges = {sizes}."
            raise InputError(told, "counts")
        if self.paper is not None and not sizes:
            raise InputError(f"paper = {self.paper:g} m2 needs edges, the sizes of tags to choose from.", "paper")
        if self.costs is not None and len(self.costs) != len(sizes):
            raise InputError(f"costs = {list(self.costs)} must have one cost per length in edges = {sizes}.", "costs")
        if self.budget is not None and self.costs is None:
            raise InputError(f"budget = {self.budget:g} needs costs: the cost of a tag for each edge length.", "budget")
        if self.budget is not None and self.paper is not None:
            raise InputError(
                "budget and paper must not both be given: each of them limits the number of tags.", "budget"
            )

    def edges_in_order(self, count: int) -> FloatArray:
        """Edge lengths of `count` landmarks in the order of placement, metres, `(count,)`; NaN if there is one size.

        Raises:
            InputError: the sum of `counts` is not `count`.
        """
        if self.edges is None or self.counts is None:
            return np.resize(np.nan if self.edges is None else self.edges, count)
        if sum(self.counts) != count:
            raise InputError(f"counts = {list(self.counts)} must add up to {count} tags.", "counts")
        return np.repeat(self.edges, self.counts)

    def filled(self, edges: FloatArray) -> FloatArray:
        """Copy of `edges` `(K,)`, metres, with NaN replaced by the edge length of the tag; zeros for points."""
        return np.zeros(len(edges)) if self.edge is None else np.where(np.isnan(edges), self.edge, edges)

    def of_size(self, edge: float) -> "Tag":
        """Copy of the tag with the single edge length `edge`, metres."""
        return replace(self, edge=edge, edges=None, counts=None, paper=None, costs=None, budget=None)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Distinct edge lengths of the placed tags, metres; empty if landmarks are points."""
        return self.edges or (() if self.edge is None else (self.edge,))

    @property
    def limit(self) -> float | None:
        """Limit on the placed tags: their total area of paper, square metres (`paper`), or their total cost (`budget`).

        None if the number of landmarks is given.
        """
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
        """Raise `InputError` if the tag is a point, without an edge length."""
        if self.is_point:
            message = f"edge must be given, in metres, as a detector cannot read a point: measure the {self.square}."
            raise InputError(message, "edge").within("tag")

    @property
    def in_family(self) -> Family:
        """Properties of the tag's family."""
        return FAMILIES[self.family]

    @property
    def square(self) -> str:
        """Phrase for the detected square in messages, such as `black square`; `size` is its edge length."""
        return self.in_family.square

    @property
    def modules(self) -> int:
        """N, number of modules along the edge between the detected corners."""
        return self.in_family.modules

    @property
    def ids(self) -> int:
        """Number of different tags in the family."""
        return self.in_family.ids

    @property
    def size(self) -> float:
        """Edge length: distance between adjacent detected corners, metres.

        Raises:
            InputError: the tag is a point.
        """
        if self.edge is None:
            raise InputError("edge must be given, in metres: without it, the tag is a point, which has no size.")
        return self.edge

    @property
    def module(self) -> float:
        """Edge length of one module (a black or white square of the picture), metres."""
        return self.size / self.modules

    @property
    def picture_share(self) -> float:
        """Ratio M / N of the edge length of the whole picture, M modules, to the edge length of the tag, N modules.

        The ratio is 1 if there is no data around the detected square.
        """
        return self.in_family.picture_modules / self.modules

    @property
    def picture_edge(self) -> float:
        """Edge length of the tag's published picture, metres: the detected square and the border around this square."""
        return self.size * self.picture_share

    @property
    def paper_modules(self) -> float:
        """Edge length of the paper in modules, M + 2 q: the picture has M modules, the quiet zone q on each side."""
        return self.in_family.picture_modules + 2.0 * self.quiet_zone

    @property
    def paper_share(self) -> float:
        """Ratio (M + 2 q) / N of the edge length of the paper to the edge length of the tag.

        The picture has M modules along its edge, the tag N modules, and the quiet zone on each side q modules.
        """
        return self.picture_share + 2.0 * self.quiet_zone / self.modules

    @property
    def paper_edge(self) -> float:
        """Edge length of the square paper that carries the tag, metres: the picture and its white margin."""
        return self.size * self.paper_share

    def check_ids(self, ids: IntArray) -> None:
        """Raise `InputError` if the family has fewer than K tags, or lacks a tag of the K distinct `ids` `(K,)`."""
        if len(ids) > self.ids:
            raise InputError(f"family {self.family} has {self.ids} different tags, too few for {len(ids)}.", "family")
        if ids.max() >= self.ids:
            message = f"family {self.family} has the tags 0 to {self.ids - 1}, but a landmark has the id {ids.max()}."
            raise InputError(message, "family")

    def picture(self, number: int) -> BoolArray:
        """Picture of tag `number`: the colours of its M x M modules, `(M, M)`, row 0 at the top; True for white.

        Raises:
            InputError: the family has no such tag.
        """
        return picture(self.family, number)
