"""Frames of a bundle adjustment, which are eliminated from its normal equations.

A sighting connects one frame with tags, cameras and other *kept* unknowns, so the block H_ff of the frames is block
diagonal, or block tridiagonal if motion links each frame with the next one (`lmd.adjust.links`). With links, its
Cholesky factor is a band matrix. Time and memory are linear in the number of frames.

Source: Triggs et al., "Bundle Adjustment - A Modern Synthesis"; Barfoot, "State Estimation for Robotics".
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from lmd.adjust.links import Links
from lmd.core.checks import FloatArray, IntArray

COLUMNS = 512  # columns of the kept unknowns that are eliminated at once
LEAST_DAMPING = 1e-9  # least relative growth of diagonals in a solution
WEAKEST = 1e-9  # information on velocities without links


class Part(NamedTuple):
    """Normal equations of f successive frames."""

    block: FloatArray
    """`(f, 6, 6)` H_ff by the sightings."""
    gradient: FloatArray
    """`(f, 6)` g_f."""
    panel: FloatArray
    """`(f, 6, r, 6)` H_fk for the r kept blocks `rows`."""
    rows: IntArray
    """`(r,)` indices of the kept blocks."""

    def reached(self, kept: FloatArray) -> FloatArray:
        """H_fk x for values x `(kept, 6, ...)` of all kept unknowns, `(f, 6, ...)`."""
        some = kept[self.rows]
        wide = self.panel.reshape(-1, 6 * len(self.rows)) @ some.reshape(6 * len(self.rows), -1)
        return wide.reshape(len(self.panel), 6, *some.shape[2:])


class Frames(Protocol):
    """Equations of all frames at one linearisation."""

    def eliminate(self, parts: list[Part], matrix: FloatArray, right: FloatArray) -> None:
        """Subtract H_kf H_ff^-1 H_fk from `matrix` `(6 kept, 6 kept)` and H_kf H_ff^-1 g_f from `right` `(kept, 6)`."""

    def steps(self, pull: FloatArray) -> FloatArray:
        """Twists `(F, 6)` that solve H_ff x = g_f - pull, for `pull` `(F, 6)`."""

    def covariances(self, reach: FloatArray, share: float) -> FloatArray:
        """Diagonal blocks of `share` H_ff^-1 + H_ff^-1 R R^T H_ff^-1 for `reach` R `(F, 6, m)`, `(F, 6, 6)`."""

    @property
    def log_determinant(self) -> float:
        """Log-determinant of H_ff."""


class SeparateFrames:
    """Frames that are independent of each other, see `Frames`."""

    def eliminate(self, parts: list[Part], matrix: FloatArray, right: FloatArray) -> None:
        """See `Frames.eliminate`."""
        blocks = [part.block + LEAST_DAMPING * (part.block + 1.0) * np.eye(6) for part in parts]
        for part, block in zip(parts, blocks, strict=True):
            lower = np.asarray(np.linalg.cholesky(block), dtype=np.float64)
            # H_kf L^-T, whose product with its transpose is H_kf H_ff^-1 H_fk.
            half = np.linalg.solve(lower, part.panel.reshape(len(block), 6, -1))
            wide = np.ascontiguousarray(half.reshape(6 * len(block), -1).T)
            index = (6 * part.rows[:, None] + np.arange(6)).ravel()
            matrix[np.ix_(index, index)] -= wide @ wide.T
            right[part.rows] -= (wide @ solved(lower, part.gradient).ravel()).reshape(-1, 6)
        self.block, self.gradient = np.concatenate(blocks), np.concatenate([part.gradient for part in parts])

    def steps(self, pull: FloatArray) -> FloatArray:
        """See `Frames.steps`."""
        return solved(self.block, self.gradient - pull)

    def covariances(self, reach: FloatArray, share: float) -> FloatArray:
        """See `Frames.covariances`."""
        moved = np.linalg.solve(self.block, reach)
        return np.asarray(share * np.linalg.inv(self.block) + moved @ np.swapaxes(moved, 1, 2))

    @property
    def log_determinant(self) -> float:
        """See `Frames.log_determinant`."""
        return float(np.linalg.slogdet(self.block)[1].sum())


class LinkedFrames:
    """Frames at `poses` `(F, 4, 4)` that `links` connect, see `Frames`."""

    def __init__(self, links: Links, poses: FloatArray, is_robust: bool) -> None:
        self.links, size, count = links, links.size, len(poses)
        self.diagonal = np.tile(WEAKEST * np.eye(size), (count, 1, 1))
        self.below, self.right = np.zeros((count, size, size)), np.zeros((count, size))
        at, first, information = links.at(poses), links.first, links.information
        if is_robust:
            information = information * links.weights(links.squares(at.error))[:, None, None]
        from_first, from_second, from_bias = (
            np.swapaxes(slope, 1, 2) @ information for slope in (at.by_first, at.by_second, at.by_bias)
        )
        self.diagonal[first] += from_first @ at.by_first
        self.diagonal[first + 1] += from_second @ at.by_second
        self.below[first] = from_second @ at.by_first
        self.right[first] -= (from_first @ at.error[..., None])[..., 0]
        self.right[first + 1] -= (from_second @ at.error[..., None])[..., 0]
        self.border = np.zeros((count, size, len(at.bias)))
        self.border[first] += from_first @ at.by_bias
        self.border[first + 1] += from_second @ at.by_bias
        self.corner = np.eye(len(at.bias)) + (from_bias @ at.by_bias).sum(axis=0)
        self.bias = -at.bias - (from_bias @ at.error[..., None]).sum(axis=0)[:, 0]
        self.chain: Any = None

    def eliminate(self, parts: list[Part], matrix: FloatArray, right: FloatArray) -> None:
        """See `Frames.eliminate`."""
        from scipy.sparse import coo_array

        size, first, entries = self.links.size, 0, []
        for part in parts:
            own = slice(first, first + len(part.block))
            self.diagonal[own, :6, :6] += part.block
            self.right[own, :6] += part.gradient
            where = np.nonzero(part.panel)
            along = 6 * part.rows[where[2]] + where[3]
            entries.append((part.panel[where], size * (first + where[0]) + where[1], along))
            first = own.stop
        self.chain = Chain.of(banded(self.diagonal, self.below), self.border.reshape(size * first, -1), self.corner)
        values, across, along = (np.concatenate(each) for each in zip(*entries, strict=True))
        coupling = coo_array((values, (across, along)), shape=(size * first, len(matrix))).tocsc()
        right -= (coupling.T @ self.chain.solved(self.right.reshape(-1, 1), self.bias)).reshape(-1, 6)
        parts_of = [slice(start, start + COLUMNS) for start in range(0, len(matrix), COLUMNS)]
        for k, one in enumerate(parts_of):
            half = self.chain.half_solved(coupling[:, one].toarray())
            for other in parts_of[: k + 1]:
                beside = half if other is one else self.chain.half_solved(coupling[:, other].toarray())
                matrix[one, other] -= (product := half.T @ beside)
                if other is not one:
                    matrix[other, one] -= product.T
        if self.chain.left.size:
            through = self.chain.reached.T @ coupling
            matrix -= through.T @ np.linalg.solve(self.chain.left, through)

    def steps(self, pull: FloatArray) -> FloatArray:
        """See `Frames.steps`."""
        right = self.right.copy()
        right[:, :6] -= pull
        return np.asarray(self.chain.solved(right.reshape(-1, 1), self.bias).reshape(right.shape)[:, :6])

    def covariances(self, reach: FloatArray, share: float) -> FloatArray:
        """See `Frames.covariances`."""
        found, whole = share * self.chain.inverse_blocks(self.links.size), np.zeros((*self.right.shape, reach.shape[2]))
        whole[:, :6] = reach
        for start in range(0, reach.shape[2], COLUMNS):
            some = whole[..., start : start + COLUMNS]
            moved = self.chain.solved(some.reshape(self.right.size, -1)).reshape(some.shape)
            found += moved @ np.swapaxes(moved, 1, 2)
        return np.asarray(found[:, :6, :6])

    @property
    def log_determinant(self) -> float:
        """See `Frames.log_determinant`."""
        return float(self.chain.log_determinant)


def solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions `(n, m)` of n systems `(n, m, m)`."""
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0], dtype=np.float64)


class Chain(NamedTuple):
    """Factors of the matrix [B c; c^T d] for n unknowns of frames and e unknowns of the odometry's bias; B is a band
    matrix.
    """

    factor: FloatArray
    """Banded Cholesky factor of B."""
    border: FloatArray
    """`(n, e)` c; e is 0 or 6."""
    reached: FloatArray
    """`(n, e)` B^-1 c."""
    left: FloatArray
    """`(e, e)` d - c^T B^-1 c."""

    @classmethod
    def of(cls, band: FloatArray, border: FloatArray, corner: FloatArray) -> "Chain":
        """Factor a matrix that is given by the lower band of B, by c and by d."""
        from scipy.linalg import cho_solve_banded, cholesky_banded

        factor = cholesky_banded(band, lower=True, check_finite=False)
        reached = cho_solve_banded((factor, True), border) if border.size else border
        return cls(factor, border, reached, corner - border.T @ reached)

    def solved(self, right: FloatArray, bias: FloatArray | None = None) -> FloatArray:
        """Solution for the frames, `(n, m)`.

        Args:
            right: right side of the frames, `(n, m)`.
            bias: right side of the bias, for all m, `(e,)`; None for 0.
        """
        from scipy.linalg import cho_solve_banded

        own = cho_solve_banded((self.factor, True), right, check_finite=False)
        if not self.left.size:
            return np.asarray(own)
        rest = -self.border.T @ own + (0.0 if bias is None else bias[:, None])
        return np.asarray(own - self.reached @ np.linalg.solve(self.left, rest))

    def half_solved(self, right: FloatArray) -> FloatArray:
        """L^-1 times `right` `(n, m)`, with the Cholesky factor L of B."""
        from scipy.linalg.lapack import dtbtrs

        return np.asarray(dtbtrs(self.factor, right, uplo="L")[0])

    def inverse_blocks(self, size: int) -> FloatArray:
        """Diagonal blocks, of the frames, of the inverse of the matrix, `(F, size, size)`; B has blocks of that size.

        With the blocks L_k and M_k of the Cholesky factor in column k, block k of B^-1 is Z_k = L_k^-T (I + M_k^T
        Z_k+1 M_k) L_k^-1.
        """
        count = self.factor.shape[1] // size
        columns = self.factor.reshape(len(self.factor), count, size)
        own, below = np.zeros((2, count, size, size))
        for column in range(size):
            rows = np.arange(size)
            low = rows[column:]
            own[:, low, column] = columns[low - column, :, column].T
            below[:, :, column] = columns[size + rows - column, :, column].T
        back = np.linalg.inv(own)
        found = np.swapaxes(back, 1, 2) @ back
        across = below @ back
        for k in range(count - 2, -1, -1):
            found[k] += across[k].T @ found[k + 1] @ across[k]
        if self.left.size:
            reached = self.reached.reshape(count, size, -1)
            found += reached @ np.linalg.inv(self.left) @ np.swapaxes(reached, 1, 2)
        return np.asarray(found)

    @property
    def log_determinant(self) -> float:
        """Log-determinant of the matrix."""
        return 2.0 * float(np.log(self.factor[0]).sum()) + float(np.linalg.slogdet(self.left)[1])


def banded(diagonal: FloatArray, below: FloatArray) -> FloatArray:
    """Lower band of a block tridiagonal matrix with blocks `(F, b, b)`, in scipy's layout, `(2 b, F b)`."""
    count, size, _ = diagonal.shape
    banded = np.zeros((2 * size, count, size))
    for column in range(size):
        rows = np.arange(size)
        low = rows[column:]
        banded[low - column, :, column] = diagonal[:, low, column].T
        banded[size + rows - column, :, column] = below[:, :, column].T
    return banded.reshape(2 * size, count * size)
