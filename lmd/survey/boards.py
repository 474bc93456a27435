"""Tags that were printed on one sheet: how they are to each other is known, where the sheets hang is not.

A tag that is at R_k on its sheet (x to the right, y up, z out of it) hangs at T_k = B R_k exp(d_k), for the pose B of
the sheet and a twist d_k that printing and a bent sheet leave. Sheets are no unknowns of an adjustment: B is the best
for the tags as they hang, and with A_k = Ad(R_k^-1) and the information D_k of d_k, what the tags of a sheet know of
each other is D - D A (A' D A)^-1 A' D.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, check_fields, real
from lmd.core.tables import read_table
from lmd.geometry.se3 import adjoint, exp, inverse, log, pose_of
from lmd.scene.labels import Labels
from lmd.survey.student import DEGREES_OF_FREEDOM, solved, weight_of

# Standard deviations of how a sheet bends, off its plane (metres) and out of it (rad), and of turns in it, rad.
BENT, TILTED, TURNED = 0.001, 0.005, 0.001
FEWEST = 2  # tags of a sheet
STEPS = 6  # of Gauss and Newton, for the pose of a sheet


@dataclass(frozen=True)
class Boards:
    """Sheets of several tags each, flat and all the same way up.

    Args:
        names: of the sheet of each of M tags, `(M,)`.
        ids: of the tags, `(M,)`, all different.
        places: of their centres on their sheet, to the right and up, metres, `(M, 2)`.
        printed: standard deviation of these, metres.

    Raises:
        InputError: a tag is there twice, a sheet has one tag only, or `printed` is not positive.
    """

    names: tuple[str, ...]
    ids: IntArray
    places: FloatArray
    printed: float

    def __post_init__(self) -> None:
        check_fields(self, real, "printed", above=0.0)
        numbers, counts = np.unique(self.ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(f"boards has tag {numbers[counts > 1][0]} twice.", "boards")
        sheets, counts = np.unique(self.names, return_counts=True)
        if (counts < FEWEST).any():
            raise InputError(f"boards has one tag only on board {str(sheets[counts < FEWEST][0])!r}.", "boards")

    @classmethod
    def from_csv(cls, path: Any, printed: float) -> "Boards":
        """Read `board,id,x,y`; further columns are ignored.

        Raises:
            InputError: the file cannot be read, or what it holds are no such sheets.
        """
        table = read_table(path, name="boards")
        if "board" not in table:
            raise InputError(f"{path} lacks the column board.", "boards")
        rows = table.numbers(("id", "x", "y"), None)
        return cls(tuple(table.texts["board"]), Labels.of(table, ()).ids, rows[:, 1:], printed)

    def among(self, ids: IntArray) -> "Sheets":
        """What is known of the tags with these `ids` `(K,)`, ascending."""
        _, of, own = np.intersect1d(ids, self.ids, return_indices=True)
        places = np.hstack([self.places[own], np.zeros((len(own), 1))])
        board = np.unique(self.names, return_inverse=True)[1][own]
        deviations = np.array([TILTED, TILTED, TURNED, self.printed, self.printed, BENT])
        return Sheets(of, board, pose_of(np.eye(3), places), deviations**-2.0)


@dataclass(frozen=True)
class Fitted:
    """Sheets that lie as well as they can on tags.

    Args:
        off: d_k, `(M, 6)`.
        squares: chi^2 of each, `(M,)`.
        weights: of Student's distribution, `(M,)`.
    """

    off: FloatArray
    squares: FloatArray
    weights: FloatArray


@dataclass(frozen=True)
class Sheets:
    """M tags of a survey that are on sheets.

    Args:
        tag: the index of each among those of the survey, `(M,)`.
        board: which of the sheets it is on, `(M,)`.
        poses: R_k, `(M, 4, 4)`.
        information: of each of the six parts of d_k, `(6,)`.
    """

    tag: IntArray
    board: IntArray
    poses: FloatArray
    information: FloatArray

    def of(self, placed: BoolArray) -> "Sheets":
        """The sheets of the tags that are `placed`, `(K,)`; a sheet with fewer than two of these is left out."""
        own = placed[self.tag]
        own &= np.bincount(self.board[own], minlength=self.board.max(initial=0) + 1)[self.board] >= FEWEST
        board = np.unique(self.board[own], return_inverse=True)[1]
        return Sheets(self.tag[own], board, self.poses[own], self.information)

    @cached_property
    def turned(self) -> FloatArray:
        """A_k, `(M, 6, 6)`."""
        return np.stack([adjoint(inverse(self.poses), axis) for axis in np.eye(6)], axis=-1)

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """All pairs of tags on one sheet, each with itself, too."""
        one, other = np.nonzero(self.board[:, None] == self.board)
        return one, other

    def _off(self, sheets: FloatArray, which: IntArray, tags: FloatArray) -> FloatArray:
        """d of the tags `which` `(n,)` if their sheets are at `sheets` `(n, 4, 4)`."""
        return log(inverse(sheets @ self.poses[which]) @ tags[self.tag[which]])

    def fitted(self, tags: FloatArray) -> Fitted:
        """The sheets where they lie best on tags at `tags` `(K, 4, 4)`.

        Each begins where that of its tags has it with which the others agree most.
        """
        one, other = self.pairs
        proposed = tags[self.tag] @ inverse(self.poses)
        squares = (self.information * self._off(proposed[one], other, tags) ** 2).sum(axis=1)
        cost = np.bincount(one, np.log1p(squares / DEGREES_OF_FREEDOM))
        order = np.lexsort((cost, self.board))
        sheets = proposed[order[np.unique(self.board[order], return_index=True)[1]]]
        every = np.arange(len(self.tag))
        for _ in range(STEPS):
            off = self._off(sheets[self.board], every, tags)
            scaled = self.information * weight_of((self.information * off**2).sum(axis=1), 6)[:, None]
            right = self._summed(np.einsum("mij,mi->mj", self.turned, scaled * off))
            sheets = sheets @ exp(solved(self._summed(self._normal(scaled)), right))
        off = self._off(sheets[self.board], every, tags)
        squares = (self.information * off**2).sum(axis=1)
        return Fitted(off, squares, weight_of(squares, 6))

    def _normal(self, scaled: FloatArray) -> FloatArray:
        """A' D A of each tag, `(M, 6, 6)`."""
        return np.asarray(np.swapaxes(self.turned, 1, 2) @ (scaled[..., None] * self.turned))

    def _summed(self, values: FloatArray) -> FloatArray:
        """The sums over the tags of each sheet."""
        result = np.zeros((self.board.max() + 1, *values.shape[1:]))
        np.add.at(result, self.board, values)
        return result

    def couplings(self, weights: FloatArray) -> FloatArray:
        """What all `pairs` know of each other, D A (A' D A)^-1 A' D, `(P, 6, 6)`, for `weights` `(M,)` of tags."""
        one, other = self.pairs
        scaled = self.information * weights[:, None]
        wide = scaled[..., None] * self.turned
        inverted = np.linalg.inv(self._summed(self._normal(scaled)))
        return np.asarray(wide[one] @ inverted[self.board[one]] @ np.swapaxes(wide[other], 1, 2))
