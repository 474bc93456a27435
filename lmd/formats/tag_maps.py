"""Tag maps of several ecosystems, read as deployments; `lmd.export` writes them.

Which format a file has follows from its content: `lmd.formats.tag_map_readers` has those in YAML and JSON,
`lmd.formats.tag_map_texts` the texts, `lmd.formats.landmark_table` the table for all others.
`lmd.formats.tag_map_others` names formats that are not read.

Source: `convert_apriltag_layouts.py` of WPILib.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.files import parse_keys, read_text
from lmd.core.tables import COMMENT, Table, read_table
from lmd.formats.families import check_family, one_family
from lmd.formats.landmark_table import families_of, is_by_normals, renamed, turned_deployment
from lmd.formats.placed_tag import PlacedTag, number_of
from lmd.formats.tag_map_others import why_keys_not_read, why_not_read
from lmd.formats.tag_map_readers import HALF_TURN, OUT_RIGHT_UP, READERS, parameters_of
from lmd.formats.tag_map_texts import PRIORS, read_lines, read_priors
from lmd.geometry.frames import roll_pitch_yaw
from lmd.scene.deployment import Deployment
from lmd.scene.families import FAMILIES
from lmd.scene.labels import Labels

LARGEST_MAP = 1 << 22  # characters of YAML or JSON; a tag has some hundred
INCH = 0.0254  # metres
EDGE_DIGITS = 12  # the rest is rounding: of millimetres as metres, or of the sides of a square
IS_JSON = re.compile(r"(\s|//[^\n]*\n|/\*.*?\*/)*{", re.DOTALL)  # comments may come first
IS_YAML = re.compile(r"%YAML|---|\s*['\"]?[\w/*]+['\"]?\s*:")
IS_NUMBER = re.compile(r"\s*[-+.\d]")
# The headers of WPILib's drawings; the same columns under other names may be in any unit.
WPILIB_HEADERS = tuple(
    f"ID,X,Y,Z,{rotations}" for rotations in ("Rotation", "Z-Rotation,X-Rotation", "Z-Rotation,Y-Rotation")
)


class Found(NamedTuple):
    """The content of a file.

    Args:
        tags: of a map of others.
        deployment: of a table, in place of these.
        families: of the tags, as they are called here, where the file says them.
        by_opencv: whether those who read such files detect by OpenCV.
        note: what was taken for granted, a sentence; empty for nothing.
    """

    tags: list[PlacedTag]
    deployment: Deployment | None = None
    families: Sequence[str | None] = ()
    by_opencv: bool = False
    note: str = ""


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
    text = read_text(path, name)
    try:
        found = _found(path, text, name, axes)
        check_family(path, one_family(found.families), family)
        if found.deployment is not None:
            return found.deployment
        if not found.tags:
            raise InputError("it has no tags with places.")
        turned = found.by_opencv and family is not None and FAMILIES[family].apriltag
        tags = [tag._replace(axes=tag.axes @ HALF_TURN) for tag in found.tags] if turned else found.tags
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


def _found(path: Any, text: str, name: str, axes: Sequence[str] | None) -> Found:
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != COMMENT]
    first = lines[0] if lines else ""
    if PRIORS.search(text) is not None or "|" in first:
        read = read_priors(text)
        return Found(read.tags, None, [tag.family for tag in read.tags], read.by_opencv)
    if (reason := why_not_read(first)) is not None:
        raise InputError(reason)
    if IS_JSON.match(text) or IS_YAML.match(first):
        return _by_keys(path, text, name)
    if IS_NUMBER.match(first):
        lines_read = read_lines(path, text)
        if lines_read.table is None:
            return Found(lines_read.tags, by_opencv=lines_read.by_opencv, note=lines_read.note)
        return _by_table(lines_read.table, axes)
    if ",".join(part.strip() for part in first.split(",")) in WPILIB_HEADERS:
        return Found(_wpilib_csv(path, name))
    return _by_table(_table(path, lines, name), axes)


def _by_keys(path: Any, text: str, name: str) -> Found:
    if len(text) > LARGEST_MAP:
        raise InputError(f"a map has at most {LARGEST_MAP} characters, it has {len(text)}.")
    keys = parameters_of(parse_keys(path, text, name))
    for reader in READERS:
        if reader.marks <= keys.keys():
            tags = list(reader.read(keys))
            return Found(tags, None, [tag.family for tag in tags], reader.by_opencv, reader.note(path, keys))
    raise InputError(why_keys_not_read(keys, ", ".join(dict.fromkeys(reader.format for reader in READERS))))


def _table(path: Any, lines: Sequence[str], name: str) -> Table:
    """A table with its header, whose columns may be apart by commas or by spaces."""
    header = lines[0].split() if lines else []
    if not header or len(header) == 1 or "," in lines[0]:
        return read_table(path, name=name)
    rows = [line.split(COMMENT)[0].split() for line in lines[1:]]
    for row in rows:
        if len(row) != len(header):
            raise InputError(f"the line {' '.join(row)[:200]!r} has {len(row)} values, the header {len(header)}.")
    if len(set(header)) < len(header):
        raise InputError("its header names a column twice.")
    return Table(
        str(path), range(2, len(lines) + 1), {column: [row[j] for row in rows] for j, column in enumerate(header)}
    )


def _by_table(table: Table, axes: Sequence[str] | None) -> Found:
    table = renamed(table)
    by_normals = is_by_normals(table)
    deployment = Deployment.from_table(table) if by_normals else turned_deployment(table, axes)
    return Found([], deployment, families_of(table))


def _wpilib_csv(path: Any, name: str) -> list[PlacedTag]:
    """Inches, and degrees about z and then about y, as the drawings of a field have them."""
    table = read_table(path, name=name)
    rows = table.numbers(tuple(table.texts)[:6])
    found = []
    for number, x, y, z, yaw, pitch in np.pad(rows, ((0, 0), (0, 6 - rows.shape[1]))).tolist():
        turn = roll_pitch_yaw(np.radians([0.0, pitch, yaw]))
        found.append(PlacedTag(number_of(number), INCH * np.array([x, y, z]), turn @ OUT_RIGHT_UP.T))
    return found
