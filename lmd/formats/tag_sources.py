"""Trees of tag maps whose form a row of a table does not describe: nodes, bundles and bodies.

The frame of a tag of apriltag_ros has x to the right, y up, z along the normal, as in `TagDetector::addObjectPoints`.

Sources: `TagDetector::parseTagBundles` of AprilRobotics/apriltag_ros and of its port to ROS 2 (pull request 158); pull
requests 59 and 60 of christianrauch/apriltag_ros; `Board::parse` and `example/tagslam.yaml` of TagSLAM.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.formats.placed_tag import edge_of, mapping, mappings, number_of, turn_by_vector
from lmd.formats.trees import Keys, number_at
from lmd.geometry.se3 import pose_of

NODE = "ros__parameters"  # key above the parameters of a node of ROS 2
NODE_DEPTH = 4  # greatest number of namespaces above that key
# Keys of known maps, which identify the node with the tags among the nodes of a file.
MARKS = frozenset(
    {
        *("tags", "field-tags", "fiducials", "target_poses", "tag_bundles", "standalone_tags", "bodies", "markers"),
        *("objects", "aruco_bc_markers", "tag_locations", "reconstructed_tags", "marker_000", "landmarks", "tag"),
    }
)
PLACE, QUATERNION = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
# Default values of a layout, as in TagDetector.
DEFAULTS = {**dict.fromkeys((*PLACE, *QUATERNION), 0.0), "qw": 1.0}
TRANSFORM = "transform"
MOST_ROWS = 200  # greatest number of rows, and of columns, of a board of TagSLAM


def parameters_of(keys: Keys) -> Keys:
    """Parameters of the node with tags in a file of ROS 2; the keys themselves for any other file.

    Raises:
        InputError: several nodes have tags, or none of several nodes has tags.
    """
    nodes = list(_nodes(keys, NODE_DEPTH))
    if len(nodes) > 1:
        nodes = [node for node in nodes if not MARKS.isdisjoint(node)] or nodes
    if len(nodes) > 1:
        raise InputError(f"it has {NODE} of {len(nodes)} nodes: leave those with the tags in the file.")
    return nodes[0] if nodes else keys


def _nodes(keys: Keys, depth: int) -> Iterable[Keys]:
    for key, value in keys.items():
        if key == NODE:
            yield mapping(NODE, value)
        elif depth and isinstance(value, dict):
            yield from _nodes(value, depth - 1)


def apriltag_ros(keys: Keys) -> Keys:
    """Tags of the bundle, whose frame is the world; or standalone tags with positions in the world.

    Raises:
        InputError: no tag has a place, or several bundles have tags.
    """
    listed = keys.get("tag_bundles") or ()
    bundles = dict(_named(listed) if isinstance(listed, dict) else _listed(listed))
    alone = keys.get("standalone_tags") or ()
    if isinstance(alone, dict):  # in the port to ROS 2, standalone tags are by name
        alone = [tag for tag in alone.values() if isinstance(tag, dict)]
    alone = mappings("standalone_tags", alone)
    placed = [tag for tag in alone if not tag.keys().isdisjoint(PLACE)]
    if not bundles and not placed:
        raise InputError(
            "its tags are standalone_tags without places: they need x, y, z, qx, qy, qz, qw, or a bundle of "
            "tag_bundles with these."
        )
    if bundles and placed:
        raise InputError("it has places in standalone_tags and in tag_bundles: leave one of the two in the file.")
    if len(bundles) > 1:
        names = ", ".join(name[:80] for name in bundles)
        raise InputError(f"it has the bundles {names}, each in a frame of its own: leave one of them in the file.")
    chosen = next(iter(bundles.values())) if bundles else alone
    tags = [_placed(tag if placed else {**DEFAULTS, **tag}) for tag in chosen]
    own = {"family": keys["family"]} if isinstance(keys.get("family"), str) else {}
    return {"tags": tags, TRANSFORM: isinstance(listed, dict) and any(TRANSFORM in tag for tag in chosen), **own}


def _placed(tag: Keys) -> Keys:
    """Tag whose place is by the keys of ROS 1, or by roll, pitch and yaw."""
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
    """Bundles of ROS 1 with their tags, by name, from a list whose entries have a name and a layout."""
    for i, bundle in enumerate(mappings("tag_bundles", listed)):
        if bundle.get("layout"):
            yield str(bundle.get("name", f"without a name, number {i}")), mappings("layout", bundle["layout"])


def _named(bundles: Keys) -> Iterator[tuple[str, list[Keys]]]:
    """Bundles of ROS 2 with their tags, by name. Parameters have no lists of mappings, so tags are keys, too."""
    for name in bundles.get("bundle_names") or [name for name in bundles if isinstance(bundles[name], dict)]:
        bundle = mapping(str(name), bundles[name])
        tags = {str(key): value for key, value in mapping("layout", bundle.get("layout", bundle)).items()}
        ids = [number_of(number) for number in tags["ids"]]
        yield str(name), [{"id": number, **mapping(f"{name}.{number}", tags[str(number)])} for number in ids]


def tagslam(keys: Keys) -> list[Keys]:
    """Tags of the static bodies of TagSLAM; TagSLAM estimates the other bodies.

    Raises:
        InputError: no body with tags is static, or one has no pose.
    """
    named = [
        (name, mapping(str(name), body)) for entry in mappings("bodies", keys["bodies"]) for name, body in entry.items()
    ]
    with_tags = [(name, body) for name, body in named if body.get("tags") or body.get("board")]
    static = [(name, body) for name, body in with_tags if body.get("is_static")]
    if not static:
        raise InputError("no body with tags is static: a map is of tags on bodies with is_static: true and a pose.")
    found: list[Keys] = []
    for name, body in static:
        if not body.get("pose"):
            raise InputError(f"the body {name!r} has no pose: give it one, such as that which TagSLAM found.")
        pose = _tagslam_pose(mapping("pose", body["pose"]))
        found += [{**tag, TRANSFORM: (pose @ tag[TRANSFORM]).ravel().tolist()} for tag in _on_body(body)]
    return found


def _on_body(body: Keys) -> Iterator[Keys]:
    """Tags of a body in the body's frame: listed tags, or tags of a board, row by row from its corner."""
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
    """Transform `(4, 4)` of a position and a rotation vector; missing ones are zero."""
    parts = [pose.get(name) or dict.fromkeys("xyz", 0.0) for name in ("position", "rotation")]
    position, rotation = (np.array([number_at(mapping("pose", part), axis) for axis in "xyz"]) for part in parts)
    return pose_of(turn_by_vector("pose", rotation), position)
