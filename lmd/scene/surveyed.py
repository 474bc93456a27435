"""Measured places and ups of landmarks, beside the positions that evaluations use."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray

# Maximum deviation of an up from upright, as its length, and from a unit vector in the plane of its tag: files round.
UP_TOLERANCE, IN_PLANE = 1e-3, 1e-2


@dataclass(frozen=True)
class Surveyed:
    """Measurements of K landmarks, each of which holds as long as the landmark is not moved.

    Args:
        positions: where the landmarks are counted as hanging, `(K, 3)`, world frame, metres.
        places: where they were measured, `(K, 3)`, metres, such as a little behind their wall.
        ups: unit vectors to their upper edges, `(K, 3)`, in the planes of the tags.
    """

    positions: FloatArray
    places: FloatArray
    ups: FloatArray

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Surveyed":
        """That of the landmarks that `chosen` selects."""
        return Surveyed(self.positions[chosen], self.places[chosen], self.ups[chosen])

    def places_of(self, positions: FloatArray) -> FloatArray:
        """The places of landmarks that are now at `positions` `(K, 3)`, metres, `(K, 3)`."""
        return np.where(self._stays(positions), self.places, positions)

    def ups_of(self, positions: FloatArray, upright: FloatArray) -> FloatArray:
        """Their ups, of those that were moved the `upright` ones, `(K, 3)`."""
        return np.where(self._stays(positions), self.ups, upright)

    def _stays(self, positions: FloatArray) -> BoolArray:
        return np.asarray((positions == self.positions).all(axis=1, keepdims=True))


def in_plane(
    path: str | Path, ids: IntArray, normals: FloatArray, upright: FloatArray, ups: FloatArray
) -> FloatArray | None:
    """Ups `(K, 3)` of a file, projected to the planes of the tags; None if all are `upright` `(K, 3)`.

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
