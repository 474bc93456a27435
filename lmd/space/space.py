"""What a room must answer; everything else in the library asks nothing more of it."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.trajectory import Trajectory
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


LEVEL_NORMAL_Z = 0.99  # normals with a larger vertical part are those of what is level


def floor_of(room: Space) -> float:
    """Where the floor is, z, metres: the lowest of the large faces that look up, else the lowest point."""
    level = [face for face in room.faces() if face.normal[2] > LEVEL_NORMAL_Z]
    sizes = np.array([face.extent[0] * face.extent[1] for face in level])
    heights = np.array([face.origin[2] for face in level])
    return float(heights[sizes > sizes.max() / 2.0].min() if level else room.bounds()[0][2])


def lower_edge(room: Space, surface: Surface) -> float:
    """How high the lower edge of a wall is above the floor, metres; 0 for what is not upright."""
    return float(surface.origin[2]) - floor_of(room) if surface.is_upright else 0.0


def check_positions(trajectory: Trajectory, room: Space) -> None:
    """Raise `InputError` if the camera leaves the closed room, or is inside something that stands in it."""
    positions = trajectory.poses[:, :3, 3]
    outside = np.flatnonzero(~room.contains(positions))
    if outside.size:
        x, y, z = positions[outside[0]]
        low, high = room.bounds()
        beyond = np.linalg.norm(np.maximum(np.maximum(low - positions, positions - high), 0.0), axis=1).max()
        far = f", up to {beyond:.3g} m beyond it" if beyond > 0.0 else ""
        more = f"; so are {outside.size} of {len(positions)} poses{far}" if outside.size > 1 or far else ""
        raise InputError(
            f"the camera at {trajectory.time[outside[0]]:.16g} s, ({x:.9g}, {y:.9g}, {z:.9g}), is outside the "
            f"{room.describe()}{more}."
        )


def check_inside(trajectory: Trajectory, room: Space) -> None:
    """Raise `InputError` as `check_positions`, or if it goes through something that stands in the room."""
    check_positions(trajectory, room)
    positions = trajectory.poses[:, :3, 3]
    through = np.flatnonzero(~room.clear(positions[:-1], positions[1:]))
    if through.size:
        x, y, z = positions[through[0]]
        raise InputError(
            f"the camera goes straight on from ({x:.9g}, {y:.9g}, {z:.9g}) at {trajectory.time[through[0]]:.16g} s, "
            f"through something that stands in the {room.describe()}."
        )
