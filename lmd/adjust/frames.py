"""Elimination of the frames from the normal equations of a bundle adjustment.

A sighting connects one frame with tags, cameras and other *kept* unknowns (see `lmd.adjust.adjustment`). So the frames'
block H_ff of the normal matrix is block diagonal, or block tridiagonal if motion links each frame with the next one
(`lmd.adjust.motion`). With links, the Cholesky factor of H_ff is a band matrix. Time and memory are linear in the
number of frames.

Source: Triggs et al., "Bundle Adjustment - A Modern Synthesis"; Barfoot, "State Estimation for Robotics".
"""

from typing import NamedTuple

import numpy as np

from lmd.adjust.corners import LEAST_DAMPING, solved
from lmd.adjust.links import LEAST_STIFFNESS, Links
from lmd.adjust.prior import Kept
from lmd.core.checks import FloatArray, IntArray

COLUMNS = 512  # number of columns of the kept unknowns that are processed together


class Part(NamedTuple):
    """Normal equations of f successive frames: the frames' own blocks, and the blocks that couple frames and kept
    unknowns. The kept unknowns are all but the frames' poses, in blocks of six.
    """

    block: FloatArray
    """Blocks of H_ff due to the sightings, `(f, 6, 6)`."""
    gradient: FloatArray
    """Right side g_f of the frames, `(f, 6)`."""
    panel: FloatArray
    """H_fk for those r blocks of kept unknowns on which the sightings of these frames depend, `(f, 6, r, 6)`."""
    rows: IntArray
    """Indices of these r blocks, `(r,)`."""

    def reached(self, kept: FloatArray) -> FloatArray:
        """Product H_fk x, `(f, 6, ...)`, by which the kept unknowns x enter the equations of these f frames. H_fk is
        the block of the normal matrix with the rows of these frames and the columns of the kept unknowns. The argument
        `kept` `(n, 6, ...)` is x, for n blocks of six unknowns.
        """
        some = kept[self.rows]
        wide = self.panel.reshape(-1, 6 * len(self.rows)) @ some.reshape(6 * len(self.rows), -1)
        return wide.reshape(len(self.panel), 6, *some.shape[2:])


class SeparateFrames:
    """Frames that are independent of each other. `parts` has their normal equations, in pieces of successive frames."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = parts
        self.block = np.concatenate([part.block for part in parts])
        self.block += LEAST_DAMPING * (self.block + 1.0) * np.eye(6)
        self.gradient = np.concatenate([part.gradient for part in parts])

    def eliminate(self, matrix: FloatArray, right: FloatArray) -> None:
        """Eliminate the frames (f) from the normal equations of the kept unknowns (k), in place. H_kf H_ff^-1 H_fk is
        subtracted from `matrix` `(6 n, 6 n)`, and H_kf H_ff^-1 g_f from `right` `(n, 6)`, for n blocks of six kept
        unknowns. H is the normal matrix, and g the right side of the equations.
        """
        ends = np.cumsum([len(part.block) for part in self.parts])
        for part, block in zip(self.parts, np.split(self.block, ends[:-1]), strict=True):
            lower = np.asarray(np.linalg.cholesky(block), dtype=np.float64)
            # H_kf L^-T, whose product with its transpose is H_kf H_ff^-1 H_fk.
            half = np.linalg.solve(lower, part.panel.reshape(len(block), 6, -1))
            wide = np.ascontiguousarray(half.reshape(6 * len(block), -1).T)
            index = (6 * part.rows[:, None] + np.arange(6)).ravel()
            matrix[np.ix_(index, index)] -= wide @ wide.T
            right[part.rows] -= (wide @ solved(lower, part.gradient).ravel()).reshape(-1, 6)

    def steps(self, pull: FloatArray) -> FloatArray:
        """Steps x of the frames, `(F, 6)`: twists that solve H_ff x = g_f - pull. H_ff is the frames' normal matrix,
        and g_f its right side. `pull` `(F, 6)` is the product of H_fk and the step of the kept unknowns.
        """
        return solved(self.block, self.gradient - pull)

    def covariances(self, reach: FloatArray, share: float) -> FloatArray:
        """Covariances of the frames, `(F, 6, 6)`: the diagonal blocks of s H_ff^-1 + H_ff^-1 R R^T H_ff^-1. H_ff is the
        frames' normal matrix, and s is the factor `share` on the frames' own covariance H_ff^-1. R is `reach`
        `(F, 6, m)`, where R R^T = H_fk C H_kf for the covariance C of the kept unknowns.
        """
        moved = np.linalg.solve(self.block, reach)
        return np.asarray(share * np.linalg.inv(self.block) + moved @ np.swapaxes(moved, 1, 2))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of H_ff, the frames' block of the normal matrix."""
        return float(np.linalg.slogdet(self.block)[1].sum())


class LinkedFrames:
    """F frames that are connected by links of motion; the class has the methods of `SeparateFrames`.

    Args:
        parts: normal equations of the frames, from the sightings alone.
        links: the links.
        poses: poses of the frames, `(F, 4, 4)`.
        is_robust: True for robust weights of the links.
        kept: normal equations of the kept unknowns; the terms of the bias of odometry are added to them.
        bias: index of the bias of odometry among the blocks of kept unknowns.
    """

    def __init__(
        self, parts: list[Part], links: Links, poses: FloatArray, is_robust: bool, kept: Kept, bias: int
    ) -> None:
        at = links.at(poses)
        size, first, count = links.size, links.first, len(poses)
        self.diagonal = np.tile(LEAST_STIFFNESS * np.eye(size), (count, 1, 1))
        self.below, self.right = np.zeros((count, size, size)), np.zeros((count, size))
        border = np.zeros((count, size, at.by_bias.shape[2]))  # products with the bias
        weights = links.weights(links.squares(at.error)) if is_robust else np.ones(len(first))
        from_first, from_second, from_bias = (
            np.swapaxes(slope, 1, 2) @ (links.information * weights[:, None, None])
            for slope in (at.by_first, at.by_second, at.by_bias)
        )
        self.below[first] = from_second @ at.by_first
        for place, back, slope in ((first, from_first, at.by_first), (first + 1, from_second, at.by_second)):
            self.diagonal[place] += back @ slope
            self.right[place] -= (back @ at.error[..., None])[..., 0]
            border[place] += back @ at.by_bias
        self.diagonal[:, :6, :6] += np.concatenate([part.block for part in parts])
        self.right[:, :6] += np.concatenate([part.gradient for part in parts])
        if len(at.bias):
            kept.diagonal[bias] += np.eye(6) + (from_bias @ at.by_bias).sum(axis=0)
            kept.right[bias] -= at.bias + (from_bias @ at.error[..., None]).sum(axis=0)[:, 0]
            borders = np.split(border[:, :, None], np.cumsum([len(part.block) for part in parts])[:-1])
            parts = [
                part._replace(panel=np.concatenate([part.panel, beside], axis=2), rows=np.append(part.rows, bias))
                for part, beside in zip(parts, borders, strict=True)
            ]
        self.parts = parts

    def eliminate(self, matrix: FloatArray, right: FloatArray) -> None:
        """See `SeparateFrames.eliminate`."""
        from scipy.linalg import cholesky_banded
        from scipy.sparse import coo_array

        size, first, entries = self.right.shape[1], 0, []
        for part in self.parts:
            where = np.nonzero(part.panel)
            along = 6 * part.rows[where[2]] + where[3]
            entries.append((part.panel[where], size * (first + where[0]) + where[1], along))
            first += len(part.block)
        self.factor = cholesky_banded(banded(self.diagonal, self.below), lower=True, check_finite=False)
        values, across, along = (np.concatenate(each) for each in zip(*entries, strict=True))
        coupling = coo_array((values, (across, along)), shape=(self.right.size, len(matrix))).tocsc()
        right -= (coupling.T @ self._solved(self.right.reshape(-1, 1))).reshape(-1, 6)
        columns = [slice(start, start + COLUMNS) for start in range(0, len(matrix), COLUMNS)]
        for k, one in enumerate(columns):
            half = self._half_solved(coupling[:, one].toarray())
            for other in columns[: k + 1]:
                beside = half if other is one else self._half_solved(coupling[:, other].toarray())
                matrix[one, other] -= (product := half.T @ beside)
                if other is not one:
                    matrix[other, one] -= product.T

    def steps(self, pull: FloatArray) -> FloatArray:
        """See `SeparateFrames.steps`."""
        right = self.right.copy()
        right[:, :6] -= pull
        return self._solved(right.reshape(-1, 1)).reshape(right.shape)[:, :6]

    def covariances(self, reach: FloatArray, share: float) -> FloatArray:
        """See `SeparateFrames.covariances`."""
        found, whole = share * self._inverse_blocks(), np.zeros((*self.right.shape, reach.shape[2]))
        whole[:, :6] = reach
        for start in range(0, reach.shape[2], COLUMNS):
            some = whole[..., start : start + COLUMNS]
            moved = self._solved(some.reshape(self.right.size, -1)).reshape(some.shape)
            found += moved @ np.swapaxes(moved, 1, 2)
        return np.asarray(found[:, :6, :6])

    @property
    def log_determinant(self) -> float:
        """See `SeparateFrames.log_determinant`."""
        return 2.0 * float(np.log(self.factor[0]).sum())

    def _solved(self, right: FloatArray) -> FloatArray:
        """Product of H_ff^-1, the inverse of the frames' block of the normal matrix, and `right` `(n, m)`."""
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded((self.factor, True), right, check_finite=False))

    def _half_solved(self, right: FloatArray) -> FloatArray:
        """Product of L^-1 and `right` `(n, m)`. L is the Cholesky factor of H_ff, the frames' block of the normal
        matrix.
        """
        from scipy.linalg.lapack import dtbtrs

        return np.asarray(dtbtrs(self.factor, right, uplo="L")[0])

    def _inverse_blocks(self) -> FloatArray:
        """Diagonal blocks of H_ff^-1, `(F, size, size)`; `size` is the number of unknowns of a frame.

        Let L_k be diagonal block k of the Cholesky factor of H_ff, and M_k the block below L_k. Diagonal block k of
        H_ff^-1 is Z_k = L_k^-T (I + M_k^T Z_k+1 M_k) L_k^-1, which follows from block k + 1.
        """
        size = self.right.shape[1]
        rows = np.arange(size)
        columns = self.factor.reshape(2 * size, -1, size)
        own, below = np.zeros((2, columns.shape[1], size, size))
        for column in range(size):
            own[:, column:, column] = columns[: size - column, :, column].T
            below[:, :, column] = columns[size + rows - column, :, column].T
        back = np.linalg.inv(own)
        found, across = np.swapaxes(back, 1, 2) @ back, below @ back
        for k in range(len(found) - 2, -1, -1):
            found[k] += across[k].T @ found[k + 1] @ across[k]
        return np.asarray(found)


def banded(diagonal: FloatArray, below: FloatArray) -> FloatArray:
    """Lower band of a symmetric block tridiagonal matrix, in scipy's layout, `(2 b, F b)`. The matrix has the blocks
    `diagonal` `(F, b, b)`, and `below` `(F, b, b)` under them.
    """
    count, size, _ = diagonal.shape
    band, rows = np.zeros((2 * size, count, size)), np.arange(size)
    for column in range(size):
        band[: size - column, :, column] = diagonal[:, column:, column].T
        band[size + rows - column, :, column] = below[:, :, column].T
    return band.reshape(2 * size, count * size)
