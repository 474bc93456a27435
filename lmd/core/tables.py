"""Readers and writers of CSV tables, with messages that name file, line and value.

The module also checks the units of times and angles, and sorts the texts of times.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import ONE_TURN, FloatArray, InputError, printable
from lmd.core.files import read_text

LATEST = 1e11  # greatest time, seconds since 1970; later times are probably milliseconds or nanoseconds
# Least median difference of times that may be milliseconds: 5 ms between frames is a rate of 200 frames per second.
APART = 5.0
CREEPING = 5e-3  # median speed, m/s; with slower motion, times `APART` or more apart are taken for milliseconds
MOST_COLUMNS = 1000  # greatest number of columns; a file with more is refused
CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
COMMENT = "#"  # first character of a comment line


def write_table(file: str | Path | TextIO, columns: Mapping[str, ArrayLike]) -> None:
    """Write a CSV with a header, as `pandas.DataFrame.to_csv` does (pandas takes long to import).

    Args:
        file: path, or an open text file.
        columns: numbers or texts of each column, keyed by the column's name; all columns have one length. NaN becomes
            an empty cell; other numbers have enough digits to be read back exactly.
    """
    if isinstance(file, str | Path):
        with Path(file).open("w", encoding="utf-8", newline="") as opened:
            write_table(opened, columns)
        return
    values = [np.asarray(column).tolist() for column in columns.values()]
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([["" if value != value else value for value in row] for row in zip(*values, strict=True)])


@dataclass(frozen=True)
class Table:
    """Cells of a CSV with a header, as texts.

    Args:
        path: path of the file, for messages.
        lines: number of the line in the file from which each row comes, from 1.
        texts: cells of each column, one for each row, keyed by the column's name. Control characters become escapes.
    """

    path: str
    lines: Sequence[int]
    texts: Mapping[str, Sequence[str]]

    def __post_init__(self) -> None:
        texts = {_safe(name): list(map(_safe, column)) for name, column in self.texts.items()}
        object.__setattr__(self, "texts", texts)

    @classmethod
    def of(cls, path: Any, columns: Sequence[str], rows: Sequence[tuple[int, list[str]]]) -> "Table":
        """Make a table from rows with their line numbers.

        Raises:
            InputError: two columns have equal names, or a row does not have one value per column.
        """
        for i, column in enumerate(columns):
            if column in columns[:i]:
                raise InputError(f"{path} names the column {column!r} twice; the first line is its header.")
        for line, row in rows:
            if len(row) != len(columns):
                raise InputError(
                    f"{path} line {line} has {len(row)} values, but the header has {len(columns)} columns."
                )
        texts = {column: [row[j] for _, row in rows] for j, column in enumerate(columns)}
        return cls(str(path), [line for line, _ in rows], texts)

    def __contains__(self, column: str) -> bool:
        return column in self.texts

    def numbers(self, columns: Sequence[str], optional: Sequence[str] | None = ()) -> FloatArray:
        """Numbers in columns, `(rows, len(columns))`; all are finite.

        Args:
            columns: names of the columns, in the order of the result.
            optional: further columns that the table may have; None if any further column is allowed.

        Raises:
            InputError: the file is empty, a column is missing or unknown, or a value is not a finite number.
        """
        if not self.texts:
            raise InputError(f"{self.path} is empty; expected the columns {','.join(columns)}.")
        expected = f"expected {','.join(columns)}"
        for column in self.texts:
            if optional is not None and column not in (*columns, *optional):
                raise InputError(f"{self.path} has an unknown column {column!r}; {expected}.")
        for column in columns:
            if column not in self:
                raise InputError(f"{self.path} lacks the column {column!r}; {expected}.")
        if not self.lines:
            raise InputError(f"{self.path} has a header but no rows.")
        return np.array([[self._number(i, column) for column in columns] for i in range(len(self.lines))])

    def _number(self, row: int, column: str) -> float:
        text, place = self.texts[column][row], f"{self.path} line {self.lines[row]}: {column}"
        try:
            number = float(text)
        except ValueError:
            raise InputError(f"{place} is {text!r}, not a number.") from None
        if not math.isfinite(number):
            raise InputError(f"{place} is {text!r}, not a finite number.")
        return number


def read_table(path: Any, *, name: str) -> Table:
    """Read a CSV with a header; blank lines and lines that begin with # are skipped.

    Args:
        path: path of the file.
        name: argument that gave the path, for messages.

    Raises:
        InputError: the file is missing, is not a CSV, or has no header, semicolons instead of commas, too many columns,
            two columns with one name, or rows of different lengths.
    """
    rows = csv_rows(path, numbered_lines(read_text(path, name)), name)
    if not rows:
        return Table(str(path), (), {})
    header = rows[0][1]
    if any(is_number(column) for column in header):
        first = ",".join(header)[:200]
        raise InputError(f"{path} has no header: its first line, {first!r}, must name the columns.")
    return Table.of(path, header, rows[1:])


def csv_rows(path: Any, lines: Sequence[tuple[int, str]], name: str) -> list[tuple[int, list[str]]]:
    """Split numbered lines of a CSV into rows: for each row, a line number and the list of its values.

    A row may span several lines; its line number is that of the last of these lines.

    Raises:
        InputError: the lines are not a CSV, have semicolons instead of commas, or too many columns.
    """
    try:
        reader = csv.reader((line for _, line in lines), skipinitialspace=True, strict=True)
        rows = [(lines[reader.line_num - 1][0], [text.strip() for text in row]) for row in reader]
    except csv.Error as error:
        raise InputError(f"{name}: {str(path)!r} cannot be read as CSV ({error}).", name) from None
    first = rows[0][1] if rows else []
    if len(first) == 1 and ";" in first[0]:  # spreadsheets write semicolons in locales with a decimal comma
        raise InputError(f"{path} has semicolons between its columns: save it with commas, and with decimal points.")
    if len(first) > MOST_COLUMNS:
        raise InputError(f"{path} has {len(first)} columns, more than {MOST_COLUMNS}; the first line is its header.")
    return rows


def _safe(text: str) -> str:
    """Text with escapes in place of characters that control a terminal or the direction of writing."""
    return text if text.isprintable() else CONTROL.sub(lambda found: printable(found[0]), text)


def is_number(text: str) -> bool:
    """True if Python reads the text as a float."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def numbered_lines(text: str) -> list[tuple[int, str]]:
    """Lines of a text that are neither blank nor comments, with their line numbers from 1."""
    lines = io.StringIO(text, newline="")
    return [(i, line) for i, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != COMMENT]


def read_numbers(path: Any, columns: Sequence[str], *, name: str) -> FloatArray:
    """Read numeric columns of a CSV with a header.

    Args:
        path: path of the file.
        columns: names of the columns, in the order of the result; the file must have no other columns.
        name: argument that gave the path, for messages.

    Returns:
        `(rows, len(columns))` finite float64.

    Raises:
        InputError: the file cannot be read, a column is missing or unknown, or a value is not a finite number.
    """
    return read_table(path, name=name).numbers(columns)


def time_of(text: str) -> Decimal | str:
    """Sort key of a time: the decimal number that the text states; for another text, such as a photograph's name, the
    text itself.

    A float has too few digits for nanoseconds since 1970.
    """
    try:
        number = Decimal(text)
    except InvalidOperation:
        return text
    return number if number.is_finite() else text


def in_order(texts: Iterable[str]) -> list[str]:
    """Sort texts of times without repetitions: numbers first, then other texts, such as names of photographs."""
    return sorted(set(texts), key=_time_key)


def _time_key(text: str) -> tuple[float, str]:
    try:
        number = float(text)
    except ValueError:
        number = math.inf
    return number if math.isfinite(number) else math.inf, text


def seconds(source: str, time: FloatArray, positions: FloatArray | None = None) -> None:
    """Raise `InputError` if times `(T,)` of the file `source` seem to be in smaller units than seconds.

    The times may have any origin. With the camera's `positions` `(T, 3)`, metres, the speed is checked too. Times that
    are seconds apart, although the camera hardly moves between them, are taken for milliseconds.
    """
    latest = float(np.abs(time).max())
    if latest > LATEST:
        asked = "times are in seconds"
        raise InputError(f"{source}: time = {latest:.15g} looks like milliseconds or nanoseconds; {asked}.")
    if positions is None or len(time) < 3:
        return
    step, way = np.diff(time), np.linalg.norm(np.diff(positions, axis=0), axis=1)
    moving = (step > 0.0) & (way > 0.0)
    if moving.any() and np.median(step) >= APART:
        speed = float(np.median(way[moving] / step[moving]))
        if speed < CREEPING:
            raise InputError(
                f"{source}: the times look like milliseconds, as frames would be {np.median(step):g} s apart and the "
                f"camera would move at {1000.0 * speed:.2g} mm/s; times are in seconds."
            )


def radians(source: str, **angles: FloatArray) -> None:
    """Raise `InputError` if named angles of the file `source` exceed one turn, as they are probably in degrees."""
    for name, angle in angles.items():
        worst = float(angle[np.argmax(np.abs(angle))])
        if abs(worst) > ONE_TURN:
            asked = "angles are in radians, at most one turn from zero"
            raise InputError(f"{source}: {name} = {worst:g} looks like degrees; {asked}.")
