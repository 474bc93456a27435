"""Room over a floor plan with a reachable volume."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.space.blockers import Blockers, edges
from lmd.space.cuboid import box_edges
from lmd.space.fixture import Fixture
from lmd.space.floor_plan import FloorPlan
from lmd.space.gridded import Gridded, GridKind, clear_of
from lmd.space.parts import Reachable, made
from lmd.space.space import Relevance
from lmd.space.surface import Surface


@dataclass(frozen=True)
class Prism(Gridded):
    """Room over a floor plan; implements `lmd.space.space.Space`.

    Positions are the points of a grid that are in the reachable volume. The grid fills the box around the walls,
    reduced by the clearance.

    Raises:
        InputError: the reachable volume leaves the room or is empty, a value is out of range, or the positions would
            not fit into memory.
    """

    plan: FloorPlan
    """Floor plan of the room."""
    reachable: Annotated[Reachable, partial(made, kind=Reachable)]
    """Reachable volume, or a mapping of its arguments."""
    spacing: float | Sequence[float]
    """Largest distance between neighbouring positions, metres: one number or one per axis."""
    positions: GridKind = "cells"
    """`cells` for the centres of the grid cells, `vertices` for the vertices."""
    relevance: Relevance = field(default_factory=Relevance)
    """Relevance Rel(p): weights of the camera positions."""
    kind: ClassVar[str] = "room over a floor plan"

    def _validate(self) -> None:
        low, high = self.box
        if low[2] < 0.0 or high[2] > self.plan.height:
            raise InputError(
                f"reachable.height = {list(self.reachable.height)} leaves the room, which is {self.plan.height:g} m "
                "high.",
                "reachable.height",
            )
        if (low > high).any():
            raise InputError(
                f"reachable.clearance = {self.reachable.clearance:g} leaves no volume in the {self.describe()}.",
                "reachable.clearance",
            )
        self._set_grid(
            f"reachable.height = {list(self.reachable.height)} and clearance = {self.reachable.clearance:g} hold no "
            "position of the grid: walls, holes and obstacles leave no space, or spacing is too large.",
            "reachable.height",
        )

    @cached_property
    @override
    def box(self) -> tuple[FloatArray, FloatArray]:
        vertices, clearance = np.array(self.plan.outline), self.reachable.clearance
        low, high = self.reachable.height
        return np.append(vertices.min(axis=0) + clearance, low), np.append(vertices.max(axis=0) - clearance, high)

    @override
    def reaches(self, points: FloatArray) -> BoolArray:
        return self.plan.contains(points, self.reachable.clearance)

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        return self.plan.carriers

    @override
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        vertices = np.array(self.plan.outline)
        return np.append(vertices.min(axis=0), 0.0), np.append(vertices.max(axis=0), self.plan.height)

    @override
    def contains(self, points: FloatArray) -> BoolArray:
        return self.plan.contains(points)

    @override
    def blockers(self) -> Blockers | None:
        return self.plan.blockers

    @override
    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.passable`: the whole path must keep the clearance."""
        blockers = self.plan.blockers
        return clear_of(blockers and blockers.grown(self.reachable.clearance), starts, ends)

    @override
    def faces(self) -> tuple[Surface, ...]:
        return self.plan.faces

    def outline(self) -> dict[str, FloatArray]:
        """See `Space.outline`; the reachable area is drawn as if obstacles reached from floor to ceiling."""
        plan, (low, high) = self.plan, self.reachable.height
        parts = {"room": [_prism_edges(ring, 0.0, plan.height) for ring in (plan.outline, *plan.holes)]}
        parts["obstacles"] = [box_edges(np.array(part.low), np.array(part.high)) for part in plan.obstacles]
        parts["nothing hangs here"] = [edges(ring) for ring in plan.kept_out]
        parts["reachable area"] = [_prism_edges(ring, low, high) for ring in plan.clearings(self.reachable.clearance)]
        return {name: np.concatenate(drawn) for name, drawn in parts.items() if drawn}

    @override
    def fixtures(self) -> list[Fixture]:
        return self.plan.fixtures


def _prism_edges(ring: Sequence[Sequence[float]], low: float, high: float) -> FloatArray:
    """Edges, `(M, 2, 3)`, of the upright prism over the polygon `ring`, from height `low` to height `high`, metres."""
    flat = edges(ring)
    bottom, top = (np.insert(flat, 2, z, axis=2) for z in (low, high))
    return np.concatenate([bottom, top, np.stack([bottom[:, 0], top[:, 0]], axis=1)])


def from_floor_plan(
    outline: Any,
    height: Any,
    reachable: Any,
    spacing: Any,
    positions: str = "cells",
    relevance: Relevance | None = None,
    **plan: Any,
) -> Prism:
    """Make a `Prism` from its arguments and the arguments of its `FloorPlan`."""
    return Prism(FloorPlan(outline, height, **plan), reachable, spacing, positions, relevance or Relevance())
