"""Deployments: where the landmarks are, and the ways to come by one."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd

from lmd.checks import BoolArray, FloatArray, InputError, IntArray, choice, integer
from lmd.space.space import Space
from lmd.space.surface import Surface, SurfaceArrays
from lmd.tables import has_column, read_numbers
from lmd.tag import upright

COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
UP_COLUMNS = ("ux", "uy", "uz")
# An up printed with a few decimals is still upright.
UP_TOLERANCE = 1e-2
# A normal printed with a few decimals is still a unit normal.
NORMAL_TOLERANCE = 1e-3
# A normal this close to that of its surface is flush with it.
FLUSH = 1e-6
# Landmarks of a file may be so far from their surface, metres: they were measured by hand, or have a board behind them.
MID_AIR = 0.05


@dataclass(frozen=True)
class Deployment:
    """K landmarks.

    Args:
        positions: `(K, 3)`, world frame, metres.
        normals: `(K, 3)` unit normals of the front faces, world frame.
        surfaces: `(K,)`, index of the surface of its room that each hangs on, -1 where none is known, the default: see
            `hung`.

    Raises:
        InputError: wrong shapes, no landmark, a value that is not finite, or a normal that is not unit.
    """

    positions: FloatArray
    normals: FloatArray
    surfaces: IntArray = None  # type: ignore[assignment] # always an array once made

    def __post_init__(self) -> None:
        for name in ("positions", "normals"):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.ndim != 2 or array.shape[1] != 3 or not len(array):
                raise InputError(f"deployment {name} must have the shape (K, 3) with K >= 1, got {array.shape}.")
            if not np.isfinite(array).all():
                raise InputError(f"deployment {name} have a value that is not finite.")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.positions) != len(self.normals):
            raise InputError(f"a deployment has {len(self.positions)} positions but {len(self.normals)} normals.")
        count = len(self.positions)
        surfaces = np.full(count, -1) if self.surfaces is None else np.array(self.surfaces, dtype=np.int64)
        if surfaces.shape != (count,):
            raise InputError(f"deployment surfaces must have the shape (K,), got {surfaces.shape}.")
        surfaces.flags.writeable = False
        object.__setattr__(self, "surfaces", surfaces)
        length = np.linalg.norm(self.normals, axis=1)
        worst = int(np.argmax(np.abs(length - 1.0)))
        if abs(length[worst] - 1.0) > NORMAL_TOLERANCE:
            raise InputError(f"landmark {worst}: the normal must have length 1, it has {length[worst]:g}.")

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Deployment":
        """The landmarks that `chosen` selects."""
        return Deployment(self.positions[chosen], self.normals[chosen], self.surfaces[chosen])

    def __add__(self, other: "Deployment") -> "Deployment":
        """The landmarks of both."""
        parts = ((getattr(self, name), getattr(other, name)) for name in ("positions", "normals", "surfaces"))
        return Deployment(*(np.concatenate(part) for part in parts))

    def hung(self, room: Space) -> "Deployment":
        """The same landmarks with the surfaces of `room` that they hang on.

        Raises:
            InputError: a landmark lies outside the room.
        """
        outside = np.flatnonzero(~room.contains(self.positions))
        if outside.size:
            raise InputError(f"landmark {self._place(outside[0])} lies outside the {room.describe()}.")
        return replace(self, surfaces=room.surfaces_of(self.positions, self.normals))

    def fault(self, room: Space, near: float = 0.0) -> str | None:
        """What is wrong with how the landmarks hang, in a clause about the first that hangs on no surface or faces into
        its own; None if all hang properly. They know their surfaces (`hung`), which are those of `room`.

        Args:
            room: has the surfaces.
            near: a landmark that is no farther from a surface may stand before it, metres.
        """
        surfaces, some = room.surfaces(), f"of {len(self)} landmarks do"
        distance = np.array([surface.distance(self.positions) for surface in surfaces])
        if (floating := np.flatnonzero((self.surfaces < 0) & (distance.min(axis=0) > near))).size:
            first = int(floating[0])
            nearest = int(np.argmin(distance[:, first]))
            return (
                f"landmark {self._place(first)} hangs in mid-air, {distance[nearest, first]:.4g} m from the nearest "
                f"surface that may carry it, {surfaces[nearest].name} ({len(floating)} {some})"
            )
        own = np.where(self.surfaces < 0, distance.argmin(axis=0), self.surfaces)
        normals = np.array([surface.normal for surface in surfaces])[own]
        if (inwards := np.flatnonzero((self.normals * normals).sum(axis=1) < 0.0)).size:
            first = int(inwards[0])
            name = surfaces[own[first]].name
            return f"landmark {self._place(first)} faces into {name}, the surface it hangs on ({len(inwards)} {some})"
        return None

    def movable(self, room: Space, flush: bool = True) -> "Deployment":
        """`hung`, for an optimiser that moves landmarks along surfaces.

        Args:
            room: has the surfaces.
            flush: whether landmarks must lie flat.

        Raises:
            InputError: a landmark hangs on no surface, faces into its surface, or does not lie flat on it.
        """
        hung = self.hung(room)
        if fault := hung.fault(room):
            raise InputError(f"{fault}, so it cannot be a start.")
        normals = np.array([surface.normal for surface in room.surfaces()])[hung.surfaces]
        deviation = np.linalg.norm(self.normals - normals, axis=1)
        if flush and deviation.max() > FLUSH:
            raise InputError(
                f"landmark {int(np.argmax(deviation))} is not flush with its wall; only an encoding "
                "that is not flush can start from it."
            )
        return hung

    def _place(self, k: int) -> str:
        x, y, z = self.positions[k]
        return f"{k} at ({x:.9g}, {y:.9g}, {z:.9g})"

    @property
    def ups(self) -> FloatArray:
        """Unit vectors to the upper edges of tags there, `(K, 3)`, world frame: all hang upright, see `lmd.tag`."""
        return upright(self.normals)[1] + 0.0  # no -0

    def to_csv(self, path: str | Path, ups: bool = False) -> None:
        """Write `id,x,y,z,nx,ny,nz` with every digit, so that reading it back gives the same numbers.

        Args:
            path: the file.
            ups: whether to add `ux,uy,uz`, for landmarks that are tags with an upper edge.
        """
        parts, columns = [self.positions, self.normals], list(COLUMNS)
        if ups:
            parts, columns = [*parts, self.ups], [*columns, *UP_COLUMNS]
        pd.DataFrame(np.hstack(parts), columns=columns).to_csv(path, index_label="id")

    @classmethod
    def from_csv(cls, path: str | Path) -> "Deployment":
        """Read a CSV with the columns x,y,z,nx,ny,nz (and id, which is ignored, and ux,uy,uz if tags hang upright).

        Normals are scaled to length 1 if they are printed with few decimals.

        Raises:
            InputError: the file cannot be read, or what it holds is no deployment, or of tags that do not hang upright.
        """
        columns = COLUMNS + UP_COLUMNS if any(has_column(path, name) for name in UP_COLUMNS) else COLUMNS
        table = read_numbers(path, columns, name="path", optional=("id",))
        try:
            deployment = cls(table[:, :3], table[:, 3:6])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        turned = table[:, 6:] - deployment.ups if table.shape[1] > len(COLUMNS) else np.zeros((1, 3))
        if (off := np.flatnonzero(np.linalg.norm(turned, axis=1) > UP_TOLERANCE)).size:
            up, way = (", ".join(f"{value:.4g}" for value in v[off[0]]) for v in (table[:, 6:], deployment.ups))
            raise InputError(
                f"{path}: the up of landmark {off[0]} is ({up}), but tags hang upright here, which would be ({way})."
            )
        length = np.linalg.norm(deployment.normals, axis=1, keepdims=True)
        exact = np.abs(length - 1.0) < 1e-12  # dividing these would only move the last bit
        return cls(deployment.positions, np.where(exact, deployment.normals, deployment.normals / length))


class DeploymentSource(Protocol):
    """Something that provides deployments: a start for optimisers, or what `evaluate` scores."""

    @property
    def varies(self) -> bool:
        """Whether two draws differ."""

    def draw(self, room: Space, rng: np.random.Generator) -> Deployment:
        """A deployment inside `room`, its landmarks with their surfaces."""


@dataclass(frozen=True)
class RandomDeployment:
    """Landmarks flush on the walls, each wall with a probability proportional to its area."""

    count: int
    varies = True

    def __post_init__(self) -> None:
        integer("count", self.count, low=1)

    def draw(self, room: Space, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`."""
        surfaces = SurfaceArrays.of(room.surfaces())
        area = surfaces.extent.prod(axis=1)
        picked = rng.choice(len(area), size=self.count, p=area / area.sum())
        return _flush(surfaces, picked, rng.random((self.count, 2)) * surfaces.extent[picked])


@dataclass(frozen=True)
class UniformDeployment:
    """Landmarks at the centres of a regular grid on each wall, flush.

    Args:
        count: K.
        layout: `per_wall` gives every wall the same number (what is left over goes to the largest walls), as in
            the paper's 15 per wall; `by_area` shares them in proportion to area.
    """

    count: int
    layout: str = "per_wall"
    varies = False

    def __post_init__(self) -> None:
        integer("count", self.count, low=1)
        choice("layout", self.layout, ("per_wall", "by_area"))

    def draw(self, room: Space, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`; nothing here is random."""
        surfaces = room.surfaces()
        area = np.array([surface.area for surface in surfaces])
        share = area / area.sum() if self.layout == "by_area" else np.full(len(area), 1.0 / len(area))
        quota = share * self.count
        counts = np.floor(quota + 1e-9).astype(int)
        # Largest remainder first; the larger surface wins a tie.
        order = np.lexsort((-area, -np.round(quota - counts, 9)))
        counts[order[: self.count - counts.sum()]] += 1
        grids = [_grid(surface, n) for surface, n in zip(surfaces, counts, strict=True)]
        at = np.array([point for grid in grids for point in grid])
        return _flush(SurfaceArrays.of(surfaces), np.repeat(np.arange(len(surfaces)), counts), at)


@dataclass(frozen=True)
class FileDeployment:
    """A deployment from a CSV written by `Deployment.to_csv` or by anyone.

    Args:
        path: the CSV.
        count: K; if given, the file must have that many rows.
        free: whether landmarks may stand free in the room, or face into the surface they hang on.
    """

    path: str | None
    count: int | None = None
    free: bool = False
    varies = False

    def __post_init__(self) -> None:
        if not isinstance(self.free, bool):
            raise InputError(f"free must be true or false, got {self.free!r}.", "free")

    def draw(self, room: Space, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`."""
        if self.path is None:
            raise InputError("path is missing: a CSV of landmarks is needed.", "path")
        deployment = Deployment.from_csv(self.path)
        if self.count is not None and self.count != len(deployment):
            raise InputError(f"count = {self.count}, but {self.path} has {len(deployment)} landmarks.", "count")
        try:
            hung = deployment.hung(room)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        if not self.free and (fault := hung.fault(room, MID_AIR)):
            raise InputError(f"free = false, but in {self.path} {fault}.", "free")
        return hung


def _flush(surfaces: SurfaceArrays, surface: IntArray, at: FloatArray) -> Deployment:
    """Landmarks flush on their surfaces `(K,)` at surface coordinates `(K, 2)`."""
    return Deployment(surfaces.points(surface, at), surfaces.normal[surface], surface)


# A grid whose cells are more elongated than this gives way to one with rows of unequal number.
MAX_ELONGATION = 3.0


def _grid(surface: Surface, count: int) -> list[tuple[float, float]]:
    """Surface coordinates of `count` cell centres, with cells as square as an even grid allows.

    The grid runs along the longer side; 15 landmarks on the paper's walls make 5 x 3.
    """
    if count == 0:
        return []
    swap = surface.extent[1] > surface.extent[0]
    long, short = max(surface.extent), min(surface.extent)

    def elongation(rows: int) -> float:
        cell = (long / (count / rows)) / (short / rows)
        return max(cell, 1.0 / cell)

    even = min((r for r in range(1, count + 1) if count % r == 0), key=elongation)
    rows = even if elongation(even) <= MAX_ELONGATION else min(range(1, count + 1), key=elongation)
    points = []
    for row in range(rows):
        in_row = count // rows + (row < count % rows)
        for i in range(in_row):
            along, across = long * (i + 0.5) / in_row, short * (row + 0.5) / rows
            points.append((across, along) if swap else (along, across))
    return points
