"""Tags in a Lanelet2 map of Autoware: ways of the type `pose_marker`, whose corners are nodes in metres.

The corners are counter-clockwise for a viewer in front of the tag. The tag's x axis (right) points from the first to
the second corner, the y axis (up) from the second to the third.

Sources: "Map specifications" of Autoware's ar_tag_based_localizer, `LandmarkManager::parse_landmarks`.
"""

from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.formats.placed_tag import PlacedTag, number_of, tag_of_corners
from lmd.scene.families import family_named

TYPE = "pose_marker"
PLACE = ("local_x", "local_y", "ele")  # coordinates in the frame of the map, metres


def autoware(root: Element) -> Iterable[PlacedTag]:
    """Tags of the ways of a map.

    Raises:
        InputError: the map has no tag, or a corner has no coordinates.
    """
    nodes = {node.get("id"): node for node in root.iter("node")}
    ways = [way for way in root.iter("way") if _tags(way).get("type") == TYPE]
    if not ways:
        raise InputError(f"it is a map of OpenStreetMap's kind without a way of the type {TYPE}, so without tags.")
    for way in ways:
        tags, name = _tags(way), f"the way {way.get('id')}"
        if not (marker := tags.get("marker_id", "")).isdecimal():
            raise InputError(f"{name}: marker_id must be the number of its tag, got {marker[:80]!r}.")
        references = [reference.get("ref") for reference in way.iter("nd")]
        if len(references) == 5 and references[0] == references[-1]:
            references.pop()
        if len(references) != 4:
            raise InputError(f"{name} must have four corners, it has {len(references)}.")
        corners = np.array([_place(name, reference, nodes.get(reference)) for reference in references])
        yield tag_of_corners(number_of(int(marker)), corners[::-1], family_named(tags.get("subtype", "")))


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}


def _place(name: str, reference: str | None, node: Element | None) -> FloatArray:
    if node is None:
        raise InputError(f"{name}: the node {reference} of a corner is missing.")
    tags = _tags(node)
    try:
        place = np.array([float(tags[key]) for key in PLACE])
    except (KeyError, ValueError):
        raise InputError(
            f"{name}: its node {reference} must have local_x, local_y and ele, metres; latitude and longitude are not "
            "read."
        ) from None
    if not np.isfinite(place).all():
        raise InputError(f"{name}: its node {reference} has a coordinate that is not finite.")
    return place
