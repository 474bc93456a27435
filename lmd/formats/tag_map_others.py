"""Formats of maps that are recognised and not read, and the way from each to one that is."""

import re
from collections.abc import Mapping
from typing import Any

# Marks of a format in YAML or JSON: keys, and why it is not read.
BY_KEYS: tuple[tuple[frozenset[str], str], ...] = (
    (frozenset({"tag_locations"}), "it is a map of pytagmapper"),
    (frozenset({"reconstructed_tags"}), "it is a reconstruction of Visual Marker Mapping"),
    (frozenset({"general", "marker_000"}), "it has the parameters of ZED's ArUco localisation"),
    (
        frozenset({"family", "size", "tag"}),
        "it has the parameters of apriltag_ros for ROS 2, which name tags and have no places",
    ),
    (frozenset({"landmarks"}), "its landmarks do not say which way the frame of a tag points"),
)
# The same of a text that begins so.
BY_TEXT: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"\s*(PARAMS_SE\dOFFSET|VERTEX_|EDGE_)"), "it is a graph of g2o, in which tags and poses are alike"),
    (re.compile(r"\s*marker_id,\s*vert_0_x"), "it is a head pose model of Pupil, which has no metres"),
    (re.compile(r"\s*-\s+(name|first_id|markers_x)\s*:"), "it lists boards of aruco_opencv, which have no places"),
    (re.compile(r"\s*(\[|-\s)"), "it is a list without keys"),
    (re.compile(r"\s*<"), "it is XML"),
)
TABLE = (
    "write its tags as a table: a header id,x,y,z,qx,qy,qz,qw,edge, or with roll,pitch,yaw for the quaternion, metres "
    "and radians, and axes for where the frame of a tag points (docs/mounting.md)"
)


def why_not_read(text: str) -> str | None:
    """Why a text of a format that is recognised is not read, and what is; None for other texts."""
    for begins, reason in BY_TEXT:
        if begins.match(text):
            return f"{reason}; {TABLE}."
    return None


def why_keys_not_read(keys: Mapping[str, Any], known: str) -> str:
    """Why the keys of a file are read by no reader, and what is.

    Args:
        known: names of the formats that are read.
    """
    for marks, reason in BY_KEYS:
        if marks <= keys.keys():
            return f"{reason}; {TABLE}."
    return f"it is no tag map that is known here ({known}): it has {', '.join(keys)[:200]}; {TABLE}."
