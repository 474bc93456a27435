"""Reading CSV tables of numbers, with messages that name the file and the value."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.checks import FloatArray, InputError


def read_numbers(path: str | Path, columns: Sequence[str], *, name: str, optional: Sequence[str] = ()) -> FloatArray:
    """Read the numeric `columns` of a CSV with a header, in that order.

    Args:
        path: the file.
        columns: columns that must be there.
        name: the argument the path came from, for messages.
        optional: columns that may be there and are ignored.

    Returns:
        `(rows, len(columns))` finite float64.

    Raises:
        InputError: the file is missing or empty, a column is missing or unknown, a value is no finite number.
    """
    try:
        with warnings.catch_warnings():
            # Without this, pandas drops fields beyond the header and carries on with the wrong columns.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(path, dtype=str, skipinitialspace=True, keep_default_na=False, index_col=False)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no file {str(path)!r}.", name) from None
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
        raise InputError(f"{name}: {str(path)!r} cannot be read as CSV ({str(error).strip()}).", name) from None
    except pd.errors.EmptyDataError:
        raise InputError(f"{path} is empty; expected the columns {','.join(columns)}.") from None
    frame.columns = [str(column).strip() for column in frame.columns]
    for column in frame.columns:
        if column not in columns and column not in optional:
            raise InputError(f"{path} has an unknown column {column!r}; expected {','.join(columns)}.")
    for column in columns:
        if column not in frame.columns:
            raise InputError(f"{path} lacks the column {column!r}; expected {','.join(columns)}.")
    if frame.empty:
        raise InputError(f"{path} has a header but no rows.")
    table = np.empty((len(frame), len(columns)))
    for j, column in enumerate(columns):
        for i, text in enumerate(frame[column]):
            try:
                table[i, j] = float(text)
            except ValueError:
                raise InputError(f"{path} line {i + 2}: {column} is {text!r}, not a number.") from None
            if not np.isfinite(table[i, j]):
                raise InputError(f"{path} line {i + 2}: {column} is {text!r}, not a finite number.")
    return table


def has_column(path: str | Path, column: str) -> bool:
    """Whether the header of a CSV names `column`; False for a file that `read_numbers` would refuse to read."""
    try:
        with Path(path).open() as file:
            return column in (name.strip() for name in file.readline().split(","))
    except (OSError, UnicodeDecodeError):
        return False
