"""Observer on SE(3): it estimates the pose of a camera from the measured twist and the landmarks in view.

    X-hat' = X-hat (U - epsilon - P(k_0 I_4 Q(Y-hat - Y)))

X is the camera pose, X-hat or Xh its estimate, and U the measured twist. Landmark i at C_i is measured at y_i = X^-1
C_i and predicted at yh_i = Xh^-1 C_i in the camera's frame. The error is e_i = yh_i - y_i, and the cost is f = 1/2 sum
k_i |e_i|^2 with the gains k_i. All sums are over the m landmarks visible at that instant. Twists (w, v) have the metric
diag(l^2 I, I) with a length l. The descent direction -epsilon (short: -eps) of f is

- left-invariant, as in the paper:  -eps = (l^-2 sum k_i yh_i x e_i, sum k_i e_i).
- right-invariant:             -eps = Ad_{Xh^-1} (l^-2 sum k_i C_i x s_i, sum k_i s_i) with s_i = C_i - Xh y_i.

The error dynamics of the right-invariant form do not depend on the trajectory. The paper takes Q, k_0 and P from a work
that is not public. Here Q(d) = -d e_4^T / m, where e_4 is the fourth unit vector, and d = Yh - Y is the sum of all e_i
with a fourth component 0. P is the orthogonal projection to se(3). Then -P(k_0 I_4 Q) is the translation k_0 mean(e_i),
which damps for k_0 > 0.

Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. II-A.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, NotNegative, Positive, choice
from lmd.estimation.estimators import Errors, pose_errors
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import act, adjoint, cross, exp, inverse

FORMS = ("right", "left")
# The correction diverges if the product of the time step and the sum of the gains reaches this value.
STABILITY_LIMIT = 2.0


@dataclass(frozen=True)
class Observer(Checked):
    """Observer: prediction with the measured twist, and correction with the landmarks in view.

    Raises:
        InputError: a value is out of range.
    """

    form: Annotated[str, partial(choice, options=FORMS)] = "right"
    """Form of the observer: `right`-invariant, or `left`-invariant as printed."""
    gain: Positive = 10.0
    """Rate kappa, 1/s. In each frame all gains k_i are kappa / sum(1 + |z_i|^2 / l^2), where z_i is C_i in the
    right-invariant form and y_i in the left-invariant form. So the fastest rate of convergence is kappa for any number
    of landmarks.
    """
    damping: NotNegative = 1.0
    """Damping gain k_0, 1/s."""
    length: Positive = 2.0
    """Length l of the metric, metres: a position error of l weighs as much as one radian."""

    def landmark_gain(self, landmarks: FloatArray, measured: FloatArray, seen: BoolArray) -> FloatArray:
        """Gain k_i of a landmark in the correction, equal for all landmarks of a frame, `(...)`; 0 if none is in view.

        Args:
            landmarks: positions C_i, world frame, metres, `(..., K, 3)`.
            measured: measured positions y_i, camera frame, metres, `(..., K, 3)`.
            seen: mask of the landmarks in view, `(..., K)`.
        """
        z = landmarks if self.form == "right" else measured
        total = (seen * (1.0 + (z**2).sum(axis=-1) / self.length**2)).sum(axis=-1)
        return np.where(total > 0.0, self.gain / np.where(total > 0.0, total, 1.0), 0.0)

    def correction(
        self, estimate: FloatArray, landmarks: FloatArray, measured: FloatArray, seen: BoolArray
    ) -> FloatArray:
        """Correction of the estimated poses: body twists, rad/s and m/s, `(..., 6)`; zero without a landmark in view.

        The twist is -epsilon - P(k_0 I_4 Q(Yh - Y)): a step that lowers the landmarks' errors, and damping, see the
        module's docstring.

        Args:
            estimate: estimated poses Xh, `(..., 4, 4)`.
            landmarks: positions C_i, world frame, metres, `(..., K, 3)`.
            measured: measured positions y_i, camera frame, metres, `(..., K, 3)`.
            seen: mask of the landmarks in view, `(..., K)`.
        """
        gain = self.landmark_gain(landmarks, measured, seen)[..., None]
        back = inverse(estimate)
        predicted = act(back, landmarks)
        error = np.where(seen[..., None], predicted - measured, 0.0)
        if self.form == "left":
            descent = self._twist(predicted, error, gain)
        else:
            residual = np.where(seen[..., None], landmarks - act(estimate, measured), 0.0)
            descent = adjoint(back, self._twist(landmarks, residual, gain))
        damped = self.damping * (-error.sum(axis=-2) / np.maximum(seen.sum(axis=-1), 1)[..., None])
        return np.asarray(descent - np.concatenate([np.zeros_like(damped), damped], axis=-1))

    def _twist(self, arms: FloatArray, forces: FloatArray, gain: FloatArray) -> FloatArray:
        """Twist (l^-2 k sum arm x force, k sum force), `(..., 6)`, with the gain k and the length l of the metric.

        `arms` are positions of landmarks and `forces` their errors, `(..., K, 3)` each; x is the cross product.
        """
        turning = cross(arms, forces).sum(axis=-2) / self.length**2
        return np.concatenate([gain * turning, gain * forces.sum(axis=-2)], axis=-1)

    def estimates(self, recording: Recording, start: FloatArray) -> FloatArray:
        """Estimated poses Xh at each of T frames, camera to world, `(S, T, 4, 4)`.

        In a time step h, the measured twist U moves the estimate: Xh <- Xh exp(h U). Then the correction xi from the
        landmarks in view in the new frame is applied: Xh <- Xh exp(h xi). Both updates are exact for a constant twist.

        Inside this function, the origin is the centroid of all K landmarks. Therefore the positions C_i of the
        landmarks are short, and the right-invariant form of the observer converges faster. The returned poses refer
        to the world frame.

        Args:
            recording: S runs.
            start: estimated poses Xh at the first frame, which are not corrected, `(S, 4, 4)`.

        Raises:
            InputError: the time between two frames is too long for the gains.
        """
        steps = np.diff(recording.time)
        self._check_step(float(steps.max()))
        motions = exp(steps[:, None] * recording.twists)
        centroid = recording.landmarks.mean(axis=1)
        landmarks, estimate = recording.landmarks - centroid[:, None], start.copy()
        estimate[:, :3, 3] -= centroid
        estimates = np.empty_like(recording.poses)
        estimates[:, 0] = estimate
        for t, step in enumerate(steps, start=1):
            estimate = estimate @ motions[:, t - 1]
            correction = self.correction(estimate, landmarks, recording.points[:, t], recording.seen[:, t])
            estimates[:, t] = estimate = estimate @ exp(step * correction)
        estimates[..., :3, 3] += centroid[:, None]
        return estimates

    def _check_step(self, longest: float) -> None:
        if longest * (self.gain + self.damping) >= STABILITY_LIMIT:
            raise InputError(
                f"gain + damping = {self.gain + self.damping:g} 1/s must stay below "
                f"{STABILITY_LIMIT / longest:g} 1/s, which is {STABILITY_LIMIT:g} divided by "
                f"the longest time between frames, {longest:g} s.",
                "gain",
            )

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        return pose_errors(recording.poses, self.estimates(recording, start))
