"""Tags and bundles of apriltag_ros for ROS 1, and of its ports to ROS 2.

The frame of a tag has x to the right, y up, z along the normal, as in `TagDetector::addObjectPoints` and `pnp_bundle`.

Sources: `TagDetector::parseTagBundles` of AprilRobotics/apriltag_ros and of its port to ROS 2 (pull request 158);
pull requests 59 and 60 of christianrauch/apriltag_ros, `pnp_bundle` and `AprilTagNode`.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from lmd.core.checks import InputError, vector
from lmd.formats.placed_tag import (
    Keys,
    PlacedTag,
    edge_of,
    mapping,
    mappings,
    number_of,
    numbers,
    turn_by_angles,
    turn_by_quaternion,
)
from lmd.scene.families import family_named

PLACE, QUATERNION = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
# Default values of a layout, as in TagDetector.
DEFAULTS = {**dict.fromkeys((*PLACE, *QUATERNION), 0.0), "qw": 1.0}
BY_QUATERNION, BY_ANGLES = 7, 6  # number of values of a transform: x, y, z and qw, qx, qy, qz, or roll, pitch, yaw
NAMES, IDS, LAYOUT, TRANSFORM = "bundle_names", "ids", "layout", "transform"


def apriltag_ros(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of the bundle, whose frame is the world; or standalone tags with positions in the world."""
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
    family = family_named(keys["family"]) if isinstance(keys.get("family"), str) else None
    for tag in next(iter(bundles.values())) if bundles else alone:
        yield _placed(tag if placed else {**DEFAULTS, **tag})._replace(family=family)


def _placed(tag: Keys) -> PlacedTag:
    number, edge = number_of(tag["id"]), edge_of("size", tag["size"])
    if TRANSFORM not in tag:
        values = numbers(tag, (*PLACE, *QUATERNION))
        return PlacedTag(number, values[:3], turn_by_quaternion(*values[3:]), edge)
    values = np.array(vector(TRANSFORM, tag[TRANSFORM], None))
    if len(values) == BY_QUATERNION:
        w, x, y, z = values[3:].tolist()
        axes = turn_by_quaternion(x, y, z, w)
    elif len(values) == BY_ANGLES:
        axes = turn_by_angles(number, *values[3:].tolist())
    else:
        raise InputError(
            f"tag {number}: its transform must be x, y, z, qw, qx, qy, qz, or x, y, z, roll, pitch, yaw, it has "
            f"{len(values)} values."
        )
    return PlacedTag(number, values[:3], axes, edge)


def _listed(listed: Any) -> Iterable[tuple[str, list[Keys]]]:
    """Bundles of ROS 1 with their tags, by name, from a list whose entries have a name and a layout."""
    for i, bundle in enumerate(mappings("tag_bundles", listed)):
        if bundle.get(LAYOUT):
            yield str(bundle.get("name", f"without a name, number {i}")), mappings(LAYOUT, bundle[LAYOUT])


def _named(bundles: Keys) -> Iterable[tuple[str, list[Keys]]]:
    """Bundles of ROS 2 with their tags, by name. Parameters have no lists of mappings, so tags are keys, too."""
    for name in bundles[NAMES] if NAMES in bundles else [name for name in bundles if isinstance(bundles[name], dict)]:
        bundle = mapping(str(name), bundles[name])
        tags = {str(key): value for key, value in mapping(LAYOUT, bundle.get(LAYOUT, bundle)).items()}
        ids = [number_of(number) for number in tags[IDS]]
        yield str(name), [{"id": number, **mapping(f"{name}.{number}", tags[str(number)])} for number in ids]


def bundle_note(path: Any, keys: Keys) -> str:
    """Note on the assumed order of the values of a `transform`; empty without a `transform`."""
    bundles = keys.get("tag_bundles")
    if not isinstance(bundles, dict) or f"'{TRANSFORM}'" not in str(bundles):
        return ""
    return (
        f"{path}: a transform is read as x y z qw qx qy qz, and one of six values as x y z roll pitch yaw, as "
        "apriltag_ros has it since its pull request 59"
    )
