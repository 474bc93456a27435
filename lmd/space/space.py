"""Interface of rooms, functions for any room, and the relevance Rel(p): the weight of a camera position p."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, IntArray, NotNegative, real, vector
from lmd.core.tables import read_numbers
from lmd.geometry.trajectory import Trajectory
from lmd.space.blockers import Blockers
from lmd.space.fixture import Fixture
from lmd.space.surface import Surface
from lmd.space.triangles import Triangles

# Largest distance between a position and the matching row in a file of weights, and tolerance of regions, metres.
SAME_POINT = 1e-6


class Weighing(Protocol):
    """Interface of a relevance: the weights of camera positions."""

    def weights(self, points: FloatArray) -> FloatArray:
        """Weight of each of the `points` `(P, 3)`, shape `(P,)`; not all weights are zero."""


@dataclass(frozen=True)
class Relevance(Checked):
    """Weights of the positions of the reachable area (Rel in Eq. H of the paper).

    Raises:
        InputError: a weight is negative, a region is malformed, or both regions and a file are given.
    """

    background: NotNegative = 1.0
    """Weight of positions outside all regions."""
    regions: Sequence[Mapping[str, Any]] = ()
    """Closed boxes `{low: [x, y, z], high: [x, y, z], weight: w}`, metres, world frame; a later region overrides an
    earlier region.
    """
    path: str | None = None
    """CSV file with columns `x,y,z,weight` and a row for every position of the grid; replaces background and regions.
    """

    def _validate(self) -> None:
        if self.path is not None and self.regions:
            raise InputError(f"path = {self.path!r} cannot be given together with regions.", "path")
        if isinstance(self.regions, str) or not isinstance(self.regions, Sequence):
            raise InputError(f"regions must be a list, got {self.regions!r}.", "regions")
        for i, region in enumerate(self.regions):
            name = f"regions[{i}]"
            if not isinstance(region, Mapping) or set(region) != {"low", "high", "weight"}:
                raise InputError(f"{name} must have the keys low, high and weight, got {region!r}.", name)
            real(f"{name}.weight", region["weight"], low=0.0)
            low, high = vector(f"{name}.low", region["low"], 3), vector(f"{name}.high", region["high"], 3)
            if any(a > b for a, b in zip(low, high, strict=True)):
                raise InputError(f"{name} is empty: low = {list(low)} exceeds high = {list(high)}.", name)

    def weights(self, points: FloatArray) -> FloatArray:
        """Weight of each of the `points` `(P, 3)`, shape `(P,)`.

        Raises:
            InputError: every weight is zero, a region contains no point, or a point has no row in the file.
        """
        weights = self._from_file(self.path, points) if self.path is not None else self._from_regions(points)
        if not weights.any():
            given = "background" if self.path is None else "path"
            raise InputError(f"{given} gives every position the weight 0.", given)
        return weights

    def _from_regions(self, points: FloatArray) -> FloatArray:
        weights = np.full(len(points), float(self.background))
        for i, region in enumerate(self.regions):
            low, high = np.asarray(region["low"]), np.asarray(region["high"])
            inside = ((points >= low - SAME_POINT) & (points <= high + SAME_POINT)).all(axis=1)
            if not inside.any():
                box, where = (
                    f"from {a.tolist()} to {b.tolist()}" for a, b in ((low, high), (points.min(0), points.max(0)))
                )
                raise InputError(f"regions[{i}] {box} holds no position; positions are {where}.", f"regions[{i}]")
            weights[inside] = float(region["weight"])
        return weights

    @staticmethod
    def _from_file(path: str, points: FloatArray) -> FloatArray:
        from scipy.spatial import cKDTree

        table = read_numbers(path, ("x", "y", "z", "weight"), name="path")
        if (table[:, 3] < 0.0).any():
            raise InputError(f"{path} has a negative weight, {table[:, 3].min():g}.")
        distance, row = cKDTree(table[:, :3]).query(points)
        if distance.max() > SAME_POINT:
            x, y, z = points[int(np.argmax(distance))]
            raise InputError(f"{path} has no weight for the position ({x:g}, {y:g}, {z:g}).")
        return np.asarray(table[row, 3])


class Space(Protocol):
    """Interface of rooms: surfaces that may carry landmarks, and reachable positions. World frame, metres."""

    @property
    def relevance(self) -> Weighing:
        """Relevance Rel(p): weights of the camera positions."""

    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces that may carry landmarks; a landmark stores the index of its surface."""

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """For each landmark `(K, 3)`, index of the surface whose rectangle contains the landmark, `(K,)`.

        The index is -1 if no rectangle contains the landmark. The landmark may be outside the allowed region of the
        surface.
        """

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """For each landmark `(K, 3)`, index of the surface to which it belongs, `(K,)`; -1 if no surface is near.

        This is the nearest surface, preferably with a similar normal, see `lmd.space.surface.surface_near`.
        """

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the box around the room, `(3,)` each."""

    def contains(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` in the closed room, `(...)`."""

    def blockers(self) -> Blockers | Triangles | None:
        """Obstacles that can block the line between two points of the room; None for a convex and empty room."""

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the straight lines between pairs of points `(..., 3)` of the room that are not blocked, `(...)`.

        Compiled kernels must give equal results.
        """

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask `(...)` of the pairs of points between which the camera may move along a straight line.

        `starts` and `ends` `(..., 3)` are reachable points.
        """

    def faces(self) -> tuple[Surface, ...]:
        """Faces of the room, with and without landmarks; parts that no camera can see may be included."""

    def grid(self) -> FloatArray:
        """Discrete positions Omega_d of the camera, `(P, 3)`."""

    def finer(self) -> "Space":
        """Room with half the grid spacing."""

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """Draw `repeats` uniform positions in the cell of each of P grid positions, `(repeats P, 3)`.

        The draws in a cell are stratified: more evenly spread than independent draws. Row i belongs to grid position
        i mod P.
        """

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw independent uniform positions in the reachable volume, `(size, 3)`."""

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw positions evenly spread over the reachable volume, `(size, 3)`.

        A mean over these positions has the expectation of a mean over positions from `sample`, and usually a smaller
        error.
        """

    def outline(self) -> Mapping[str, FloatArray]:
        """Edges of the parts of the room by name, for drawings, `(M, 2, 3)` each.

        Names are `room` and `reachable area`, and optionally `obstacles` and `nothing hangs here` (places without
        landmarks).
        """

    def fixtures(self) -> Sequence[Fixture]:
        """Doors, windows, furniture and other objects, for drawings."""

    def describe(self) -> str:
        """Short description, such as `room of 7.5 x 5 x 6 m`."""


# Distances behind a surface at which `outwards` looks for the room, relative to the room's size.
BEHIND = np.linspace(0.02, 1.0, 20)
# Least |n_z| of the unit normal of a level face.
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


def outwards(room: Space, surface: Surface) -> FloatArray:
    """Direction `(2,)` in which a drawing puts the name of a wall.

    The name is behind a wall at the edge of the room, and in front of a wall inside the room.
    """
    low, high = room.bounds()
    middle, normal = surface.point(*np.divide(surface.extent, 2.0)), surface.normal
    behind = middle - np.linalg.norm(high - low) * BEHIND[:, None] * normal
    return np.asarray(normal if room.contains(behind).any() else -normal)[:2]


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
    """Raise `InputError` if the camera leaves the closed room, is inside an obstacle, or passes through an obstacle."""
    check_positions(trajectory, room)
    positions = trajectory.poses[:, :3, 3]
    through = np.flatnonzero(~room.clear(positions[:-1], positions[1:]))
    if through.size:
        x, y, z = positions[through[0]]
        raise InputError(
            f"the camera's straight path from ({x:.9g}, {y:.9g}, {z:.9g}) at {trajectory.time[through[0]]:.16g} s "
            f"passes through an obstacle in the {room.describe()}."
        )


def check_file_inside(
    path: str | None, trajectory: Trajectory, room: Space, check: Callable[[Trajectory, Space], None] = check_positions
) -> None:
    """Raise `InputError` if the trajectory from the file `path` fails the test `check`.

    The message names the file. If most of the trajectory is outside the room, the file may use another frame. The
    message then suggests the argument `align`, the pose of the file's frame in the room.
    """
    try:
        check(trajectory, room)
    except InputError as error:
        lost = ~room.contains(trajectory.poses[:, :3, 3])
        hint = " If the file has a frame of its own, give its pose in the room as align." if lost.mean() > 0.5 else ""
        raise InputError(f"path: {path}: {error}{hint}", "path") from None
