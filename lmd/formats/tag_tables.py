"""Tag maps as tables: texts, and lists of tags in YAML or JSON, whose keys correspond to columns.

A row has id, x, y, z, a rotation and, if known, edge and family. The rotation is a normal nx, ny, nz (and an up vector
ux, uy, uz) or a unit quaternion qx, qy, qz, qw. Or the rotation is ROS's roll, pitch, yaw, or a rotation vector rx, ry,
rz, radians. A rotation is from the tag's frame to the map's frame; for the axes of a tag's frame see
`lmd.formats.placed_tag.axes_of`.

Sources: `ArucoMap::addMarker` of CopterExpress/clover; `Map::saveMap` of UbiquityRobotics/fiducials; `Marker/Priors` of
RTAB-Map, and the poses that it exports.
"""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from lmd.core.checks import FloatArray, InputError, vector
from lmd.core.tables import Table
from lmd.core.words import few
from lmd.formats.columns import (
    EULER,
    FAMILY,
    IDS,
    LAYOUTS,
    LISTS,
    NORMAL,
    PARTS,
    POSITION,
    QUATERNION,
    TAGS,
    TIME,
    VECTOR,
    named,
    standard,
    standardised,
)
from lmd.formats.placed_tag import (
    NUMBERS,
    RIGHT_UP_OUT,
    Found,
    PlacedTag,
    axes_of,
    edge_of,
    mapping,
    number_of,
    tag_named,
    turn_by_angles,
    turn_by_quaternion,
    turn_by_vector,
)
from lmd.formats.trees import File, Keys
from lmd.scene.deployment import Deployment
from lmd.scene.families import family_named
from lmd.scene.labels import EDGE, ID, Labels, edge_column

PRIORS = re.compile(r"^[ \t]*Marker[\\/]Priors\s*=(.*)$", re.MULTILINE)
SETTING = r"^[ \t]*Marker[\\/]{}\s*=\s*\"?(\S+?)\"?\s*$"  # line of a setting in RTAB-Map's configuration
NAMELESS = re.compile(r"(?:unnamed:[_ ]?\d+)?", re.I)  # column of pandas that may have the numbers of lines
LIMELIGHT, PYTAGMAPPER = "fiducials", "tag_locations"  # keys of lists that other formats also have


def read_tag_text(file: File) -> Found:
    """Read tags from a text; `file.asked` may have the `columns` of `lmd.formats.columns.named`.

    Raises:
        InputError: the text is not a table of tags, or its columns are unknown.
    """
    if PRIORS.search(file.text) is not None or "|" in file.first:
        return _priors(file.path, file.text)
    found = named(file.path, file.text, TAGS, file.asked.get("columns"), file.argument)
    table, layout = found.table, found.layout
    if next(iter(found.columns), "") == TIME and ID in table:
        return Found(_landmarks(table), by_opencv=True, note=f"{file.path}: its tags are poses with a negative id")
    if not layout.name:
        return Found([], table)
    frame = axes_of(layout.axes).T
    return Found([tag._replace(axes=tag.axes @ frame) for tag in _placed(table)], by_opencv=layout.opencv)


def _landmarks(table: Table) -> list[PlacedTag]:
    """Tags in a table of poses that RTAB-Map exports; the poses with a negative id are those of tags."""
    numbers = table.numbers([ID], None)[:, 0].tolist()
    chosen = [i for i, number in enumerate(numbers) if number < 0.0]
    if not chosen:
        raise InputError("it has poses of RTAB-Map but no tag: a tag has a negative id.")
    texts = {name: [column[i] for i in chosen] for name, column in table.texts.items()}
    texts[ID] = [f"{-numbers[i]:.15g}" for i in chosen]
    return _placed(Table(table.path, [table.lines[i] for i in chosen], texts))


def _priors(path: object, text: str) -> Found:
    """Tags of RTAB-Map's parameter `Marker/Priors`, from its value or from a configuration file; `|` separates tags."""
    found = PRIORS.search(text)
    entries = (entry.strip(" \t\r\n\"'") for entry in (text if found is None else found[1]).split("|"))
    rows = [(1, entry.split()) for entry in entries if entry]
    columns = next(layout.columns for layout in LAYOUTS if layout[:2] == ("rtabmap", TAGS))
    if odd := [row for _, row in rows if len(row) != len(columns)]:
        raise InputError(f"{' '.join(odd[0])[:200]!r} must have a value for each of {' '.join(columns)}.")
    edge = family = None
    if found is not None:
        length, number = (re.search(SETTING.format(name), text, re.MULTILINE) for name in ("Length", "Dictionary"))
        if length is not None and float(length[1]) > 0.0:  # otherwise RTAB-Map measures the edge
            edge = edge_of("Marker/Length", float(length[1]))
        if number is not None and number[1].isdecimal():
            family = family_named(NUMBERS.get(int(number[1]), f"{number[1]} of OpenCV"))
    tags = _placed(Table.of(path, columns, rows))
    return Found([tag._replace(edge=edge, family=family) for tag in tags], by_opencv=True)


def _placed(table: Table) -> list[PlacedTag]:
    """Tags of a table whose columns have standard names."""
    ids, places = (table.numbers(names, None) for names in ((ID,), POSITION))
    numbers = [number_of(int(number) if number.is_integer() else number) for number in ids[:, 0].tolist()]
    edges = [edge_of(EDGE, float(text)) for text in table.texts[EDGE]] if EDGE in table else [None] * len(ids)
    turns = _turns(table, numbers)
    return [PlacedTag(*row) for row in zip(numbers, places, turns, edges, strict=True)]


def _turns(table: Table, numbers: Sequence[int]) -> FloatArray:
    """Rotation matrices of the tags of a table whose columns have standard names, `(N, 3, 3)`.

    `numbers` are the ids of the tags, for messages.

    Raises:
        InputError: a column is missing, or a value is refused.
    """
    for columns in (QUATERNION, VECTOR, EULER):
        if missing := [name for name in columns if name not in table]:
            if len(missing) < len(columns):
                raise InputError(f"it lacks {', '.join(missing)} of the columns {', '.join(columns)}.")
            continue
        values = zip(numbers, table.numbers(columns, None), strict=True)
        if columns == QUATERNION:
            return np.array([turn_by_quaternion(*row.tolist()) for _, row in values])
        if columns == EULER:
            return np.array([turn_by_angles(number, *row.tolist()) for number, row in values])
        return np.array([turn_by_vector(f"tag {number}", row) for number, row in values])
    raise InputError(
        "it has positions but no rotations of tags: add the columns nx,ny,nz (and ux,uy,uz), or "
        f"qx,qy,qz,qw, or roll,pitch,yaw in radians; it has {', '.join(table.texts)[:200]}."
    )


def deployment_of(table: Table, axes: Sequence[str] | None) -> tuple[Deployment, list[str]]:
    """Deployment from a table whose columns have standard names; and a list of the tag families that the table names.

    Args:
        table: the table.
        axes: directions, in words, of the axes x, y and z of a tag's frame, see `axes_of`; None for right, up, out.

    Raises:
        InputError: a column is missing, or a value is refused.
    """
    table, families = _numbered(table)
    if any(name in table for name in NORMAL) or not all(name in table for name in POSITION):
        return Deployment.from_table(table), families
    columns = next((names for names in (QUATERNION, VECTOR, EULER) if names[0] in table), QUATERNION)
    labels = Labels.of(table, (*POSITION, *columns, EDGE))
    turns = _turns(table, labels.ids.tolist()) @ axes_of(axes).T
    pointing = ", ".join(RIGHT_UP_OUT if axes is None else axes)
    note = (
        f"{table.path} is read as {' '.join((ID, *POSITION, *columns))}; the axes x, y, z of a tag point {pointing}"
        f"{'; set axes if they point elsewhere' if axes is None else ''}"
    )
    places = table.numbers(POSITION, None)
    found = Deployment(places, turns[:, :, 2], labels=labels, edges=edge_column(table), note=note)
    return found.turned(table.path, turns[:, :, 1]), families


def _numbered(table: Table) -> tuple[Table, list[str]]:
    """Copy of a table in which the column `id` has numbers of tags; and a list of the families that the table names.

    In the file, this column may have another name, and names of tags such as tag36h11:7 instead of numbers. The
    families are those in such names and in the column `family`.

    Raises:
        InputError: a table of poses lacks a column with the numbers of the tags, or has two such columns that differ.
    """
    read = dict[str, list[tuple[str | None, int]]]()
    for column in sorted(table.texts, key=lambda name: (name != ID, NAMELESS.fullmatch(name) is not None)):
        if NAMELESS.fullmatch(column) is not None or standard(column, TAGS) == (ID, None):
            tags = [tag for text in table.texts[column] if (tag := tag_named(text)) is not None]
            if tags and len(tags) == len(table.lines):
                read[column] = tags
    chosen = ID if ID in table else next(iter(read), "")
    numbers = [str(number) for _, number in read.get(chosen, ())] or table.texts.get(chosen)
    lines = [[str(number) for number in range(first, len(table.lines) + first)] for first in (0, 1)]
    if NAMELESS.fullmatch(chosen) is not None and numbers in lines:  # pandas writes the numbers of lines
        numbers = None
    if numbers is None:
        if all(name in table for name in POSITION):
            given = few(map(repr, table.texts), most=9)
            raise InputError(
                f"it needs a column id with the number of each tag, such as 7 or tag36h11:7; it has {given}."
            )
        return table, []
    for column, tags in read.items():
        if any(family for family, _ in tags) and [str(number) for _, number in tags] != list(numbers):
            raise InputError(f"its columns {chosen!r} and {column!r} have different numbers of tags.")
    columns = {
        ID if name == chosen else name: numbers if name == chosen else texts for name, texts in table.texts.items()
    }
    families = [family_named(text) for text in table.texts.get(FAMILY, ()) if text]
    return Table(table.path, table.lines, columns), families + [f for tags in read.values() for f, _ in tags if f]


def is_list(keys: Keys) -> bool:
    """True if the content `keys` of a file has a list of tags with ids, or a mapping of tags keyed by number."""
    return _list_of(keys) is not None


def _list_of(keys: Keys) -> str | None:
    for name in LISTS:
        value = keys.get(name)
        if isinstance(value, dict) and value:
            kinds = dict if name == PYTAGMAPPER else (dict, list)
            if all(isinstance(one, kinds) for one in value.values()):
                return name
        elif isinstance(value, list) and value:
            named_all = all(isinstance(one, dict) and any(one.get(key) is not None for key in IDS) for one in value)
            if named_all and not (name == LIMELIGHT and "transform" in value[0]):
                return name
    return None


def listed(file: File) -> Found:
    """Read tags from the list or mapping of tags in a file that `is_list` accepts.

    Each entry becomes a row of a table, whose columns are the keys.

    Raises:
        InputError: a tag lacks a value that another tag has, or a value is refused.
    """
    name = str(_list_of(file.data))
    tags, rows = file.data[name], list[dict[str, str]]()
    for key, entry in tags.items() if isinstance(tags, dict) else enumerate(tags):
        at, told = f"{name}[{key}]", "{position: [x, y, z], orientation: [roll, pitch, yaw]}, metres and radians"
        if isinstance(entry, list):
            raise InputError(f"{at} has values without names: a tag needs {told}.")
        cells = dict(_cells(at, mapping(at, entry)))
        row = standardised(Table(str(file.path), [1], {column: [text] for column, text in cells.items()}), TAGS)
        number = key if isinstance(tags, dict) else next(entry[one] for one in IDS if entry.get(one) is not None)
        if tag_named(number) is None:
            raise InputError(f"{at}: the name {number!r} must have a number, such as 7, tag_7 or tag36h11:7.")
        rows.append(
            {ID: str(number)} | {column: row.table.texts[column][0] for column in row.columns if column != TIME}
        )
        if missing := sorted(rows[0].keys() - rows[-1].keys() - {EDGE, FAMILY}):
            raise InputError(f"{at} lacks {', '.join(missing)}; it has {', '.join(map(str, entry))[:200]}.")
    top = {key: [str(value)] for key, value in file.data.items() if isinstance(value, str | float | int)}
    common = standardised(Table(str(file.path), [1], top), TAGS).table.texts
    given = {column: common[column][0] for column in (EDGE, FAMILY) if column in common}
    columns = dict.fromkeys(column for row in (*rows, given) for column in row)
    texts = {column: [row.get(column, given.get(column, "")) for row in rows] for column in columns}
    return Found([], Table(str(file.path), range(1, len(rows) + 1), texts))


def _cells(at: str, keys: Keys, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Split an entry into cells of a table: pairs of a column's name and a text.

    Nested keys are joined by dots, and each number of a list gets its own column. `at` is the entry, for messages.
    """
    for key, value in keys.items():
        if isinstance(value, Mapping):
            yield from _cells(at, value, f"{prefix}{key}.")
        elif isinstance(value, list):
            if (names := PARTS.get(key)) is not None:
                if names == EULER and len(value) == 4:
                    raise InputError(
                        f"{at}: a quaternion's name must show the place of w, as quaternion_xyzw does, not {key}."
                    )
                yield from zip(names, map(repr, vector(f"{at}: {key}", value, len(names))), strict=True)
        elif value is not None and not isinstance(value, bool):
            yield f"{prefix}{key}", str(value)
