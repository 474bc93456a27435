"""Rel(p), relevance of a position: uniform, by regions, or from a file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, NotNegative, real, vector
from lmd.core.tables import read_numbers

# Largest distance between a position and its row in a file of weights, and tolerance of regions, metres.
SAME_POINT = 1e-6


class Weighing(Protocol):
    """Weights of positions."""

    def weights(self, points: FloatArray) -> FloatArray:
        """Weights of `points` `(P, 3)`, `(P,)`; not all are zero."""


@dataclass(frozen=True)
class Relevance(Checked):
    """Weights of the positions of the reachable area (Rel in Eq. H of the paper).

    Raises:
        InputError: a weight is negative, a region is malformed, or both regions and a file are given.
    """

    background: NotNegative = 1.0
    """Weight of positions in no region."""
    regions: Sequence[Mapping[str, Any]] = ()
    """Closed boxes `{low: [x, y, z], high: [x, y, z], weight: w}`, metres, world frame; later regions override earlier
    ones."""
    path: str | None = None
    """CSV with columns `x,y,z,weight` for every position of the grid, instead of background and regions."""

    def _validate(self) -> None:
        if self.path is not None and self.regions:
            raise InputError(f"path = {self.path!r} cannot be given beside regions.", "path")
        if isinstance(self.regions, str) or not isinstance(self.regions, Sequence):
            raise InputError(f"regions must be a list, got {self.regions!r}.", "regions")
        for i, region in enumerate(self.regions):
            name = f"regions[{i}]"
            if not isinstance(region, Mapping) or set(region) != {"low", "high", "weight"}:
                raise InputError(f"{name} must have the keys low, high and weight, got {region!r}.", name)
            real(f"{name}.weight", region["weight"], low=0.0)
            low, high = vector(f"{name}.low", region["low"], 3), vector(f"{name}.high", region["high"], 3)
            if any(a > b for a, b in zip(low, high, strict=True)):
                raise InputError(f"{name} is empty: low = {list(low)} exceeds high = {list(high)}.", name)

    def weights(self, points: FloatArray) -> FloatArray:
        """Weights of `points` `(P, 3)`, shape `(P,)`.

        Raises:
            InputError: every weight is zero, a region holds none of the points, or a point has no row in the file.
        """
        weights = self._from_file(self.path, points) if self.path is not None else self._from_regions(points)
        if not weights.any():
            given = "background" if self.path is None else "path"
            raise InputError(f"{given} gives every position the weight 0.", given)
        return weights

    def _from_regions(self, points: FloatArray) -> FloatArray:
        weights = np.full(len(points), float(self.background))
        for i, region in enumerate(self.regions):
            low, high = np.asarray(region["low"]), np.asarray(region["high"])
            inside = ((points >= low - SAME_POINT) & (points <= high + SAME_POINT)).all(axis=1)
            if not inside.any():
                box, where = (
                    f"from {a.tolist()} to {b.tolist()}" for a, b in ((low, high), (points.min(0), points.max(0)))
                )
                raise InputError(f"regions[{i}] {box} holds no position; they are {where}.", f"regions[{i}]")
            weights[inside] = float(region["weight"])
        return weights

    @staticmethod
    def _from_file(path: str, points: FloatArray) -> FloatArray:
        from scipy.spatial import cKDTree

        table = read_numbers(path, ("x", "y", "z", "weight"), name="path")
        if (table[:, 3] < 0.0).any():
            raise InputError(f"{path} has a negative weight, {table[:, 3].min():g}.")
        distance, row = cKDTree(table[:, :3]).query(points)
        if distance.max() > SAME_POINT:
            x, y, z = points[int(np.argmax(distance))]
            raise InputError(f"{path} has no weight for the position ({x:g}, {y:g}, {z:g}).")
        return np.asarray(table[row, 3])
