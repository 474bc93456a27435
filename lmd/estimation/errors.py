"""How far an estimated pose is from the true one."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import angle_between


@dataclass(frozen=True)
class Errors:
    """Errors of S runs of T frames; NaN where there is no estimate.

    Args:
        frobenius: Er = |X - Xh|_F^2, which adds square metres and pure numbers, `(S, T)`.
        position: |p - ph|, metres, `(S, T)`.
        attitude: angle of the rotation between R and Rh, rad, `(S, T)`.
    """

    frobenius: FloatArray
    position: FloatArray
    attitude: FloatArray

    @property
    def available(self) -> FloatArray:
        """Share of the frames with an estimate, `(S,)`."""
        return np.asarray(np.isfinite(self.frobenius).mean(axis=1))


def pose_errors(true: FloatArray, estimated: FloatArray) -> Errors:
    """Errors of estimated poses `(S, T, 4, 4)`, NaN where there is none."""
    return Errors(
        frobenius=((true - estimated) ** 2).sum(axis=(-2, -1)),
        position=np.linalg.norm(true[..., :3, 3] - estimated[..., :3, 3], axis=-1),
        attitude=angle_between(true, estimated),
    )
