"""Equivariant Kalman filter that estimates the pose of a body and the bias of its gyro.

The state is a pose T and a bias b of the measured body twist w. The gyro measures the angular part of w. Landmark i at
C_i is measured at y_i in the camera's frame. With the noise n of w and white noise `walk`,

    T' = T (w - b - n),    b' = walk,    y_i = T^-1 C_i + noise.

The filter is an extended Kalman filter of 12 numbers. Th and bh are the estimates, h is the time step. The prediction
Th <- Th exp(h (w - bh)) is exact for constant w and b. Below, Ad and ad are the adjoint maps of poses and twists, and J
is the left Jacobian, see `lmd.geometry.se3`.

The tangent group of SE(3) has pairs of a pose A and a twist a as elements. With its product (A, a)(B, b) = (A B, a +
Ad_A b) it acts on states by (T, b) -> (T A, Ad_A^-1 (b - a)). The system is equivariant. With the origin (I, 0) the
equivariant error is (e, z) = (T Th^-1, Ad_Th (b - bh)), in the frame of the map. The dynamics are

    e' = -e z,    z' = ad_W z    with W = Ad_Th (w - bh).

So the error of the bias has linear dynamics, which depend on the estimate only through W. For e = exp(x), the errors
change in a time step by

    x <- x - h J(h W) z,    z <- Ad_exp(h W) z.

The output is equivariant, too: without noise, Th y_i = e^-1 C_i. Let x = (u, v) and c_i = (C_i + Th y_i) / 2. Then the
residual Th y_i - C_i is c_i x u - v (with a cross product), up to third-order errors. After a correction (dx, dz), the
errors relative to the new estimate are x <- J(dx) x and z <- Ad_exp(dx) z. With these formulas the linear part of the
estimated bias stays 0, as only the gyro is biased.

Source: P. van Goor, T. Hamel and R. Mahony, "Equivariant filter (EqF)", IEEE Trans. Automatic Control 68 (6), 2023; A.
Fornasier et al., "Overcoming bias: equivariant filter design for biased attitude estimation with online calibration",
IEEE Robotics and Automation Letters 7 (4), 2022.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.estimators import Errors, errors_of
from lmd.estimation.fusion import CameraPoints, Uncertainty
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import act, adjoint, adjoint_matrix, exp, inverse, left_jacobian, skew


class State(NamedTuple):
    """Estimated pose and bias, with the covariance of their errors."""

    pose: FloatArray
    """Estimated pose Th, `(4, 4)`."""
    bias: FloatArray
    """Estimated bias bh, rad/s and m/s, `(6,)`."""
    covariance: FloatArray
    """Covariance of the errors (x, z), `(12, 12)`: x is the twist of the pose error, exp(x) = T Th^-1, and z = Ad_Th (b
    - bh) is the error of the bias in the map's frame.
    """


@dataclass(frozen=True)
class EquivariantFilter(Uncertainty):
    """Equivariant Kalman filter on the tangent group of SE(3), for a camera with a biased gyro among known landmarks.

    The assumed noise of gyro and bias comes from the odometry model of the recording (`Recording.odometry`).
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        return errors_of(recording, start, self.run)

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Iterate over the frames of run s. Yields the estimated pose, `(4, 4)`, and the covariance of its error as a
        body twist, `(6, 6)`.
        """
        for state in self.states(recording, s, start):
            to_body = adjoint_matrix(inverse(state.pose))
            yield state.pose, to_body @ state.covariance[:6, :6] @ to_body.T

    def states(self, recording: Recording, s: int, start: FloatArray) -> Iterator[State]:
        """Iterate over the frames of run s. Yields the estimated pose and bias in each frame, with the covariance of
        their errors. `start` is the initial estimate of the pose, `(4, 4)`.
        """
        known = recording.odometry
        gyro = np.repeat([1.0, 0.0], 3)
        spread = np.concatenate([self.initial, known.gyro_bias * gyro])
        density = np.concatenate([self.drift(recording), known.gyro_walk * gyro])
        state = State(start, np.zeros(6), self._from_body(start, spread**2))
        yield state
        for t, step in enumerate(np.diff(recording.time), start=1):
            state = self.predicted(state, recording.twists[s, t - 1], step, density)
            if recording.seen[s, t].any():
                state = self.corrected(state, CameraPoints.of(recording, s, t, self))
            yield state

    def predicted(self, state: State, twist: FloatArray, step: float, density: FloatArray) -> State:
        """Predict the state after a step of the odometry.

        Args:
            state: estimate before the step.
            twist: measured body twist w, `(6,)`.
            step: duration h of the step, seconds.
            density: standard deviations, per root second, of the errors of the twist (first 6) and of the bias, body's
                frame, `(12,)`.
        """
        moved = step * (twist - state.bias)
        pose = state.pose @ exp(moved)
        transition = self.transition(state.pose, moved, step)
        noise = self._from_body(pose, step * density**2)
        return State(pose, state.bias, transition @ state.covariance @ transition.T + noise)

    def _from_body(self, pose: FloatArray, squares: FloatArray) -> FloatArray:
        """Covariance `(12, 12)`, in the map's frame, of independent errors of pose and bias in the body's frame.

        `squares` `(12,)` has the variances of the errors, first of the pose; `pose` is the pose of the body.
        """
        turn = np.kron(np.eye(2), adjoint_matrix(pose))
        return np.asarray(turn @ np.diag(squares) @ turn.T)

    def corrected(self, state: State, seen: CameraPoints) -> State:
        """State after the correction with measured positions of landmarks, `seen`."""
        residual, jacobian, noise = self.residual(state.pose, seen)
        jacobian = np.pad(jacobian, ((0, 0), (0, 6)))
        spread = jacobian @ state.covariance @ jacobian.T + noise
        gain = np.linalg.solve(spread, jacobian @ state.covariance).T
        kept = np.eye(12) - gain @ jacobian
        covariance = kept @ state.covariance @ kept.T + gain @ noise @ gain.T
        return self.moved(State(state.pose, state.bias, covariance), gain @ residual)

    def transition(self, pose: FloatArray, moved: FloatArray, step: float) -> FloatArray:
        """Matrix that maps the errors of pose and bias before a step to the errors after the step, `(12, 12)`.

        The errors are x and z as in `State.covariance`.

        Args:
            pose: estimated pose Th before the step, `(4, 4)`.
            moved: estimated motion h (w - bh) in the step of duration h, `(6,)`.
            step: duration h of the step, seconds.
        """
        world = adjoint(pose, moved)
        return np.block([
            [np.eye(6), -step * left_jacobian(world)],
            [np.zeros((6, 6)), adjoint_matrix(exp(world))],
        ])  # fmt: skip

    def residual(self, pose: FloatArray, seen: CameraPoints) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual Th y_i - C_i of m landmarks, `(3 m,)`; its Jacobian with respect to the pose error x, `(3 m, 6)`;
        and its covariance, `(3 m, 3 m)`. `pose` is the estimated pose Th; `seen` has the measured positions y_i and the
        world positions C_i.
        """
        moved = act(pose, seen.value.reshape(-1, 3))
        middle = skew((moved + seen.landmarks) / 2.0)
        jacobian = np.concatenate([middle, np.broadcast_to(-np.eye(3), middle.shape)], axis=-1).reshape(-1, 6)
        turn = np.kron(np.eye(len(moved)), pose[:3, :3])
        return (moved - seen.landmarks).reshape(-1), jacobian, turn @ seen.covariance @ turn.T

    def moved(self, state: State, change: FloatArray) -> State:
        """Correct a state by the estimated errors of pose and bias, `change` = (dx, dz), `(12,)`; return the new state.

        The covariance of the new state is that of the errors relative to this state.
        """
        step, reset = exp(change[:6]), np.zeros((12, 12))
        reset[:6, :6], reset[6:, 6:] = left_jacobian(change[:6]), adjoint_matrix(step)
        bias = state.bias + adjoint(inverse(state.pose), change[6:])
        return State(step @ state.pose, bias, reset @ state.covariance @ reset.T)
