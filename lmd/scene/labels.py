"""Ids and further columns of the landmarks of a file, kept from input to output."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lmd.core.checks import BoolArray, InputError, IntArray, said_of
from lmd.core.tables import Table

ID = "id"
LARGEST = 2**53  # largest id; floats do not represent all whole numbers above it


@dataclass(frozen=True)
class Labels:
    """Ids and further columns of K landmarks.

    Args:
        ids: unique non-negative whole numbers, `(K,)`; the id of a tag is its number in the family.
        columns: further columns of the file by name, K texts each.

    Raises:
        InputError: an id is negative or occurs twice.
    """

    ids: IntArray
    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64)
        ids.flags.writeable = False
        object.__setattr__(self, "ids", ids)
        found, counts = np.unique(ids, return_counts=True)
        if (twice := found[counts > 1]).size:
            raise InputError(f"id {twice[0]} belongs to {counts.max()} landmarks; ids must be different.")
        if ids.min() < 0:
            raise InputError(f"id {ids.min()} is negative.")

    @classmethod
    def of(cls, table: Table, known: Sequence[str]) -> "Labels":
        """Labels from a table of landmarks; without a column `id`, the ids count from 0.

        Args:
            table: table of the landmarks.
            known: columns with another meaning, which are not labels.

        Raises:
            InputError: an id is no whole number, is negative, or occurs twice.
        """
        count = len(table.lines)
        columns = {name: texts for name, texts in table.texts.items() if name not in (ID, *known)}
        if ID not in table:
            return cls(np.arange(count), columns)
        (given,) = table.numbers((ID,), None).T
        for line, value in zip(table.lines, given.tolist(), strict=True):
            if not (0 <= value <= LARGEST and value.is_integer()):
                place = f"{table.path} line {line}: {ID}"
                raise InputError(f"{place} must be a whole number from 0 to {LARGEST:.4g}, got {value:.9g}.")
        with said_of(table.path):
            return cls(given.astype(np.int64), columns)

    def __add__(self, other: "Labels") -> "Labels":
        """Concatenate labels; a column that only one operand has gets empty texts for the landmarks of the other
        operand.
        """
        names = {**self.columns, **other.columns}
        parts = ((part.columns.get(name, [""] * len(part.ids)) for part in (self, other)) for name in names)
        columns = {name: [*mine, *theirs] for name, (mine, theirs) in zip(names, parts, strict=True)}
        return Labels(np.concatenate([self.ids, other.ids]), columns)

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Labels":
        """Labels of the landmarks selected by `chosen`."""
        columns = {name: np.array(texts, dtype=object)[chosen].tolist() for name, texts in self.columns.items()}
        return Labels(self.ids[chosen], columns)
