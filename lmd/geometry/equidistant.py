"""Lenses that Kalibr and ROS call equidistant, and OpenCV fisheye, in the terms of `lmd.geometry.distortion`.

A ray at the angle theta from the axis is imaged at the distance t(theta) = theta (1 + k1 theta^2 + k2 theta^4 +
k3 theta^6 + k4 theta^8) from it, in focal lengths (Kannala and Brandt, 2006). `distortion` has polynomials of r =
tan(theta) instead. In an image that does not reach too far from the axis one of them, with a focal length of its own,
is the same but for a fraction of a pixel.
"""

import math
from collections.abc import Sequence

import numpy as np

from lmd.core.checks import InputError, vector

WIDEST = math.radians(85.0)  # from the axis; tan(theta) grows without end
SAMPLES = 400  # radii at which the two are compared


def nearest_radial(lens: Sequence[float], reach: float) -> tuple[float, tuple[float, ...], float]:
    """The polynomial s r (1 + k1 r^2 + k2 r^4 + k3 r^6) whose greatest distance from t(theta) is least.

    Args:
        lens: k1 to k4 of t.
        reach: the largest t in the image.

    Returns:
        s, by which the focal length is to be multiplied; (k1, k2, 0, 0, k3); the greatest distance in the image, in
        focal lengths.

    Raises:
        InputError: there are not four coefficients, or the image does not grow up to `reach` before `WIDEST`.
    """
    from scipy.optimize import linprog  # slow to load, and most lenses are no such ones

    lens = vector("distortion", lens, 4)
    theta = np.linspace(0.0, WIDEST, SAMPLES * 10)
    image = theta * np.polynomial.polynomial.polyval(theta**2, [1.0, *lens])
    beyond = np.flatnonzero(image >= reach)
    end = int(beyond[0]) if beyond.size else 0
    if not end or (np.diff(image[: end + 1]) <= 0.0).any():
        raise InputError(
            f"distortion {list(lens)} does not reach the corners of the image, {reach:.3g} focal lengths from the "
            f"axis, within {math.degrees(WIDEST):g} degrees.",
            "distortion",
        )
    wanted = np.linspace(0.0, reach, SAMPLES + 1)[1:]
    powers = np.tan(np.interp(wanted, image[: end + 1], theta[: end + 1]))[:, None] ** [1, 3, 5, 7]
    off = np.ones((SAMPLES, 1))
    # The least greatest distance is a linear program: minimise e with -e <= powers x - wanted <= e.
    found = linprog(
        [0.0] * 4 + [1.0],
        A_ub=np.block([[powers, -off], [-powers, -off]]),
        b_ub=np.concatenate([wanted, -wanted]),
        bounds=[(None, None)] * 4 + [(0.0, None)],
    ).x
    scale, *others, farthest = found.tolist()
    k1, k2, k3 = (value / scale for value in others)
    return scale, (k1, k2, 0.0, 0.0, k3), farthest
