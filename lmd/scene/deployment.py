"""Deployments: where the landmarks are."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TextIO

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, said_of
from lmd.core.tables import Table, read_table, write_table
from lmd.geometry.squares import upright
from lmd.scene.edges import EDGE, checked_edges, edge_column
from lmd.scene.labels import ID, Labels
from lmd.scene.surveyed import Surveyed, in_plane
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.space.surface import FILE_TOLERANCE, PLACEMENT_TOLERANCE, SurfaceArrays

HUNG = ("positions", "normals", "surfaces")  # the arrays that say where and how landmarks hang
COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
UP_COLUMNS = ("ux", "uy", "uz")
# A normal printed with a few decimals is still a unit normal.
NORMAL_TOLERANCE = 1e-3
# A normal this close to that of its surface is flush with it.
FLUSH = 1e-6


@dataclass(frozen=True)
class Deployment:
    """K landmarks.

    Args:
        positions: `(K, 3)`, world frame, metres.
        normals: `(K, 3)` unit normals of the front faces, world frame.
        surfaces: `(K,)`, index of the surface of its room that each hangs on, -1 where none is known, the default: see
            `hung`.
        labels: what the landmarks are called; None where they are numbered from 0.
        surveyed: places and ups to the last digit, where landmarks were measured behind their surface, or turned in
            their plane; None where `positions` are the places and all hang upright.
        edges: of the black squares, `(K,)`, metres; NaN, the default, for that of the scene's tag, see `edges_of`.
        note: how a file was read that may mean something else, a sentence; empty where there is no doubt.

    Raises:
        InputError: wrong shapes, no landmark, a value that is not finite, a normal that is not unit, or an edge that is
            not positive.
    """

    positions: FloatArray
    normals: FloatArray
    surfaces: IntArray = None  # type: ignore[assignment] # always an array once made
    labels: Labels | None = None
    surveyed: Surveyed | None = None
    edges: FloatArray = None  # type: ignore[assignment] # always an array once made
    note: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in ("positions", "normals"):
            array = np.array(getattr(self, name), dtype=np.float64, order="C")  # kernels are compiled for that
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
        if len(self.ids) != count:
            raise InputError(f"a deployment has {count} positions but {len(self.ids)} ids.")
        length = np.linalg.norm(self.normals, axis=1)
        worst = int(np.argmax(np.abs(length - 1.0)))
        if abs(length[worst] - 1.0) > NORMAL_TOLERANCE:
            raise InputError(f"landmark {self.ids[worst]}: the normal must have length 1, it has {length[worst]:g}.")
        object.__setattr__(self, "edges", checked_edges(self.edges, self.ids))

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Deployment":
        """The landmarks that `chosen` selects."""
        labels = None if self.labels is None else self.labels[chosen]
        surveyed = None if self.surveyed is None else self.surveyed[chosen]
        parts = self.positions[chosen], self.normals[chosen], self.surfaces[chosen]
        return Deployment(*parts, labels, surveyed, self.edges[chosen])

    @property
    def ids(self) -> IntArray:
        """The number of each landmark, `(K,)`, all different."""
        return np.arange(len(self)) if self.labels is None else self.labels.ids

    def put(self, chosen: slice | IntArray, there: "Deployment") -> "Deployment":
        """The deployment with the landmarks that `chosen` selects moved to those of `there`."""
        parts = {name: getattr(self, name).copy() for name in HUNG}
        for name, values in parts.items():
            values[chosen] = getattr(there, name)
        return replace(self, **parts)

    def __add__(self, other: "Deployment") -> "Deployment":
        """The landmarks of both, numbered from 0."""
        columns = ((getattr(self, name), getattr(other, name)) for name in (*HUNG, "edges"))
        positions, normals, surfaces, edges = (np.concatenate(column) for column in columns)
        both = Deployment(positions, normals, surfaces, edges=edges)
        if self.surveyed is None and other.surveyed is None:
            return both
        places, ups = (np.concatenate([getattr(each, name) for each in (self, other)]) for name in ("places", "ups"))
        return replace(both, surveyed=Surveyed(both.positions, places, ups))

    def hung(self, room: Space, anywhere: bool = False, papers: float | FloatArray = 0.0) -> "Deployment":
        """The deployment with the surfaces of `room` that the landmarks hang on.

        What belongs to a surface (`Space.surface_near`) and was measured behind it, if only with a corner because it
        leans, counts as if it just touched it: nothing is seen through a wall. Its `places` stay what they were.

        Args:
            anywhere: whether landmarks may lie outside the room.
            papers: edges of their papers, upright, metres, one for all or `(K,)`; 0 for points.

        Raises:
            InputError: a landmark lies outside the room and belongs to no surface of it.
        """
        own, surfaces = room.surface_near(self.positions, self.normals), room.surfaces()
        outside = np.flatnonzero((own < 0) & ~room.contains(self.positions))
        if outside.size and not anywhere:
            first = outside[0]
            raise InputError(
                f"landmark {self._place(first)} lies outside the {room.describe()}, "
                f"{self._distance(room)[:, first].min():.4g} m from the nearest surface; only with free=true is it "
                "taken there."
            )
        depth = np.take_along_axis(SurfaceArrays.of(surfaces).depth(self.positions), own[:, None], axis=1)
        normals = np.array([surface.normal for surface in surfaces])[own]
        sides = np.stack(upright(self.normals))  # right and up
        leaning = np.abs((sides * normals).sum(axis=-1)).sum(axis=0)
        depth = depth - (papers / 2.0 * leaning)[:, None]  # of the deepest corner
        behind = (own[:, None] >= 0) & (depth < -PLACEMENT_TOLERANCE)
        hung = self
        if behind.any():
            positions = np.where(behind, self.positions - depth * normals, self.positions)
            hung = replace(self, positions=positions, surveyed=Surveyed(positions, self.places, self.ups))
        return replace(hung, surfaces=room.surfaces_of(hung.positions, hung.normals))

    def fault(self, room: Space, near: bool = False) -> str | None:
        """Clause about the first landmark that hangs on no surface, faces into its own, or hangs where none may.

        None if there is none. Landmarks know their surfaces (`hung`), which are those of `room`.

        Args:
            near: whether landmarks may stand a little before a surface, see `Space.surface_near`.
        """
        surfaces, some = room.surfaces(), f"of {len(self)} landmarks do"
        distance = self._distance(room)
        touched = np.where(distance.min(axis=0) > 0.0, -1, distance.argmin(axis=0))
        own = self.belonging(room) if near else np.where(self.surfaces < 0, touched, self.surfaces)
        if (floating := np.flatnonzero(own < 0)).size:
            first = int(floating[0])
            nearest = int(np.argmin(distance[:, first]))
            return (
                f"landmark {self._place(first)} hangs in mid-air, {distance[nearest, first]:.4g} m from the nearest "
                f"surface that may carry it, {surfaces[nearest].name} ({len(floating)} {some})"
            )
        normals = np.array([surface.normal for surface in surfaces])[own]
        if (inwards := np.flatnonzero((self.normals * normals).sum(axis=1) < 0.0)).size:
            first = int(inwards[0])
            name = surfaces[own[first]].name
            return f"landmark {self._place(first)} faces into {name}, the surface it hangs on ({len(inwards)} {some})"
        hanging = SurfaceArrays.of(surfaces)
        at = hanging.coordinates(own, self.positions)
        everywhere = np.array([surface.allowed is None for surface in surfaces])[own]
        if (kept_out := np.flatnonzero(~everywhere & ~hanging.allow(own, at, FILE_TOLERANCE))).size:
            first = int(kept_out[0])
            return (
                f"landmark {self._place(first)} hangs on {surfaces[own[first]].name} where none may hang "
                f"({len(kept_out)} {some})"
            )
        return None

    def belonging(self, room: Space) -> IntArray:
        """The surface of `room` that each hangs on, or else belongs to (`Space.surface_near`), -1 for none, `(K,)`."""
        if (self.surfaces >= 0).all():
            return self.surfaces
        return np.where(self.surfaces < 0, room.surface_near(self.positions, self.normals), self.surfaces)

    def before(self, room: Space) -> "Deployment":
        """The deployment in which landmarks that belong to no surface of `room` have the nearest one."""
        own = self.belonging(room)
        if own is self.surfaces:
            return self
        if (own < 0).any():
            own = np.where(own < 0, self._distance(room).argmin(axis=0), own)
        return replace(self, surfaces=own)

    def _distance(self, room: Space) -> FloatArray:
        """From each surface of `room` to each landmark, `(W, K)`, metres."""
        return np.array([surface.distance(self.positions) for surface in room.surfaces()])

    def movable(self, room: Space, flush: bool = True) -> "Deployment":
        """`hung`, for an optimiser that moves landmarks along surfaces.

        Args:
            flush: whether landmarks must lie flat.

        Raises:
            InputError: a landmark hangs on no surface or where none may, faces into its surface or is not flush.
        """
        hung = self.hung(room)
        if fault := hung.fault(room):
            raise InputError(f"{fault}, so it cannot be a start.")
        hung = hung.before(room)
        normals = np.array([surface.normal for surface in room.surfaces()])[hung.surfaces]
        deviation = np.linalg.norm(self.normals - normals, axis=1)
        if flush and deviation.max() > FLUSH:
            raise InputError(
                f"landmark {self.ids[np.argmax(deviation)]} is not flush with its wall; only an encoding "
                "that is not flush can start from it."
            )
        return hung

    def _place(self, k: int) -> str:
        x, y, z = self.positions[k]
        return f"{self.ids[k]} at ({x:.9g}, {y:.9g}, {z:.9g})"

    @property
    def places(self) -> FloatArray:
        """Measured positions of the landmarks, `(K, 3)`, world frame, metres; see `Surveyed`."""
        return self.positions if self.surveyed is None else self.surveyed.places_of(self.positions)

    @property
    def ups(self) -> FloatArray:
        """Unit vectors to the upper edges of tags there, `(K, 3)`, world frame: upright unless they were `surveyed`."""
        ups = upright(self.normals)[1] + 0.0  # no -0
        return ups if self.surveyed is None else self.surveyed.ups_of(self.positions, ups)

    @property
    def has_own_edges(self) -> bool:
        """True if a landmark has an edge of its own."""
        return not np.isnan(self.edges).all()

    def edges_of(self, tag: Tag) -> FloatArray:
        """Edges of the black squares, `(K,)`, metres: the landmark's own, or else that of `tag`; zeros for points."""
        return tag.filled(self.edges)

    def to_csv(self, file: str | Path | TextIO, ups: bool = False) -> None:
        """Write `id,x,y,z,nx,ny,nz` with every digit, so that reading it back gives the same numbers and labels.

        Tags with edges of their own have a further column `edge`.

        Args:
            file: its path, or an open text file.
            ups: whether to add `ux,uy,uz`, for landmarks that are tags with an upper edge.
        """
        columns = dict(zip(COLUMNS, np.hstack([self.places, self.normals]).T, strict=True))
        if ups:
            columns |= zip(UP_COLUMNS, self.ups.T, strict=True)
        if self.has_own_edges:
            columns[EDGE] = self.edges
        further = {} if self.labels is None else self.labels.columns
        write_table(file, {ID: self.ids, **columns, **further})

    @classmethod
    def from_csv(cls, path: str | Path, name: str = "path") -> "Deployment":
        """Read a CSV with the columns x,y,z,nx,ny,nz (and id, and ux,uy,uz for how tags are turned in their plane).

        A column `edge` has the edges of tags, metres, empty for those that have none of their own. Normals are scaled
        to length 1 if they are printed with few decimals. Further columns are kept as labels.

        Args:
            name: the argument the path came from, for messages.

        Raises:
            InputError: the file cannot be read, or what it holds is no deployment, or an up is not in its tag's plane.
        """
        return cls.from_table(read_table(path, name=name))

    @classmethod
    def from_table(cls, table: Table) -> "Deployment":
        """Read a deployment from a table, see `from_csv`."""
        path = table.path
        columns = COLUMNS + UP_COLUMNS if any(name in table for name in UP_COLUMNS) else COLUMNS
        rows, labels = table.numbers(columns, None), Labels.of(table, (*columns, EDGE))
        edges = edge_column(table)
        with said_of(path):
            deployment = cls(rows[:, :3], rows[:, 3:6], labels=labels, edges=edges)
        length = np.linalg.norm(deployment.normals, axis=1, keepdims=True)
        exact = np.abs(length - 1.0) < 1e-12  # dividing these would only move the last bit
        deployment = replace(deployment, normals=np.where(exact, deployment.normals, deployment.normals / length))
        return deployment if rows.shape[1] == len(COLUMNS) else deployment.turned(path, rows[:, 6:])

    def turned(self, path: str | Path, ups: FloatArray) -> "Deployment":
        """The deployment with the ups `(K, 3)` of a file, if one of them is not upright.

        Raises:
            InputError: an up is no unit vector in the plane of its tag.
        """
        turned = in_plane(path, self.ids, self.normals, self.ups, ups)
        return self if turned is None else replace(self, surveyed=Surveyed(self.positions, self.positions, turned))
