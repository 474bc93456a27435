"""Links between frames that follow each other: errors of their relative poses, and how these change with the poses.

See `lmd.survey.motion`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse, log, skew

# chi^2 of a link of odometry up to which it counts in full; normal errors exceed it once in a thousand times.
MOST_SQUARE = 22.5
LEAN_ROUNDS = 3


class Joints(NamedTuple):
    """Derivatives of M links by the frames, whose unknowns are b numbers."""

    error: FloatArray
    """`(M, r)`."""
    by_one: FloatArray
    """`(M, r, b)` how the error changes with the unknowns of the first frame: a right-hand twist, and velocities."""
    by_other: FloatArray
    """`(M, r, b)` with those of the second."""
    by_lean: FloatArray
    """`(M, r, 6)` with what every metre is off by, in units of `LEAN`; `(M, r, 0)` where there is no such."""
    lean: FloatArray
    """`(6,)` what that is; `(0,)` likewise."""


@dataclass(frozen=True)
class Links:
    """Links between some frames, each of which follows the one before.

    Args:
        size: b, unknowns of a frame: 6, or 12 with its turn rate and velocity.
        one: places of the first frame of each link among the frames, `(M,)`; the second is the next.
        seconds: between them, `(M,)`.
        information: inverse of the covariance of the error, `(M, r, r)`.
        steps: relative poses by odometry, `(M, 4, 4)`; None for a constant velocity.
        leans: how their errors change with what every metre is off by, in units of `LEAN`, `(M, 6, 6)`; likewise.
    """

    size: int
    one: IntArray
    seconds: FloatArray
    information: FloatArray
    steps: FloatArray | None
    leans: FloatArray | None

    def at(self, poses: FloatArray) -> Joints:
        """The links at poses of the frames, `(F, 4, 4)`."""
        before, after = poses[self.one], poses[self.one + 1]
        between = inverse(before) @ after
        if self.steps is not None and self.leans is not None:
            error = log(inverse(self.steps) @ between)
            slope, lean = _by_twist(error), np.zeros(6)
            for _ in range(LEAN_ROUNDS):  # links that do not fit say little of it
                weights = self.weights(self.squares(error - self.leans @ lean))
                turned = np.swapaxes(self.leans, 1, 2) @ (self.information * weights[:, None, None])
                matrix = np.eye(6) + (turned @ self.leans).sum(axis=0)
                lean = np.linalg.solve(matrix, (turned @ error[..., None]).sum(axis=0)[:, 0])
            by_one = -slope @ adjoints(inverse(between))
            return Joints(error - self.leans @ lean, by_one, slope, -self.leans, lean)
        rates = self._rates(poses)
        phi, way = log(between)[:, :3], after[:, :3, 3] - before[:, :3, 3]
        change = rates[self.one + 1] - rates[self.one]
        off = np.concatenate([phi, way], axis=1) - self.seconds[:, None] * rates[self.one]
        by_one, by_other = np.zeros((2, len(self.one), 12, 12))
        by_other[:, :3, :3], by_one[:, :3, :3] = _by_turn(phi), -_by_turn(-phi)
        by_other[:, 3:6, 3:6], by_one[:, 3:6, 3:6] = after[:, :3, :3], -before[:, :3, :3]
        by_other[:, 6:, 6:], by_one[:, 6:, 6:] = np.eye(6), -np.eye(6)
        by_one[:, :6, 6:] = -self.seconds[:, None, None] * np.eye(6)
        nothing = np.zeros((len(self.one), 12, 0))
        return Joints(np.concatenate([off, change], axis=1), by_one, by_other, nothing, np.zeros(0))

    def _rates(self, poses: FloatArray) -> FloatArray:
        """Turn rates and velocities that fit poses best, `(F, 6)`: those of natural cubic splines."""
        from scipy.linalg import solveh_banded

        before, after, h = poses[self.one], poses[self.one + 1], self.seconds
        turn, way = log(inverse(before) @ after)[:, :3], after[:, :3, 3] - before[:, :3, 3]
        pull = 6.0 * np.concatenate([turn, way], axis=1) / h[:, None] ** 2
        banded, right = np.full((2, len(poses)), 1e-9), np.zeros((len(poses), 6))
        banded[1] = 0.0
        for place in (self.one, self.one + 1):
            banded[0, place] += 4.0 / h
            right[place] += pull
        banded[1, self.one] = 2.0 / h
        return np.asarray(solveh_banded(banded, right, lower=True))

    def velocities(self, poses: FloatArray) -> FloatArray:
        """Velocities in the body's frame, turn first, `(F, 6)`; NaN for frames without links."""
        rates = self._rates(poses)
        result = np.concatenate([rates[:, :3], (rates[:, None, 3:] @ poses[:, :3, :3])[:, 0]], axis=1)
        linked = np.zeros(len(poses), dtype=bool)
        linked[self.one] = linked[self.one + 1] = True
        result[~linked] = np.nan
        return result

    def squares(self, error: FloatArray) -> FloatArray:
        """chi^2 of each link, `(M,)`."""
        return np.asarray(np.einsum("mi,mij,mj->m", error, self.information, error))

    def cost(self, squares: FloatArray) -> float:
        """The part of the links in the sum that is minimised; large errors of odometry count less, as wheels slip."""
        if self.steps is None:
            return 0.5 * float(squares.sum())
        least = np.minimum(squares, MOST_SQUARE)
        return 0.5 * float((least + MOST_SQUARE * np.log(np.maximum(squares, MOST_SQUARE) / MOST_SQUARE)).sum())

    def weights(self, squares: FloatArray) -> FloatArray:
        """Weights of the links, `(M,)`."""
        return np.ones(len(squares)) if self.steps is None else MOST_SQUARE / np.maximum(squares, MOST_SQUARE)

    @property
    def log_determinant(self) -> float:
        """Of all covariances of the errors."""
        return -float(np.linalg.slogdet(self.information)[1].sum())


def adjoints(pose: FloatArray) -> FloatArray:
    """Ad_X of poses `(..., 4, 4)` as matrices, `(..., 6, 6)`."""
    result = np.zeros((*pose.shape[:-2], 6, 6))
    turn = pose[..., :3, :3]
    result[..., :3, :3], result[..., 3:, 3:], result[..., 3:, :3] = turn, turn, skew(pose[..., :3, 3]) @ turn
    return result


def _by_twist(twist: FloatArray) -> FloatArray:
    """The derivative of log(E exp(d)) by d at log(E) = twist, small, `(..., 6, 6)`."""
    matrix = np.zeros((*twist.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = skew(twist[..., :3])
    matrix[..., 3:, :3] = skew(twist[..., 3:])
    square = matrix @ matrix
    return np.asarray(np.eye(6) + matrix / 2.0 + square / 12.0 - square @ square / 720.0)


def turning(turn: FloatArray) -> FloatArray:
    """Twists of turns alone, `(..., 6)`."""
    return np.concatenate([turn, 0.0 * turn], axis=-1)


def _by_turn(turn: FloatArray) -> FloatArray:
    """The same for turns alone, `(..., 3, 3)`."""
    return _by_twist(turning(turn))[..., :3, :3]
