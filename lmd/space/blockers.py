"""What blocks a line of sight: convex bodies, each the part of space behind all of its planes.

The line from p to q is at p + t (q - p), 0 <= t <= 1. Its height above a plane falls or rises evenly from h(p) to h(q),
so it is behind the plane from t = h(p) / (h(p) - h(q)) on if h(p) >= 0 > h(q), and up to there if h(p) < 0 <= h(q). A
body blocks it if there is a t at which it is behind all of them.

A body is open, and smaller by `PLACEMENT_TOLERANCE` than what it stands for: a line that runs along a face, or touches
an edge or a corner, is clear, and so is the last micrometre before a landmark on the body. What is not convex is made
of several bodies. Where they meet each reaches into the other a little, so that no line slips through.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.space.surface import PLACEMENT_TOLERANCE

# By which bodies that meet reach into each other, metres: more than rounding, and too little to stick out of a corner.
OVERLAP_M = 1e-9


class Body(NamedTuple):
    """A convex body with m planes."""

    normals: FloatArray
    """`(m, 3)` unit, outwards."""
    offsets: FloatArray
    """`(m,)` n . x of the points x of a plane, metres."""
    solid: BoolArray
    """`(m,)` which planes are faces; the others are where the body meets another one."""


class Blockers(NamedTuple):
    """Bodies as arrays: the planes of all `(J, 3)`, `(J,)`; those of body m are from `first[m]` to `first[m + 1]`."""

    normals: np.ndarray
    offsets: np.ndarray
    solid: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Blockers":
        """The arrays of at least one body, with the tolerance."""
        normals, offsets, solid = (np.concatenate(parts) for parts in zip(*bodies, strict=True))
        offsets = offsets + np.where(solid, -PLACEMENT_TOLERANCE, OVERLAP_M)
        first = np.append(0, np.cumsum([len(body.offsets) for body in bodies]))
        return cls(np.ascontiguousarray(normals), offsets, solid, first)

    def grown(self, by: float) -> "Blockers":
        """The bodies with all faces moved outwards by so many metres."""
        return self._replace(offsets=self.offsets + by * self.solid)

    def heights(self, points: FloatArray) -> FloatArray:
        """Heights h of points `(..., 3)` above the planes, `(..., J)`, metres."""
        x, y, z = points[..., :1], points[..., 1:2], points[..., 2:]
        nx, ny, nz = self.normals.T
        return np.asarray(nx * x + ny * y + nz * z - self.offsets)

    def inside(self, points: FloatArray) -> BoolArray:
        """Whether points `(..., 3)` are in a body, `(...)`."""
        return np.asarray((np.maximum.reduceat(self.heights(points), self.first[:-1], axis=-1) < 0.0).any(axis=-1))

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Whether no body blocks the lines between points `(..., 3)`, `(...)`."""
        start, end = self.heights(starts), self.heights(ends)
        with np.errstate(all="ignore"):  # where the line does not cross the plane, t is anything
            t = start / (start - end)
        apart = (start >= 0.0) & (end >= 0.0)
        enters = np.where(start >= 0.0, np.where(apart, np.inf, t), 0.0)
        leaves = np.where((start < 0.0) & (end >= 0.0), t, 1.0)
        bodies = self.first[:-1]
        entered = np.maximum.reduceat(enters, bodies, axis=-1)
        return np.asarray((entered >= np.minimum.reduceat(leaves, bodies, axis=-1)).all(axis=-1))
