"""Tables II and III of the paper, as fractions.

Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. V-A: the room
of 7.5 x 5 x 6 m, K = 90 landmarks, 400 iterations with populations of 30.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Printed:
    """Three indices of a row, fractions in [0, 1], with the names of `Problem.metrics`."""

    qualified_ratio: float
    average_coverage_probability: float
    maximum_coverage_probability: float


# Table II, for n = 2 and thold_p = 0.65.
TABLE_2 = {
    "EGA": Printed(0.8188, 0.7500, 0.9169),
    "SGA": Printed(0.5344, 0.6445, 0.8431),
    "uniform": Printed(0.4392, 0.6016, 0.7446),
    "initial": Printed(0.1111, 0.5231, 0.7108),
}

# Table III by (n, thold_p), for the deployment that EGA found for (2, 0.65).
TABLE_3 = {
    (2, 0.50): Printed(0.9775, 0.7500, 0.9169),
    (2, 0.65): Printed(0.8188, 0.7500, 0.9169),
    (2, 0.80): Printed(0.3968, 0.7500, 0.9169),
    (3, 0.50): Printed(0.7394, 0.5970, 0.8308),
    (3, 0.65): Printed(0.3704, 0.5970, 0.8308),
    (3, 0.80): Printed(0.0397, 0.5970, 0.8308),
    (4, 0.50): Printed(0.3585, 0.4676, 0.7385),
    (4, 0.65): Printed(0.0741, 0.4676, 0.7385),
    (4, 0.80): Printed(0.0000, 0.4676, 0.7385),
}
