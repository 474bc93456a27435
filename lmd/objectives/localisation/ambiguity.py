"""Planar ambiguity: the two poses of a single tag, and the residual that distinguishes the poses.

Far from the camera, a square has nearly the same image after its normal is mirrored about the line of sight: the two
poses are the two solutions of IPPE. Let s be the edge, d >> s the distance, t and u the unit vectors to the square's
right and up, and b the unit vector to its centre. Let p = t . b and q = u . b, so that p^2 + q^2 is the squared sine of
the incidence angle, and f the focal length in pixels. The translation, rotation and foreshortening of the mirrored pose
absorb all differences of the two images but one, to the leading order in s / d. Perspective moves the corners of one
diagonal in one direction and the corners of the other diagonal in the opposite direction. This difference leaves the
squared residual

    S = (f s^2 / d^2)^2 (p^2 + q^2 - 4 p^2 q^2),

summed over the eight coordinates of the corners. A solver takes the pose that fits better. With noise of sigma on each
coordinate, the mirrored pose fits better with the probability

    P = Q(sqrt(S) / (2 sigma)),    Q(x) the probability that a standard normal variable exceeds x.

The poses are distinguished if P is at most 1 - `CONFIDENCE`. Away from the middle of the image, S and the information
grow with `pixel_density`. docs/results/ambiguity.md has the error of P.

Two or more tags are unambiguous, because the mirrored pose of one tag does not fit another tag.

A rig has one mirrored pose for all cameras. Let b_i be the unit vector from camera i to the tag. For the tag mirrored
about b_i, the residual in camera i is S_i. For the tag mirrored about another line b, the corners are also displaced by
b_i - b times twice their depth from the tag's centre. The best b leaves the squared residual S, to the leading order in
edge and baseline over distance, because every other displacement of the mirrored tag is common to all cameras. So

    S = sum S_i + sum m_i |b_i - b|^2,    m_i = 4 (f_i s / d_i)^2 (p_i^2 + q_i^2),    b = sum m_i b_i / sum m_i.

With M = sum m_i, h = sum m_i b_i and |b_i| = 1, the second sum is M - |h|^2 / M. So S follows from five sums over the
cameras: sum S_i, M and the three components of h. A further camera never lowers S.

At incidence angles below about 1.5 baselines over distance, radians, a rig has no second pose; S neglects this.
docs/results/ambiguity.md has the error of S.
"""

from statistics import NormalDist
from typing import Any

import numpy as np

from lmd.core.bits import Integer
from lmd.core.compiled import inlined
from lmd.core.dispatch import overridable
from lmd.geometry.vectors import dot3, times3
from lmd.objectives.localisation.information import (
    BODY_NUMBERS,
    BODY_WIDTH,
    NEAREST,
    NUMBERS,
    QUANTUM,
    Number,
    Precision,
    Square,
)
from lmd.scene.criteria import TOLERANCE

CONFIDENCE = 0.99  # least probability that the better pose is the true pose
# Greatest residual ratio of a tag; greater ratios are clipped to this value, which keeps sums exact.
MOST = 16.0
# Square metres, added to a squared distance, of which it changes only 0. A tag at the camera itself is not covered, so
# its ratio has no weight there; the ratio must be a number.
TINY = 1e-300
MIRRORED = 5  # additional numbers of a view of a rig: S over the least S, M, and h (three)
MIRRORED_WIDTH = 32  # length of a row of `sums` with the additional numbers


def resolved(asked: Precision, scale: float) -> Precision:
    """Copy of the limits `asked` with the additional requirement that views are unambiguous.

    `scale` is the result of `information.deviation_per_variance`: pixel noise over focal length.
    """
    least = 2.0 * NormalDist().inv_cdf(CONFIDENCE) * scale
    return asked._replace(residual=least**2 * (1.0 - TOLERANCE))


@overridable
def _is_limit(limit: float | None) -> bool:
    return True


@overridable
def least_residual(limit: float | None) -> float:
    """Required squared residual of the mirrored pose, `limit` (`Precision.residual`), as a number; 0 if it is None."""
    return limit  # type: ignore[return-value] # None has a function of its own


@_is_limit.register(type(None))
def _is_no_limit(limit: None) -> bool:
    return False


@least_residual.register(type(None))
def _no_residual(limit: None) -> float:
    return 0.0


@inlined
def resolves_ambiguity(precision: Precision) -> bool:
    """True if `precision` requires that the two poses of a single tag can be distinguished."""
    return _is_limit(precision.residual)


@inlined
def mirrored_square(tag: Square) -> Number:
    """Squared residual S of the mirrored pose of a tag (see the module), times the cube of the tag's distance.

    The unit of S is f^2, the squared focal length. The weight `pixel_density`, applied later, contains the inverse of
    the cube.
    """
    offset, right, up = tag
    squared, along, above = dot3(offset, offset) + TINY, dot3(offset, right), dot3(offset, up)
    p, q = along * along / squared, above * above / squared  # p^2 and q^2, times the squared half edge
    return 16.0 * (dot3(right, right) * (p + q) - 4.0 * (p * q)) / np.sqrt(squared)


@inlined
def residual_ratio(tag: Square, least: Number) -> Number:
    """Ratio of a tag's squared residual S (see the module) to the required one, `least`.

    The result is multiplied by the cube of the tag's distance. The weight `pixel_density`, applied later, contains the
    inverse of the cube. Ratios above `MOST` are clipped.
    """
    squared = dot3(tag[0], tag[0])
    return np.minimum(mirrored_square(tag) / least, MOST * (squared * np.sqrt(squared)))


@overridable
def camera_residual(least: float | None, tag: Square) -> Number:
    """Contribution of a tag to the last number of a view's information: `residual_ratio`, or 0 if `least` is None.

    `least` is the required squared residual in units of f^2 (`Precision.residual`). The contributions of the tags in
    view, times the `pixel_density` of each tag, are summed. The two poses of a single tag can be distinguished if the
    sum is at least 1.
    """
    return residual_ratio(tag, least)


@camera_residual.register(type(None))
def _no_camera_residual(least: None, tag: Square) -> Number:
    return 0.0


@inlined
def mirrored_numbers(tag: Square, least: Number) -> tuple[Number, Number, Number, Number, Number]:
    """Five numbers of a tag in one camera of a rig; their sums over the cameras give the residual of the mirrored pose.

    The numbers are the ratio of S to the required residual `least`, then M and the three components of h, all defined
    in the module. S and M are in units of f^2. Each number is multiplied by the cube of the tag's distance. The weight
    `pixel_density`, applied later, contains the inverse of the cube.
    """
    offset, right, up = tag
    squared, along, above = dot3(offset, offset), dot3(offset, right), dot3(offset, up)
    m = 16.0 * (along * along + above * above) / np.maximum(squared, NEAREST)
    hx, hy, hz = times3(m, offset)
    return residual_ratio(tag, least), m * np.sqrt(squared), hx, hy, hz


@inlined
def rig_ratio(ratio: Number, m: Number, hx: Number, hy: Number, hz: Number, least: Number) -> Number:
    """Ratio of a rig's squared residual S (see the module) to the required residual `least`. The other arguments are
    the sums of a single tag's `mirrored_numbers` over the cameras.
    """
    return ratio + (m - (hx * hx + hy * hy + hz * hz) / np.maximum(m, QUANTUM)) / least


@overridable
def has_one_pose(least: float | None, sums: Any, v: Integer, step: Integer) -> Any:
    """True if the image of the only tag in view v determines one pose; always True if `least` is None.

    `least` is the required squared residual. Number j of the view's information is `sums[v + j * step]`; the last
    number is the ratio of the residual to the required one.
    """
    return sums[v + NUMBERS * step] >= 1.0


@has_one_pose.register(type(None))
def _has_any_pose(least: None, sums: Any, v: Integer, step: Integer) -> bool:
    return True


@overridable
def body_has_one_pose(least: float | None, sums: Any, v: Integer, step: Integer) -> Any:
    """True if a rig's images of the only tag in view v determine one pose; always True if `least` is None.

    Number j of the view's information is `sums[v + j * step]`; `least` is the required squared residual.
    """
    r, m = v + BODY_NUMBERS * step, v + (BODY_NUMBERS + 1) * step
    return rig_ratio(sums[r], sums[m], sums[m + step], sums[m + 2 * step], sums[m + 3 * step], least) >= 1.0


@body_has_one_pose.register(type(None))
def _body_has_any_pose(least: None, sums: Any, v: Integer, step: Integer) -> bool:
    return True


def width_of(precision: Precision) -> int:
    """Length of the row that is stored for the information of a view of a rig.

    The row is longer if the two poses of a single tag must be distinguished.
    """
    return MIRRORED_WIDTH if resolves_ambiguity(precision) else BODY_WIDTH
