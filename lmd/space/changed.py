"""Rooms derived from another room: with smaller surfaces, or with other camera positions, taken from a recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.gridded import checked_spacing, latin_hypercube
from lmd.space.space import Space, Weighing
from lmd.space.surface import Surface


class Changed:
    """Base class of rooms derived from another room, the original room.

    Attributes and methods that a subclass does not define are those of the original room.
    """

    def __init__(self, room: Space) -> None:
        self.original = room
        """Room from which this room is derived."""

    def __getattr__(self, name: str) -> Any:
        """Return a public attribute of the original room."""
        if name.startswith("_") or name == "original":  # neither a dataclass nor a room that is still being unpickled
            raise AttributeError(name)
        return getattr(self.original, name)


class Inset(Changed):
    """Room whose surfaces lack a strip along their edges.

    A strip half as wide as a tag's paper keeps this paper on the original surface. `surfaces_of`, `surface_near` and
    `faces` use the original surfaces.

    Args:
        room: original room.
        margin: width of the strip, metres.

    Raises:
        InputError: a surface vanishes.
    """

    def __init__(self, room: Space, margin: float) -> None:
        super().__init__(room)
        self._surfaces = tuple(surface.inset(margin) for surface in room.surfaces())

    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces of the original room in their order, without the strip of width `margin` along their edges."""
        return self._surfaces


# Rounding tolerance of cell borders, metres: a record below a border by less than this is in the cell above.
ON_BORDER = 1e-9


class _Cells(NamedTuple):
    """P grid cells that contain records (positions of a recording), ordered by x, y and z."""

    of: IntArray
    """Index of the cell of each record, `(T,)`."""
    seconds: FloatArray
    """Time spent in each cell, seconds, `(P,)`."""
    chosen: IntArray
    """Index of the record nearest to each cell's mean position, `(P,)`; the mean itself might be unreachable."""


@dataclass(frozen=True)
class TimeSpent:
    """Relevance (weights) of the camera positions of a recording.

    The weight of a position is the time that the camera spent in the grid cell of the position, times the weight that
    the room's own relevance gives to the position.
    """

    positions: FloatArray
    """Positions of the cells, metres, `(P, 3)`."""
    seconds: FloatArray
    """Time spent in each cell, seconds, `(P,)`."""
    within: Weighing
    """Weights of positions in the room, by which the times are multiplied."""

    def weights(self, points: FloatArray) -> FloatArray:
        """Weight of each of the `points` `(P, 3)`, shape `(P,)`.

        The time spent in the cell nearest to a point is multiplied by the point's weight in the room's own relevance.
        """
        from scipy.spatial import cKDTree  # slow to load, and only recordings need it

        _, nearest = cKDTree(self.positions).query(points)
        return np.asarray(self.within.weights(points) * self.seconds[nearest])


class RecordedRoom(Changed):
    """Room whose camera positions are the positions of a recording; implements `Space`.

    Args:
        room: room of the recording.
        positions: positions of T records, metres, `(T, 3)`.
        seconds: duration of each record, seconds, `(T,)`.
        spacing: edge length of the cells, metres: one number or one per axis. The world's origin is a corner of a cell.

    Raises:
        InputError: the spacing is not positive, or the cells would not fit into memory.
    """

    def __init__(
        self, room: Space, positions: FloatArray, seconds: FloatArray, spacing: float | Sequence[float]
    ) -> None:
        super().__init__(room)
        self._spacing = checked_spacing(spacing, np.ptp(positions, axis=0).tolist())
        self._positions, self._seconds = positions, seconds

    def __repr__(self) -> str:
        return f"{self.original!r}, visited in cells of {self._spacing} m"

    @cached_property
    def _cells(self) -> _Cells:
        cell = np.floor((self._positions + ON_BORDER) / np.asarray(self._spacing)).astype(np.int64)
        _, of = np.unique(cell, axis=0, return_inverse=True)
        of = of.reshape(-1)
        seconds = np.asarray(np.bincount(of, weights=self._seconds), dtype=np.float64)
        mean = np.stack([np.bincount(of, weights=self._seconds * x) / seconds for x in self._positions.T], axis=1)
        away = np.linalg.norm(self._positions - mean[of], axis=1)
        by_cell = np.lexsort((away, of))
        chosen = by_cell[np.searchsorted(of[by_cell], np.arange(len(seconds)))]
        return _Cells(of, seconds, chosen)

    @property
    def relevance(self) -> Weighing:
        """Weights of positions: the time spent in each cell, times the weight of its position in the room."""
        return TimeSpent(self.grid(), self._cells.seconds, self.original.relevance)

    def grid(self) -> FloatArray:
        """One position for each of the P visited cells, metres, `(P, 3)`.

        Among the recorded positions in a cell, the one nearest to their mean (weighted by duration) is chosen.
        """
        return self._positions[self._cells.chosen]

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask `(...)` of the straight paths from `starts` to `ends`, `(..., 3)`, that no obstacle blocks.

        The paths need not keep the camera's clearance, as a recorded pose may be closer to an obstacle.
        """
        return np.asarray(self.clear(starts, ends))

    def finer(self) -> "RecordedRoom":
        """See `Space.finer`: the cells of the returned room have half the edge length."""
        half = tuple(np.broadcast_to(self._spacing, 3) / 2.0)
        return RecordedRoom(self.original, self._positions, self._seconds, half)

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Draw `repeats` recorded positions in each of the P cells, `(repeats P, 3)`.

        The probability of a record is proportional to its duration. Row i belongs to cell i mod P.
        """
        of, total, _ = self._cells
        by_cell = np.argsort(of, kind="stable")
        ends = np.cumsum(self._seconds[by_cell])
        last = np.cumsum(np.bincount(of)) - 1
        drawn = np.searchsorted(ends, ends[last] - latin_hypercube(repeats, total.shape, rng) * total)
        return np.asarray(self._positions[by_cell[np.minimum(drawn, last)]]).reshape(-1, 3)

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw `size` recorded positions, `(size, 3)`; the probability of a record is proportional to its duration."""
        return self._positions[rng.choice(len(self._seconds), size, p=self._seconds / self._seconds.sum())]

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw `size` recorded positions, `(size, 3)`: one from each of `size` equal parts of the recorded time."""
        ends = np.cumsum(self._seconds)
        times = (np.arange(size) + rng.random(size)) / size * ends[-1]
        return np.asarray(self._positions[np.searchsorted(ends[:-1], times, side="right")])

    def describe(self) -> str:
        """See `Space.describe`."""
        return f"{self.original.describe()} along a recording"


SPACING = 1.0  # edge of the base class's cells, metres; not used by a driven room


class FrameTime(TimeSpent):
    """Relevance (weights) of the frames (moments with one camera pose each) of recorded drives.

    The weight of a frame is its duration, times the weight that the room's own relevance gives to the camera's
    position.
    """

    def weights(self, points: FloatArray) -> FloatArray:
        """Weight of each of the `points` `(P, 3)`, shape `(P,)`.

        The durations count only if `points` are the positions of all frames, in their order. The weights of other
        points are those of the room's own relevance.
        """
        seconds = self.seconds if np.array_equal(points, self.positions) else np.float64(1.0)
        return np.asarray(self.within.weights(points) * seconds)


class DrivenRoom(RecordedRoom):
    """Room whose grid has one position for each frame of recorded drives; implements `Space`.

    A frame is a moment of a drive with one camera pose. The positions are in the order of the frames.

    Args:
        room: room of the drives.
        positions: positions of F frames, metres, `(F, 3)`.
        seconds: duration of each frame, seconds, `(F,)`.
    """

    def __init__(self, room: Space, positions: FloatArray, seconds: FloatArray) -> None:
        super().__init__(room, positions, seconds, SPACING)

    def __repr__(self) -> str:
        return f"{self.original!r}, along {len(self._positions)} frames"

    @property
    def relevance(self) -> Weighing:
        """Weights of positions: the duration of each frame, times the weight of its position in the room."""
        return FrameTime(self._positions, self._seconds, self.original.relevance)

    def grid(self) -> FloatArray:
        """Position of each frame, metres, `(F, 3)`; several frames may have equal positions."""
        return self._positions

    def finer(self) -> "DrivenRoom":
        """See `Space.finer`: the room itself, as the frames cannot be refined."""
        return self

    def describe(self) -> str:
        """See `Space.describe`."""
        return f"{self.original.describe()} along drives"
