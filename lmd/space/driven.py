"""Room with the frames of drives as its positions."""

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray
from lmd.space.changed import RecordedRoom
from lmd.space.relevance import Weighing
from lmd.space.space import Space

SPACING = 1.0  # edge of the cells of the base class, metres; a driven room does not use them


@dataclass(frozen=True)
class FrameTime:
    """Relevance of the frames of drives: duration of the frame times the relevance of the room."""

    positions: FloatArray
    """Positions of the frames, metres, `(F, 3)`."""
    seconds: FloatArray
    """Duration of each frame, seconds, `(F,)`."""
    within: Weighing
    """Relevance of the room."""

    def weights(self, points: FloatArray) -> FloatArray:
        """See `Weighing.weights`; points that are not the frames have the relevance of the room alone."""
        seconds = self.seconds if np.array_equal(points, self.positions) else np.float64(1.0)
        return np.asarray(self.within.weights(points) * seconds)


class DrivenRoom(RecordedRoom):
    """Room whose grid has one position for each frame of drives, in their order; a `Space`.

    Args:
        room: room of the drives.
        positions: positions of F frames, metres, `(F, 3)`.
        seconds: duration of each frame, seconds, `(F,)`.
    """

    def __init__(self, room: Space, positions: FloatArray, seconds: FloatArray) -> None:
        super().__init__(room, positions, seconds, SPACING)

    def __repr__(self) -> str:
        return f"{self._room!r}, along {len(self._positions)} frames"

    @property
    @override
    def relevance(self) -> Weighing:
        """Duration of the frames times the relevance of the room."""
        return FrameTime(self._positions, self._seconds, self._room.relevance)

    @override
    def grid(self) -> FloatArray:
        """Position of each frame, `(F, 3)`; frames may coincide."""
        return self._positions

    @override
    def finer(self) -> "DrivenRoom":
        return self

    @override
    def describe(self) -> str:
        return f"{self._room.describe()} along drives"
