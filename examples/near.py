"""A camera sees what faces it within a range and 40 degrees of its optical axis; nobody hides anybody."""

import math
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, real
from lmd.geometry.camera import Camera
from lmd.scene.criteria import Covering

COSINE = math.cos(math.radians(40.0))


@dataclass(frozen=True)
class Near(Covering):
    """Thresholds.

    Args:
        range: greatest distance, metres.

    Raises:
        InputError: the range is not positive.
    """

    range: float = 3.0
    needs_roll = False

    def __post_init__(self) -> None:
        real("range", self.range, above=0.0)

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """Which landmarks the camera covers, `(A, K)`: the reference."""
        x, y, z = (landmarks - position).T
        distance = np.sqrt(x * x + y * y + z * z)
        facing = normals[:, 0] * x + normals[:, 1] * y + normals[:, 2] * z < 0.0
        depth = axes[:, :1] * x + axes[:, 1:2] * y + axes[:, 2:3] * z
        return np.asarray(facing & (distance <= self.range) & (depth >= COSINE * distance))
