"""Convex bodies that block lines of sight, each the intersection of half-spaces.

The points of the line from p to q are p + t (q - p), 0 <= t <= 1. The height h of a point above a plane is linear in t
and zero at t0 = h(p) / (h(p) - h(q)). The line is behind the plane for t > t0 if h(p) >= 0 > h(q), and for t < t0 if
h(p) < 0 <= h(q). A body blocks the line if some t is behind all its planes.

A body is an open set, smaller by `PLACEMENT_TOLERANCE` than the obstacle. So a line along a face or through an edge or
corner is clear, and a body does not hide landmarks on its faces. A non-convex obstacle consists of several bodies,
which overlap by `OVERLAP_M` so that no line passes between them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.space.surface import PLACEMENT_TOLERANCE

# Overlap of adjacent bodies, metres: more than rounding errors, and too little to protrude at a corner.
OVERLAP_M = 1e-9


class Body(NamedTuple):
    """Convex body with m planes."""

    normals: FloatArray
    """Unit normals outwards, `(m, 3)`."""
    offsets: FloatArray
    """Offset n . x of each plane, metres, `(m,)`."""
    solid: BoolArray
    """True for faces, False for planes shared with another body, `(m,)`."""


class Blockers(NamedTuple):
    """M bodies as arrays of their J planes."""

    normals: np.ndarray
    """Unit normals outwards, `(J, 3)`."""
    offsets: np.ndarray
    """Offset n . x of each plane, moved by the tolerance, metres, `(J,)`."""
    solid: np.ndarray
    """True for faces, False for planes shared with another body, `(J,)`."""
    first: np.ndarray
    """Planes of body m are `first[m]` to `first[m + 1]`, `(M + 1,)`."""

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Blockers":
        """Make the arrays of at least one body, with faces moved inwards by the tolerance."""
        normals, offsets, solid = (np.concatenate(parts) for parts in zip(*bodies, strict=True))
        offsets = offsets + np.where(solid, -PLACEMENT_TOLERANCE, OVERLAP_M)
        first = np.append(0, np.cumsum([len(body.offsets) for body in bodies]))
        return cls(np.ascontiguousarray(normals), offsets, solid, first)

    def grown(self, by: float) -> "Blockers":
        """Bodies with all faces moved outwards `by` metres."""
        return self._replace(offsets=self.offsets + by * self.solid)

    def heights(self, points: FloatArray) -> FloatArray:
        """Heights h of points `(..., 3)` above the planes, `(..., J)`, metres."""
        x, y, z = points[..., :1], points[..., 1:2], points[..., 2:]
        nx, ny, nz = self.normals.T
        return np.asarray(nx * x + ny * y + nz * z - self.offsets)

    def inside(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` inside a body, `(...)`."""
        return np.asarray((np.maximum.reduceat(self.heights(points), self.first[:-1], axis=-1) < 0.0).any(axis=-1))

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the lines between points `(..., 3)` that no body blocks, `(...)`."""
        start, end = self.heights(starts), self.heights(ends)
        with np.errstate(all="ignore"):  # t is unused for lines that do not cross the plane
            t = start / (start - end)
        apart = (start >= 0.0) & (end >= 0.0)
        enters = np.where(start >= 0.0, np.where(apart, np.inf, t), 0.0)
        leaves = np.where((start < 0.0) & (end >= 0.0), t, 1.0)
        bodies = self.first[:-1]
        entered = np.maximum.reduceat(enters, bodies, axis=-1)
        return np.asarray((entered >= np.minimum.reduceat(leaves, bodies, axis=-1)).all(axis=-1))
