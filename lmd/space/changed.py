"""A space that is a room but for what a subclass says otherwise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from scipy.spatial import cKDTree
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.gridded import checked_spacing, latin_hypercube
from lmd.space.relevance import Weighing
from lmd.space.space import Space
from lmd.space.surface import Surface

Method = TypeVar("Method", bound=Callable[..., Any])


def _asked(method: Method) -> Method:
    """A method of `Space` by which `Changed` asks its room."""

    @wraps(method)
    def ask(changed: "Changed", *arguments: Any, **named: Any) -> Any:
        return getattr(changed._room, method.__name__)(*arguments, **named)

    return cast(Method, ask)


class Changed:
    """A `lmd.space.space.Space` that asks a room; subclasses answer themselves what they change.

    Args:
        room: the room.
    """

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
    """A room whose surfaces end before their edges, as by half a plate for the centres of plates.

    Those of `surfaces_of`, `surface_near` and `faces` stay the room's, to their edges.

    Args:
        room: the room.
        margin: by which every edge of every surface is moved inwards, metres.

    Raises:
        InputError: a surface has nothing left.
    """

    def __init__(self, room: Space, margin: float) -> None:
        super().__init__(room)
        self._surfaces = tuple(surface.inset(margin) for surface in room.surfaces())

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        """In the order of the room's."""
        return self._surfaces


ON_BORDER = 1e-9  # metres: a record so close below the border of a cell belongs to the one above


class _Cells(NamedTuple):
    """Cells that hold records, ordered by x, y and z.

    of `(T,)` the cell of each record; seconds `(P,)` spent in each; chosen `(P,)` the record nearest to the mean of
    each: there the camera can be, which the mean of a way around a pillar does not promise.
    """

    of: IntArray
    seconds: FloatArray
    chosen: IntArray


@dataclass(frozen=True)
class TimeSpent:
    """The time that a recording spent in the cell of a position, times what else makes it matter.

    Args:
        positions: of the cells, `(P, 3)`, metres.
        seconds: in each, `(P,)`.
        within: the relevance of the room that was recorded.
    """

    positions: FloatArray
    seconds: FloatArray
    within: Weighing

    def weights(self, points: FloatArray) -> FloatArray:
        """See `Weighing.weights`; a point belongs to the nearest cell."""
        _, nearest = cKDTree(self.positions).query(points)
        return np.asarray(self.within.weights(points) * self.seconds[nearest])


class Visited(Changed):
    """A room whose positions are those of a recording; a `lmd.space.space.Space`.

    Args:
        room: the room.
        positions: of T records, `(T, 3)`, metres.
        seconds: that each of them lasted, `(T,)`.
        spacing: edge of the cells, metres: one number or one per axis. They fill space from the world's origin on.

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
        """In each cell that was visited the record nearest to the mean of those in it."""
        return self._positions[self._cells.chosen]

    @override
    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Where the camera was, it may have been nearer to things than the room's clearance."""
        return self.clear(starts, ends)

    @override
    def finer(self) -> "Visited":
        half = tuple(np.broadcast_to(self._spacing, 3) / 2.0)
        return Visited(self._room, self._positions, self._seconds, half)

    @override
    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Records in each cell, drawn by how long they lasted."""
        of, total, _ = self._cells
        by_cell = np.argsort(of, kind="stable")
        ends = np.cumsum(self._seconds[by_cell])
        last = np.cumsum(np.bincount(of)) - 1
        drawn = np.searchsorted(ends, ends[last] - latin_hypercube(repeats, total.shape, rng) * total)
        return np.asarray(self._positions[by_cell[np.minimum(drawn, last)]]).reshape(-1, 3)

    @override
    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Of the records, by how long they lasted."""
        return self._positions[rng.choice(len(self._seconds), size, p=self._seconds / self._seconds.sum())]

    @override
    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """A record from each of so many equal parts of the time."""
        ends = np.cumsum(self._seconds)
        times = (np.arange(size) + rng.random(size)) / size * ends[-1]
        return np.asarray(self._positions[np.searchsorted(ends[:-1], times, side="right")])

    @override
    def describe(self) -> str:
        return f"{self._room.describe()} along a recording"
