"""Tags from files of keys and values (YAML, JSON), whose formats are described by rows of `tables/tag_map.yaml`.

Sources of the rows: `AprilTagFieldLayout` of WPILib; `Marker::corners_f_map` of ptrmu/fiducial_vlam; `MarkerMap` of
ArUco 3; `SE2Transform` of duckietown-world; `target_map.fbs` of frc971; "AprilTag Map Specification" of Limelight;
`ReconstructedTag` and `exportReconstructions` of schmidtniko/visual_marker_mapping.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.formats.placed_tag import (
    METRE,
    RIGHT_UP_OUT,
    Found,
    PlacedTag,
    axes_of,
    edge_of,
    mapping,
    mappings,
    number_of,
    one_family,
    tag_named,
    tag_of_corners,
    transform_of,
    turn_by_angles,
    turn_by_quaternion,
    turn_by_vector,
)
from lmd.formats.registry import Keyed
from lmd.formats.trees import MISSING, File, Keys, find, number_at, numbers_of, vector_at
from lmd.geometry.se3 import pose_of
from lmd.scene.families import family_named

TURNS = ("transform", "pose", "rpy", "yaw_degrees", "yaw", "quaternion")
KNOWN = ("id", "position", "corners", "edge", "family", *TURNS)


@dataclass(frozen=True, kw_only=True)
class KeyedTags(Keyed):
    """Description of a format: the keys under which a file holds its tags.

    The field `at` has the paths (see `lmd.formats.trees`) of these quantities of a tag:

    - `id`, a number or a name such as `tag36h11:7`; `edge`; `family`.
    - `position`: three numbers, or two for a tag on the floor.
    - rotation: `quaternion`, `rpy` (roll, pitch, yaw), or `yaw` (rad) or `yaw_degrees` about the vertical. If an entry
      has several rotations, the first in the order of `TURNS` is taken.
    - position and rotation in one: `transform`, 16 numbers row by row, or `pose`, x, y, z, qx, qy, qz, qw.
    - edge, position and rotation in one: `corners`, four points clockwise from the top left.

    A path with spaces stands for several paths, one for each number of the quantity.
    """

    axes: Sequence[str] = RIGHT_UP_OUT
    """Directions of the axes x, y, z of a tag's frame, see `lmd.formats.placed_tag.axes_of`."""
    order: str = "xyzw"
    """Order of the components of a quaternion that the file gives as a list."""
    unit: float = METRE
    """Length of the unit of edge lengths in the file, metres (0.001 for mm)."""
    any_edge: bool = False
    """True if implausible edge lengths are accepted."""
    opencv: bool = False
    """True if the programs that read files of this format detect tags with OpenCV."""
    where: Mapping[str, Any] = field(default_factory=dict)
    """Values that an entry must have to be a tag, keyed by the path of the value."""
    first: str = ""
    """Path to the number of tags, n: only the first n entries, in the order of their keys, are read. Empty to read all.
    """
    corner: Sequence[str] = ()
    """Paths to the length and to the width of a field. Positions count from the field's middle in the file, and from
    its corner in the map that is read.
    """
    notes: Mapping[str, str] = field(default_factory=dict)
    """Sentences for the user, keyed by path; a sentence is shown if the value at its path is not 0."""

    def __post_init__(self) -> None:
        axes_of(list(self.axes))
        if unknown := [name for name in self.at if name not in KNOWN]:
            raise InputError(f"a tag map format has the unknown key {unknown[0]!r}; the keys are {', '.join(KNOWN)}.")

    def read(self, file: File) -> Found:
        """Read the tags of a file.

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
            raise InputError(f"the name {named[:80]!r} must have a number, such as 7, tag_7 or tag36h11:7.")
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
        """Value to which a path of keys leads in a tag's entry; `MISSING` if it is missing but optional.

        A path with spaces stands for several paths; `path` is then returned unchanged.
        """
        value = find(tag, path.rstrip("?")) if " " not in path else path
        if value is MISSING and not path.endswith("?"):
            raise InputError(f"the key {path.split('|')[0]} is missing.")
        return value

    def _pose(self, tag: Keys, at: Mapping[str, str], number: int) -> tuple[FloatArray, FloatArray]:
        """Position `(3,)`, metres, and rotation matrix `(3, 3)` of a tag, as its entry states them.

        The columns of the matrix are the axes x, y and z that the format defines for a tag, see its field `axes`. `at`
        has the paths of the tag's quantities, keyed by name; `number` is the tag's id, for messages.
        """
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
    """Numbers of one quantity in a tag's entry: one for each letter of `names`, such as `xyz`, in this order.

    The path leads to a list, or to a mapping whose keys are the letters (for a quaternion, with or without the prefix
    `q`). `order` has the letters in the order of the list, by default `names`. A path with spaces stands for several
    paths, one for each number.
    """
    if " " in path:
        return np.array([*(number_at(tag, part) for part in path.split()), 0.0][: len(names)])
    value = find(tag, path)
    if isinstance(value, Mapping):
        paths = "q{0}|{0}|{1}" if names == "xyzw" else "{0}|{1}"
        return np.array([number_at(value, paths.format(name, name.upper())) for name in names])
    numbers = dict(zip(order or names, vector_at(tag, path, len(names)), strict=True))
    return np.array([numbers[name] for name in names])


NODE = "ros__parameters"  # key above the parameters of a ROS 2 node
NODE_DEPTH = 4  # maximum number of namespaces above that key
# Keys of known maps, by which the node with tags is found among the nodes of a file.
MARKS = frozenset(
    {
        *("tags", "field-tags", "fiducials", "target_poses", "tag_bundles", "standalone_tags", "bodies", "markers"),
        *("objects", "aruco_bc_markers", "tag_locations", "reconstructed_tags", "marker_000", "landmarks", "tag"),
    }
)
PLACE, QUATERNION = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
# Default values of a bundle's layout, as in TagDetector.
DEFAULTS = {**dict.fromkeys((*PLACE, *QUATERNION), 0.0), "qw": 1.0}
TRANSFORM = "transform"
MOST_ROWS = 200  # maximum number of rows, and of columns, of a TagSLAM board


def parameters_of(keys: Keys) -> Keys:
    """Parameters of the node (program) that has tags, from a parameter file of ROS 2.

    Content `keys` without parameters of nodes is returned unchanged.

    Raises:
        InputError: several nodes have tags, or none of several nodes has tags.
    """
    nodes = list(_nodes(keys, NODE_DEPTH))
    if len(nodes) > 1:
        nodes = [node for node in nodes if not MARKS.isdisjoint(node)] or nodes
    if len(nodes) > 1:
        raise InputError(f"it has {NODE} of {len(nodes)} nodes: keep only the nodes with the tags.")
    return nodes[0] if nodes else keys


def _nodes(keys: Keys, depth: int) -> Iterable[Keys]:
    for key, value in keys.items():
        if key == NODE:
            yield mapping(NODE, value)
        elif depth and isinstance(value, dict):
            yield from _nodes(value, depth - 1)


def apriltag_ros(keys: Keys) -> Keys:
    """Tags in a configuration of apriltag_ros, as a tree with the key `tags`.

    The tags are those of a bundle, a group of tags with a common frame, which is taken as the world frame. Without a
    bundle, they are the standalone tags that have positions. The result also has the key `transform`, True if a bundle
    of ROS 2 states poses as transforms, and the key `family` if the configuration names a family.

    Raises:
        InputError: no tag has a pose, or several bundles have tags.
    """
    listed = keys.get("tag_bundles") or ()
    bundles = dict(_named(listed) if isinstance(listed, dict) else _listed(listed))
    alone = keys.get("standalone_tags") or ()
    if isinstance(alone, dict):  # in the ROS 2 port, standalone tags are a mapping by name
        alone = [tag for tag in alone.values() if isinstance(tag, dict)]
    alone = mappings("standalone_tags", alone)
    placed = [tag for tag in alone if not tag.keys().isdisjoint(PLACE)]
    if not bundles and not placed:
        raise InputError(
            "its standalone_tags have no poses: add x, y, z, qx, qy, qz, qw to each tag, or list the tags with their "
            "poses in tag_bundles."
        )
    if bundles and placed:
        raise InputError("it has poses in both standalone_tags and tag_bundles: remove one of the two.")
    if len(bundles) > 1:
        names = ", ".join(name[:80] for name in bundles)
        raise InputError(f"it has the bundles {names}, each in a frame of its own: keep only one.")
    chosen = next(iter(bundles.values())) if bundles else alone
    tags = [_placed(tag if placed else {**DEFAULTS, **tag}) for tag in chosen]
    own = {"family": keys["family"]} if isinstance(keys.get("family"), str) else {}
    return {"tags": tags, TRANSFORM: isinstance(listed, dict) and any(TRANSFORM in tag for tag in chosen), **own}


def _placed(tag: Keys) -> Keys:
    """Entry of a tag with separate keys for position and rotation, made from the values at the key `TRANSFORM`.

    The rotation is a quaternion if there are seven values, and roll, pitch and yaw if there are six. An entry without
    the key `TRANSFORM` is returned unchanged.
    """
    if TRANSFORM not in tag:
        return tag
    values = vector(TRANSFORM, tag[TRANSFORM], None)
    if len(values) == 7:
        return {**tag, **dict(zip((*PLACE, "qw", "qx", "qy", "qz"), values, strict=True))}
    if len(values) == 6:
        return {**tag, **dict(zip(PLACE, values[:3], strict=True)), "rpy": list(values[3:])}
    raise InputError(
        f"tag {tag.get('id')}: its transform must be x, y, z, qw, qx, qy, qz, or x, y, z, roll, pitch, yaw, it has "
        f"{len(values)} values."
    )


def _listed(listed: Any) -> Iterator[tuple[str, list[Keys]]]:
    """Yield name and tags of each bundle in a configuration for ROS 1.

    `listed` is the list of the bundles, mappings with the keys `name` and `layout`. A bundle without tags is left out.
    """
    for i, bundle in enumerate(mappings("tag_bundles", listed)):
        if bundle.get("layout"):
            yield str(bundle.get("name", f"without a name, number {i}")), mappings("layout", bundle["layout"])


def _named(bundles: Keys) -> Iterator[tuple[str, list[Keys]]]:
    """Yield name and tags of each bundle in a configuration for ROS 2; `bundles` are the bundles, keyed by name.

    In a bundle each tag has a key of its own, as parameters of ROS 2 cannot be lists of mappings.
    """
    for name in bundles.get("bundle_names") or [name for name in bundles if isinstance(bundles[name], dict)]:
        bundle = mapping(str(name), bundles[name])
        tags = {str(key): value for key, value in mapping("layout", bundle.get("layout", bundle)).items()}
        ids = [number_of(number) for number in tags["ids"]]
        yield str(name), [{"id": number, **mapping(f"{name}.{number}", tags[str(number)])} for number in ids]


def tagslam(keys: Keys) -> list[Keys]:
    """Tags of the static bodies in a configuration of TagSLAM, each with its pose under the key `TRANSFORM`.

    Tags of other bodies, whose poses TagSLAM estimates, are ignored.

    Raises:
        InputError: no body with tags is static, or a static body has no pose.
    """
    named = [
        (name, mapping(str(name), body)) for entry in mappings("bodies", keys["bodies"]) for name, body in entry.items()
    ]
    with_tags = [(name, body) for name, body in named if body.get("tags") or body.get("board")]
    static = [(name, body) for name, body in with_tags if body.get("is_static")]
    if not static:
        raise InputError("no body with tags is static: a map needs tags on a body with is_static: true and a pose.")
    found: list[Keys] = []
    for name, body in static:
        if not body.get("pose"):
            raise InputError(f"the body {name!r} has no pose: give it one, such as TagSLAM's estimate.")
        pose = _tagslam_pose(mapping("pose", body["pose"]))
        found += [{**tag, TRANSFORM: (pose @ tag[TRANSFORM]).ravel().tolist()} for tag in _on_body(body)]
    return found


def _on_body(body: Keys) -> Iterator[Keys]:
    """Yield the tags of a body, each with its pose in the body's frame, `(4, 4)`, under the key `TRANSFORM`.

    The tags are in a list, or on a board, row by row from the board's corner.
    """
    for tag in mappings("tags", body.get("tags") or ()):
        pose = _tagslam_pose(mapping("pose", tag.get("pose") or {}))
        yield {"id": tag["id"], "size": tag.get("size", body.get("default_tag_size")), TRANSFORM: pose}
    if body.get("board"):
        board = mapping("board", body["board"])
        size = edge_of("tag_size", board["tag_size"])
        pitch = size * (1.0 + real("tag_spacing", board["tag_spacing"]))
        rows, columns = (integer(name, board[name], low=1, high=MOST_ROWS) for name in ("tag_rows", "tag_columns"))
        for k in range(rows * columns):
            centre = pitch * np.array([k % columns, k // columns, 0.0])
            yield {"id": number_of(board["tag_start_id"]) + k, "size": size, TRANSFORM: pose_of(np.eye(3), centre)}


def _tagslam_pose(pose: Keys) -> FloatArray:
    """Transform `(4, 4)` from the position and the rotation vector of a pose in TagSLAM's file; missing values are
    zero.
    """
    parts = [pose.get(name) or dict.fromkeys("xyz", 0.0) for name in ("position", "rotation")]
    position, rotation = (np.array([number_at(mapping("pose", part), axis) for axis in "xyz"]) for part in parts)
    return pose_of(turn_by_vector("pose", rotation), position)
