"""Interface of estimators that localise a camera from a recording, and their errors."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import angle_between


@dataclass(frozen=True)
class Errors:
    """Errors of S runs of T frames; NaN in frames without an estimate."""

    frobenius: FloatArray
    """Er = |X - Xh|_F^2, a sum of square metres and pure numbers, `(S, T)`."""
    position: FloatArray
    """|p - ph|, metres, `(S, T)`."""
    attitude: FloatArray
    """Angle of the rotation between R and Rh, rad, `(S, T)`."""

    @property
    def available(self) -> FloatArray:
        """Share of the frames with an estimate, `(S,)`."""
        return np.asarray(np.isfinite(self.frobenius).mean(axis=1))


def pose_errors(true: FloatArray, estimated: FloatArray) -> Errors:
    """Errors of estimated poses `(S, T, 4, 4)`, which may be NaN."""
    return Errors(
        frobenius=((true - estimated) ** 2).sum(axis=(-2, -1)),
        position=np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1),
        attitude=angle_between(true, estimated),
    )


class Estimator(Protocol):
    """Estimator of the poses of a camera."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """Estimate the poses in every frame of every run and compute the errors, NaN without an estimate.

        Args:
            recording: S runs.
            start: initial estimate of the pose, `(S, 4, 4)`; ignored by estimators that need none.

        Raises:
            InputError: the estimator does not support this recording, or needs a missing package.
        """
