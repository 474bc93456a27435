"""Named doors, windows and furniture of a room, for drawings."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.surface import Surface

# Largest distance between a fixture and a surface that touch, and largest thickness of a flat fixture, metres.
TOUCHING_M = 0.03
KINDS = ("door", "window", "furniture", "other")
NAMED_KIND = re.compile("(?<![a-z])(door|window)")  # matches only the beginning of a word


@dataclass(frozen=True)
class Fixture:
    """Named part of a room other than a wall, such as a door, a window, a table or a picture.

    Args:
        name: name on drawings.
        corners: points whose convex hull is the fixture, world frame, metres, `(N, 3)`.
    """

    name: str
    corners: FloatArray

    @cached_property
    def kind(self) -> str:
        """One of `KINDS`: `door` or `window` if the name contains this word.

        Otherwise, a fixture is of the kind `other` if its footprint is at most `TOUCHING_M` wide, and `furniture` if
        not.
        """
        named = NAMED_KIND.search(self.name.lower())
        if named:
            return named[0]
        return "other" if self.footprint.buffer(-TOUCHING_M / 2.0).is_empty else "furniture"

    @cached_property
    def footprint(self) -> Any:
        """Vertical projection to the floor, a shapely polygon or line."""
        import shapely

        return shapely.MultiPoint(self.corners[:, :2]).convex_hull

    def has(self, surface: Surface) -> bool:
        """True if a surface is a face of the fixture.

        The fixture must be behind the surface and contain the point `TOUCHING_M` behind the surface's centre.
        """
        import shapely

        depth = (self.corners - surface.origin) @ surface.normal
        inside = surface.point(*np.divide(surface.extent, 2.0)) - TOUCHING_M * surface.normal
        within = (inside >= self.corners.min(axis=0)).all() and (inside <= self.corners.max(axis=0)).all()
        return bool(depth.max() < TOUCHING_M and within and self.footprint.covers(shapely.Point(inside[:2])))

    def on(self, surface: Surface) -> Any:
        """Part of a surface that the fixture covers, a shapely polygon, possibly empty.

        Coordinates are metres from the left and the lower edge of the surface. The part is empty for the fixture's own
        faces.
        """
        import shapely

        depth = (self.corners - surface.origin) @ surface.normal
        near = self.corners[np.abs(depth) <= TOUCHING_M] - surface.origin
        if self.has(surface) or len(near) < 3:
            return shapely.Polygon()
        at = surface.from_left_and_below(np.stack([near @ surface.u, near @ surface.v], axis=-1))
        hull = shapely.MultiPoint(at).convex_hull.intersection(shapely.box(0.0, 0.0, *surface.extent))
        return hull if hull.geom_type == "Polygon" else shapely.Polygon()
