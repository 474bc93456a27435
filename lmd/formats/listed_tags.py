"""Hand-written lists of tags in YAML or JSON: a list `landmarks`, `markers` or `tags`, or a mapping by number or name.

A tag has an id, a position and an orientation, under one of the names in this module. The list does not define the axes
of a tag's frame; the user may define them. The four values of a quaternion must be named, so that w is known. A
rotation vector has the direction of its axis, and its angle as length.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, vector
from lmd.formats.placed_tag import (
    Keys,
    PlacedTag,
    edge_of,
    mapping,
    number_of,
    one_family,
    tag_named,
    turn_by_angles,
    turn_by_quaternion,
    turn_by_vector,
)
from lmd.scene.families import family_named

LIMELIGHT, PYTAGMAPPER = "fiducials", "tag_locations"  # lists that other formats have, too
LISTS = ("landmarks", "markers", "tags", "apriltags", "aruco_markers", PYTAGMAPPER, LIMELIGHT)
IDS = ("id", "tag_id", "marker_id", "aruco_id", "apriltag_id", "number", "tag", "marker", "name", "frame_id")
POSITIONS = ("position", "position_m", "translation", "xyz", "pos", "location", "translation_vector", "tvec")
VECTORS = ("rotation_vector", "rvec", "rodrigues")
ANGLES = ("orientation", "rotation", "rpy", "orientation_rpy", "rotation_rpy", "euler", "angles")
QUATERNIONS = ("quaternion", "orientation", "rotation", "q")
ORDERED = {f"{name}_{order}": order for name in QUATERNIONS for order in ("xyzw", "wxyz")}
SIZES = ("size", "tag_size", "marker_size", "tag_size_m", "marker_length", "size_m", "edge")
FAMILIES = ("family", "tag_family", "dictionary", "dict")
PLACE, TURN, QUATERNION = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("qx", "qy", "qz", "qw")


def is_list(keys: Keys) -> bool:
    """True for keys with a list of tags, each with an id, or a mapping of tags by their numbers."""
    return _list_of(keys) is not None


def listed(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of a list.

    Raises:
        InputError: a tag lacks its position or its orientation, or a value is refused.
    """
    name = _list_of(keys)
    assert name is not None
    common = {key: value for key, value in keys.items() if not isinstance(value, dict | list)}
    entries = keys[name].items() if isinstance(keys[name], dict) else enumerate(keys[name])
    for key, entry in entries:
        at = f"{name}[{key}]"
        if isinstance(entry, list):
            lacks = "has no orientation" if len(entry) == len(PLACE) else "has values without names"
            told = "{position: [x, y, z], orientation: [roll, pitch, yaw]}, metres and radians"
            raise InputError(f"{at} {lacks}: a tag needs {told}.")
        tag = mapping(at, entry)
        own, number = _named(at, key if isinstance(keys[name], dict) else _first(tag, IDS))
        pose = {**tag, **mapping(f"{at}.pose", tag["pose"])} if isinstance(tag.get("pose"), dict) else tag
        size, family = _first({**common, **tag}, SIZES), _first({**common, **tag}, FAMILIES)
        edge = None if size is None else edge_of(f"{at}: size", size)
        named = one_family((own, None if family is None else family_named(family)))
        yield PlacedTag(number, _place(at, pose), _turn(at, number, pose), edge, named)


def _list_of(keys: Keys) -> str | None:
    for name in LISTS:
        value = keys.get(name)
        if isinstance(value, dict) and value:
            kinds = dict if name == PYTAGMAPPER else (dict, list)
            if all(isinstance(one, kinds) for one in value.values()):
                return name
        elif isinstance(value, list) and value:
            named = all(isinstance(one, dict) and _first(one, IDS) is not None for one in value)
            if named and not (name == LIMELIGHT and "transform" in value[0]):
                return name
    return None


def _named(at: str, value: Any) -> tuple[str | None, int]:
    """Family, None if unknown, and number of a tag."""
    if not isinstance(value, str):
        return None, number_of(value)
    if (named := tag_named(value)) is None:
        raise InputError(f"{at}: the name {value!r} has no number of a tag, as 7, tag_7 or tag36h11:7 have.")
    return named


def _first(keys: Keys, names: Iterable[str]) -> Any:
    """Value of the first of `names` that has a value; None if there is none."""
    return next((keys[name] for name in names if keys.get(name) is not None), None)


def _together(at: str, keys: Keys, names: Iterable[str]) -> FloatArray | None:
    """Values of all `names`; None if a key is missing."""
    values = [keys.get(name) for name in names]
    return None if None in values else np.array(vector(f"{at}: {', '.join(names)}", values, len(values)))


def _place(at: str, pose: Keys) -> FloatArray:
    value = _first(pose, POSITIONS)
    if isinstance(value, dict):
        pose, value = value, None
    place = _together(at, pose, PLACE) if value is None else np.array(vector(f"{at}: position", value, 3))
    if place is None:
        raise InputError(f"{at} has no position of x, y and z, metres; it has {', '.join(map(str, pose))[:200]}.")
    return place


def _turn(at: str, number: int, pose: Keys) -> FloatArray:
    """Rotation matrix of a tag, from a quaternion or from roll, pitch and yaw."""
    for name, order in ORDERED.items():
        if pose.get(name) is not None:
            values = dict(zip(order, vector(f"{at}: {name}", pose[name], 4), strict=True))
            return turn_by_quaternion(*(values[axis] for axis in "xyzw"))
    if (rotation := _first(pose, VECTORS)) is not None:
        return turn_by_vector(f"tag {number}", np.array(vector(f"{at}: rotation vector", rotation, 3)))
    value = _first(pose, (*ANGLES, *QUATERNIONS))
    inner = value if isinstance(value, dict) else pose
    for names in ((*"xyzw",), QUATERNION) if isinstance(value, dict) else (QUATERNION,):
        if (quaternion := _together(at, inner, names)) is not None:
            return turn_by_quaternion(*quaternion.tolist())
    if value is None or isinstance(value, dict):
        angles = _together(at, inner, TURN)
        if angles is None:
            raise InputError(
                f"{at} has no orientation: it needs roll, pitch and yaw, rad, or qx, qy, qz and qw; it has "
                f"{', '.join(map(str, inner))[:200]}."
            )
        return turn_by_angles(number, *angles.tolist())
    turn = vector(f"{at}: orientation", value, None)
    if len(turn) != 3:
        raise InputError(
            f"{at}: its orientation must be roll, pitch, yaw, rad, or a quaternion whose name says where w is, such as "
            f"quaternion_xyzw; it has {len(turn)} values."
        )
    return turn_by_angles(number, *turn)
