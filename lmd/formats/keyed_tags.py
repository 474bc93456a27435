"""Tags of keyed files, as rows of `tables/tag_map.yaml` describe them.

Sources of the rows: `AprilTagFieldLayout` of WPILib; `Marker::corners_f_map` of ptrmu/fiducial_vlam; `MarkerMap` of
ArUco 3; `SE2Transform` of duckietown-world; `target_map.fbs` of frc971; "AprilTag Map Specification" of Limelight;
`ReconstructedTag` and `exportReconstructions` of schmidtniko/visual_marker_mapping.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.formats.placed_tag import (
    METRE,
    RIGHT_UP_OUT,
    Found,
    PlacedTag,
    axes_of,
    edge_of,
    number_of,
    one_family,
    tag_named,
    tag_of_corners,
    transform_of,
    turn_by_angles,
    turn_by_quaternion,
)
from lmd.formats.registry import Keyed
from lmd.formats.trees import MISSING, File, Keys, find, number_at, numbers_of, vector_at
from lmd.scene.families import family_named

TURNS = ("transform", "pose", "rpy", "yaw_degrees", "yaw", "quaternion")
KNOWN = ("id", "position", "corners", "edge", "family", *TURNS)


@dataclass(frozen=True, kw_only=True)
class KeyedTags(Keyed):
    """Description of the tags in a keyed file.

    Quantities of a tag: `id`, a number or a name such as `tag36h11:7`; `edge`; `family`; the place as `position`; the
    rotation as `quaternion`, as `rpy`, roll, pitch and yaw, or as `yaw`, rad, or `yaw_degrees` about the vertical;
    place and rotation as `transform`, 16 numbers row by row, or as `pose`, x, y, z, qx, qy, qz, qw; all as four
    `corners`, clockwise from the top left. The first rotation that the entry has counts. A path with spaces is one of
    numbers by themselves; a position of two numbers is on the floor.
    """

    axes: Sequence[str] = RIGHT_UP_OUT
    """Directions of the axes x, y, z of a tag's frame, see `lmd.formats.placed_tag.axes_of`."""
    order: str = "xyzw"
    """Order of a quaternion that is a list."""
    unit: float = METRE
    """Unit of edges, metres."""
    any_edge: bool = False
    """True if implausible edges are taken, too."""
    opencv: bool = False
    """True if the programs that read such files detect tags with OpenCV."""
    where: Mapping[str, Any] = field(default_factory=dict)
    """Values at paths that an entry must have to be a tag."""
    first: str = ""
    """Path of the number of entries that count, in the order of their keys."""
    corner: Sequence[str] = ()
    """Paths of length and width of a field, from whose middle the file counts; the map counts from its corner."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Sentences for the user, by paths that lead to a value which is not 0."""

    def __post_init__(self) -> None:
        axes_of(list(self.axes))
        if unknown := [name for name in self.at if name not in KNOWN]:
            raise InputError(f"a row of a tag map has no quantity {unknown[0]!r}, only {', '.join(KNOWN)}.")

    def read(self, file: File) -> Found:
        """Tags of a file.

        Raises:
            InputError: a value is missing or wrong.
        """
        tree, listed = self.entries(file)
        if self.first and find(tree, self.first) is not MISSING:
            listed = sorted(listed, key=lambda keyed: keyed[0])[: int(number_at(tree, self.first))]
        wanted = self.where.items()
        tags = [self._tag(key, tag) for key, tag in listed if all(find(tag, path) == value for path, value in wanted)]
        notes = [text for path, text in self.notes.items() if find(tree, path) not in (MISSING, 0, False)]
        return Found(tags, None, self.opencv, "; ".join(f"{file.path}: {text}" for text in notes))

    def _tag(self, key: str, tag: Keys) -> PlacedTag:
        at = {name: path.replace("{key}", key) for name, path in self.at.items()}
        value = {name: self._value(tag, path) for name, path in at.items() if name not in (*TURNS, "id")}
        named = key if self.at["id"] == "{key}" else self._value(tag, at["id"])
        known = tag_named(named) if isinstance(named, str) else (None, number_of(named))
        if known is None:
            raise InputError(f"the name {named[:80]!r} has no number of a tag, as 7, tag_7 or tag36h11:7 have.")
        family, number = known
        if (said := value.get("family", MISSING)) is not MISSING:
            family = one_family((family, family_named(said)))
        if "corners" in value:
            corners = np.array([vector("corners", numbers_of(corner), 3) for corner in value["corners"]])
            return tag_of_corners(number, corners, family)
        place, turn = self._pose(tag, at, number)
        middle = [number_at(tag, path) / 2.0 if find(tag, path) is not MISSING else 0.0 for path in self.corner]
        edge = None
        if value.get("edge", MISSING) is not MISSING:
            name, edge = at["edge"].rpartition(".")[2].rstrip("?"), number_at(tag, at["edge"].rstrip("?"))
            edge = real(name, edge, above=0.0) if self.any_edge else edge_of(name, edge, self.unit)
        shifted = place + np.array([*middle, 0.0]) if middle else place
        return PlacedTag(number, shifted, turn @ axes_of(list(self.axes)).T, edge, family)

    def _value(self, tag: Keys, path: str) -> Any:
        """Value at a path; `MISSING` if it may be missing, and is."""
        value = find(tag, path.rstrip("?")) if " " not in path else path
        if value is MISSING and not path.endswith("?"):
            raise InputError(f"the key {path.split('|')[0]} is missing.")
        return value

    def _pose(self, tag: Keys, at: Mapping[str, str], number: int) -> tuple[FloatArray, FloatArray]:
        """Position, metres, and rotation matrix of the tag's own frame."""
        turns = {name: at[name].rstrip("?") for name in TURNS if name in at}
        name = next((name for name, path in turns.items() if find(tag, path) is not MISSING), list(turns)[-1])
        if (value := self._value(tag, at[name])) is not MISSING and name == "transform":
            moved = transform_of(numbers_of(value), "transform", f"tag {number}: ")
            return moved[:3, 3], moved[:3, :3]
        path = turns[name]
        if name == "pose":
            x, y, z, *turn = vector_at(tag, path, 7)
            return np.array([x, y, z]), turn_by_quaternion(*turn)
        place = _numbers(tag, at["position"], "xyz")
        if value is MISSING:
            return place, np.eye(3)
        if name == "quaternion":
            return place, turn_by_quaternion(*_numbers(tag, path, "xyzw", self.order))
        angles = vector_at(tag, path, 3) if name == "rpy" else (0.0, 0.0, number_at(tag, path))
        return place, turn_by_angles(number, *(np.radians(angles).tolist() if name == "yaw_degrees" else angles))


def _numbers(tag: Keys, path: str, names: str, order: str = "") -> FloatArray:
    """Numbers of a mapping by names, with or without a `q`, or of a list in an order; sorted as `names`."""
    if " " in path:
        return np.array([*(number_at(tag, part) for part in path.split()), 0.0][: len(names)])
    value = find(tag, path)
    if isinstance(value, Mapping):
        paths = "q{0}|{0}|{1}" if names == "xyzw" else "{0}|{1}"
        return np.array([number_at(value, paths.format(name, name.upper())) for name in names])
    numbers = dict(zip(order or names, vector_at(tag, path, len(names)), strict=True))
    return np.array([numbers[name] for name in names])
