"""Links between consecutive frames of a drive. A link compares the frames' relative pose with the relative pose that a
model of the motion predicts.

The two models are odometry and a nearly constant velocity; `lmd.adjust.motion` has the formulas of their errors and
covariances.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import adjoint_matrix, inverse, left_jacobian, log

# Prior standard deviation of the common error of every metre of odometry, rad and m; re-estimated from the drive.
BIAS = (0.005, 0.02)
# chi^2 above which a link of odometry has less weight; normal errors exceed this value once in a thousand times.
MOST_SQUARE = 22.5
BIAS_ROUNDS = 3  # number of rounds of reweighted least squares for the bias of odometry
LEAST_STIFFNESS = 1e-9  # information on the velocity of a frame without links
# Odometry belongs to another camera or drive if the share of links that do not fit exceeds `MOST_OFF`, or if the bias
# exceeds `MOST_BIAS`, in units of `BIAS`.
MOST_OFF, MOST_BIAS = 0.5, 8.0


class LinkErrors(NamedTuple):
    """Errors of M links between consecutive frames, and the errors' Jacobians. An error has r components, and a frame
    has b unknowns.
    """

    error: FloatArray
    """`(M, r)` errors."""
    by_first: FloatArray
    """`(M, r, b)` Jacobian with respect to the unknowns of the link's first frame: the twist of its pose, X -> X
    exp(twist), and, if b = 12, its turn rate and velocity.
    """
    by_second: FloatArray
    """`(M, r, b)` Jacobian with respect to the unknowns of the link's second frame."""
    by_bias: FloatArray
    """`(M, r, 6)` Jacobian with respect to `bias`; `(M, r, 0)` for a constant velocity."""
    bias: FloatArray
    """`(6,)` bias b of odometry, the error per metre that all steps share, in units of `BIAS`; `(0,)` for a constant
    velocity.
    """


@dataclass(frozen=True)
class Links:
    """M links between F frames; each link connects a frame with the next frame."""

    size: int
    """Number b of unknowns of a frame: 6 for its pose, or 12 for its pose, turn rate and velocity."""
    first: IntArray
    """`(M,)` index of the first frame of each link; the second frame has the next index."""
    seconds: FloatArray
    """`(M,)` time between the two frames, seconds."""
    information: FloatArray
    """`(M, r, r)` inverse covariance of each link's error."""
    steps: FloatArray | None = None
    """`(M, 4, 4)` relative poses by odometry; None for a constant velocity."""
    by_bias: FloatArray | None = None
    """`(M, 6, 6)` derivatives of the relative poses with respect to the bias of odometry; None for a constant
    velocity.
    """

    def at(self, poses: FloatArray) -> LinkErrors:
        """Errors of the links and their Jacobians, given the poses of the frames, `(F, 4, 4)`."""
        before, after = poses[self.first], poses[self.first + 1]
        between = inverse(before) @ after
        if self.steps is not None and self.by_bias is not None:
            error = log(inverse(self.steps) @ between)
            slope, bias = np.asarray(np.linalg.inv(left_jacobian(-error)), dtype=np.float64), np.zeros(6)
            for _ in range(BIAS_ROUNDS):  # links that do not fit have little weight
                weights = self.weights(self.squares(error - self.by_bias @ bias))
                turned = np.swapaxes(self.by_bias, 1, 2) @ (self.information * weights[:, None, None])
                matrix = np.eye(6) + (turned @ self.by_bias).sum(axis=0)
                bias = np.linalg.solve(matrix, (turned @ error[..., None]).sum(axis=0)[:, 0])
            by_first = -slope @ adjoint_matrix(inverse(between))
            return LinkErrors(error - self.by_bias @ bias, by_first, slope, -self.by_bias, bias)
        rates, way = self._rates(poses), self._ways(poses)
        change = rates[self.first + 1] - rates[self.first]
        off = way - self.seconds[:, None] * rates[self.first]
        by_first, by_second = np.zeros((2, len(self.first), 12, 12))
        turn = turn_twist(way[:, :3])
        by_second[:, :3, :3] = np.linalg.inv(left_jacobian(-turn)[:, :3, :3])
        by_first[:, :3, :3] = -np.linalg.inv(left_jacobian(turn)[:, :3, :3])
        by_second[:, 3:6, 3:6], by_first[:, 3:6, 3:6] = after[:, :3, :3], -before[:, :3, :3]
        by_second[:, 6:, 6:], by_first[:, 6:, 6:] = np.eye(6), -np.eye(6)
        by_first[:, :6, 6:] = -self.seconds[:, None, None] * np.eye(6)
        nothing = np.zeros((len(self.first), 12, 0))
        return LinkErrors(np.concatenate([off, change], axis=1), by_first, by_second, nothing, np.zeros(0))

    def _ways(self, poses: FloatArray) -> FloatArray:
        """Relative motion of the two frames of each link, `(M, 6)`: rotation vector, rad, then shift along the world's
        axes, metres.
        """
        before, after = poses[self.first], poses[self.first + 1]
        return np.hstack([log(inverse(before) @ after)[:, :3], after[:, :3, 3] - before[:, :3, 3]])

    def _rates(self, poses: FloatArray) -> FloatArray:
        """Turn rates, rad/s, and velocities in the world, m/s, of the frames, `(F, 6)`: derivatives of natural cubic
        splines through the poses.
        """
        from scipy.linalg import solveh_banded

        h, pull = self.seconds, 6.0 * self._ways(poses) / self.seconds[:, None] ** 2
        banded, right = np.full((2, len(poses)), LEAST_STIFFNESS), np.zeros((len(poses), 6))
        banded[1] = 0.0
        for place in (self.first, self.first + 1):
            banded[0, place] += 4.0 / h
            right[place] += pull
        banded[1, self.first] = 2.0 / h
        return np.asarray(solveh_banded(banded, right, lower=True))

    def velocities(self, poses: FloatArray) -> FloatArray:
        """Turn rates, rad/s, and velocities, m/s, of the frames, in the body's frame, `(F, 6)`; NaN for frames without
        links.
        """
        rates = self._rates(poses)
        result = np.concatenate([rates[:, :3], (rates[:, None, 3:] @ poses[:, :3, :3])[:, 0]], axis=1)
        result[~np.isin(np.arange(len(poses)), [self.first, self.first + 1])] = np.nan
        return result

    def squares(self, error: FloatArray) -> FloatArray:
        """chi^2 of each link, `(M,)`, from its error `(M, r)`."""
        return np.asarray(np.einsum("mi,mij,mj->m", error, self.information, error))

    def loss(self, poses: FloatArray) -> float:
        """Loss of the links plus loss of the odometry's bias, for poses `(F, 4, 4)` of the frames. The loss of a link
        of odometry is robust against large errors, as wheels may slip.
        """
        at = self.at(poses)
        squares, bias = self.squares(at.error), float(at.bias @ at.bias)
        if self.steps is None:
            return 0.5 * float(squares.sum())
        least = np.minimum(squares, MOST_SQUARE)
        slipped = MOST_SQUARE * np.log(np.maximum(squares, MOST_SQUARE) / MOST_SQUARE)
        return 0.5 * float((least + slipped).sum()) + 0.5 * bias

    def weights(self, squares: FloatArray) -> FloatArray:
        """Robust weights of the links, `(M,)`. `squares` `(M,)` has chi^2 of each link. All weights are 1 if the motion
        model is a constant velocity.
        """
        return np.ones(len(squares)) if self.steps is None else MOST_SQUARE / np.maximum(squares, MOST_SQUARE)

    def check(self, poses: FloatArray) -> None:
        """Check that odometry does not contradict the images. `poses` `(F, 4, 4)` are those of the frames, estimated
        from the images.

        Raises:
            InputError: too many links do not fit, or the bias of odometry is too large.
        """
        if self.steps is None or not len(self.first):
            return
        at = self.at(poses)
        off = float((self.squares(at.error) > MOST_SQUARE).mean())
        if off > MOST_OFF or np.abs(at.bias).max() > MOST_BIAS:
            raise InputError(
                "odometry contradicts the motion in the images: if its poses are not of the (first) camera, give mount "
                "or frame=body; check that it is of the same drive as the images, with a clock at most 0.5 s off.",
                "odometry",
            )


def turn_twist(turn: FloatArray) -> FloatArray:
    """Twists without translation, `(..., 6)`, from rotation vectors, `(..., 3)`."""
    return np.concatenate([turn, 0.0 * turn], axis=-1)
