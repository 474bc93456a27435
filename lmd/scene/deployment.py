"""Deployments: positions and normals of landmarks."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TextIO

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, said_of
from lmd.core.tables import Table, read_table, write_table
from lmd.geometry.se3 import pose_of
from lmd.geometry.squares import upright
from lmd.scene.labels import EDGE, ID, Labels, Surveyed, checked_edges, edge_column, in_plane
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.space.surface import FILE_TOLERANCE, PLACEMENT_TOLERANCE, SurfaceArrays

POSE_FIELDS = ("positions", "normals", "surfaces")  # fields that define the poses of the landmarks
COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
UP_COLUMNS = ("ux", "uy", "uz")
# Largest error of the length of a normal, which may be printed with few decimals.
NORMAL_TOLERANCE = 1e-3
# Largest difference between the normals of a landmark and of its surface for which the landmark is flush.
FLUSH = 1e-6


@dataclass(frozen=True)
class Deployment:
    """K landmarks: positions, normals, and further data about each landmark.

    Args:
        positions: `(K, 3)`, world frame, metres.
        normals: `(K, 3)` unit normals of the front faces, world frame.
        surfaces: index of the room's surface that carries each landmark, `(K,)`; -1 (the default) if unknown, see
            `with_surfaces`.
        labels: ids and further columns of the landmarks; None to number the landmarks from 0.
        surveyed: measured positions and up vectors, for landmarks measured behind their surface or rotated in their
            plane; None if `positions` are the measured positions and all landmarks hang upright.
        edges: edge lengths of the black squares, metres, `(K,)`; NaN (the default) for the edge length of the scene's
            tag, see `edges_of`.
        note: sentence about an ambiguity in the file of the landmarks; empty if nothing is ambiguous.

    Raises:
        InputError: wrong shapes, no landmark, a value that is not finite, a normal that is not unit, or an edge length
            that is not positive.
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
            array = np.array(getattr(self, name), dtype=np.float64, order="C")  # kernels are compiled for C order
            if array.ndim != 2 or array.shape[1] != 3 or not len(array):
                raise InputError(f"deployment {name} must have the shape (K, 3) with K >= 1, got {array.shape}.")
            if not np.isfinite(array).all():
                raise InputError(f"deployment {name} must be finite, but a value is not.")
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
        """Deployment with only the landmarks selected by `chosen`, a slice, indices or a mask."""
        labels = None if self.labels is None else self.labels[chosen]
        surveyed = None if self.surveyed is None else self.surveyed[chosen]
        parts = self.positions[chosen], self.normals[chosen], self.surfaces[chosen]
        return Deployment(*parts, labels, surveyed, self.edges[chosen])

    @property
    def ids(self) -> IntArray:
        """Unique id of each landmark, `(K,)`."""
        return np.arange(len(self)) if self.labels is None else self.labels.ids

    def put(self, chosen: slice | IntArray, there: "Deployment") -> "Deployment":
        """Copy of the deployment in which the landmarks `chosen` have the poses of the landmarks in `there`.

        The first landmark of `chosen` gets the first pose, the second landmark the second pose, and so on.
        """
        parts = {name: getattr(self, name).copy() for name in POSE_FIELDS}
        for name, values in parts.items():
            values[chosen] = getattr(there, name)
        return replace(self, **parts)

    def __add__(self, other: "Deployment") -> "Deployment":
        """Deployment with the landmarks of `self` followed by those of `other`; the result has ids from 0."""
        columns = ((getattr(self, name), getattr(other, name)) for name in (*POSE_FIELDS, "edges"))
        positions, normals, surfaces, edges = (np.concatenate(column) for column in columns)
        both = Deployment(positions, normals, surfaces, edges=edges)
        if self.surveyed is None and other.surveyed is None:
            return both
        places, ups = (np.concatenate([getattr(each, name) for each in (self, other)]) for name in ("places", "ups"))
        return replace(both, surveyed=Surveyed(both.positions, places, ups))

    def with_surfaces(self, room: Space, anywhere: bool = False, papers: float | FloatArray = 0.0) -> "Deployment":
        """Copy of the deployment with `surfaces` set to the surfaces of `room` that carry the landmarks.

        A tag that belongs to a surface (`Space.surface_near`) may have a corner behind this surface, which would hide
        the tag. Such a tag is moved along the surface's normal to the surface; `places` keeps the measured position.

        Args:
            room: room of the landmarks.
            anywhere: True if landmarks may lie outside the room.
            papers: edge lengths of the square papers that carry the tags, metres, one for all or `(K,)`; 0 for points.

        Raises:
            InputError: a landmark lies outside the room and belongs to none of the room's surfaces.
        """
        own, surfaces = room.surface_near(self.positions, self.normals), room.surfaces()
        outside = np.flatnonzero((own < 0) & ~room.contains(self.positions))
        if outside.size and not anywhere:
            first = outside[0]
            raise InputError(
                f"landmark {self._place(first)} lies outside the {room.describe()}, "
                f"{self._distance(room)[:, first].min():.4g} m from the nearest surface; set free=true to allow this."
            )
        depth = np.take_along_axis(SurfaceArrays.of(surfaces).heights(self.positions), own[:, None], axis=1)
        normals = np.array([surface.normal for surface in surfaces])[own]
        sides = np.stack(upright(self.normals))  # right and up
        leaning = np.abs((sides * normals).sum(axis=-1)).sum(axis=0)
        depth = depth - (papers / 2.0 * leaning)[:, None]  # depth of the deepest corner
        behind = (own[:, None] >= 0) & (depth < -PLACEMENT_TOLERANCE)
        hung = self
        if behind.any():
            positions = np.where(behind, self.positions - depth * normals, self.positions)
            hung = replace(self, positions=positions, surveyed=Surveyed(positions, self.places, self.ups))
        return replace(hung, surfaces=room.surfaces_of(hung.positions, hung.normals))

    def fault(self, room: Space, near: bool = False) -> str | None:
        """Describe the first misplaced landmark in a clause for an error message; None if all are well placed.

        A landmark is misplaced if it is on no surface, faces into its surface, or is outside the allowed region.
        `surfaces` must refer to `room`, see `with_surfaces`.

        Args:
            room: room of the landmarks.
            near: True to accept a small distance from a surface, see `Space.surface_near`.
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
                f"landmark {self._place(first)} hangs on {surfaces[own[first]].name} where no tag may hang "
                f"({len(kept_out)} {some})"
            )
        return None

    def belonging(self, room: Space) -> IntArray:
        """Index of each landmark's surface, `(K,)`; -1 if no surface is near.

        A landmark's surface is its value in `surfaces`. If this value is -1, the surface near the landmark is used
        (`Space.surface_near`).
        """
        if (self.surfaces >= 0).all():
            return self.surfaces
        return np.where(self.surfaces < 0, room.surface_near(self.positions, self.normals), self.surfaces)

    def before(self, room: Space) -> "Deployment":
        """Copy of the deployment with a surface for every landmark: its own (`belonging`), else the nearest surface."""
        own = self.belonging(room)
        if own is self.surfaces:
            return self
        if (own < 0).any():
            own = np.where(own < 0, self._distance(room).argmin(axis=0), own)
        return replace(self, surfaces=own)

    def _distance(self, room: Space) -> FloatArray:
        """Distance from each of the W surfaces of `room` to each landmark, metres, `(W, K)`."""
        return np.array([surface.distance(self.positions) for surface in room.surfaces()])

    def movable(self, room: Space, flush: bool = True) -> "Deployment":
        """Copy of the deployment with surfaces assigned (`with_surfaces`), checked to be movable by an optimiser.

        Args:
            room: room of the landmarks.
            flush: True if landmarks must be parallel to their surfaces.

        Raises:
            InputError: a landmark is on no surface, is outside the allowed region, faces into its surface, or, with
                `flush`, is not parallel to its surface.
        """
        hung = self.with_surfaces(room)
        if fault := hung.fault(room):
            raise InputError(f"{fault}, so the search cannot start from this deployment.")
        hung = hung.before(room)
        normals = np.array([surface.normal for surface in room.surfaces()])[hung.surfaces]
        deviation = np.linalg.norm(self.normals - normals, axis=1)
        if flush and deviation.max() > FLUSH:
            raise InputError(
                f"landmark {self.ids[np.argmax(deviation)]} is not flush with its wall; a search with flush = true "
                "cannot start from this deployment."
            )
        return hung

    def _place(self, k: int) -> str:
        x, y, z = self.positions[k]
        return f"{self.ids[k]} at ({x:.9g}, {y:.9g}, {z:.9g})"

    @property
    def places(self) -> FloatArray:
        """Measured position of each landmark, `(K, 3)`, world frame, metres.

        For a landmark that is not in `surveyed` or was moved after the measurement, this is its present position.
        """
        return self.positions if self.surveyed is None else self.surveyed.places_of(self.positions)

    @property
    def ups(self) -> FloatArray:
        """Up vectors: unit vectors from the centres of the tags to their upper edges, world frame, `(K, 3)`.

        A tag hangs upright unless `surveyed` has another up vector for it and it has not been moved.
        """
        ups = upright(self.normals)[1] + 0.0  # turns -0 into 0
        return ups if self.surveyed is None else self.surveyed.ups_of(self.positions, ups)

    @property
    def has_own_edges(self) -> bool:
        """True if any landmark has an individual edge length."""
        return not np.isnan(self.edges).all()

    def edges_of(self, tag: Tag) -> FloatArray:
        """Edge lengths of the black squares, metres, `(K,)`: `edges`, with NaN replaced by the edge length of `tag`.

        All are 0 if `tag` is a point.
        """
        return tag.filled(self.edges)

    def to_csv(self, file: str | Path | TextIO, ups: bool = False) -> None:
        """Write a CSV with the columns `id,x,y,z,nx,ny,nz` and all digits; `from_csv` restores equal values and labels.

        If any tag has an individual edge length, the column `edge` is added. Further columns of the labels are also
        written.

        Args:
            file: path or open text file.
            ups: True to add the columns `ux,uy,uz`, the up vectors of tags.
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
        """Read a CSV with the columns x,y,z,nx,ny,nz and optionally id, ux,uy,uz (up vectors of tags) and edge.

        Column `edge` has the edge lengths of tags, metres; an empty cell means the edge length of the scene's tag.
        Normals printed with few decimals are normalised. Further columns are kept as labels.

        Args:
            path: path of the file.
            name: name of the argument with the path, for messages.

        Raises:
            InputError: the file cannot be read or is not a deployment, or an up vector is not in its tag's plane.
        """
        return cls.from_table(read_table(path, name=name))

    @classmethod
    def from_table(cls, table: Table) -> "Deployment":
        """Read a deployment from a table with the columns of `from_csv`.

        Raises:
            InputError: the table is not a deployment, or an up vector is not in the plane of its tag.
        """
        path = table.path
        columns = COLUMNS + UP_COLUMNS if any(name in table for name in UP_COLUMNS) else COLUMNS
        rows, labels = table.numbers(columns, None), Labels.of(table, (*columns, EDGE))
        edges = edge_column(table)
        with said_of(path):
            deployment = cls(rows[:, :3], rows[:, 3:6], labels=labels, edges=edges)
        length = np.linalg.norm(deployment.normals, axis=1, keepdims=True)
        exact = np.abs(length - 1.0) < 1e-12  # normalising these normals would only change the last bit
        deployment = replace(deployment, normals=np.where(exact, deployment.normals, deployment.normals / length))
        return deployment if rows.shape[1] == len(COLUMNS) else deployment.turned(path, rows[:, 6:])

    def turned(self, path: str | Path, ups: FloatArray) -> "Deployment":
        """Copy of the deployment with given up vectors of the tags; the deployment itself if all tags are upright.

        Args:
            path: file of the up vectors, for messages.
            ups: up vectors, `(K, 3)`, world frame.

        Raises:
            InputError: an up vector is not a unit vector in the plane of its tag.
        """
        turned = in_plane(path, self.ids, self.normals, self.ups, ups)
        return self if turned is None else replace(self, surveyed=Surveyed(self.positions, self.positions, turned))


def poses_of(deployment: Deployment) -> FloatArray:
    """Poses of tags in the world frame, `(K, 4, 4)`, metres: x to the right of the tag, y up, z along the normal."""
    up, normal = deployment.ups, deployment.normals
    return pose_of(np.stack([np.cross(up, normal), up, normal], axis=-1), deployment.places)
