"""Rooms whose camera positions are the points of a grid in a box, limited to the reachable volume."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, IntArray, bounded, choice, real, vector
from lmd.core.memory import check_memory
from lmd.space.blockers import Blockers
from lmd.space.fixture import Fixture
from lmd.space.surface import FILE_TOLERANCE, PLACEMENT_TOLERANCE, Surface, SurfaceArrays, surface_near
from lmd.space.triangles import Triangles

KINDS = ("cells", "vertices")
# Greatest number of positions (a hall of 100 m x 60 m x 10 m has 4 million with a spacing of 0.25 m), and memory of a
# position and its test, bytes.
MOST_POSITIONS, POSITION_BYTES = 20_000_000, 256
# Inverse powers of the root of x^4 = x + 1, the golden ratio of three dimensions (Roberts, 2018). Other irrational
# steps, such as square roots, sampled some shapes worse than independent points do.
KRONECKER_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


GridKind = Annotated[str, partial(choice, options=KINDS)]


def checked_spacing(value: Any, size: Sequence[float]) -> float | tuple[float, ...]:
    """Check the spacing of a grid in a box with the side lengths `size`, metres, and return the spacing.

    The spacing is one number, or three numbers, one per axis, metres.

    Raises:
        InputError: the spacing is not positive, or the positions would not fit into memory.
    """
    spacing: float | tuple[float, ...]
    if isinstance(value, Iterable) and not isinstance(value, str):
        spacing = vector("spacing", value, 3, above=0.0)
    else:
        spacing = real("spacing", value, above=0.0)
    steps = spacing if isinstance(spacing, tuple) else 3 * (spacing,)
    positions = math.prod(length / step for length, step in zip(size, steps, strict=True))
    check_memory(POSITION_BYTES * positions, f"spacing = {spacing} makes {positions:.4g} positions, which", "spacing")
    bounded("positions", positions, MOST_POSITIONS, f"spacing = {spacing}", "spacing")
    return spacing


def grid_counts(size: FloatArray, spacing: float | Sequence[float], kind: str) -> tuple[int, int, int]:
    """Numbers of grid positions along x, y and z in a box with the side lengths `size` `(3,)`, metres.

    The cells are at most `spacing` long, metres. `kind` is `cells` for one position at the centre of each cell, or
    `vertices` for positions at the vertices of the cells.
    """
    # The tolerance of 1e-9 keeps rounding from adding a cell, as in 4.5 / 0.5 = 9.
    cells = np.ceil(np.asarray(size) / np.asarray(spacing) - 1e-9).astype(int)
    nx, ny, nz = (int(c) for c in np.maximum(cells, 1) + (kind == "vertices"))
    return nx, ny, nz


def grid_axes(low: FloatArray, high: FloatArray, counts: tuple[int, int, int], kind: str) -> list[FloatArray]:
    """Coordinates of a grid along x, y and z in a box with the corners `low` and `high` `(3,)`, metres.

    `counts` are the numbers of positions along x, y and z. The `kind` `cells` puts a position at the centre of each
    cell, `vertices` at each vertex.
    """
    if kind == "vertices":
        return [np.linspace(a, b, count) for a, b, count in zip(low, high, counts, strict=True)]
    return [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]


def cell_borders(axes: list[FloatArray], low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners of the cell around each grid position, `(P, 3)` each.

    `axes` are the coordinates of the positions along x, y and z; `low` and `high` `(3,)` are the corners of the box
    that the cells fill.
    """
    lows, highs = [], []
    for axis, start, stop in zip(axes, low, high, strict=True):
        between = (axis[1:] + axis[:-1]) / 2.0
        lows.append(np.append(start, between))
        highs.append(np.append(between, stop))
    return combined(lows), combined(highs)


def combined(axes: Sequence[FloatArray]) -> FloatArray:
    """Every combination of coordinates along x, y, z, `(P, 3)`; z varies fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def latin_hypercube(repeats: int, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Stratified random numbers in [0, 1), `(repeats, *shape)`, each uniform.

    At every index of `shape`, each of `repeats` equal parts of [0, 1) contains one of the `repeats` numbers. Means
    over these numbers usually have smaller errors than means over independent numbers.
    """
    part = rng.permuted(np.broadcast_to(np.arange(repeats).reshape(-1, *len(shape) * (1,)), (repeats, *shape)), axis=0)
    drawn = (part + rng.random(part.shape)) / repeats
    return np.asarray(np.minimum(drawn, np.nextafter(1.0, 0.0)))  # the sum may have been rounded up to 1


def kronecker(shift: FloatArray) -> Callable[[int], FloatArray]:
    """Make a function that returns the next points of a Kronecker sequence, evenly spread in the unit cube.

    The function takes the number of points `count` and returns points `(count, 3)`. `shift` `(3,)` is the first point
    of the sequence. If it is uniform, every point is uniform. Means over many points usually have smaller errors than
    means over independent points.
    """
    drawn = 0

    def following(count: int) -> FloatArray:
        nonlocal drawn
        index = np.arange(drawn, drawn + count)[:, None]
        drawn += count
        return np.asarray((shift + index * KRONECKER_STEPS) % 1.0)

    return following


# Maximum number of draws of a reachable position in a cell; after that the grid position is used.
MOST_DRAWS = 100
# Least reachable share of the box's volume for random sampling.
LEAST_SHARE = 1e-4
# Tolerance of the comparison of cosines between a landmark's normal and the normals of two surfaces.
SAME_WAY = 1e-6


def clear_of(blockers: Blockers | Triangles | None, starts: FloatArray, ends: FloatArray) -> BoolArray:
    """Mask of the straight lines between pairs of points `(..., 3)` that `blockers` do not block, `(...)`."""
    if blockers is None:
        return np.ones(np.broadcast_shapes(starts.shape, ends.shape)[:-1], dtype=np.bool_)
    return blockers.clear(starts, ends)


class Gridded(Checked, ABC):
    """Base class of rooms whose camera positions are the reachable points of a grid in a box.

    A subclass is a frozen dataclass that defines the fields `reachable`, `spacing` and `positions`.
    """

    reachable: Any
    spacing: Any
    positions: str
    kind: ClassVar[str] = "room"
    """Kind of the room in words, with which the text of `describe` begins."""
    digits: ClassVar[int] = 6
    """Significant digits of the lengths in `describe`."""

    @property
    @abstractmethod
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the box around the reachable volume, `(3,)` each."""

    @abstractmethod
    def reaches(self, points: FloatArray) -> BoolArray:
        """Mask of the points `(..., 3)` that are in the reachable volume, `(...)`; all points must be in the box."""

    @abstractmethod
    def contains(self, points: FloatArray) -> BoolArray:
        """See `Space.contains`."""

    @abstractmethod
    def surfaces(self) -> tuple[Surface, ...]:
        """See `Space.surfaces`."""

    @abstractmethod
    def blockers(self) -> Blockers | Triangles | None:
        """See `Space.blockers`."""

    @abstractmethod
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """See `Space.bounds`."""

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.clear`."""
        return clear_of(self.blockers(), starts, ends)

    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """See `Space.passable`."""
        return self.clear(starts, ends)

    def faces(self) -> tuple[Surface, ...]:
        """See `Space.faces`."""
        return self.surfaces()

    def fixtures(self) -> Sequence[Fixture]:
        """See `Space.fixtures`."""
        return ()

    def describe(self) -> str:
        """See `Space.describe`."""
        low, high = self.bounds()
        return f"{self.kind} of {' x '.join(f'{length:.{self.digits}g}' for length in high - low)} m"

    def _set_grid(self, lacking: str, argument: str) -> None:
        """Replace `spacing` by its checked value, and raise `InputError` if the grid has no position.

        Args:
            lacking: message of the error about a grid without positions.
            argument: name of the argument that the error reports.
        """
        low, high = self.box
        object.__setattr__(self, "spacing", checked_spacing(self.spacing, (high - low).tolist()))
        if not len(self.grid()):
            raise InputError(lacking, argument)

    def grid_shape(self) -> tuple[int, int, int]:
        """Numbers of grid positions in the box along x, y and z, three counts."""
        low, high = self.box
        return grid_counts(high - low, self.spacing, self.positions)

    def _grid_axes(self) -> list[FloatArray]:
        return grid_axes(*self.box, self.grid_shape(), self.positions)

    @cached_property
    def _grid(self) -> tuple[FloatArray, BoolArray]:
        """All N grid positions in the box, metres, `(N, 3)`, and the mask `(N,)` of the reachable positions."""
        positions = combined(self._grid_axes())
        return positions, self.reaches(positions)

    def grid(self) -> FloatArray:
        """See `Space.grid`; z varies fastest."""
        positions, reached = self._grid
        return positions[reached]

    def finer(self) -> Self:
        """See `Space.finer`."""
        return replace(self, spacing=tuple(np.broadcast_to(self.spacing, 3) / 2.0))  # type: ignore[type-var]

    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.jittered_grid`; each position is drawn from the reachable part of its cell."""
        positions, reached = self._grid
        borders = (corner[reached] for corner in cell_borders(self._grid_axes(), *self.box))
        low, high = (np.tile(corner, (repeats, 1)) for corner in borders)
        drawn, left = np.tile(positions[reached], (repeats, 1)), np.arange(len(low))
        offsets = latin_hypercube(repeats, (reached.sum(), 3), rng).reshape(-1, 3)
        for _ in range(MOST_DRAWS):
            tried = low[left] + offsets * (high[left] - low[left])
            good = self.reaches(tried)
            drawn[left[good]] = tried[good]
            left = left[~good]
            if not len(left):
                break
            offsets = rng.random((len(left), 3))
        return drawn

    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample`."""
        return self._reached(size, lambda count: rng.random((count, 3)))

    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        """See `Space.sample_evenly`."""
        low, high = self.box
        # The first point is uniform in the reachable volume, so all reachable points of the sequence are uniform. With
        # a first point uniform in the box, reachable points that follow many unreachable ones would be drawn too often.
        extent = np.where(high > low, high - low, 1.0)  # the box of a ground robot may have zero height
        return self._reached(size, kronecker((self.sample(1, rng)[0] - low) / extent))

    def _reached(self, size: int, following: Callable[[int], FloatArray]) -> FloatArray:
        """Return the first `size` points of a sequence that are in the reachable volume, metres, `(size, 3)`.

        `following(count)` returns the next `count` points of the sequence in the unit cube; they are scaled to the box.
        """
        low, high = self.box
        drawn, tries = np.empty((0, 3)), 0
        while len(drawn) < size:
            if tries > (size + 1) / LEAST_SHARE:
                raise InputError(
                    f"reachable.clearance = {self.reachable.clearance:g} leaves positions of the grid, but almost "
                    "no volume around these positions.",
                    "reachable.clearance",
                )
            tried = low + following(size - len(drawn)) * (high - low)
            tries += len(tried)
            drawn = np.concatenate([drawn, tried[self.reaches(tried)]])
        return drawn

    def surfaces_of(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """Index of the surface on which each of K landmarks lies, `(K,)`; -1 for landmarks on no surface.

        Several surfaces can contain a landmark. At an edge that surfaces share, the landmark belongs to the surface
        whose normal is most similar to the landmark's. Among coplanar surfaces with overlapping rectangles, it belongs
        to the surface whose allowed region contains it.
        """
        carriers, within, allowed = self._carried(positions)
        hangs = within & self.contains(positions)[..., None]
        facing = np.where(hangs, normals @ carriers.normal.T, -np.inf)
        same = allowed & (facing >= facing.max(axis=-1, keepdims=True) - SAME_WAY)
        return np.where(hangs.any(axis=-1), np.argmax(np.where(same, facing + 1.0, facing), axis=-1), -1)

    def _carried(self, points: FloatArray) -> tuple[SurfaceArrays, BoolArray, BoolArray]:
        """Find the surfaces on which points `(..., 3)` lie.

        Returns:
            arrays of the W surfaces; mask of the surfaces whose rectangle contains each point, `(..., W)`; mask of the
            surfaces whose allowed region contains each point, `(..., W)`.
        """
        carriers = SurfaceArrays.of(self.surfaces())
        every = np.arange(len(carriers.normal))
        at = carriers.coordinates(every, np.asarray(points)[..., None, :])
        within = ((at >= -PLACEMENT_TOLERANCE) & (at <= carriers.extent + PLACEMENT_TOLERANCE)).all(axis=-1)
        within &= np.abs(carriers.heights(points)) <= PLACEMENT_TOLERANCE
        allowed = within.copy()
        allowed[within] = carriers.allow(np.broadcast_to(every, within.shape)[within], at[within], FILE_TOLERANCE)
        return carriers, within, allowed

    def surface_near(self, positions: FloatArray, normals: FloatArray) -> IntArray:
        """See `Space.surface_near`."""
        return surface_near(self.surfaces(), positions, normals)
