"""Measured positions and ups of landmarks, kept apart from the corrected positions that evaluations use."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray

# `UP_TOLERANCE`: largest length of the difference between an up and the upright up that counts as upright. `IN_PLANE`:
# largest deviation of an up in a file from unit length and from the plane of its tag.
UP_TOLERANCE, IN_PLANE = 1e-3, 1e-2


@dataclass(frozen=True)
class Surveyed:
    """Measurements of K landmarks; a measurement is ignored once its landmark is moved.

    Args:
        positions: corrected positions, on or in front of the surfaces, world frame, metres, `(K, 3)`.
        places: measured positions, such as slightly behind a wall, world frame, metres, `(K, 3)`.
        ups: unit vectors in the planes of the tags to their upper edges, world frame, `(K, 3)`.
    """

    positions: FloatArray
    places: FloatArray
    ups: FloatArray

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Surveyed":
        """Measurements of the landmarks selected by `chosen`."""
        return Surveyed(self.positions[chosen], self.places[chosen], self.ups[chosen])

    def places_of(self, positions: FloatArray) -> FloatArray:
        """Measured positions of landmarks at `positions`, `(K, 3)` each, metres; for moved landmarks, `positions`."""
        return np.where(self._stays(positions), self.places, positions)

    def ups_of(self, positions: FloatArray, upright: FloatArray) -> FloatArray:
        """Measured ups of landmarks at `positions`, `(K, 3)` each; for moved landmarks, the `upright` ups."""
        return np.where(self._stays(positions), self.ups, upright)

    def _stays(self, positions: FloatArray) -> BoolArray:
        return np.asarray((positions == self.positions).all(axis=1, keepdims=True))


def in_plane(
    path: str | Path, ids: IntArray, normals: FloatArray, upright: FloatArray, ups: FloatArray
) -> FloatArray | None:
    """Project a file's up vectors `(K, 3)` to the planes of their tags; None if all equal `upright` `(K, 3)`.

    Raises:
        InputError: an up is no unit vector in the plane of its tag.
    """
    leaning = (ups * normals).sum(axis=1, keepdims=True)
    off = np.maximum(np.abs(leaning[:, 0]), np.abs(np.linalg.norm(ups, axis=1) - 1.0))
    if (wrong := np.flatnonzero(off > IN_PLANE)).size:
        up, normal = (", ".join(f"{value:.4g}" for value in v[wrong[0]]) for v in (ups, normals))
        raise InputError(
            f"{path}: the up of landmark {ids[wrong[0]]}, ({up}), is no unit vector in the plane of its tag, whose "
            f"normal is ({normal})."
        )
    level = np.linalg.norm(ups - upright, axis=1, keepdims=True) <= UP_TOLERANCE
    if level.all():
        return None
    flat = ups - leaning * normals
    return np.where(level, upright, flat / np.linalg.norm(flat, axis=1, keepdims=True))
