"""Links: relative pose constraints between consecutive frames, their errors and Jacobians; see `lmd.adjust.motion`."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import adjoint_matrix, inverse, log, skew

# chi^2 above which a link of odometry has less weight; normal errors exceed this value once in a thousand times.
MOST_SQUARE = 22.5
BIAS_ROUNDS = 3  # reweighted least-squares rounds for the bias of odometry
LEAST_STIFFNESS = 1e-9  # information on a velocity without links
# Odometry belongs to another camera or drive if the share of links that do not fit exceeds `MOST_OFF`, or if the bias
# exceeds `MOST_BIAS`, in units of `lmd.adjust.motion.BIAS`.
MOST_OFF, MOST_BIAS = 0.5, 8.0


class LinkErrors(NamedTuple):
    """Errors of M links with r components, and their Jacobians by the b unknowns of each frame."""

    error: FloatArray
    """`(M, r)` errors."""
    by_first: FloatArray
    """`(M, r, b)` Jacobian by the first frame: its right-hand twist, and its turn rate and velocity if b = 12."""
    by_second: FloatArray
    """`(M, r, b)` Jacobian by the second frame."""
    by_bias: FloatArray
    """`(M, r, 6)` Jacobian by `bias`; `(M, r, 0)` for a constant velocity."""
    bias: FloatArray
    """`(6,)` error common to all metres of odometry, in units of `lmd.adjust.motion.BIAS`; `(0,)` for a constant
    velocity.
    """


@dataclass(frozen=True)
class Links:
    """M links between F frames; a link connects a frame with the next frame."""

    size: int
    """Number b of unknowns of a frame: 6, or 12 with its turn rate and velocity."""
    first: IntArray
    """`(M,)` index of the first frame of each link; the second frame has the next index."""
    seconds: FloatArray
    """`(M,)` time between the two frames, seconds."""
    information: FloatArray
    """`(M, r, r)` inverse of the covariance of the error."""
    steps: FloatArray | None
    """`(M, 4, 4)` relative poses by odometry; None for a constant velocity."""
    by_bias: FloatArray | None
    """`(M, 6, 6)` derivatives of the relative poses by the bias of odometry; None for a constant velocity."""

    def at(self, poses: FloatArray) -> LinkErrors:
        """Errors of the links, and Jacobians, at poses of the frames, `(F, 4, 4)`."""
        before, after = poses[self.first], poses[self.first + 1]
        between = inverse(before) @ after
        if self.steps is not None and self.by_bias is not None:
            error = log(inverse(self.steps) @ between)
            slope, bias = _by_twist(error), np.zeros(6)
            for _ in range(BIAS_ROUNDS):  # links that do not fit have little weight
                weights = self.weights(self.squares(error - self.by_bias @ bias))
                turned = np.swapaxes(self.by_bias, 1, 2) @ (self.information * weights[:, None, None])
                matrix = np.eye(6) + (turned @ self.by_bias).sum(axis=0)
                bias = np.linalg.solve(matrix, (turned @ error[..., None]).sum(axis=0)[:, 0])
            by_first = -slope @ adjoint_matrix(inverse(between))
            return LinkErrors(error - self.by_bias @ bias, by_first, slope, -self.by_bias, bias)
        rates = self._rates(poses)
        turn, way = log(between)[:, :3], after[:, :3, 3] - before[:, :3, 3]
        change = rates[self.first + 1] - rates[self.first]
        off = np.concatenate([turn, way], axis=1) - self.seconds[:, None] * rates[self.first]
        by_first, by_second = np.zeros((2, len(self.first), 12, 12))
        by_second[:, :3, :3], by_first[:, :3, :3] = _by_turn(turn), -_by_turn(-turn)
        by_second[:, 3:6, 3:6], by_first[:, 3:6, 3:6] = after[:, :3, :3], -before[:, :3, :3]
        by_second[:, 6:, 6:], by_first[:, 6:, 6:] = np.eye(6), -np.eye(6)
        by_first[:, :6, 6:] = -self.seconds[:, None, None] * np.eye(6)
        nothing = np.zeros((len(self.first), 12, 0))
        return LinkErrors(np.concatenate([off, change], axis=1), by_first, by_second, nothing, np.zeros(0))

    def _rates(self, poses: FloatArray) -> FloatArray:
        """Turn rates and velocities that fit poses best, `(F, 6)`: derivatives of natural cubic splines."""
        from scipy.linalg import solveh_banded

        before, after, h = poses[self.first], poses[self.first + 1], self.seconds
        turn, way = log(inverse(before) @ after)[:, :3], after[:, :3, 3] - before[:, :3, 3]
        pull = 6.0 * np.concatenate([turn, way], axis=1) / h[:, None] ** 2
        banded, right = np.full((2, len(poses)), LEAST_STIFFNESS), np.zeros((len(poses), 6))
        banded[1] = 0.0
        for place in (self.first, self.first + 1):
            banded[0, place] += 4.0 / h
            right[place] += pull
        banded[1, self.first] = 2.0 / h
        return np.asarray(solveh_banded(banded, right, lower=True))

    def velocities(self, poses: FloatArray) -> FloatArray:
        """Turn rates and velocities in the body's frame, `(F, 6)`; NaN for frames without links."""
        rates = self._rates(poses)
        result = np.concatenate([rates[:, :3], (rates[:, None, 3:] @ poses[:, :3, :3])[:, 0]], axis=1)
        linked = np.zeros(len(poses), dtype=bool)
        linked[self.first] = linked[self.first + 1] = True
        result[~linked] = np.nan
        return result

    def squares(self, error: FloatArray) -> FloatArray:
        """chi^2 of each link, `(M,)`, by its error `(M, r)`."""
        return np.asarray(np.einsum("mi,mij,mj->m", error, self.information, error))

    def loss(self, squares: FloatArray) -> float:
        """Sum of the losses of the links; the loss is robust against large errors of odometry, as wheels slip."""
        if self.steps is None:
            return 0.5 * float(squares.sum())
        least = np.minimum(squares, MOST_SQUARE)
        return 0.5 * float((least + MOST_SQUARE * np.log(np.maximum(squares, MOST_SQUARE) / MOST_SQUARE)).sum())

    def weights(self, squares: FloatArray) -> FloatArray:
        """Robust weights of the links, `(M,)`, by chi^2."""
        return np.ones(len(squares)) if self.steps is None else MOST_SQUARE / np.maximum(squares, MOST_SQUARE)

    def check(self, poses: FloatArray) -> None:
        """Raise `InputError` if odometry contradicts the images, by poses of the frames, `(F, 4, 4)`."""
        if self.steps is None or not len(self.first):
            return
        at = self.at(poses)
        off = float((self.squares(at.error) > MOST_SQUARE).mean())
        if off > MOST_OFF or np.abs(at.bias).max() > MOST_BIAS:
            raise InputError(
                "odometry does not move as the images do: does it need a mount or frame=body, as it describes a body "
                "and not the (first) camera, or is it of another drive?",
                "odometry",
            )

    @property
    def log_determinant(self) -> float:
        """Log-determinant of the covariance of all errors."""
        return -float(np.linalg.slogdet(self.information)[1].sum())


def _by_twist(twist: FloatArray) -> FloatArray:
    """Derivative of log(E exp(d)) by d at a small log(E) = twist `(..., 6)`, `(..., 6, 6)`: inverse right Jacobian."""
    matrix = np.zeros((*twist.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = skew(twist[..., :3])
    matrix[..., 3:, :3] = skew(twist[..., 3:])
    square = matrix @ matrix
    return np.asarray(np.eye(6) + matrix / 2.0 + square / 12.0 - square @ square / 720.0)


def _by_turn(turn: FloatArray) -> FloatArray:
    """Inverse right Jacobian of rotations, `(..., 3)` -> `(..., 3, 3)`."""
    return _by_twist(turn_twist(turn))[..., :3, :3]


def turn_twist(turn: FloatArray) -> FloatArray:
    """Twists of rotations alone, `(..., 3)` -> `(..., 6)`."""
    return np.concatenate([turn, 0.0 * turn], axis=-1)
