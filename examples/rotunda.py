"""A cuboid in which the camera stays in an upright cylinder, as wide as the reachable box."""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.space.cuboid import Cuboid


class Rotunda(Cuboid):
    """Settings are those of `Cuboid`."""

    def _within(self, points: FloatArray) -> BoolArray:
        middle, radii = np.array(self.size[:2]) / 2.0, np.array(self.reachable_size[:2]) / 2.0
        within: BoolArray = (((points[:, :2] - middle) / radii) ** 2).sum(axis=1) <= 1.0
        return within

    def _bent(self, points: FloatArray) -> FloatArray:
        """Points of the box, `(N, 3)`, as evenly in the cylinder: x becomes the angle, y the radius."""
        x, y, _ = ((points - self.reachable_low) / self.reachable_size).T
        radius = np.sqrt(y)[:, None] * self.reachable_size[:2] / 2.0
        circle = np.stack([np.cos(2.0 * np.pi * x), np.sin(2.0 * np.pi * x)], axis=1)
        return np.column_stack([np.array(self.size[:2]) / 2.0 + radius * circle, points[:, 2]])

    def grid(self) -> FloatArray:
        """Positions of the camera, `(P, 3)`."""
        points = super().grid()
        return points[self._within(points)]

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Positions in the cells of the grid, `(repeats P, 3)`."""
        return super().jittered_grid(repeats, rng)[np.tile(self._within(super().grid()), repeats)]

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Independent positions, `(size, 3)`."""
        return self._bent(super().sample(size, rng))

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Positions spread evenly, `(size, 3)`."""
        return self._bent(super().sample_evenly(size, rng))
