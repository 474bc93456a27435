"""Room from a mesh with a reachable volume."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.space.cuboid import box_edges
from lmd.space.fixture import Fixture
from lmd.space.gridded import Gridded, GridKind
from lmd.space.parts import FreeVolume, made
from lmd.space.scan import Scan
from lmd.space.space import Relevance
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface
from lmd.space.triangles import Triangles


@dataclass(frozen=True)
class MeshRoom(Gridded):
    """Room from a mesh; implements `lmd.space.space.Space`.

    Positions are the points of a grid that are in the free space of the mesh and keep the clearance. The grid fills a
    given box; without a given box, it fills the box around the mesh, reduced by the clearance.

    Raises:
        InputError: the reachable volume leaves the mesh or is empty, a value is out of range, or the positions would
            not fit into memory.
    """

    scan: Scan
    """Mesh with its surfaces and its free space."""
    reachable: Annotated[FreeVolume, partial(made, kind=FreeVolume)]
    """Reachable volume: a `FreeVolume`, or a mapping of its arguments."""
    spacing: Any
    """Largest distance between neighbouring positions, metres: one number or one per axis."""
    positions: GridKind = "cells"
    """`cells` for the centres of the grid cells, `vertices` for the vertices."""
    relevance: Relevance = field(default_factory=Relevance)
    """Relevance Rel(p): weights of the camera positions."""
    kind: ClassVar[str] = "room from a mesh"
    digits: ClassVar[int] = 4

    def _validate(self) -> None:
        (low, high), (lowest, highest) = self.box, self.bounds()
        name = "reachable.height" if self.reachable.low is None else "reachable.low"
        if (
            (low > high).any()
            or (low < lowest - PLACEMENT_TOLERANCE).any()
            or (high > highest + PLACEMENT_TOLERANCE).any()
        ):
            ranges = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(lowest, highest, strict=True))
            raise InputError(
                f"{name} and clearance = {self.reachable.clearance:g} leave no volume in the mesh, whose x, y and z go "
                f"from {ranges} m.",
                name,
            )
        self._set_grid(
            f"{name} and clearance = {self.reachable.clearance:g} hold no position of the grid: triangles leave "
            "no space, there is no floor below, or spacing is too large.",
            name,
        )
        self.surfaces()  # raises an error if no surface may carry landmarks

    @cached_property
    @override
    def box(self) -> tuple[FloatArray, FloatArray]:
        if self.reachable.low is not None:
            return np.array(self.reachable.low), np.array(self.reachable.high)
        (low, high), clearance = self.scan.bounds, self.reachable.clearance
        assert self.reachable.height is not None
        bottom, top = self.reachable.height
        return np.append(low[:2] + clearance, bottom), np.append(high[:2] - clearance, top)

    @override
    def reaches(self, points: FloatArray) -> BoolArray:
        reached = self.scan.keeps_away(points, self.reachable.clearance)
        reached[reached] = self.scan.interior.contains(points[reached])
        return reached

    @cached_property
    def _surfaces(self) -> tuple[Surface, ...]:
        return self.scan.carriers(self.grid())

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        return self._surfaces

    @override
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        return self.scan.bounds

    @override
    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` in the closed room, `(...)`.

        A point is inside if a clear line joins it to a nearby node of the graph `Scan.interior`. Places where landmarks
        are allowed are always inside.
        """
        low, high = self.bounds()
        within = (points >= low - PLACEMENT_TOLERANCE) & (points <= high + PLACEMENT_TOLERANCE)
        found = np.asarray(within.all(axis=-1) & self.scan.interior.contains(points))
        found[~found] = self._carried(points[~found])[2].any(axis=-1)
        return found

    @override
    def blockers(self) -> Triangles:
        return self.scan.triangles

    @override
    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.passable`: the whole path must keep the clearance."""
        free, clearance = self.clear(starts, ends), self.reachable.clearance
        return free if self.scan.solids is None else free & self.scan.solids.keeps_away(starts, ends, clearance)

    @override
    def faces(self) -> tuple[Surface, ...]:
        return self.scan.faces

    def outline(self) -> dict[str, FloatArray]:
        """See `Space.outline`; the reachable area is drawn as the box around its positions."""
        grid, kept_out = self.grid(), self.scan.kept_out(self.surfaces())
        parts = {"room": self.scan.edges}
        if kept_out:
            parts["nothing hangs here"] = np.concatenate(
                [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in kept_out]
            )
        return parts | {"reachable area": box_edges(grid.min(axis=0), grid.max(axis=0))}

    @override
    def fixtures(self) -> list[Fixture]:
        return self.scan.fixtures(self.surfaces())
