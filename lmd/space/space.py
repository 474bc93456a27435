"""Interface of rooms, and functions of any room."""

from collections.abc import Callable, Mapping, Sequence
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
        """Surfaces that may carry landmarks; landmarks refer to them by index."""

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """Index of the surface that each landmark `(K, 3)` hangs on, `(K,)`, also where none is allowed; or -1."""

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """Index of the surface that each landmark `(K, 3)` belongs to, see `lmd.space.surface.surface_near`."""

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the box around the room, `(3,)` each."""

    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` in the closed room, `(...)`."""

    def blockers(self) -> Blockers | Triangles | None:
        """Obstacles between points of the room; None for a convex and empty room."""

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the lines between points `(..., 3)` of the room that nothing blocks, `(...)`: the reference."""

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the straight paths between reachable points `(..., 3)` that the camera may take, `(...)`."""

    def faces(self) -> tuple[Surface, ...]:
        """Visible faces of the room; each fills its `allowed` region, with or without landmarks."""

    def grid(self) -> FloatArray:
        """Discrete positions Omega_d of the camera, `(P, 3)`."""

    def finer(self) -> "Space":
        """The same room with half the spacing of its grid."""

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Draw stratified uniform positions in the cell of each grid position, `(repeats P, 3)`.

        The order is that of `grid`, repeated.
        """

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw independent uniform positions in the reachable volume, `(size, 3)`."""

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw positions evenly spread over the reachable volume, `(size, 3)`.

        Means over them have the expectation of `sample` and usually smaller errors, as the positions are dependent.
        """

    def outline(self) -> Mapping[str, FloatArray]:
        """Edges of the parts of the room to draw, `(M, 2, 3)` each.

        At least `room` and `reachable area`; also `obstacles` and `nothing hangs here`.
        """

    def fixtures(self) -> Sequence[Fixture]:
        """Doors, windows, furniture and other things to draw."""

    def describe(self) -> str:
        """Short description, such as `room of 7.5 x 5 x 6 m`."""


# Least vertical part of the normal of a level face.
LEVEL_NORMAL_Z = 0.99


def floor_of(room: Space) -> float:
    """Height z of the floor, metres: the lowest of the large faces that face up, else the lowest point."""
    level = [face for face in room.faces() if face.normal[2] > LEVEL_NORMAL_Z]
    sizes = np.array([face.extent[0] * face.extent[1] for face in level])
    heights = np.array([face.origin[2] for face in level])
    return float(heights[sizes > sizes.max() / 2.0].min() if level else room.bounds()[0][2])


def lower_edge(room: Space, surface: Surface) -> float:
    """Height of the lower edge of a wall above the floor, metres; 0 for surfaces that are not upright."""
    return float(surface.origin[2]) - floor_of(room) if surface.is_upright else 0.0


def check_positions(trajectory: Trajectory, room: Space) -> None:
    """Raise `InputError` if the camera leaves the closed room, or is inside an obstacle."""
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
    """Raise `InputError` as `check_positions`, or if the camera passes through an obstacle."""
    check_positions(trajectory, room)
    positions = trajectory.poses[:, :3, 3]
    through = np.flatnonzero(~room.clear(positions[:-1], positions[1:]))
    if through.size:
        x, y, z = positions[through[0]]
        raise InputError(
            f"the camera goes straight on from ({x:.9g}, {y:.9g}, {z:.9g}) at {trajectory.time[through[0]]:.16g} s, "
            f"through something that stands in the {room.describe()}."
        )


def check_file_inside(
    path: str | None, trajectory: Trajectory, room: Space, check: Callable[[Trajectory, Space], None] = check_positions
) -> None:
    """Raise `InputError` about the file `path` of a trajectory that does not pass `check`.

    The message names `align` where most of the trajectory is outside: the file may have a frame of its own.
    """
    try:
        check(trajectory, room)
    except InputError as error:
        lost = ~room.contains(trajectory.poses[:, :3, 3])
        hint = " If it has a frame of its own, align says where that is in the room." if lost.mean() > 0.5 else ""
        raise InputError(f"path: {path}: {error}{hint}", "path") from None
