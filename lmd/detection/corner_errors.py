"""How far the corners that a detector finds are from where they are, by the tag's pitch."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lmd.core.checks import FloatArray, InputError, check_fields, real

# The 90 % quantile of the standard normal distribution.
NORMAL_QUANTILE_90 = 1.2815515655446004


@dataclass(frozen=True)
class CornerErrors:
    """The root mean square error of a tag's four corners, in pixels, log-normal at every pitch.

    Between the given pitches the logarithms of both quantiles are interpolated linearly in that of the pitch; below the
    first and above the last they stay. The errors of the corners have this root mean square, and any direction in
    their eight dimensions is as likely as another.

    Args:
        pitch: pixels a module where it is shortest, ascending, `(B,)`.
        median: of the error at these pitches, pixels, `(B,)`.
        high: its 90 % quantile, `(B,)`.
        inward: mean shift of a tag's edges towards its middle at these pitches, pixels, `(B,)`; zeros if it is left
            out. It is a part of the errors above.
        inward_spread: standard deviation of that shift between blurs and exposures, pixels: one camera in one light has
            one shift.

    Raises:
        InputError: the values are not one for each pitch, or the spread is negative.
    """

    pitch: tuple[float, ...]
    median: tuple[float, ...]
    high: tuple[float, ...]
    inward: tuple[float, ...] = ()
    inward_spread: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "inward", self.inward or (0.0,) * len(self.pitch))
        for name in ("median", "high", "inward"):
            if len(getattr(self, name)) != len(self.pitch):
                raise InputError(
                    f"{name} = {getattr(self, name)} must have a value for each of {len(self.pitch)} pitches."
                )
        check_fields(self, real, "inward_spread", low=0.0)

    def _at(self, pitch: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the error's logarithm, as `pitch`."""
        at, known = np.log(pitch), np.log(self.pitch)
        mean, high = (np.interp(at, known, np.log(values)) for values in (self.median, self.high))
        return mean, (high - mean) / NORMAL_QUANTILE_90

    def draw(self, pitch: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Errors of the corners of tags with these pitches `(...)`, pixels, `(..., 4, 2)`."""
        mean, spread = self._at(pitch)
        error = np.exp(mean + spread * rng.standard_normal(pitch.shape))
        direction = rng.standard_normal((*pitch.shape, 4, 2))
        square = (direction**2).sum(axis=-1).mean(axis=-1)
        return np.asarray(direction * (error / np.sqrt(square))[..., None, None])

    def inward_at(self, pitch: FloatArray) -> FloatArray:
        """Mean shift of the edges towards the tag's middle, pixels, as `pitch`, interpolated like the quantiles."""
        return np.asarray(np.interp(np.log(pitch), np.log(self.pitch), self.inward))

    def sigma(self, pitch: FloatArray) -> FloatArray:
        """Standard deviation of one coordinate of one corner, pixels, as `pitch`."""
        mean, spread = self._at(pitch)
        return np.asarray(np.exp(mean + spread**2) / np.sqrt(2.0))


# The geometric middles of the classes of pitch from 1.25 to 9 pixels a module.
PITCH_MIDDLES = tuple(math.sqrt(low * high) for low, high in pairwise((1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0)))
# Measured in rendered frames, `python -m pipelines.detect deployment=uniform tag.edge=0.10 poses=400` with these
# detectors, tags of the family 36h11 and an ordinary camera in good light: 72 to 793 tags in a class. The shifts are
# those that `python benchmarks/corners.py preset --tags 24` prints, in images by another renderer, in light that is not
# clipped and has no tone curve, of tags with the white margin that lmd prints.
# A tone curve adds 0.24 pixels, clipped white 0.32; the cameras of docs/results/survey.md have -0.07 to 0.03. Blur adds
# as much with ArUco.
LIGHT_SPREAD, BLUR_SPREAD = 0.1, 0.2
CORNER_ERRORS = {
    "aruco": CornerErrors(
        PITCH_MIDDLES,
        (1.007, 0.908, 0.824, 0.703, 0.616, 0.545, 0.306, 0.273),
        (1.400, 1.406, 1.126, 0.964, 0.878, 0.778, 0.668, 0.343),
        (0.268, 0.289, 0.267, 0.245, 0.308, 0.314, 0.237, 0.167),
        BLUR_SPREAD,
    ),
    "apriltag": CornerErrors(
        PITCH_MIDDLES,
        (0.228, 0.193, 0.180, 0.135, 0.080, 0.033, 0.017, 0.017),
        (0.363, 0.280, 0.236, 0.200, 0.131, 0.057, 0.042, 0.039),
        (0.025, 0.025, 0.022, 0.021, 0.012, 0.005, 0.001, 0.001),
        LIGHT_SPREAD,
    ),
    # It finds next to nothing below 1.5 pixels a module.
    "apriltag_decimate2": CornerErrors(
        PITCH_MIDDLES[1:],
        (0.244, 0.212, 0.151, 0.084, 0.034, 0.018, 0.016),
        (0.497, 0.383, 0.253, 0.147, 0.063, 0.040, 0.039),
        # Below 2 pixels a module as at 2.24: it reads too few there.
        (0.046, 0.046, 0.046, 0.017, 0.006, 0.000, 0.000),
        LIGHT_SPREAD,
    ),
}
