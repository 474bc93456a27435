"""Where landmarks hang to the last digit, beside where they are counted as hanging."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Surveyed:
    """What somebody measured of K landmarks. It holds for a landmark as long as that is not moved.

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
