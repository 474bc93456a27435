"""Interface of estimators that localise a camera from a recording, and their errors."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation import consistency
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
    squares: FloatArray | None = None
    """Normalised errors squared of `lmd.estimation.consistency.squares`, `(S, T, 3)`; None without covariances."""

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


def errors_of(
    recording: Recording,
    start: FloatArray,
    run: Callable[[Recording, int, FloatArray], Iterator[tuple[FloatArray, FloatArray]]],
) -> Errors:
    """Errors of an estimator that states covariances.

    Args:
        recording: S runs.
        start: initial estimate of the pose, `(S, 4, 4)`.
        run: estimate Xh `(4, 4)` of each frame of a run, and the covariance of its error as a body twist, `(6, 6)`; NaN
            without an estimate.
    """
    runs = [list(run(recording, s, first)) for s, first in enumerate(start)]
    errors = pose_errors(recording.poses, np.array([[pose for pose, _ in one] for one in runs]))
    squares = [consistency.squares(one, true) for one, true in zip(runs, recording.poses, strict=True)]
    return replace(errors, squares=np.stack(squares))


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
