"""Simple table of tags: one row per tag, named columns, separated by commas or spaces.

    id, x, y, z, then one of
        nx, ny, nz (and ux, uy, uz)   its normal and its up, see `Deployment.from_table`
        qx, qy, qz, qw                a unit quaternion
        roll, pitch, yaw              rad, as ROS has them: Rz(yaw) Ry(pitch) Rx(roll)
    and, if known, edge (metres) and family.

Quaternion or angles rotate the frame of a tag to the frame of the map; for the axes of a tag's frame see
`lmd.formats.placed_tag.axes_of`. The names of columns are in the first line, or in a comment above the values.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import COMMENT, Table, is_number, read_table
from lmd.core.words import few
from lmd.formats.placed_tag import (
    RIGHT_UP_OUT,
    TAG_WORDS,
    axes_of,
    tag_named,
    turn_by_angles,
    turn_by_quaternion,
)
from lmd.scene.deployment import COLUMNS, UP_COLUMNS, Deployment
from lmd.scene.edges import EDGE, edge_column
from lmd.scene.families import family_named
from lmd.scene.labels import ID, Labels

FAMILY = "family"
PLACE, NORMAL, UP = COLUMNS[:3], COLUMNS[3:], UP_COLUMNS
QUATERNION, ANGLES = ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
# Names of columns in other programs; an edge is recognised only if its values are numbers.
NAMES = {
    **dict.fromkeys(("size", "tag_size", "marker_size", "edge_size"), EDGE),
    **dict.fromkeys(("length", "tag_length", "marker_length", "edge_length", "side", "side_length"), EDGE),
    **dict.fromkeys((FAMILY, "tag_family", "dictionary", "dict", "aruco_dict"), FAMILY),
}
_PLACE = re.compile(r"(?:p|t|pos|position|translation)[_.]?([xyz])")
_TURN = re.compile(r"(?:q|quat|quaternion|ori|orientation)[_.]?([xyzw])")
_UNIT = re.compile(r"(.*?)[_\s]?[\[(](\w+)[\])]|(.*)_(m|rad|mm|cm|inch|in|deg|degrees)")
# Columns with the numbers or the names of tags; tables of pandas have one without a name.
_IDS, _NAMELESS = re.compile(TAG_WORDS, re.I), re.compile(r"(?:unnamed:[_ ]?\d+)?", re.I)
OUR_UNITS = ("m", "metre", "metres", "meter", "meters", "rad", "radian", "radians")


def name_of(column: str) -> str:
    """Standard name of a column of the table, or the column's own name if the column is unknown.

    Raises:
        InputError: the column has another unit.
    """
    plain, unit = column.strip().strip("#:;").strip(), None
    if (found := _UNIT.fullmatch(plain.lower())) is not None:
        base, unit = (found[1], found[2]) if found[2] else (found[3], found[4])
    else:
        base = plain.lower()
    base = re.sub(r"[\s-]+", "_", base)
    place, turn = _PLACE.fullmatch(base), _TURN.fullmatch(base)
    known = NAMES.get(base, ID if _IDS.fullmatch(base) or _NAMELESS.fullmatch(base) else base)
    name = place[1] if place else f"q{turn[1]}" if turn else known
    if name not in (ID, *PLACE, *NORMAL, *UP, *QUATERNION, *ANGLES, EDGE, FAMILY):
        return plain
    if unit is not None and unit not in OUR_UNITS:
        raise InputError(f"its column {plain!r} is in another unit: places and edges are in metres, angles in radians.")
    return name


def named_columns(columns: Sequence[str]) -> list[str]:
    """Standard names of columns, see `name_of`; a column keeps its own name if its standard name is already used."""
    names, given, taken = list[str](), set(columns), set[str]()
    for column in columns:
        name = name_of(column)
        names.append(column if name in taken or (name != column and name in given) else name)
        taken.add(names[-1])
    return names


def renamed(table: Table) -> tuple[Table, list[str]]:
    """Table with standard names of columns and the numbers of tags as ids, and the families that it names.

    Raises:
        InputError: a table of places has no column with the numbers of its tags, or a second such column differs.
    """
    read = dict[str, list[tuple[str | None, int]]]()
    for column, texts in table.texts.items():
        tags = [tag for tag in map(tag_named, texts) if tag is not None] if name_of(column) == ID else []
        if tags and len(tags) == len(texts) and not _counts_lines(column, [number for _, number in tags]):
            read[column] = tags
    chosen = ID if ID in table else min(read, key=lambda column: bool(_NAMELESS.fullmatch(column)), default=None)
    columns = dict[str, Sequence[str]]()
    for name, (column, texts) in zip(named_columns(list(table.texts)), table.texts.items(), strict=True):
        fits = name != ID and (name != EDGE or name == column or all(map(is_number, filter(None, texts))))
        columns[ID if column == chosen else name if fits else column] = texts
    if chosen is None and all(name in columns for name in PLACE):
        raise InputError(
            "it needs a column id with the number of each tag, such as 7 or tag36h11:7; it has "
            f"{few(map(repr, table.texts), most=9)}."
        )
    if chosen in read:
        columns[ID] = [str(number) for _, number in read[chosen]]
        for column, tags in read.items():
            if any(family for family, _ in tags) and [str(number) for _, number in tags] != columns[ID]:
                raise InputError(f"its columns {chosen!r} and {column!r} have different numbers of tags.")
    families = [family_named(text) for text in columns.get(FAMILY, ()) if text]
    return Table(table.path, table.lines, columns), families + [f for tags in read.values() for f, _ in tags if f]


def _counts_lines(column: str, numbers: list[int]) -> bool:
    """True for a column without a name that may have the numbers of its lines, as tables of pandas have."""
    count = len(numbers)
    return bool(_NAMELESS.fullmatch(column)) and numbers in (list(range(count)), list(range(1, count + 1)))


def is_by_normals(table: Table) -> bool:
    """True for a table with standard names that has normals of tags, or that is no table of tags."""
    return any(name in table for name in NORMAL) or not all(name in table for name in PLACE)


def turned_deployment(table: Table, axes: Sequence[str] | None) -> Deployment:
    """Deployment from a table with positions and quaternions or angles.

    Args:
        table: table whose columns have the names of `named_columns`.
        axes: directions of x, y and z of a tag's frame, see `axes_of`.

    Raises:
        InputError: a column is missing, or a value is refused.
    """
    quaternions = any(name in table for name in QUATERNION)
    columns = QUATERNION if quaternions else ANGLES
    if missing := [name for name in columns if name not in table]:
        here = ", ".join(table.texts)[:200]
        lacks = "" if len(missing) == len(columns) else f", and of {', '.join(columns)} it lacks {', '.join(missing)}"
        wpilib = "; WPILib's own, in inches and degrees, has the header ID,X,Y,Z,Rotation" if "rotation" in here else ""
        raise InputError(
            "it says where tags are, and not how they are turned: it needs the columns nx,ny,nz (and ux,uy,uz), or "
            f"qx,qy,qz,qw, or roll,pitch,yaw in radians; it has {here}{lacks}{wpilib}."
        )
    rows, frame = table.numbers((*PLACE, *columns), None), axes_of(axes)
    labels = Labels.of(table, (*PLACE, *columns, EDGE))
    turns = np.array([_turn(int(number), row[3:]) for number, row in zip(labels.ids, rows, strict=True)]) @ frame.T
    pointing = ", ".join(RIGHT_UP_OUT if axes is None else axes)
    note = (
        f"{table.path} is read as {' '.join((ID, *PLACE, *columns))}; the axes x, y, z of a tag point {pointing}"
        f"{', and axes can say otherwise' if axes is None else ''}"
    )
    deployment = Deployment(rows[:, :3], turns[:, :, 2], labels=labels, edges=edge_column(table), note=note)
    return deployment.turned(table.path, turns[:, :, 1])


def _turn(number: int, values: FloatArray) -> FloatArray:
    if len(values) == len(QUATERNION):
        return turn_by_quaternion(*values.tolist())
    return turn_by_angles(number, *values.tolist())


def headed_table(path: Any, lines: Sequence[str], name: str) -> Table:
    """Table from lines with a header; columns are separated by commas or by spaces."""
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
