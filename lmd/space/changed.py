"""A space that is a room but for what a subclass says otherwise."""

from collections.abc import Mapping, Sequence

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.blockers import Blockers
from lmd.space.fixture import Fixture
from lmd.space.relevance import Weighing
from lmd.space.space import Space
from lmd.space.surface import Surface
from lmd.space.triangles import Triangles


class Changed:
    """A `lmd.space.space.Space` that asks a room; subclasses answer themselves what they change.

    Args:
        room: the room.
    """

    def __init__(self, room: Space) -> None:
        self._room = room

    def surfaces(self) -> tuple[Surface, ...]:
        """See `Space.surfaces`."""
        return self._room.surfaces()

    @property
    def relevance(self) -> Weighing:
        """See `Space.relevance`."""
        return self._room.relevance

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """See `Space.surfaces_of`."""
        return self._room.surfaces_of(positions, normals)

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """See `Space.surface_near`."""
        return self._room.surface_near(positions, normals)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """See `Space.bounds`."""
        return self._room.bounds()

    def contains(self, points: FloatArray) -> BoolArray:
        """See `Space.contains`."""
        return self._room.contains(points)

    def blockers(self) -> Blockers | Triangles | None:
        """See `Space.blockers`."""
        return self._room.blockers()

    def faces(self) -> tuple[Surface, ...]:
        """See `Space.faces`."""
        return self._room.faces()

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.passable`."""
        return self._room.passable(starts, ends)

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.clear`."""
        return self._room.clear(starts, ends)

    def grid(self) -> FloatArray:
        """See `Space.grid`."""
        return self._room.grid()

    def finer(self) -> Space:
        """See `Space.finer`."""
        return self._room.finer()

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.jittered_grid`."""
        return self._room.jittered_grid(repeats, rng)

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample`."""
        return self._room.sample(size, rng)

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample_evenly`."""
        return self._room.sample_evenly(size, rng)

    def outline(self) -> Mapping[str, FloatArray]:
        """See `Space.outline`."""
        return self._room.outline()

    def fixtures(self) -> Sequence[Fixture]:
        """See `Space.fixtures`."""
        return self._room.fixtures()

    def describe(self) -> str:
        """See `Space.describe`."""
        return self._room.describe()
