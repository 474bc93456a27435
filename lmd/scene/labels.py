"""Data about landmarks that is read from a file and written again to the output.

The data are ids, further columns, edge lengths, and measured positions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, said_of
from lmd.core.tables import Table

ID = "id"
LARGEST = 2**53  # largest id; floats do not represent all whole numbers above it


@dataclass(frozen=True)
class Labels:
    """Ids and further columns of K landmarks.

    Args:
        ids: unique non-negative whole numbers, `(K,)`; the id of a tag is its number in the family.
        columns: further columns of the file by name, K texts each.

    Raises:
        InputError: an id is negative or occurs twice.
    """

    ids: IntArray
    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64)
        ids.flags.writeable = False
        object.__setattr__(self, "ids", ids)
        found, counts = np.unique(ids, return_counts=True)
        if (twice := found[counts > 1]).size:
            raise InputError(f"id {twice[0]} belongs to {counts.max()} landmarks; ids must be different.")
        if ids.min() < 0:
            raise InputError(f"id {ids.min()} is negative.")

    @classmethod
    def of(cls, table: Table, known: Sequence[str]) -> "Labels":
        """Labels from a table of landmarks; without a column `id`, the ids count from 0.

        Args:
            table: table of the landmarks.
            known: names of the columns that are read elsewhere and are not labels.

        Raises:
            InputError: an id is not a whole number, is negative, or occurs twice.
        """
        count = len(table.lines)
        columns = {name: texts for name, texts in table.texts.items() if name not in (ID, *known)}
        if ID not in table:
            return cls(np.arange(count), columns)
        (given,) = table.numbers((ID,), None).T
        for line, value in zip(table.lines, given.tolist(), strict=True):
            if not (0 <= value <= LARGEST and value.is_integer()):
                place = f"{table.path} line {line}: {ID}"
                raise InputError(f"{place} must be a whole number from 0 to {LARGEST:.4g}, got {value:.9g}.")
        with said_of(table.path):
            return cls(given.astype(np.int64), columns)

    def __add__(self, other: "Labels") -> "Labels":
        """Concatenate the labels of two deployments.

        If only one of the two has a column, the landmarks of the other get empty texts in this column.
        """
        names = {**self.columns, **other.columns}
        parts = ((part.columns.get(name, [""] * len(part.ids)) for part in (self, other)) for name in names)
        columns = {name: [*mine, *theirs] for name, (mine, theirs) in zip(names, parts, strict=True)}
        return Labels(np.concatenate([self.ids, other.ids]), columns)

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Labels":
        """Labels of the landmarks selected by `chosen`."""
        columns = {name: np.array(texts, dtype=object)[chosen].tolist() for name, texts in self.columns.items()}
        return Labels(self.ids[chosen], columns)


LARGEST_EDGE = 10.0  # largest edge in a file, metres; larger numbers are assumed to be millimetres and refused
EDGE = "edge"  # column with the edge of each tag, metres; an empty cell means the edge of the scene's tag


def checked_edges(edges: FloatArray | None, ids: IntArray) -> FloatArray:
    """Return the edge lengths of K tags as a checked array, metres, `(K,)`; NaN for the edge length of the scene's tag.

    Args:
        edges: edge lengths, metres, `(K,)`; None if no tag has an individual edge length.
        ids: ids of the tags, `(K,)`.

    Raises:
        InputError: the numbers of `edges` and `ids` differ, or an edge length is not positive.
    """
    edges = np.full(ids.shape, np.nan) if edges is None else np.array(edges, dtype=np.float64)
    if edges.shape != ids.shape:
        raise InputError(f"deployment edges must have the shape ({len(ids)},), got {edges.shape}.")
    if (wrong := np.flatnonzero((edges <= 0.0) | np.isinf(edges))).size:
        raise InputError(f"{EDGE} must be positive metres, landmark {ids[wrong[0]]} has {edges[wrong[0]]:g}.")
    edges.flags.writeable = False
    return edges


def edge_column(table: Table) -> FloatArray:
    """Edge lengths from the column `EDGE` of a file, metres, `(K,)`; NaN for an empty cell or a missing column.

    Raises:
        InputError: an edge length is not a number, or exceeds `LARGEST_EDGE`.
    """
    if EDGE not in table:
        return np.full(len(table.lines), np.nan)
    try:
        edges = np.array([float(text or "nan") for text in table.texts[EDGE]])
    except ValueError as error:
        raise InputError(f"{table.path}: {EDGE} must be positive metres: {error}.") from None
    if (wrong := np.flatnonzero((edges > LARGEST_EDGE) & np.isfinite(edges))).size:
        place = f"{table.path} line {table.lines[wrong[0]]}"
        raise InputError(f"{place}: {EDGE} = {edges[wrong[0]]:g} looks like millimetres; edges are in metres.")
    return edges


# `UP_TOLERANCE`: largest difference of an up vector from the upright up vector that counts as upright. `IN_PLANE`:
# largest deviation of a file's up vector from unit length and from the plane of its tag.
UP_TOLERANCE, IN_PLANE = 1e-3, 1e-2


@dataclass(frozen=True)
class Surveyed:
    """Measured positions and up vectors of K landmarks.

    A landmark whose present position differs from `positions` has been moved, and its measurement is ignored.

    Args:
        positions: positions on or in front of the surfaces, world frame, metres, `(K, 3)`. A landmark that was measured
            behind its surface is moved to the surface; for all others this is the measured position.
        places: measured positions, world frame, metres, `(K, 3)`.
        ups: unit vectors from the centres of the tags to their upper edges, world frame, `(K, 3)`.
    """

    positions: FloatArray
    places: FloatArray
    ups: FloatArray

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Surveyed":
        """Measurements of the landmarks selected by `chosen`."""
        return Surveyed(self.positions[chosen], self.places[chosen], self.ups[chosen])

    def places_of(self, positions: FloatArray) -> FloatArray:
        """Measured position of each landmark that has not been moved, and present position of each moved landmark.

        The result and the present positions `positions` are `(K, 3)`, world frame, metres.
        """
        return np.where(self._stays(positions), self.places, positions)

    def ups_of(self, positions: FloatArray, upright: FloatArray) -> FloatArray:
        """Up vector of each landmark, `(K, 3)`: measured if the landmark has not been moved, else its row of `upright`.

        Args:
            positions: present positions, metres, `(K, 3)`.
            upright: up vectors of upright tags, `(K, 3)`.
        """
        return np.where(self._stays(positions), self.ups, upright)

    def _stays(self, positions: FloatArray) -> BoolArray:
        return np.asarray((positions == self.positions).all(axis=1, keepdims=True))


def in_plane(
    path: str | Path, ids: IntArray, normals: FloatArray, upright: FloatArray, ups: FloatArray
) -> FloatArray | None:
    """Correct small errors of the up vectors in a file: project each vector to the plane of its tag, with length 1.

    An error is small if the length and the component along the tag's normal are wrong by at most `IN_PLANE`. A tag
    whose up vector differs by at most `UP_TOLERANCE` from `upright` gets the up vector of `upright`.

    Args:
        path: file, for messages.
        ids: ids of the tags, `(K,)`.
        normals: unit normals, `(K, 3)`.
        upright: up vectors of the tags if they were upright, `(K, 3)`.
        ups: up vectors of the file, `(K, 3)`.

    Returns:
        unit up vectors in the planes of the tags, `(K, 3)`; None if all tags are upright.

    Raises:
        InputError: the error of an up vector exceeds `IN_PLANE`.
    """
    leaning = (ups * normals).sum(axis=1, keepdims=True)
    off = np.maximum(np.abs(leaning[:, 0]), np.abs(np.linalg.norm(ups, axis=1) - 1.0))
    if (wrong := np.flatnonzero(off > IN_PLANE)).size:
        up, normal = (", ".join(f"{value:.4g}" for value in v[wrong[0]]) for v in (ups, normals))
        raise InputError(
            f"{path}: the up vector of landmark {ids[wrong[0]]}, ({up}), must have length 1 and be perpendicular to "
            f"the normal of its tag, ({normal})."
        )
    level = np.linalg.norm(ups - upright, axis=1, keepdims=True) <= UP_TOLERANCE
    if level.all():
        return None
    flat = ups - leaning * normals
    return np.where(level, upright, flat / np.linalg.norm(flat, axis=1, keepdims=True))
