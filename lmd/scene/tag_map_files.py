"""Tag maps of several ecosystems, read as deployments; `lmd.mapping` writes them.

Which format a file has follows from its content. `lmd.scene.tag_map_readers` has those in YAML and JSON; here are the
texts.

Sources: `convert_apriltag_layouts.py` of WPILib; `ArucoMap::addMarker` of CopterExpress/clover; `Map::saveMap` of
UbiquityRobotics/fiducials; `Marker/Priors` of RTAB-Map.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import InputError, real
from lmd.core.files import parse_keys, read_text
from lmd.core.tables import COMMENT, read_table
from lmd.geometry.frames import roll_pitch_yaw
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import FAMILIES
from lmd.scene.tag_map_readers import HALF_TURN, OUT_RIGHT_UP, READERS, PlacedTag, number_of

LARGEST_MAP = 1 << 22  # characters of YAML or JSON; a tag has some hundred
INCH = 0.0254  # metres
FIDUCIAL_SLAM_VALUES = 9  # at least, in a line; Clover has at most 8
EDGE_DIGITS = 12  # the rest is rounding: of millimetres as metres, or of the sides of a square
IS_JSON = re.compile(r"(\s|//[^\n]*\n|/\*.*?\*/)*{", re.DOTALL)  # comments may come first


def read_deployment(path: Any, name: str = "path", family: str | None = None) -> Deployment:
    """The tags of a map, or the landmarks of a CSV, see `Deployment.from_csv`.

    Maps that say how large each tag is give `Deployment.edges`.

    Args:
        name: the argument the path came from, for messages.
        family: of the tags, for maps of those who detect by OpenCV.

    Raises:
        InputError: the file cannot be read, or is no map with the places of tags.
    """
    text = read_text(path, name)
    try:
        tags, by_opencv = _tags_of(path, text, name)
        if tags is None:
            return Deployment.from_csv(path, name)
        if not tags:
            raise InputError("it has no tags with places.")
        if by_opencv and family is not None and FAMILIES[family].apriltag:
            tags = [tag._replace(axes=tag.axes @ HALF_TURN) for tag in tags]
        return _deployment(path, tags)
    except InputError as error:
        known = error.argument == name or str(path) in str(error)
        raise error if known else InputError(f"{path}: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the key or value {error} is missing or wrong.") from None
    except AttributeError:
        raise InputError(f"{path}: a mapping was expected where there is none.") from None


def _deployment(path: str | Path, tags: Sequence[PlacedTag]) -> Deployment:
    edges = np.array([np.nan if tag.edge is None else float(f"{tag.edge:.{EDGE_DIGITS}g}") for tag in tags])
    labels = Labels(np.array([tag.number for tag in tags]))
    axes = np.array([tag.axes for tag in tags])
    deployment = Deployment(np.array([tag.position for tag in tags]), axes[:, :, 2], labels=labels, edges=edges)
    return deployment.turned(path, axes[:, :, 1])


def _tags_of(path: Any, text: str, name: str) -> tuple[list[PlacedTag] | None, bool]:
    """The tags of a map, and whether those who read it detect by OpenCV; None for a CSV of landmarks."""
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != COMMENT]
    first = lines[0] if lines else ""
    if IS_JSON.match(text) or re.match(r"%YAML|---|\s*['\"]?[\w/*]+['\"]?\s*:", first):
        if len(text) > LARGEST_MAP:
            raise InputError(f"a map has at most {LARGEST_MAP} characters, it has {len(text)}.")
        keys = parse_keys(path, text, name)
        for reader in READERS:
            if reader.marks <= keys.keys():
                return list(reader.read(keys)), reader.by_opencv
        known = ", ".join(dict.fromkeys(reader.format for reader in READERS))
        raise InputError(f"it is no tag map that is known here ({known}, and texts): it has {', '.join(keys)[:200]}.")
    if "|" in text or (len(lines) == 1 and len(first.split()) == 7 and "," not in first):
        return _rtabmap(text), True
    if re.match(r"\s*\d+\s+[-+.\d]", first):
        read = _clover if len(_values(first)) < FIDUCIAL_SLAM_VALUES else _fiducial_slam
        return [read(line) for line in lines], True
    header = [column.strip().lower() for column in first.split(",")]
    if header[:4] == ["id", "x", "y", "z"] and "rotation" in "".join(header[4:]):
        return _wpilib_csv(path, name), False
    return None, False


def _wpilib_csv(path: Any, name: str) -> list[PlacedTag]:
    """Inches, and degrees about z and then about y, as the drawings of a field have them."""
    table = read_table(path, name=name)
    rows = table.numbers(tuple(table.texts)[:6])
    found = []
    for number, x, y, z, yaw, pitch in np.pad(rows, ((0, 0), (0, 6 - rows.shape[1]))).tolist():
        turn = roll_pitch_yaw(np.radians([0.0, pitch, yaw]))
        found.append(PlacedTag(number_of(number), INCH * np.array([x, y, z]), turn @ OUT_RIGHT_UP.T))
    return found


def _values(line: str) -> list[str]:
    """Before a comment."""
    return line.split(COMMENT)[0].split()


def _fiducial_slam(line: str) -> PlacedTag:
    """`id x y z roll pitch yaw variance observations`, degrees, and the tags that were seen with it."""
    number, *values = _values(line)
    if len(values) < FIDUCIAL_SLAM_VALUES - 1 or not values[7].isdecimal():
        raise InputError(f"{line.strip()!r} must be: id x y z roll pitch yaw variance observations, as the first line.")
    pose = np.array([float(value) for value in values[:6]])
    return PlacedTag(number_of(int(number)), pose[:3], roll_pitch_yaw(np.radians(pose[3:])))


def _clover(line: str) -> PlacedTag:
    """`id length x y z yaw pitch roll`, of which what follows y may be missing."""
    number, edge, *values = _values(line)
    if not 2 <= len(values) <= 6:
        raise InputError(f"{line.strip()!r} must be: id length x y z yaw pitch roll.")
    x, y, z, yaw, pitch, roll = np.pad([float(value) for value in values], (0, 6 - len(values)))
    turn = roll_pitch_yaw([roll, pitch, yaw])
    return PlacedTag(number_of(int(number)), np.array([x, y, z]), turn, real("length", float(edge), above=0.0))


def _rtabmap(text: str) -> list[PlacedTag]:
    """`id x y z roll pitch yaw`, tags with a `|` between them."""
    found = []
    for entry in filter(None, (part.strip(" \t\r\n\"'") for part in text.split("|"))):
        number, *values = entry.split()
        if len(values) != 6:
            raise InputError(f"{entry!r} must be: id x y z roll pitch yaw.")
        place = np.array([float(value) for value in values])
        found.append(PlacedTag(number_of(int(number)), place[:3], roll_pitch_yaw(place[3:])))
    return found
