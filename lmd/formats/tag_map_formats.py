"""Formats of tag maps, in the order in which they are tried.

The format of a file follows from its content. `lmd.formats.tag_map_readers`, `tag_bundles` and `mapped_tags` read maps
in YAML and JSON, `lanelet_maps` and `gazebo_tags` maps in XML, `tag_map_texts` and `pose_graphs` texts, and
`landmark_table` the simple table.
"""

import re
from collections.abc import Callable, Iterable
from typing import Any

from lmd.formats import mapped_tags, tag_bundles
from lmd.formats import tag_map_readers as readers
from lmd.formats.placed_tag import Found, Keys, PlacedTag
from lmd.formats.registry import File, Format, anything, has_keys
from lmd.formats.ros2_tf import TAGS_OF_LAUNCH, read_launch
from lmd.formats.tag_map_writers import WRITERS
from lmd.formats.tag_tables import PRIORS, is_list, listed, read_tag_text
from lmd.scene.edges import EDGE

IS_NUMBER = re.compile(r"\s*[-+.\d]")
# Headers of WPILib's drawings; these columns under other names may be in any unit.
WPILIB_HEADERS = tuple(
    f"ID,X,Y,Z,{rotations}" for rotations in ("Rotation", "Z-Rotation,X-Rotation", "Z-Rotation,Y-Rotation")
)
# Refused formats in YAML or JSON: keys, and the reason.
BY_KEYS: tuple[tuple[set[str], str], ...] = (
    ({"family", "size", "tag"}, "it has the parameters of apriltag_ros for ROS 2, which name tags and have no places"),
)
# Refused formats of texts: pattern at the beginning, and the reason.
BY_TEXT: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"\s*marker_id,\s*vert_0_x"), "it is a head pose model of Pupil, which has no metres"),
    (re.compile(r"\s*-\s+(name|first_id|markers_x)\s*:"), "it lists boards of aruco_opencv, which have no places"),
    (re.compile(r"\s*(\[|-\s)"), "it is a list without keys"),
)
GRAPH = re.compile(r"\s*(PARAMS_SE\dOFFSET|VERTEX_|EDGE_)")
OSM, GAZEBO = "osm", ("sdf", "gazebo", "world", "model")  # outermost elements of XML
TABLE = (
    "write its tags as a table: a header id,x,y,z,qx,qy,qz,qw,edge, or with roll,pitch,yaw for the quaternion, metres "
    "and radians, and axes for where the frame of a tag points (docs/mounting.md)"
)


def _row(written: str, cells: str) -> str:
    """Row of the table in the documentation.

    Args:
        written: name in `formats`.
        cells: program; content of the written file; content that is read.
    """
    writer, (program, file, is_read) = WRITERS[written], cells.split(" | ")
    return f"{program} | `{written}`{' *' if writer.only_apriltag else ''} | `{writer.file}`{file} | {is_read}"


def _keyed(
    name: str,
    reader: Callable[[Keys], Iterable[PlacedTag]],
    *keys: str,
    row: str = "",
    by_opencv: bool = False,
    note: Callable[[Any, Keys], str] = lambda _path, _keys: "",
) -> Format:
    """Format of YAML or JSON that is recognised by keys that no other format has.

    Args:
        note: function of the path and the keys that returns a sentence about an assumption; empty without an
            assumption.
    """

    def read_keyed(file: File) -> Found:
        return Found(list(reader(file.keys)), None, by_opencv, note(file.path, file.keys))

    return Format("tag map", name, has_keys(*keys), read_keyed, row=row)


def _refused(recognises: Callable[[Any], bool], reason: str) -> Format:
    return Format("tag map", "of another program", recognises, why_not=f"{reason}; {TABLE}")


def _first(begins: re.Pattern[str]) -> Callable[[File], bool]:
    """Make a test for texts whose first line begins with a pattern."""
    return lambda file: begins.match(file.first) is not None


LIST = Format(
    "tag map",
    "a list of tags",
    lambda file: is_list(file.keys),
    listed,
    row="a list `landmarks`, `markers` or `tags` | | not written | `id`, `position`, `orientation` as in "
    "[a table](#a-table-of-your-own), `size`",
)
KEYED = (
    _keyed("lmd", readers.own_json, "tags", "family", EDGE),
    _keyed(
        "fiducial_vlam",
        readers.fiducial_vlam,
        "markers",
        "marker_length",
        row=_row("fiducial_vlam", "fiducial_vlam | : all tags stay where they are | yes, `marker_length`"),
        by_opencv=True,
    ),
    LIST,
    _keyed(
        "WPILib",
        readers.wpilib,
        "tags",
        row=_row(
            "wpilib",
            "WPILib, PhotonVision | , the field layout | yes; also its drawings, a CSV in inches and degrees with"
            " the header `ID,X,Y,Z,Rotation` or `ID,X,Y,Z,Z-Rotation,X-Rotation`",
        ),
    ),
    _keyed("WPILib", readers.wpilib, "field-tags"),
    _keyed(
        "Limelight",
        readers.limelight,
        "fiducials",
        row=_row("limelight", "Limelight | , the field map | yes, `size`; transforms row by row"),
        note=readers.corner_note,
    ),
    _keyed(
        "frc971",
        readers.frc971,
        "target_poses",
        row=_row("frc971", "frc971 | , the target map | yes; a quaternion, or degrees as in 2025"),
    ),
    _keyed(
        "apriltag_ros",
        tag_bundles.apriltag_ros,
        "tag_bundles",
        row=_row(
            "apriltag_ros",
            "AprilRobotics/apriltag_ros (ROS 1) | : one bundle called `room` | the only one of `tag_bundles`, or "
            "`standalone_tags` with `x` ... `qw`; `size`",
        ),
        note=tag_bundles.bundle_note,
    ),
    _keyed("apriltag_ros", tag_bundles.apriltag_ros, "standalone_tags"),
    _keyed(
        "TagSLAM",
        readers.tagslam,
        "bodies",
        row=_row(
            "tagslam",
            "TagSLAM | : the room as a static body; the camera's body comes from you | static bodies with a "
            "`pose`: their `tags`, or a `board`; `size`, `default_tag_size`",
        ),
    ),
    _keyed(
        "ArUco",
        readers.aruco,
        "aruco_bc_markers",
        row=_row("aruco", "ArUco library | : marker map in metres | yes, by the corners"),
    ),
    _keyed(
        "Duckietown",
        readers.duckietown,
        "objects",
        row=_row(
            "duckietown",
            "Duckietown | : tags on the floor, for the `objects` of the city's map | `objects` of the kind "
            "`floor_tag`, `size`",
        ),
    ),
    _keyed(
        "Visual Marker Mapping",
        mapped_tags.visual_marker_mapping,
        "reconstructed_tags",
        row="Visual Marker Mapping | | not written | `reconstruction.json`, `width`",
    ),
    _keyed(
        "pytagmapper",
        mapped_tags.pytagmapper,
        "tag_locations",
        row="pytagmapper | | not written | `map.json`, 2d, 2.5d and 3d, `tag_side_lengths`",
        by_opencv=True,
    ),
    _keyed(
        "ZED",
        mapped_tags.zed,
        "general",
        "marker_000",
        row="ZED's ArUco localisation | | not written | `aruco_loc.yaml`, `marker_size`",
        by_opencv=True,
    ),
)
KNOWN = ", ".join(dict.fromkeys(form.name for form in KEYED))


def _root(*names: str) -> Callable[[Any], bool]:
    """Make a test for XML whose outermost element has one of the given names."""
    return lambda file: file.root is not None and file.root.tag in names


def _xml_reason(file: Any) -> str:
    return f"it is XML with the element {file.root.tag[:80]}, and Gazebo's sdf and Lanelet2's osm are read; {TABLE}"


FORMATS = (
    Format(
        "tag map",
        "RTAB-Map",
        lambda file: PRIORS.search(file.text) is not None or "|" in file.first,
        read_tag_text,
        row=_row(
            "rtabmap",
            "RTAB-Map | : the value of `Marker/Priors` | `id x y z roll pitch yaw`, alone or in its `.ini` "
            "(`Marker/Length`); its exported poses with a negative id",
        ),
    ),
    Format(
        "tag map",
        "launch file",
        lambda file: TAGS_OF_LAUNCH.search(file.text) is not None,
        lambda file: Found(list(read_launch(file.text))),
        row=_row("ros2_tf", "ROS 2, tf2 | : a static transform for each tag, `ros2 launch` runs it | yes; no size"),
    ),
    Format("tag map", "XML", lambda file: file.root is not None, why_not=_xml_reason),
    *(_refused(_first(begins), reason) for begins, reason in BY_TEXT),
    *KEYED,
    *(_refused(has_keys(*marks), reason) for marks, reason in BY_KEYS),
    Format(
        "tag map",
        "unknown keys",
        lambda file: file.has_keys,
        why_not=lambda file: (
            f"it is no tag map that is known here ({KNOWN}): it has {', '.join(file.keys)[:200]}; {TABLE}"
        ),
        row=_row(
            "apriltag_ros2", "christianrauch/apriltag_ros (ROS 2) | : parameters of the node, without places | no"
        ),
    ),
    Format(
        "tag map",
        "table",
        anything,
        read_tag_text,
        row=(
            "your own | `csv`, `json` | `tags.csv`, `tags.json`: poses as quaternions, and corners | yes, `edge`; or "
            "[a table](#a-table-of-your-own)\n"
            + _row("clover", "Clover | : `aruco_map` | `columns=clover` (`id length x y z yaw pitch roll`), `length`")
            + "\nfiducial_slam | | not written | what it saves, with `columns=fiducial_slam`"
        ),
    ),
)
