"""Convex bodies that block lines of sight, each the intersection of half-spaces.

The line from p to q is at p + t (q - p), 0 <= t <= 1. Its height above a plane falls or rises evenly from h(p) to h(q),
so it is behind the plane from t = h(p) / (h(p) - h(q)) on if h(p) >= 0 > h(q), and up to there if h(p) < 0 <= h(q). A
body blocks it if there is a t at which it is behind all of them.

A body is open, and smaller by `PLACEMENT_TOLERANCE` than the obstacle: a line along a face, or through an edge or a
corner, is clear, and so is the last micrometre before a landmark on the body. An obstacle that is not convex consists
of several bodies, which overlap by `OVERLAP_M` so that no line passes between them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.space.surface import PLACEMENT_TOLERANCE

# Overlap of adjacent bodies, metres: more than rounding errors, and too little to protrude at a corner.
OVERLAP_M = 1e-9


class Body(NamedTuple):
    """A convex body with m planes."""

    normals: FloatArray
    """Unit normals outwards, `(m, 3)`."""
    offsets: FloatArray
    """n . x of the points x of each plane, metres, `(m,)`."""
    solid: BoolArray
    """True for faces, False for planes shared with another body, `(m,)`."""


class Blockers(NamedTuple):
    """Bodies as arrays of J planes."""

    normals: np.ndarray
    """Unit normals outwards, `(J, 3)`."""
    offsets: np.ndarray
    """n . x of the points x of each plane, with the tolerance, metres, `(J,)`."""
    solid: np.ndarray
    """See `Body`, `(J,)`."""
    first: np.ndarray
    """Planes of body m are `first[m]` to `first[m + 1]`, `(M + 1,)`."""

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Blockers":
        """Arrays of at least one body, with the tolerance."""
        normals, offsets, solid = (np.concatenate(parts) for parts in zip(*bodies, strict=True))
        offsets = offsets + np.where(solid, -PLACEMENT_TOLERANCE, OVERLAP_M)
        first = np.append(0, np.cumsum([len(body.offsets) for body in bodies]))
        return cls(np.ascontiguousarray(normals), offsets, solid, first)

    def grown(self, by: float) -> "Blockers":
        """The bodies with all faces moved outwards `by` metres."""
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
