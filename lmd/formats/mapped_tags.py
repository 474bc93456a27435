"""Readers of maps by programs for mapping and localisation, in JSON and YAML.

Sources: `ReconstructedTag` and `exportReconstructions` of schmidtniko/visual_marker_mapping; `map_lift_3d`,
`get_corners_mat` and `xytz_to_SE3` of markisus/pytagmapper; `ZedArucoLoc` of stereolabs/zed-ros2-examples.
"""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from lmd.core.checks import InputError, real, vector
from lmd.formats.placed_tag import (
    Keys,
    PlacedTag,
    axes_of,
    edge_of,
    mapping,
    mappings,
    number_of,
    transform_of,
    turn_by_angles,
    turn_by_quaternion,
)
from lmd.scene.families import family_named

# Frame of a marker in the ZED's localisation: img2aruco and ros2img of `initTFs`.
OUT_RIGHT_UP = axes_of(("out", "right", "up"))
PLANAR, LIFTED, SPATIAL = "2d", "2.5d", "3d"  # kinds of maps of pytagmapper
VALUES = {PLANAR: ("x", "y", "yaw"), LIFTED: ("x", "y", "yaw", "z")}
DEFAULT = "default"  # key of the size of tags without their own size
MARKER = re.compile(r"marker_\d+")


def visual_marker_mapping(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of a reconstruction by Visual Marker Mapping; values are texts, the quaternion begins with w, and y is
    up.
    """
    for tag in mappings("reconstructed_tags", keys["reconstructed_tags"]):
        number = number_of(_number("id", tag["id"]))
        width, height = (_number(name, tag[name]) for name in ("width", "height"))
        if width != height:
            raise InputError(f"tag {number}: width = {width:g} and height = {height:g} must be equal.")
        w, x, y, z = vector("rotation", [_number("rotation", value) for value in tag["rotation"]], 4)
        place = np.array(vector("translation", [_number("translation", value) for value in tag["translation"]], 3))
        family = family_named(tag["type"]) if "type" in tag else None
        yield PlacedTag(number, place, turn_by_quaternion(x, y, z, w), edge_of("width", width), family)


def _number(name: str, value: Any) -> float:
    """Number that may be written as a text."""
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            raise InputError(f"{name} must be a number, got {value[:80]!r}.") from None
    return real(name, value)


def pytagmapper(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of a map of pytagmapper: 3-D transforms, or positions and rotations about z of tags that lie face up."""
    sizes = mapping("tag_side_lengths", keys.get("tag_side_lengths", {DEFAULT: keys.get("tag_side_length")}))
    for name, value in mapping("tag_locations", keys["tag_locations"]).items():
        number = number_of(_number("id", str(name)))
        size = sizes.get(str(name), sizes.get(DEFAULT))
        edge = None if size is None else edge_of("tag_side_length", size)
        kind = keys.get("map_type") or _kind_of(value)
        if kind == SPATIAL:
            place, turn = transform_of(number, np.ravel(value).tolist())
        elif kind in VALUES:
            pose = dict(zip(VALUES[kind], vector(f"tag_locations.{name}", value, len(VALUES[kind])), strict=True))
            place = np.array([pose["x"], pose["y"], pose.get("z", 0.0)])
            turn = turn_by_angles(number, 0.0, 0.0, pose["yaw"])
        else:
            raise InputError(f"map_type must be {PLANAR}, {LIFTED} or {SPATIAL}, got {kind!r}.")
        yield PlacedTag(number, place, turn, edge)


def _kind_of(value: Any) -> str:
    """Kind of a map that older versions of pytagmapper wrote, from the shape of a location."""
    if np.ndim(value) == 2:
        return SPATIAL
    return LIFTED if len(value) == len(VALUES[LIFTED]) else PLANAR


def zed(keys: Keys) -> Iterable[PlacedTag]:
    """Markers of the ZED's localisation, of which the first `marker_count` are used; x points out of a marker, y right,
    z up.
    """
    general = mapping("general", keys["general"])
    edge = edge_of("general.marker_size", general["marker_size"])
    count = real("general.marker_count", general.get("marker_count", np.inf), low=0.0, infinite=True)
    for name in sorted(name for name in keys if MARKER.fullmatch(name)):
        if int(name.split("_")[1]) >= count:
            continue
        marker = mapping(name, keys[name])
        number = number_of(marker["aruco_id"])
        turn = turn_by_angles(number, *vector(f"{name}.orientation", marker["orientation"], 3))
        place = np.array(vector(f"{name}.position", marker["position"], 3))
        yield PlacedTag(number, place, turn @ OUT_RIGHT_UP.T, edge)
