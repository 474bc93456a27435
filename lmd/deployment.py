"""Deployments: where the landmarks are, and the ways to come by one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd

from lmd.checks import FloatArray, InputError, choice, integer
from lmd.space.cuboid import Room, Wall
from lmd.tables import read_numbers

COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
# A normal printed with a few decimals is still a unit normal.
NORMAL_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Deployment:
    """K landmarks.

    Args:
        positions: `(K, 3)`, world frame, metres.
        normals: `(K, 3)` unit normals of the front faces, world frame.

    Raises:
        InputError: wrong shapes, no landmark, a value that is not finite, or a normal that is not unit.
    """

    positions: FloatArray
    normals: FloatArray

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
        length = np.linalg.norm(self.normals, axis=1)
        worst = int(np.argmax(np.abs(length - 1.0)))
        if abs(length[worst] - 1.0) > NORMAL_TOLERANCE:
            raise InputError(f"landmark {worst}: the normal must have length 1, it has {length[worst]:g}.")

    def __len__(self) -> int:
        return len(self.positions)

    def check_inside(self, room: Room) -> None:
        """Raise `InputError` if a landmark lies outside the closed room."""
        outside = np.flatnonzero(~room.contains(self.positions))
        if outside.size:
            x, y, z = self.positions[outside[0]]
            raise InputError(
                f"landmark {outside[0]} at ({x:.9g}, {y:.9g}, {z:.9g}) lies outside the room of "
                f"{' x '.join(f'{s:g}' for s in room.size)} m."
            )

    def to_csv(self, path: str | Path) -> None:
        """Write `id,x,y,z,nx,ny,nz` with every digit, so that reading it back gives the same numbers."""
        table = pd.DataFrame(np.hstack([self.positions, self.normals]), columns=list(COLUMNS))
        table.to_csv(path, index_label="id")

    @classmethod
    def from_csv(cls, path: str | Path) -> "Deployment":
        """Read a CSV with the columns x,y,z,nx,ny,nz (and id, which is ignored).

        Normals are scaled to length 1 if they are printed with few decimals.

        Raises:
            InputError: the file cannot be read, or what it holds is no deployment.
        """
        table = read_numbers(path, COLUMNS, name="deployment.path", optional=("id",))
        try:
            deployment = cls(table[:, :3], table[:, 3:])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        length = np.linalg.norm(deployment.normals, axis=1, keepdims=True)
        exact = np.abs(length - 1.0) < 1e-12  # dividing these would only move the last bit
        return cls(deployment.positions, np.where(exact, deployment.normals, deployment.normals / length))


class DeploymentSource(Protocol):
    """Something that provides deployments: a start for optimisers, or what `evaluate` scores."""

    @property
    def varies(self) -> bool:
        """Whether two draws differ."""

    def draw(self, room: Room, rng: np.random.Generator) -> Deployment:
        """A deployment inside `room`."""


@dataclass(frozen=True)
class RandomDeployment:
    """Landmarks flush on the walls, each wall with a probability proportional to its area."""

    count: int
    varies = True

    def __post_init__(self) -> None:
        integer("deployment.count", self.count, low=1)

    def draw(self, room: Room, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`."""
        walls = room.landmark_walls()
        area = np.array([wall.area for wall in walls])
        picked = rng.choice(len(walls), size=self.count, p=area / area.sum())
        fraction = rng.random((self.count, 2))
        return _flush([(walls[w], f * np.asarray(walls[w].extent)) for w, f in zip(picked, fraction, strict=True)])


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
        integer("deployment.count", self.count, low=1)
        choice("deployment.layout", self.layout, ("per_wall", "by_area"))

    def draw(self, room: Room, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`; nothing here is random."""
        walls = room.landmark_walls()
        area = np.array([wall.area for wall in walls])
        share = area / area.sum() if self.layout == "by_area" else np.full(len(walls), 1.0 / len(walls))
        quota = share * self.count
        counts = np.floor(quota + 1e-9).astype(int)
        # Largest remainder first; the larger wall wins a tie.
        order = np.lexsort((-area, -np.round(quota - counts, 9)))
        counts[order[: self.count - counts.sum()]] += 1
        places = [
            (wall, np.asarray(point)) for wall, n in zip(walls, counts, strict=True) for point in _wall_grid(wall, n)
        ]
        return _flush(places)


@dataclass(frozen=True)
class FileDeployment:
    """A deployment from a CSV written by `Deployment.to_csv` or by anyone.

    Args:
        path: the CSV.
        count: K; if given, the file must have that many rows.
    """

    path: str | None
    count: int | None = None
    varies = False

    def draw(self, room: Room, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`."""
        if self.path is None:
            raise InputError("deployment.path is missing: deployment=file needs a CSV of landmarks.")
        deployment = Deployment.from_csv(self.path)
        if self.count is not None and self.count != len(deployment):
            raise InputError(f"{self.path} has {len(deployment)} landmarks, but deployment.count = {self.count}.")
        try:
            deployment.check_inside(room)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        return deployment


def _flush(places: list[tuple[Wall, FloatArray]]) -> Deployment:
    """Landmarks flush on walls at wall coordinates `(2,)`."""
    return Deployment(
        np.array([wall.point(at[0], at[1]) for wall, at in places]), np.array([wall.normal for wall, _ in places])
    )


# A grid whose cells are more elongated than this gives way to one with rows of unequal number.
MAX_ELONGATION = 3.0


def _wall_grid(wall: Wall, count: int) -> list[tuple[float, float]]:
    """Wall coordinates of `count` cell centres, with cells as square as an even grid allows.

    The grid runs along the longer side; 15 landmarks on the paper's walls make 5 x 3.
    """
    if count == 0:
        return []
    swap = wall.extent[1] > wall.extent[0]
    long, short = max(wall.extent), min(wall.extent)

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
