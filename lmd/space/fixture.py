"""Doors, windows and furniture of a room by their names, for whoever draws it."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.surface import Surface

# What is so near to a surface stands against it, and what is no thicker is flat, metres.
TOUCHING_M = 0.03
KINDS = ("door", "window", "furniture", "other")
NAMED_KIND = re.compile("(?<![a-z])(door|window)")  # a word of the name begins so


@dataclass(frozen=True)
class Fixture:
    """A named part of a room that is no wall: a door, a window, a table, a picture.

    Args:
        name: what it is called.
        corners: points `(N, 3)` whose convex hull it fills, world frame, metres.
    """

    name: str
    corners: FloatArray

    @cached_property
    def kind(self) -> str:
        """One of `KINDS`: what its name says, or otherwise `furniture` if it stands on some ground."""
        named = NAMED_KIND.search(self.name.lower())
        if named:
            return named[0]
        return "other" if self.footprint.buffer(-TOUCHING_M / 2.0).is_empty else "furniture"

    @cached_property
    def footprint(self) -> Any:
        """The part of the floor that it covers, seen from above: a polygon of shapely, or a line."""
        import shapely

        return shapely.MultiPoint(self.corners[:, :2]).convex_hull

    def has(self, surface: Surface) -> bool:
        """Whether a surface is one of its faces: it is behind it, and there."""
        import shapely

        depth = (self.corners - surface.origin) @ surface.normal
        inside = surface.point(*np.divide(surface.extent, 2.0)) - TOUCHING_M * surface.normal
        within = (inside >= self.corners.min(axis=0)).all() and (inside <= self.corners.max(axis=0)).all()
        return bool(depth.max() < TOUCHING_M and within and self.footprint.covers(shapely.Point(inside[:2])))

    def on(self, surface: Surface) -> Any:
        """The part of a surface that it covers, metres from the left and lower edge: a polygon of shapely, maybe empty.

        Nothing of its own faces.
        """
        import shapely

        depth = (self.corners - surface.origin) @ surface.normal
        near = self.corners[np.abs(depth) <= TOUCHING_M] - surface.origin
        if self.has(surface) or len(near) < 3:
            return shapely.Polygon()
        at = surface.seen(np.stack([near @ surface.u, near @ surface.v], axis=-1))
        hull = shapely.MultiPoint(at).convex_hull.intersection(shapely.box(0.0, 0.0, *surface.extent))
        return hull if hull.geom_type == "Polygon" else shapely.Polygon()
