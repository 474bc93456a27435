"""Readers of tag maps in YAML and JSON of several ecosystems.

A format differs from `lmd.formats.placed_tag` in the directions of a tag's axes, or in the origin.

Sources: `AprilTagFieldLayout` of WPILib; `Board::parse` and `example/tagslam.yaml` of TagSLAM; `Marker::corners_f_map`
of ptrmu/fiducial_vlam; `MarkerMap` of ArUco 3; `SE2Transform` of duckietown-world; `target_map.fbs` of frc971;
"AprilTag Map Specification" of Limelight.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.core.tables import read_table
from lmd.formats.placed_tag import (
    MM,
    Keys,
    PlacedTag,
    axes_of,
    edge_of,
    mapping,
    mappings,
    number_of,
    numbers,
    tag_of_corners,
    transform_of,
    turn_by_angles,
    turn_by_quaternion,
    turn_by_vector,
)
from lmd.geometry.frames import roll_pitch_yaw
from lmd.scene.edges import EDGE
from lmd.scene.families import family_named

METRES = 1  # aruco_bc_mInfoType of a map in metres
PIXELS = 0  # aruco_bc_mInfoType of a board in pixels
MOST_ROWS = 200  # greatest number of rows, and of columns, of a board of TagSLAM
INCH = 0.0254  # metres per inch
NODE = "ros__parameters"  # key above the parameters of a node of ROS 2
NODE_DEPTH = 4  # greatest number of namespaces above that key
# Keys of known maps, which identify the node with the tags among the nodes of a file.
MARKS = frozenset(
    {
        "tags",
        "field-tags",
        "fiducials",
        "target_poses",
        "tag_bundles",
        "standalone_tags",
        "bodies",
        "markers",
        "objects",
    }
    | {"aruco_bc_markers", "tag_locations", "reconstructed_tags", "marker_000", "landmarks", "tag"}
)
# Columns: axes of a format in the frame of a tag with x right, y up, z out.
OUT_RIGHT_UP = axes_of(("out", "right", "up"))  # WPILib
INTO = axes_of(("right", "down", "into"))  # frc971, as AprilTag 3
FACING_BACK = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # frc971: a tag looks along -y
# OpenCV rotates the pictures of AprilTag by half a turn, so its detections have the opposite up.
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def parameters_of(keys: Keys) -> Keys:
    """Parameters of the node with tags in a file of ROS 2; the keys themselves for any other file.

    Raises:
        InputError: several nodes have tags, or none of several nodes has tags.
    """
    nodes = [_nested(node) for node in _nodes(keys, NODE_DEPTH)]
    if len(nodes) > 1:
        nodes = [node for node in nodes if not MARKS.isdisjoint(node)] or nodes
    if len(nodes) > 1:
        raise InputError(f"it has {NODE} of {len(nodes)} nodes: leave those with the tags in the file.")
    return nodes[0] if nodes else keys


def _nested(parameters: Keys) -> dict[str, Any]:
    """Parameters as nested mappings; ROS 2 may also write `a.b` for `b` in the namespace `a`."""
    nested: dict[str, Any] = {}
    for name, value in parameters.items():
        *spaces, last = str(name).split(".")
        inner = nested
        for space in spaces:
            inner = inner.setdefault(space, {})
            if not isinstance(inner, dict):
                raise InputError(f"the parameter {name} is in {space}, which has a value of its own.")
        inner[last] = {**inner[last], **value} if isinstance(value, dict) and last in inner else value
    return nested


def _nodes(keys: Keys, depth: int) -> Iterable[Keys]:
    for key, value in keys.items():
        if key == NODE:
            yield mapping(NODE, value)
        elif depth and isinstance(value, dict):
            yield from _nodes(value, depth - 1)


def wpilib(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of WPILib's field layout."""
    name = "tags" if "tags" in keys else "field-tags"  # `field-tags` from 2027 on
    for tag in mappings(name, keys[name]):
        pose = mapping("pose", tag["pose"])
        turn = turn_by_quaternion(*numbers(_within(pose, "rotation", "quaternion"), "XYZW"))
        place = numbers(_within(pose, "translation"), "xyz")
        yield PlacedTag(number_of(tag["ID"]), place, turn @ OUT_RIGHT_UP.T)


def _within(keys: Keys, *path: str) -> Keys:
    """Mapping below nested keys."""
    for key in path:
        keys = mapping(key, keys[key])
    return keys


def own_json(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of the JSON that `lmd` writes."""
    family = family_named(keys["family"])
    for tag in mappings("tags", keys["tags"]):
        turn = turn_by_quaternion(*numbers(_within(tag, "quaternion"), "xyzw"))
        edge = real(EDGE, tag.get(EDGE, keys[EDGE]), above=0.0)
        place = np.array(vector("position", tag["position"], 3))
        yield PlacedTag(number_of(tag["id"]), place, turn, edge, family)


FIELD = ("fieldlength", "fieldwidth")  # keys with the size of the field in Limelight's maps, metres


def limelight(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of Limelight's map. The origin is a corner of the field, or its middle if the file lacks the field's
    size.
    """
    middle = np.array([real(name, keys.get(name, 0.0)) / 2.0 for name in FIELD])
    for tag in mappings("fiducials", keys["fiducials"]):
        number = number_of(tag["id"])
        place, axes = transform_of(number, tag["transform"])
        edge = edge_of("size", tag["size"], MM) if "size" in tag else None
        family = family_named(tag["family"]) if "family" in tag else None
        yield PlacedTag(number, place + np.array([*middle, 0.0]), axes @ OUT_RIGHT_UP.T, edge, family)


def frc971(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of frc971, by quaternions, or as in 2025 by angles, degrees, about the axes of a tag that looks along -y."""
    from scipy.spatial.transform import Rotation  # slow to load

    for tag in mappings("target_poses", keys["target_poses"]):
        if "w" in (turned := _within(tag, "orientation")):
            turn = turn_by_quaternion(*numbers(turned, "xyzw"))
        else:
            turn = FACING_BACK @ Rotation.from_euler("XYZ", numbers(turned, "xyz"), degrees=True).as_matrix()
        yield PlacedTag(number_of(tag["id"]), numbers(_within(tag, "position"), "xyz"), turn @ INTO)


def tagslam(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of the static bodies of TagSLAM; TagSLAM estimates the other bodies."""
    named = [
        (name, mapping(str(name), body)) for entry in mappings("bodies", keys["bodies"]) for name, body in entry.items()
    ]
    if not any(body.get("is_static") for _, body in named if body.get("tags") or body.get("board")):
        raise InputError("no body with tags is static: a map is of tags on bodies with is_static: true and a pose.")
    for name, body in named:
        own = list(_on_body(body)) if body.get("is_static") else []
        if own and not body.get("pose"):
            raise InputError(f"the body {name!r} has no pose: give it one, such as that which TagSLAM found.")
        if own:
            position, turn = _tagslam_pose(mapping("pose", body["pose"]))
            for tag in own:
                yield tag._replace(position=turn @ tag.position + position, axes=turn @ tag.axes)


def _on_body(body: Keys) -> Iterable[PlacedTag]:
    """Tags of a body in the body's frame: listed tags, or tags of a board, row by row from its corner."""
    for tag in mappings("tags", body.get("tags") or ()):
        position, turn = _tagslam_pose(mapping("pose", tag.get("pose") or {}))
        size = edge_of("size", tag.get("size", body.get("default_tag_size")))
        yield PlacedTag(number_of(tag["id"]), position, turn, size)
    if body.get("board"):
        board = mapping("board", body["board"])
        size = edge_of("tag_size", board["tag_size"])
        pitch = size * (1.0 + real("tag_spacing", board["tag_spacing"]))
        rows, columns = (integer(name, board[name], low=1, high=MOST_ROWS) for name in ("tag_rows", "tag_columns"))
        for k in range(rows * columns):
            centre = pitch * np.array([k % columns, k // columns, 0.0])
            yield PlacedTag(number_of(board["tag_start_id"]) + k, centre, np.eye(3), size)


def _tagslam_pose(pose: Keys) -> tuple[FloatArray, FloatArray]:
    """Position and rotation vector of a pose; missing values are zero."""
    position, rotation = (
        numbers(mapping(key, pose.get(key) or dict.fromkeys("xyz", 0.0)), "xyz") for key in ("position", "rotation")
    )
    return position, turn_by_vector("pose", rotation)


def fiducial_vlam(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of fiducial_vlam, by roll, pitch, yaw or by a quaternion."""
    edge = edge_of("marker_length", keys["marker_length"])
    for tag in mappings("markers", keys["markers"]):
        number = number_of(tag["id"])
        if "q" in tag:  # older files have quaternions
            position, turn = tag["t"], turn_by_quaternion(*vector("q", tag["q"], 4))
        else:
            position, turn = tag["xyz"], turn_by_angles(number, *vector("rpy", tag["rpy"], 3))
        yield PlacedTag(number, np.array(vector("xyz", position, 3)), turn, edge)


def aruco(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of a marker map of ArUco, by their corners."""
    kind = keys.get("aruco_bc_mInfoType", METRES)
    if kind != METRES:
        board = "; a board in pixels has no places in a room" if kind == PIXELS else ""
        raise InputError(f"aruco_bc_mInfoType must be {METRES}, metres, got {str(kind)[:80]}{board}.")
    family = family_named(keys["aruco_bc_dict"]) if "aruco_bc_dict" in keys else None
    for tag in mappings("aruco_bc_markers", keys["aruco_bc_markers"]):
        number = number_of(tag["id"])
        corners = np.array([vector("corners", corner, 3) for corner in tag["corners"]])
        yield tag_of_corners(number, corners, family)


def duckietown(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of Duckietown's map that lie on the floor; tags of traffic signs are left out, as the map has no heights."""
    for name, value in mapping("objects", keys["objects"]).items():
        thing = mapping(str(name), value)
        if thing.get("kind") != "floor_tag":
            continue
        tag, pose = _within(thing, "tag", "~TagInstance"), _within(thing, "pose", "~SE2Transform")
        number, (x, y) = number_of(tag["tag_id"]), vector("p", pose["p"], 2)
        if "theta_deg" in pose:
            turn = roll_pitch_yaw([0.0, 0.0, np.radians(real("theta_deg", pose["theta_deg"]))])
        else:
            turn = turn_by_angles(number, 0.0, 0.0, real("theta", pose.get("theta", 0.0)))
        edge, family = edge_of("size", tag["size"]), family_named(tag["family"]) if "family" in tag else None
        yield PlacedTag(number, np.array([x, y, 0.0]), turn, edge, family)


def corner_note(path: Any, keys: Keys) -> str:
    """Note on the corner that is the origin, for a file of Limelight with the size of the field."""
    if not any(keys.get(name) for name in FIELD):
        return ""
    return (
        f"{path}: places are counted from the corner of its field, half of {' and '.join(FIELD)} away from its origin"
    )


def wpilib_drawing(path: Any, name: str) -> list[PlacedTag]:
    """Tags of a table from WPILib's drawings of a field: inches, and degrees about z and then about y."""
    table = read_table(path, name=name)
    rows = table.numbers(tuple(table.texts)[:6])
    found = []
    for number, x, y, z, yaw, pitch in np.pad(rows, ((0, 0), (0, 6 - rows.shape[1]))).tolist():
        turn = roll_pitch_yaw(np.radians([0.0, pitch, yaw]))
        found.append(PlacedTag(number_of(number), INCH * np.array([x, y, z]), turn @ OUT_RIGHT_UP.T))
    return found
