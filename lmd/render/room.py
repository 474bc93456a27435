"""Room with tags on its surfaces, and with people, for a renderer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import FloatArray, InputError
from lmd.geometry.squares import corners
from lmd.scene.tag import Tag
from lmd.space.crowd import BOTTOM, COLUMNS, RADIUS, TOP, X, Y
from lmd.space.surface import Surface

SIDES = 32  # number of sides of a prism; error of its outline: r (1 - cos(pi / 32)) / 2, or 0.6 mm for r = 25 cm


def faces_of(people: FloatArray) -> tuple[Surface, ...]:
    """Surfaces (sides and tops) of prisms that approximate people.

    `people` `(N, 5)` are the cylinders of the people: x, y, radius, lower and upper z, metres.
    """
    import shapely

    faces = []
    half = np.pi / SIDES
    for i, person in enumerate(people):
        low, height = person[BOTTOM], float(person[TOP] - person[BOTTOM])
        radius = person[RADIUS] * 2.0 / (1.0 + np.cos(half))  # vertices as far outside the cylinder as sides inside
        angles = 2.0 * half * np.arange(SIDES + 1)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius
        for j in range(SIDES):
            way = ring[j + 1] - ring[j]
            width = float(np.linalg.norm(way))
            u = np.array([*(way / width), 0.0])
            origin = np.array([*(person[[X, Y]] + ring[j]), low])
            normal = np.array([u[1], -u[0], 0.0])
            faces.append(Surface(f"person_{i}_side_{j}", origin, u, np.array([0.0, 0.0, 1.0]), normal, (width, height)))
        corner = np.array([*(person[[X, Y]] - radius), person[TOP]])
        top = shapely.Polygon(ring[:-1] + radius)
        ex, ey, ez = np.eye(3)
        faces.append(Surface(f"person_{i}_top", corner, ex, ey, ez, (2.0 * radius, 2.0 * radius), top))
    return tuple(faces)


@dataclass(frozen=True)
class TaggedRoom:
    """K tags on the surfaces of a room.

    Raises:
        InputError: shapes differ, an id is repeated or not in the family, or an up vector is not in its tag's plane.
    """

    tag: Tag
    """Family of all tags, and their edge length unless `edges` are given."""
    ids: NDArray[np.int64]
    """Number of each tag in the family, all different, `(K,)`."""
    centres: FloatArray
    """Centres of the tags, world frame, metres, `(K, 3)`."""
    normals: FloatArray
    """Unit normals of the front faces, `(K, 3)`."""
    ups: FloatArray
    """Unit vectors in the tags' planes to their upper edges, `(K, 3)`."""
    surfaces: Sequence[Surface] = ()
    """Surfaces that carry or occlude the tags."""
    edges: FloatArray = None  # type: ignore[assignment] # always an array once made
    """Edge length of each tag, metres, `(K,)`; None for that of `tag`."""
    people: FloatArray = None  # type: ignore[assignment] # always an array once made
    """Cylinders of people in front of surfaces and tags, `(N, 5)`, columns as in `faces_of`; None without a crowd."""

    def __post_init__(self) -> None:
        ids = np.asarray(self.ids)
        object.__setattr__(self, "ids", ids)
        if ids.ndim != 1 or len(np.unique(ids)) != len(ids) or not np.issubdtype(ids.dtype, np.integer):
            raise InputError(f"ids must be different whole numbers, got {ids.tolist()}.")
        if len(ids) and not (ids.min() >= 0 and ids.max() < self.tag.ids):
            raise InputError(
                f"ids must be in [0, {self.tag.ids - 1}] for family {self.tag.family}, got {ids.min()} to {ids.max()}."
            )
        if self.people is None:
            object.__setattr__(self, "people", np.empty((0, COLUMNS)))
        edges = np.full(len(ids), np.nan) if self.edges is None else self.edges
        object.__setattr__(self, "edges", self.tag.filled(edges))
        for name in ("centres", "normals", "ups"):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            if array.shape != (len(ids), 3) or not np.isfinite(array).all():
                raise InputError(f"{name} must be finite and have the shape ({len(ids)}, 3), got {array.shape}.")
            object.__setattr__(self, name, array)
        lean = np.abs((self.normals * self.ups).sum(axis=1))
        if len(ids) and lean.max() > 1e-3:
            k = int(lean.argmax())
            raise InputError(f"ups[{k}] must be perpendicular to normals[{k}], but their dot product is {lean[k]:g}.")

    def among(self, people: FloatArray) -> "TaggedRoom":
        """Copy of the room in which the people are replaced by `people`, cylinders `(N, 5)`."""
        return replace(self, people=people)

    @cached_property
    def people_faces(self) -> tuple[Surface, ...]:
        """Surfaces of the cylinders that stand for people."""
        return faces_of(self.people)

    @cached_property
    def corners(self) -> FloatArray:
        """Corners of the tags in the order of `squares.CORNERS`, world frame, metres, `(K, 4, 3)`."""
        return corners(self.centres, self.normals, self.ups, self.edges)

    @cached_property
    def picture_corners(self) -> FloatArray:
        """Corners of the tags' whole pictures, world frame, metres, `(K, 4, 3)`, in the order of `corners`.

        In some families the picture is larger than the black square; a detector needs the whole picture in the image.
        """
        if self.tag.picture_share == 1.0:
            return self.corners
        return corners(self.centres, self.normals, self.ups, self.tag.picture_share * self.edges)
