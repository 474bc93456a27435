"""What a room must answer; everything else in the library asks nothing more of it."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.blockers import Blockers
from lmd.space.fixture import Fixture
from lmd.space.relevance import Weighing
from lmd.space.surface import Surface
from lmd.space.triangles import Triangles


class Space(Protocol):
    """A room: surfaces that may carry landmarks, and positions where the camera may be. World frame, metres."""

    @property
    def relevance(self) -> Weighing:
        """Rel(p), how much each position matters."""

    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces that may carry landmarks; a landmark carries the index of its own."""

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """The index, `(K,)`, of the surface that each landmark `(K, 3)` hangs on; -1 if it hangs on none.

        Also where none may hang, see `Surface.allowed`.
        """

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """The index of the surface that each landmark `(K, 3)` belongs to, see `lmd.space.surface.surface_near`."""

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of a box around everything, `(3,)` each."""

    def contains(self, points: FloatArray) -> BoolArray:
        """Whether points `(..., 3)` lie in the closed room, `(...)`."""

    def blockers(self) -> Blockers | Triangles | None:
        """What can stand between two points inside the room; None for a convex and empty one."""

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Whether nothing of the room stands between points `(..., 3)` inside it, `(...)`: the reference."""

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Whether the camera may fly straight between points `(..., 3)` where it may be, `(...)`."""

    def faces(self) -> tuple[Surface, ...]:
        """What is seen of the room, whole: each where it is `allowed`, whether or not landmarks may hang there."""

    def grid(self) -> FloatArray:
        """Discrete positions Omega_d of the camera, `(P, 3)`."""

    def finer(self) -> "Space":
        """The same room with half the spacing of its grid."""

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Uniformly drawn positions in the cell of each grid position, `(repeats P, 3)`.

        They go through the cells `repeats` times, in the order of `grid`. Those of one cell are spread over it.
        """

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Independent positions drawn uniformly from where the camera may be, `(size, 3)`."""

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Positions spread evenly over where the camera may be, `(size, 3)`.

        Means over them are those of `sample`, but as a rule they err less, as the positions are not independent.
        """

    def outline(self) -> Mapping[str, FloatArray]:
        """Edges to draw, by what they belong to, `(M, 2, 3)` each.

        At least `room` and `reachable area`; also `obstacles`, and `nothing hangs here`.
        """

    def fixtures(self) -> Sequence[Fixture]:
        """Doors, windows, furniture and the like, to draw them."""

    def describe(self) -> str:
        """The room in a few words, such as `room of 7.5 x 5 x 6 m`."""
