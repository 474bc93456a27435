"""Interface of estimators that localise a camera from a recording, and errors of estimators.

The consistency of an estimator is judged by its normalised estimation errors squared (NEES), which should follow a
chi-square distribution.

An estimate Xh of the pose X has the error Xh^-1 X = exp(w, v). Let S be the covariance that the estimator states for
the body twist (w, v). The estimate is consistent if (w, v)^T S^-1 (w, v) follows the chi-square distribution with 6
degrees of freedom. The diagonal blocks of S give the normalised squares of rotation and of position, with 3 degrees of
freedom each. See Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with applications to tracking and navigation",
2001, section 5.4.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import angle_between, inverse, log

# Degrees of freedom of the three columns of `squares`.
DEGREES = {"joint": 6, "rotation": 3, "position": 3}


def squares(estimates: Sequence[tuple[FloatArray, FloatArray]], true: FloatArray) -> FloatArray:
    """Normalised squared errors (NEES) in each frame of a run, `(T, 3)`: of the whole pose, of its rotation, and of its
    position; NaN for frames without an estimate.

    Args:
        estimates: for each frame, the estimate Xh `(4, 4)` and the covariance of its error as a body twist, `(6, 6)`.
        true: true poses X, `(T, 4, 4)`.
    """
    found = np.full((len(true), 3), np.nan)
    poses, covariances = (np.array(part) for part in zip(*estimates, strict=True))
    there = np.isfinite(poses).all(axis=(-2, -1)) & np.isfinite(covariances).all(axis=(-2, -1))
    back = inverse(poses[there]) @ true[there]
    twist, covariance = log(back), covariances[there]
    found[there, 0] = _square(twist, covariance)
    found[there, 1] = _square(twist[:, :3], covariance[:, :3, :3])
    found[there, 2] = _square(back[:, :3, 3], covariance[:, 3:, 3:])
    return found


def _square(error: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1))


@dataclass(frozen=True)
class Errors:
    """Errors of the poses estimated in S runs of T frames; NaN in frames without an estimate."""

    frobenius: FloatArray
    """Squared Frobenius norm Er = |X - Xh|_F^2 of the pose error, a sum of square metres (translation) and pure numbers
    (rotation), `(S, T)`.
    """
    position: FloatArray
    """Position error: distance between the true and the estimated position, metres, `(S, T)`."""
    attitude: FloatArray
    """Attitude error: angle of the rotation between the true and the estimated attitude, rad, `(S, T)`."""
    squares: FloatArray | None = None
    """Normalised squared errors (NEES) of the whole pose, of its rotation, and of its position, `(S, T, 3)`; None if
    the estimator states no covariances.
    """

    @property
    def available(self) -> FloatArray:
        """Fraction of the frames of each run that have an estimate, `(S,)`."""
        return np.asarray(np.isfinite(self.frobenius).mean(axis=1))


def pose_errors(true: FloatArray, estimated: FloatArray) -> Errors:
    """Errors of the `estimated` poses, compared with the `true` poses, `(S, T, 4, 4)` each; estimated poses may be
    NaN.
    """
    return Errors(
        frobenius=((true - estimated) ** 2).sum(axis=(-2, -1)),
        position=np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1),
        attitude=angle_between(true, estimated),
    )


def errors_of(
    recording: Recording,
    start: FloatArray,
    run: Callable[[Recording, int, FloatArray], Iterator[tuple[FloatArray, FloatArray]]],
) -> Errors:
    """Compute the errors of an estimator that states covariances.

    Args:
        recording: S runs.
        start: initial estimate of the pose, `(S, 4, 4)`.
        run: function of the recording, the index s of a run and the run's initial estimate `(4, 4)`. The function
            gives, for each frame of the run, the estimate Xh `(4, 4)` and the covariance of its error as a body twist,
            `(6, 6)`; NaN without an estimate.
    """
    runs = [list(run(recording, s, first)) for s, first in enumerate(start)]
    errors = pose_errors(recording.poses, np.array([[pose for pose, _ in one] for one in runs]))
    normalised = [squares(one, true) for one, true in zip(runs, recording.poses, strict=True)]
    return replace(errors, squares=np.stack(normalised))


class Estimator(Protocol):
    """Interface of estimators of camera poses."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """Estimate the pose in every frame of every run, and compute the errors; NaN for frames without an estimate.

        Args:
            recording: S runs.
            start: initial estimate of the pose, `(S, 4, 4)`; ignored by estimators that need none.

        Raises:
            InputError: the estimator does not support this recording, or a package that it needs is not installed.
        """
