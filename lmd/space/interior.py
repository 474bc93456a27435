"""Interior of a mesh: points with a clear line to a node of its largest free component."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.gridded import combined, grid_axes, grid_counts
from lmd.space.triangles import Triangles

# Spacing of nodes, metres, and maximum number of nodes; a larger number increases the spacing.
STEP, MOST_NODES = 0.2, 400_000
# Least distance of a node from a triangle, metres: a node in the plane of a triangle would connect both sides.
NODE_CLEARANCE_M = 1e-3
# Largest distance between a point and the nodes that are tested for a clear line, node spacings per axis.
STEPS_TO_NODES = 2


@dataclass(frozen=True)
class Interior:
    """Free space of a mesh as a graph of grid nodes, with edges along clear lines.

    Nodes have a triangle below them, as there usually is no floor outside the walls. The room is the connected
    component with the largest volume; the insides of furniture and walls are other components.
    """

    triangles: Triangles
    """Mesh."""
    low: FloatArray
    """Lower corner of the box around the mesh, metres, `(3,)`."""
    high: FloatArray
    """Upper corner of the box around the mesh, metres, `(3,)`."""

    @cached_property
    def _step(self) -> float:
        return max(STEP, float(np.cbrt(np.prod(self.high - self.low) / MOST_NODES)))

    @cached_property
    def _shape(self) -> tuple[int, int, int]:
        return grid_counts(self.high - self.low, self._step, "cells")

    @cached_property
    def _axes(self) -> list[FloatArray]:
        return grid_axes(self.low, self.high, self._shape, "cells")

    @cached_property
    def nodes(self) -> tuple[FloatArray, BoolArray]:
        """All nodes, metres, `(N, 3)`, and the mask of the nodes in the room, `(N,)`."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        at, clear = combined(self._axes), self.triangles.clear
        below = at.copy()
        below[:, 2] = self.low[2] - 1.0
        free = (self.triangles.distance(at, NODE_CLEARANCE_M) >= NODE_CLEARANCE_M) & ~clear(at, below)
        index = np.arange(len(at)).reshape(self._shape)
        pairs = np.concatenate(
            [
                np.stack([index.take(range(n - 1), axis).ravel(), index.take(range(1, n), axis).ravel()])
                for axis, n in enumerate(self._shape)
            ],
            axis=1,
        )
        pairs = pairs[:, free[pairs].all(axis=0)]
        pairs = pairs[:, clear(at[pairs[0]], at[pairs[1]])]
        links = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(at), len(at)))
        _, piece = connected_components(links, directed=False)
        return at, free & (piece == np.bincount(piece[free], minlength=1).argmax()) if free.any() else free

    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` of the box in the room or on its walls, `(...)`."""
        nodes, inside = self.nodes
        flat = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        found, left = np.zeros(len(flat), dtype=np.bool_), np.arange(len(flat))
        # Points in units of the node spacing, relative to the first node.
        at = np.stack(
            [(flat[:, i] - axis[0]) / max(self._pitch[i], 1e-12) for i, axis in enumerate(self._axes)], axis=1
        )
        for offset in _nearest_first():
            node = np.floor(at[left]).astype(int) + offset
            here = ((node >= 0) & (node < self._shape)).all(axis=1)
            number = np.ravel_multi_index(tuple(np.where(here[:, None], node, 0).T), self._shape)
            here &= inside[number]
            asked = left[here]
            found[asked] = self.triangles.clear(flat[asked], nodes[number[here]])
            left = left[~found[left]]
            if not len(left):
                break
        return found.reshape(points.shape[:-1])

    @cached_property
    def _pitch(self) -> FloatArray:
        return np.array((self.high - self.low) / self._shape)


def _nearest_first() -> IntArray:
    """Integer offsets from the lowest corner of a cell to the nodes around the cell, nearest first, `(M, 3)`."""
    offsets = np.array(list(itertools.product(range(1 - STEPS_TO_NODES, 1 + STEPS_TO_NODES), repeat=3)))
    return offsets[np.argsort(np.abs(offsets - 0.5).sum(axis=1), kind="stable")]
