"""Chains of frames: symmetric positive definite band matrices with a border, and their Cholesky factors."""

from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray


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
