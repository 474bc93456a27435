"""Sheets with several tags. The poses of the tags on a sheet are known; the pose of the sheet is not.

Tag k has the pose R_k on its sheet (x to the right, y up, z out of the sheet) and the pose T_k = B R_k exp(d_k) in the
world, where B is the pose of the sheet and d_k a twist due to printing and bending. Sheets are no unknowns of the
bundle adjustment, as B is eliminated. With A_k = Ad(R_k^-1) and the information D of d, the tags of a sheet have the
joint information D - D A (A' D A)^-1 A' D.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, student_weight
from lmd.adjust.frames import solved
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import adjoint_matrix, exp, inverse, log

FEWEST = 2  # minimum number of tags of a sheet
STEPS = 6  # Gauss-Newton steps for the pose of a sheet


@dataclass(frozen=True)
class SheetFit:
    """Deviations of M tags from their places on the sheets, with each sheet at its best pose."""

    off: FloatArray
    """`(M, 6)` twists d_k."""
    squares: FloatArray
    """`(M,)` chi^2."""
    weights: FloatArray
    """`(M,)` robust weights."""


@dataclass(frozen=True)
class Sheets:
    """M tags of a survey that are on sheets."""

    tag: IntArray
    """`(M,)` indices of the tags in the survey."""
    board: IntArray
    """`(M,)` index of the sheet of each tag."""
    poses: FloatArray
    """`(M, 4, 4)` poses R_k of the tags on their sheets."""
    information: FloatArray
    """`(6,)` inverse variances of the components of d_k."""

    def of(self, placed: BoolArray) -> "Sheets":
        """Sheets of the tags that are `placed`, `(K,)`; sheets with fewer than two placed tags are dropped."""
        own = placed[self.tag]
        own &= np.bincount(self.board[own], minlength=self.board.max(initial=0) + 1)[self.board] >= FEWEST
        board = np.unique(self.board[own], return_inverse=True)[1]
        return Sheets(self.tag[own], board, self.poses[own], self.information)

    @cached_property
    def turned(self) -> FloatArray:
        """A_k, `(M, 6, 6)`."""
        return adjoint_matrix(inverse(self.poses))

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """Indices of all pairs of tags on one sheet, including each tag with itself."""
        one, other = np.nonzero(self.board[:, None] == self.board)
        return one, other

    def _off(self, sheets: FloatArray, which: IntArray, tags: FloatArray) -> FloatArray:
        """Twists d of the tags `which` `(n,)`, with their sheets at `sheets` `(n, 4, 4)`."""
        return log(inverse(sheets @ self.poses[which]) @ tags[self.tag[which]])

    def _squares(self, off: FloatArray) -> FloatArray:
        return np.asarray((self.information * off**2).sum(axis=1))

    def fitted(self, tags: FloatArray) -> SheetFit:
        """Fit the sheets to tags at `tags` `(K, 4, 4)`.

        The fit of a sheet starts with the pose that follows from the tag with which the other tags agree most.
        """
        one, other = self.pairs
        proposed = tags[self.tag] @ inverse(self.poses)
        squares = self._squares(self._off(proposed[one], other, tags))
        loss = np.bincount(one, np.log1p(squares / DEGREES_OF_FREEDOM))
        order = np.lexsort((loss, self.board))
        sheets = proposed[order[np.unique(self.board[order], return_index=True)[1]]]
        every = np.arange(len(self.tag))
        for _ in range(STEPS):
            off = self._off(sheets[self.board], every, tags)
            scaled = self.information * student_weight(self._squares(off), 6)[:, None]
            right = self._summed(np.einsum("mij,mi->mj", self.turned, scaled * off))
            sheets = sheets @ exp(solved(self._normal(scaled), right))
        off = self._off(sheets[self.board], every, tags)
        squares = self._squares(off)
        return SheetFit(off, squares, student_weight(squares, 6))

    def _normal(self, scaled: FloatArray) -> FloatArray:
        """A' D A of each sheet, `(S, 6, 6)`, for D `(M, 6)`."""
        return self._summed(np.swapaxes(self.turned, 1, 2) @ (scaled[..., None] * self.turned))

    def _summed(self, values: FloatArray) -> FloatArray:
        """Sums of values `(M, ...)` over the tags of each sheet."""
        result = np.zeros((self.board.max() + 1, *values.shape[1:]))
        np.add.at(result, self.board, values)
        return result

    def couplings(self, weights: FloatArray) -> FloatArray:
        """D A (A' D A)^-1 A' D for all `pairs`, `(P, 6, 6)`, for `weights` `(M,)` of tags."""
        one, other = self.pairs
        scaled = self.information * weights[:, None]
        wide = scaled[..., None] * self.turned
        inverted = np.linalg.inv(self._normal(scaled))
        return np.asarray(wide[one] @ inverted[self.board[one]] @ np.swapaxes(wide[other], 1, 2))
