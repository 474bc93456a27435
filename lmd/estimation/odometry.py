"""What a camera knows of its own motion."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, check_fields, real


@dataclass(frozen=True)
class Odometry:
    """Measures the twist between two frames with independent normal errors, so that what is integrated drifts.

    Args:
        turn_noise: standard deviation about each axis, rad per root second.
        motion_noise: the same along each axis, metres per root second.

    Raises:
        InputError: a value is negative.
    """

    turn_noise: float = 0.0
    motion_noise: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, real, "turn_noise", "motion_noise", low=0.0)

    def measured(self, twists: FloatArray, steps: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Twists as measured, `(T - 1, 6)`, rad/s and m/s.

        White noise of density q integrated over a step of h seconds has the variance q^2 h; over h, q^2 / h.

        Args:
            twists: the true ones.
            steps: time of each, seconds, `(T - 1,)`.
        """
        density = np.repeat([self.turn_noise, self.motion_noise], 3)
        return np.asarray(twists + rng.standard_normal(twists.shape) * density / np.sqrt(steps)[:, None])
