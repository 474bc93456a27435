"""Rooms derived from another room: with smaller surfaces, or with the positions of a recording."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.gridded import checked_spacing, latin_hypercube
from lmd.space.relevance import Weighing
from lmd.space.space import Space
from lmd.space.surface import Surface

Method = TypeVar("Method", bound=Callable[..., Any])


def _asked(method: Method) -> Method:
    """Delegate a method of `Space` to the room."""

    @wraps(method)
    def ask(changed: "Changed", *arguments: Any, **named: Any) -> Any:
        return getattr(changed._room, method.__name__)(*arguments, **named)

    return cast(Method, ask)


class Changed:
    """A `Space` that delegates to a room; subclasses override what they change."""

    def __init__(self, room: Space) -> None:
        self._room = room

    @property
    def relevance(self) -> Weighing:
        """See `Space.relevance`."""
        return self._room.relevance

    surfaces = _asked(Space.surfaces)
    surfaces_of = _asked(Space.surfaces_of)
    surface_near = _asked(Space.surface_near)
    bounds = _asked(Space.bounds)
    contains = _asked(Space.contains)
    blockers = _asked(Space.blockers)
    faces = _asked(Space.faces)
    passable = _asked(Space.passable)
    clear = _asked(Space.clear)
    grid = _asked(Space.grid)
    finer = _asked(Space.finer)
    jittered_grid = _asked(Space.jittered_grid)
    sample = _asked(Space.sample)
    sample_evenly = _asked(Space.sample_evenly)
    outline = _asked(Space.outline)
    fixtures = _asked(Space.fixtures)
    describe = _asked(Space.describe)


class Inset(Changed):
    """A room with smaller surfaces, such as for the centres of footprints.

    `surfaces_of`, `surface_near` and `faces` use the whole surfaces.

    Args:
        room: the room.
        margin: width of the strip that is removed along all edges, metres.

    Raises:
        InputError: a surface vanishes.
    """

    def __init__(self, room: Space, margin: float) -> None:
        super().__init__(room)
        self._surfaces = tuple(surface.inset(margin) for surface in room.surfaces())

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces in the order of those of the room."""
        return self._surfaces


# Rounding tolerance of the borders of cells, metres: a record this far below a border belongs to the cell above.
ON_BORDER = 1e-9


class _Cells(NamedTuple):
    """Cells with records, ordered by x, y and z."""

    of: IntArray
    """Cell of each record, `(T,)`."""
    seconds: FloatArray
    """Time spent in each cell, seconds, `(P,)`."""
    chosen: IntArray
    """Record nearest to the mean of each cell, `(P,)`: unlike the mean, certainly a possible position."""


@dataclass(frozen=True)
class TimeSpent:
    """Relevance by the time that a recording spent in a cell, times the relevance of the room."""

    positions: FloatArray
    """Positions of the cells, metres, `(P, 3)`."""
    seconds: FloatArray
    """Time spent in each cell, seconds, `(P,)`."""
    within: Weighing
    """Relevance of the room."""

    def weights(self, points: FloatArray) -> FloatArray:
        """See `Weighing.weights`; a point belongs to the nearest cell."""
        from scipy.spatial import cKDTree  # slow to load, and only recordings need it

        _, nearest = cKDTree(self.positions).query(points)
        return np.asarray(self.within.weights(points) * self.seconds[nearest])


class Visited(Changed):
    """A room with the positions of a recording; a `Space`.

    Args:
        room: the room.
        positions: positions of T records, metres, `(T, 3)`.
        seconds: duration of each record, seconds, `(T,)`.
        spacing: edge of the cells, metres: one number or one per axis. A corner of a cell is the world's origin.

    Raises:
        InputError: the spacing is not positive, or so fine that the cells would not fit into memory.
    """

    def __init__(
        self, room: Space, positions: FloatArray, seconds: FloatArray, spacing: float | Sequence[float]
    ) -> None:
        super().__init__(room)
        self._spacing = checked_spacing(spacing, np.ptp(positions, axis=0).tolist())
        self._positions, self._seconds = positions, seconds

    def __repr__(self) -> str:
        return f"{self._room!r}, visited in cells of {self._spacing} m"

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
    @override
    def relevance(self) -> Weighing:
        """Seconds."""
        return TimeSpent(self.grid(), self._cells.seconds, self._room.relevance)

    @override
    def grid(self) -> FloatArray:
        """The record nearest to the mean of each visited cell."""
        return self._positions[self._cells.chosen]

    @override
    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """As `clear`, since the recorded camera may have violated the clearance of the room."""
        return self.clear(starts, ends)

    @override
    def finer(self) -> "Visited":
        half = tuple(np.broadcast_to(self._spacing, 3) / 2.0)
        return Visited(self._room, self._positions, self._seconds, half)

    @override
    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Records of each cell, drawn in proportion to their duration."""
        of, total, _ = self._cells
        by_cell = np.argsort(of, kind="stable")
        ends = np.cumsum(self._seconds[by_cell])
        last = np.cumsum(np.bincount(of)) - 1
        drawn = np.searchsorted(ends, ends[last] - latin_hypercube(repeats, total.shape, rng) * total)
        return np.asarray(self._positions[by_cell[np.minimum(drawn, last)]]).reshape(-1, 3)

    @override
    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Records, drawn in proportion to their duration."""
        return self._positions[rng.choice(len(self._seconds), size, p=self._seconds / self._seconds.sum())]

    @override
    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """One random record from each of `size` equal parts of the time."""
        ends = np.cumsum(self._seconds)
        times = (np.arange(size) + rng.random(size)) / size * ends[-1]
        return np.asarray(self._positions[np.searchsorted(ends[:-1], times, side="right")])

    @override
    def describe(self) -> str:
        return f"{self._room.describe()} along a recording"
