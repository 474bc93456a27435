"""Tag maps of several ecosystems, read as deployments; `lmd.export` writes them.

Which format a file has follows from its content: `lmd.formats.tag_map_readers` has those in YAML and JSON,
`lmd.formats.tag_map_texts` the texts, `lmd.formats.landmark_table` the table for all others.

Source: `convert_apriltag_layouts.py` of WPILib.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.formats import tag_map_readers as readers
from lmd.formats.landmark_table import families_of, headed_table, is_by_normals, renamed, turned_deployment
from lmd.formats.placed_tag import Found, Keys, PlacedTag, check_family, one_family
from lmd.formats.registry import File, Format, anything, has_keys, read
from lmd.formats.tag_map_texts import PRIORS, read_lines, read_priors
from lmd.formats.tag_map_writers import WRITERS
from lmd.scene.deployment import Deployment
from lmd.scene.edges import EDGE
from lmd.scene.families import FAMILIES
from lmd.scene.labels import Labels

LARGEST_MAP = 1 << 22  # characters of YAML or JSON; a tag has some hundred
EDGE_DIGITS = 12  # the rest is rounding: of millimetres as metres, or of the sides of a square
IS_JSON = re.compile(r"(\s|//[^\n]*\n|/\*.*?\*/)*{", re.DOTALL)  # comments may come first
IS_YAML = re.compile(r"%YAML|---|\s*['\"]?[\w/*]+['\"]?\s*:")
IS_NUMBER = re.compile(r"\s*[-+.\d]")
# The headers of WPILib's drawings; the same columns under other names may be in any unit.
WPILIB_HEADERS = tuple(
    f"ID,X,Y,Z,{rotations}" for rotations in ("Rotation", "Z-Rotation,X-Rotation", "Z-Rotation,Y-Rotation")
)
# Marks of a format in YAML or JSON: keys, and why it is not read.
BY_KEYS: tuple[tuple[set[str], str], ...] = (
    ({"tag_locations"}, "it is a map of pytagmapper"),
    ({"reconstructed_tags"}, "it is a reconstruction of Visual Marker Mapping"),
    ({"general", "marker_000"}, "it has the parameters of ZED's ArUco localisation"),
    ({"family", "size", "tag"}, "it has the parameters of apriltag_ros for ROS 2, which name tags and have no places"),
    ({"landmarks"}, "its landmarks do not say which way the frame of a tag points"),
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


class TagMapFile(File):
    """A tag map; a text that is neither YAML nor JSON has no keys."""

    @cached_property
    def has_keys(self) -> bool:
        """True for YAML and JSON."""
        return bool(IS_JSON.match(self.text) or IS_YAML.match(self.first))

    @cached_property
    def keys(self) -> Keys:
        """The keys, without those of a node of ROS 2 around them.

        Raises:
            InputError: the text begins as YAML or JSON and is neither, or it is too long.
        """
        if not self.has_keys:
            return {}
        if len(self.text) > LARGEST_MAP:
            raise InputError(f"a map has at most {LARGEST_MAP} characters, it has {len(self.text)}.")
        return readers.parameters_of(super().keys)


def read_deployment(
    path: Any, name: str = "path", family: str | None = None, axes: Sequence[str] | None = None
) -> Deployment:
    """The tags of a map, or the landmarks of a table, see `lmd.formats.landmark_table`.

    Maps that say how large each tag is give `Deployment.edges`.

    Args:
        name: the argument the path came from, for messages.
        family: of the tags, which a file must not contradict, and by which OpenCV has another up; None for points.
        axes: where the axes of the frame of a tag point in a table, see `lmd.formats.placed_tag.axes_of`.

    Raises:
        InputError: the file cannot be read, is no map with the places of tags, or one of another family.
    """
    file = TagMapFile(path, name)
    try:
        found: Found = read("tag map", file)
        table = None if found.table is None else renamed(found.table)
        if table is None:
            families: Iterable[str | None] = [tag.family for tag in found.tags]
        else:
            by_normals = is_by_normals(table)
            deployment = Deployment.from_table(table) if by_normals else turned_deployment(table, axes)
            families = families_of(table)
        check_family(path, one_family(families), family)
        if table is not None:
            return deployment
        if not found.tags:
            raise InputError("it has no tags with places.")
        turned = found.by_opencv and family is not None and FAMILIES[family].apriltag
        tags = [tag._replace(axes=tag.axes @ readers.HALF_TURN) for tag in found.tags] if turned else found.tags
        return _deployment(path, tags, found.note)
    except InputError as error:
        known = error.argument in (name, "axes") or str(path) in str(error)
        raise error if known else InputError(f"{path}: {error}") from None
    except KeyError as error:
        raise InputError(f"{path}: the key {error} is missing.") from None
    except (IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path}: a value in it is of another kind than a tag map has there ({error}).") from None


def _deployment(path: Any, tags: Sequence[PlacedTag], note: str) -> Deployment:
    edges = np.array([np.nan if tag.edge is None else float(f"{tag.edge:.{EDGE_DIGITS}g}") for tag in tags])
    labels = Labels(np.array([tag.number for tag in tags]))
    axes = np.array([tag.axes for tag in tags])
    positions: FloatArray = np.array([tag.position for tag in tags])
    deployment = Deployment(positions, axes[:, :, 2], labels=labels, edges=edges, note=note)
    return deployment.turned(path, axes[:, :, 1])


def _row(written: str, cells: str) -> str:
    """A row of the table in the documentation.

    Args:
        written: name in `formats`.
        cells: the program, what the written file holds after its name, and what is read.
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
    """A format of YAML or JSON with keys that no other has.

    Args:
        note: gives a sentence on how a file at a path is read; empty where there is no doubt.
    """

    def read_keyed(file: File) -> Found:
        return Found(list(reader(file.keys)), None, by_opencv, note(file.path, file.keys))

    return Format("tag map", name, has_keys(*keys), read_keyed, row=row)


def _refused(recognises: Callable[[Any], bool], reason: str) -> Format:
    return Format("tag map", "of another program", recognises, why_not=f"{reason}; {TABLE}")


def _first(begins: re.Pattern[str]) -> Callable[[File], bool]:
    """A test for texts whose first line begins so."""
    return lambda file: begins.match(file.first) is not None


KEYED = (
    _keyed("lmd", readers.own_json, "tags", "family", EDGE),
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
        readers.apriltag_ros,
        "tag_bundles",
        row=_row(
            "apriltag_ros",
            "AprilRobotics/apriltag_ros (ROS 1) | : one bundle called `room` | the only one of `tag_bundles`, or "
            "`standalone_tags` with `x` ... `qw`; `size`",
        ),
    ),
    _keyed("apriltag_ros", readers.apriltag_ros, "standalone_tags"),
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
        "fiducial_vlam",
        readers.fiducial_vlam,
        "markers",
        "marker_length",
        row=_row("fiducial_vlam", "fiducial_vlam | : all tags stay where they are | yes, `marker_length`"),
        by_opencv=True,
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
)
KNOWN = ", ".join(dict.fromkeys(form.name for form in KEYED))
FORMATS = (
    Format(
        "tag map",
        "RTAB-Map",
        lambda file: PRIORS.search(file.text) is not None or "|" in file.first,
        lambda file: read_priors(file.text),
        row=_row(
            "rtabmap",
            "RTAB-Map | : the value of `Marker/Priors` | `id x y z roll pitch yaw`, alone or in its `.ini` "
            "(`Marker/Length`); its exported poses with a negative id",
        ),
    ),
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
        "lines",
        _first(IS_NUMBER),
        lambda file: read_lines(file.path, file.text),
        row=_row("clover", "Clover | : `aruco_map` | `id length x y z yaw pitch roll`, `length`")
        + "\nfiducial_slam | | not written | what it saves: `id x y z roll pitch yaw variance ...`, degrees",
    ),
    Format(
        "tag map",
        "WPILib's drawing",
        lambda file: ",".join(part.strip() for part in file.first.split(",")) in WPILIB_HEADERS,
        lambda file: Found(readers.wpilib_drawing(file.path, file.argument)),
    ),
    Format(
        "tag map",
        "table",
        anything,
        lambda file: Found([], headed_table(file.path, file.lines, file.argument)),
        row=(
            "your own | `csv`, `json` | `tags.csv`, `tags.json`: poses as quaternions, and corners | yes, `edge`; or "
            "[a table](#a-table-of-your-own)"
        ),
    ),
)
