"""Tables of poses and of tags in text files: names and units of columns, and the reader.

A text names its columns in the first line, or in a comment above the values. For other texts the user names either the
columns, or the program that wrote the text (a row of `LAYOUTS`). If the user names neither, only TUM's format and lines
of `ros2 topic echo` are read, because in these two formats the values show whether the columns are the expected ones.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from lmd.core.checks import InputError
from lmd.core.tables import COMMENT, Table, csv_rows, is_number, numbered_lines
from lmd.formats.placed_tag import TAG_WORDS, tag_named
from lmd.geometry.se3 import ROW
from lmd.scene.deployment import COLUMNS
from lmd.scene.labels import EDGE, ID

POSES, TAGS = "poses", "tags"  # kinds of tables
TIME, FAMILY, POSITION, QUATERNION, NORMAL = "time", "family", ROW[:3], ROW[3:], COLUMNS[3:]
EULER = ("roll", "pitch", "yaw")  # angles of a body in ROS's convention: x ahead, y left, z up
# Angles of a camera, as in `lmd.geometry.frames.rotation`: clockwise from the y axis, upwards, and to the left.
OWN_ANGLES = ("yaw_from_y", "pitch_up", "roll_left")
VECTOR = ("rx", "ry", "rz")  # rotation vector, whose length is the angle
LONGEST_NAME = 200  # maximum number of characters of a column's name; longer names are unknown
ALONE = ("tum",)  # layouts that the number of values determines: a wrong reading gives no valid rotation
ONCE = (EDGE, FAMILY)  # quantities that several columns may hold; only the first of these columns is read
SHOWN = 200  # maximum number of characters of a line that a message shows
_BRACKETS = re.compile(r"[\[(]([^\[(\])]*)[\])]$")
# Names of a quaternion with w first: qw qx qy qz, (w, x, y, z), wxyz, w i j k.
_W_FIRST = re.compile(r"(?<![a-z])q?_?w[\W_]*q?_?x[\W_]*q?_?y[\W_]*q?_?z|(?<![a-z])w[\W_]+i[\W_]+j[\W_]+k(?![a-z])")
_TEXT = Path(__file__).with_name("tables").joinpath("columns.yaml").read_text(encoding="utf-8")
_TABLE = yaml.load(_TEXT, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


class Quantity(NamedTuple):
    """Quantity, such as a time or a coordinate, and the names and units of the columns of files that hold it."""

    name: str
    """Standard name of the column, in which {} stands for the axis."""
    pattern: re.Pattern[str]
    """Pattern that the column's names in files match, in lower case. The groups `axis` and `unit` of the pattern are
    the axis and the unit in a name.
    """
    units: Mapping[str, float]
    """Size of each unit in seconds, metres or radians, keyed by the unit's name; empty for a quantity without a
    unit.
    """

    @classmethod
    def of(cls, name: str, names: str, unit: str = "") -> "Quantity":
        """Make a quantity from its row in `lmd`'s table of columns.

        Args:
            name: standard name.
            names: pattern of the names in files, in which UNIT stands for the name of a unit.
            unit: kind of the unit, such as `length`; empty for a quantity without a unit.
        """
        units = _units(unit) | (_units(f"bare_{unit}") if unit == TIME else {})
        words = "|".join(sorted(units, key=len, reverse=True))
        return cls(name, re.compile(names.replace("UNIT", f"(?P<unit>{words})")), units)


def _units(kind: str) -> dict[str, float]:
    return {word: size for size, words in _TABLE["units"].get(kind, {}).items() for word in words.split()}


_OF_POSES = [Quantity.of(**row) for row in _TABLE["quantities"]]
VOCABULARY = {
    POSES: _OF_POSES,
    TAGS: [*_OF_POSES, *(Quantity.of(**row) for row in _TABLE["tags"]), Quantity.of(ID, TAG_WORDS)],
}


class Layout(NamedTuple):
    """Columns of a text file in their order, and conventions of the program that writes such files.

    The conventions concern missing and further values in a line, the first line, and the directions of a tag's axes.
    """

    name: str
    """Name of the program, as in the argument `columns`; empty if a file or the user names the columns."""
    of: str
    """Content of the table: `POSES` or `TAGS`."""
    columns: tuple[str, ...]
    """Names of the columns, with their units."""
    least: int = 0
    """Smallest number of values in a line, if the last values may be missing (they are then 0); 0 if no value may be
    missing.
    """
    more: bool = False
    """True if further values, which are ignored, may follow in a line."""
    ragged: bool = False
    """True if the lines may have different numbers of further values."""
    header: str = ""
    """Regular expression that matches the first line of the program's files, which names columns without their
    units.
    """
    axes: Sequence[str] | None = None
    """Directions, in words, of the axes x, y and z of a tag's frame, see `lmd.formats.placed_tag.axes_of`."""
    opencv: bool = False
    """True if the program detects tags with OpenCV, in which the upward direction of a tag may differ from AprilTag's.
    """

    def takes(self, width: int) -> bool:
        """True if a line with `width` values can have these columns."""
        return (self.least or len(self.columns)) <= width and (self.more or width <= len(self.columns))


LAYOUTS = tuple(Layout(**row)._replace(columns=tuple(row["columns"].split())) for row in _TABLE["layouts"])
# For lists of tags: keys of a list, keys of a tag's number or name, and columns of the lists of numbers, by their keys.
LISTS: list[str] = _TABLE["lists"].split()
IDS: list[str] = _TABLE["ids"].split()
PARTS: dict[str, tuple[str, ...]] = {
    key: tuple(names.split()) for names, keys in _TABLE["parts"].items() for key in keys.split()
}
# Columns that refusals suggest.
PLAIN = {of: [tuple(names.split()) for names in listed] for of, listed in _TABLE["suggested"].items()}


class Lines(NamedTuple):
    """Lines of a text that are neither blank nor comments."""

    path: str
    comments: list[str]
    """Comments before the first line, without #."""
    commas: bool
    """True if commas separate the values; False if blanks do."""
    rows: list[tuple[int, list[str]]]
    """For each line, its number in the text, from 1, and its values."""

    @property
    def width(self) -> int:
        """Number of values of the first line."""
        return len(self.rows[0][1])

    @classmethod
    def of(cls, path: object, text: str, argument: str = "path") -> "Lines":
        """Split a text into lines of values.

        Raises:
            InputError: the lines have commas but are not valid CSV.
        """
        lines = numbered_lines(text)
        first = lines[0][1].strip() if lines else ""
        before = text.splitlines()[: lines[0][0] - 1] if lines else []
        comments = [comment for line in before if (comment := line.strip().lstrip(COMMENT).strip())]
        if commas := any(mark in first for mark in ",;"):
            rows = csv_rows(path, lines, argument)
            if not any(row[-1] for _, row in rows):  # unless each line ends with a comma
                rows = [(number, row[:-1]) for number, row in rows]
        else:
            tab = "\t" if "\t" in first and not is_number(first.split()[0]) else None
            split = ((number, line.split(COMMENT)[0].split(tab)) for number, line in lines)
            rows = [(number, [value.strip() for value in row]) for number, row in split]
        return cls(str(path), comments, commas, rows)


class Named(NamedTuple):
    """Table in which the columns of known quantities have standard names, and their values are in metres and radians.

    Other columns are unchanged.
    """

    table: Table
    columns: Mapping[str, str]
    """Names that the columns of known quantities have in the file, keyed by standard name."""
    time_unit: float | None
    """Length of the time unit of the column `TIME`, seconds (1e-9 for ns); None if the file names no unit."""
    layout: Layout
    """Layout of the text's columns."""


def standard(name: str, of: str) -> tuple[str, float | None] | None:
    """Standard name of the column `name`, and size of its unit in seconds, metres or radians.

    The size is None if the name states no unit, or the quantity has none. The result is None if the quantity is
    unknown. `of` is the content of the table, `POSES` or `TAGS`.

    Raises:
        InputError: the unit is unknown.
    """
    plain = name.strip().strip("'\"").strip("#%:; \t").lstrip("_").lower()
    unit = None
    # Digits in brackets count the columns of an array, in any order: q[0].
    if (brackets := _BRACKETS.search(plain)) is not None and not brackets[1].strip().isdigit():
        unit, plain = brackets[1].strip(), plain[: brackets.start()].rstrip("_ \t")
    for quantity in VOCABULARY[of] if len(plain) <= LONGEST_NAME else ():
        if (found := quantity.pattern.fullmatch(_TABLE["renamed"].get(plain, plain))) is not None:
            groups = found.groupdict()
            unit = unit or groups.get("unit")
            if quantity.units and unit not in (None, "", "-", "1") and unit not in quantity.units:
                known = ", ".join(quantity.units)
                raise InputError(f"the unit {unit!r} of the column {name!r} is not known, only {known}.")
            return quantity.name.format(groups.get("axis")), quantity.units.get(unit or "")
    return None


def standardised(table: Table, of: str, layout: Layout | None = None) -> Named:
    """Convert a table to standard names and units; if it has several columns of times, the first one is taken.

    Args:
        table: the table.
        of: content of the table, `POSES` or `TAGS`.
        layout: layout to store in the result; None to make it from the names in the table.

    Raises:
        InputError: two columns may hold one quantity, or a unit is unknown.
    """
    columns, texts, time_unit = dict[str, str](), dict[str, Sequence[str]](), None
    # Nanoseconds beside seconds are not a time of their own.
    for name in sorted(table.texts, key=lambda name: re.search(r"n(ano)?sec\w*$", name) is not None):
        values = table.texts[name]
        own, unit = standard(name, of) or ("", None)
        literal = own != name and own in table  # another column already has the standard name
        if own == ID or (own == EDGE and not all(map(is_number, filter(None, values)))) or (own in ONCE and literal):
            own = ""
        if own in columns and own not in (TIME, *ONCE):
            raise InputError(f"its columns {columns[own]!r} and {name!r} may both be {own}: keep one of them.")
        if not own or own in columns:
            texts.setdefault(name, values)
            continue
        columns[own] = name
        if own == TIME:
            time_unit = unit
        elif unit not in (None, 1.0):
            values = [repr(float(text) * unit) if is_number(text) else text for text in values]
        texts[name if own == TIME and of == TAGS else own] = values
    own_layout = layout or Layout("", of, tuple(table.texts))
    return Named(Table(table.path, table.lines, texts), columns, time_unit, own_layout)


def named(
    path: object, text: str, of: str, columns: str | Sequence[str] | None = None, argument: str = "path"
) -> Named:
    """Read the table in a text.

    Args:
        path: path of the file, for messages.
        text: text of the file.
        of: content of the table, `POSES` or `TAGS`.
        columns: names of the columns, or the name of a program of `LAYOUTS`, for a text that does not name its columns.
        argument: name of the argument with the path, for messages.

    Raises:
        InputError: the text is not a table, or its columns are unknown.
    """
    lines = Lines.of(path, text, argument)
    if not lines.rows:
        raise InputError(f"{path} is empty; expected the columns {','.join(PLAIN[of][0])}.")
    (number, first), *others = lines.rows
    has_names = not is_number(first[0]) and (of == POSES or tag_named(first[0]) is None)
    if has_names and sum(map(is_number, first)) >= 3:
        wrong = f"line {number} begins with {first[0][:80]!r}"
        raise InputError(f"{wrong}, which is neither a number nor the name of a column.")
    asked = None if columns is None else _asked(lines, of, columns)
    if has_names:  # the user's columns replace a header that names no position
        has_place = any((standard(name, of) or ("",))[0] == "x" for name in first)
        given = next((one for one in LAYOUTS if re.fullmatch(one.header or "$", ",".join(first))), None)
        layout = given or (Layout("", of, tuple(first)) if asked is None or has_place else asked)
    else:
        layout = asked or _commented(lines, of) or _by_content(lines, of)
    count, rows = len(layout.columns), list[tuple[int, list[str]]]()
    for number, row in others if has_names else lines.rows:
        if (len(row) != lines.width and not (layout.ragged or layout.least)) or not layout.takes(len(row)):
            said = f"{path} line {number} has {len(row)} values, but its columns are"
            raise InputError(f"{said} {','.join(layout.columns)[:SHOWN]}.")
        rows.append((number, row if len(row) == count else [*row[:count], *["0"] * (count - len(row))]))
    return standardised(Table.of(path, layout.columns, rows), of, layout)


def _asked(lines: Lines, of: str, columns: str | Sequence[str]) -> Layout:
    """Layout from the user's argument `columns`: names of columns, or the name of a program in `LAYOUTS`."""
    known = [layout for layout in LAYOUTS if layout.of == of]
    if isinstance(columns, str) and re.fullmatch(r"\w+", columns):
        found = [layout for layout in known if layout.name == columns]
        if not found:
            words = ", ".join(dict.fromkeys(layout.name for layout in known))
            raise InputError(f"columns must be a list of names, or one of {words}, got {columns!r}.", "columns")
        return next((layout for layout in found if layout.takes(lines.width)), found[0])
    names = re.split(r"[,\s]+", columns) if isinstance(columns, str) else [str(name) for name in columns]
    return Layout("", of, tuple(names), more=True)


def _commented(lines: Lines, of: str) -> Layout | None:
    """Layout of the columns, from the last comment that names columns; None if no comment does.

    A comment names the columns in three cases. The comment has x and the names of a rotation (a quaternion, or roll,
    pitch and yaw). Or the comment begins with a tag's id and three more known names. Or the comment has one word for
    each value of a line, and the words look like names.

    Raises:
        InputError: a comment names more columns than the first line has values.
    """
    for comment in reversed(lines.comments):
        # In some files, blanks separate units from the names: p_x [m].
        spaced = re.sub(r"(?<!\s)\s+([\[(])", r"\1", comment)
        for words in (comment.split(","), re.split(r"[,\s]+", spaced)) if "," in comment else (spaced.split(),):
            names = [word for one in words if (word := one.strip(" \t:;,")) not in ("", "...")]
            known = [(standard(name, of) or ("",))[0] for name in names]
            leading = known.index("") if "" in known else len(known)
            if known[:4] == [ID, *POSITION] or known[:4] == [ID, EDGE, *POSITION[:2]]:
                names, known = names[:leading], known[:leading]
            clover = next(layout for layout in LAYOUTS if layout.name == "clover")
            if of == TAGS and len(known) >= clover.least and tuple(known) == clover.columns[: len(known)]:
                return clover
            has_pose = {"x", *QUATERNION} <= set(known) or {"x", *EULER} <= set(known)
            if has_pose and len(names) > lines.width:
                said = f"a comment names {len(names)} columns, {', '.join(names)[:SHOWN]}, but line {lines.rows[0][0]}"
                raise InputError(f"{said} has {lines.width} values.")
            few_words = 2 * sum(len(one) <= 3 or not one.isalpha() for one in names) >= len(names)
            fits = 1 < len(names) == lines.width and (sum(map(bool, known)) >= 2 or few_words)
            if has_pose or fits or (known[:1] == [ID] and leading >= 4):
                return Layout("", of, tuple(names), more=True)
    return None


def _by_content(lines: Lines, of: str) -> Layout:
    """Layout of the columns of a text, determined from its values.

    Raises:
        InputError: the values do not determine the columns; the message proposes names of columns.
    """
    layouts, first = [layout for layout in LAYOUTS if layout.of == of], lines.rows[0][1]
    for layout in layouts:
        words = [name.endswith("frame_id") for name in layout.columns]
        if any(words) and layout.takes(lines.width) and [not is_number(text) for text in first[: len(words)]] == words:
            return layout
    for comment in lines.comments:
        if _W_FIRST.search(comment.lower()):
            raise InputError(
                f"a comment, {comment[:120]!r}, has w before x, y, z, and does not name the columns: write a line "
                f"above the values that names each column, such as '# {' '.join(PLAIN[of][0])}'."
            )
    for layout in layouts:
        if layout.name in ALONE and not lines.commas and lines.width == len(layout.columns):
            return layout
    width = lines.width
    exact = [one for one in layouts if len(one.columns) == width or (one.takes(width) and (one.least or one.ragged))]
    exact = [one for one in exact if not one.header]
    fits = [f"{one.name} ({','.join(one.columns)})" for one in exact]
    fits += [f"[{','.join(names)}]" for names in PLAIN[of] if len(names) == width]
    told = f", which fits {' or '.join(fits[:3])}" if fits else ""
    raise InputError(
        f"columns must be given, as {lines.path} does not name its columns: its first line is "
        f"{(',' if lines.commas else ' ').join(first)[:SHOWN]!r}{told}; or write the names of the columns above "
        f"the values, such as {','.join(PLAIN[of][0])}.",
        "columns",
    )
