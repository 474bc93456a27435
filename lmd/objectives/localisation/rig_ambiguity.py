"""Which of its two poses a body has whose cameras see a single tag: `ambiguity`, over all cameras of a rig.

The mirrored pose is one for all of them. That of camera i would be mirrored about its own line of sight b_i; mirrored
about another line b, the tag is off in that camera's image by twice what its corners are nearer or farther than its
centre, times b_i - b. To the leading order in edge and baseline over distance, and with the best b, that leaves

    S = sum S_i + sum m_i |b_i - b|^2,    m_i = 4 (f_i s / d_i)^2 (p_i^2 + q_i^2),    b = sum m_i b_i / sum m_i

as all else that moves the mirrored tag moves it alike for all cameras. So two cameras as far apart as the tag is wide,
across the line of sight, tell as much by that as each does alone. As |b_i| = 1, the second sum is M - |h|^2 / M with
M = sum m_i and h = sum m_i b_i: five numbers that add up. More cameras never tell less.

At an incidence below about one and a half baselines over distance, radians, there is no second pose at all; S does not
know. docs/results/ambiguity.md has what it is off by.
"""

from typing import Any

import numpy as np

from lmd.core.bits import ZERO, add_digit
from lmd.core.compiled import inlined
from lmd.geometry.squares import upright_sides
from lmd.objectives.localisation.ambiguity import ResolvedPrecision, asks_apart, square_of, telling
from lmd.objectives.localisation.body import BODY_NUMBERS, BODY_WIDTH, about_body, body_meets
from lmd.objectives.localisation.information import NEAREST, QUANTUM, half_of, share_of
from lmd.objectives.localisation.kernels import landmark_moments
from lmd.scene.criteria import pixel_density

MIRRORED = 5  # numbers of a view beside those of the body: S over what it must be, M and h
MIRRORED_WIDTH = 32  # of a view's numbers with these; what is left fills up


@inlined
def numbers_of(precision):
    """How many numbers of a view `precision` asks for."""
    return np.uint64(BODY_NUMBERS + MIRRORED if asks_apart(precision) else BODY_NUMBERS)


def width_of(precision: Any) -> int:
    """The width of rows of these numbers."""
    return MIRRORED_WIDTH if asks_apart(precision) else BODY_WIDTH


@body_meets.register(ResolvedPrecision)
def _meets_other(precision, sums, v, step):
    return body_meets(precision.of, sums, v, step)


@inlined
def mirrored_numbers(x, y, z, rx, ry, rz, ux, uy, uz, square):
    """S over `square`, M and h of a tag times its distance cubed, S and M in units of f^2; others as in `moments`."""
    squared = x * x + y * y + z * z
    along, above = x * rx + y * ry + z * rz, x * ux + y * uy + z * uz
    m = 16.0 * (along * along + above * above) / np.maximum(squared, NEAREST)
    return telling(x, y, z, rx, ry, rz, ux, uy, uz, square), m * np.sqrt(squared), m * x, m * y, m * z


@inlined
def told_by_all(told, m, hx, hy, hz, square):
    """S over `square`, of the sums of these numbers of a single tag."""
    return told + (m - (hx * hx + hy * hy + hz * hz) / np.maximum(m, QUANTUM)) / square


@inlined
def has_one_pose(precision, sums, v, step):
    """Whether a view of a single tag has one pose, as far as `precision` asks; arguments as in `body_meets`."""
    if not asks_apart(precision):
        return True
    m = v + (BODY_NUMBERS + 1) * step
    told = sums[v + BODY_NUMBERS * step], sums[m], sums[m + step], sums[m + 2 * step], sums[m + 3 * step]
    return told_by_all(told[0], told[1], told[2], told[3], told[4], square_of(precision)) >= 1.0


@inlined
def several(was, now, digits):
    """The orientations with which two landmarks or more are seen.

    The counts `digits` `(J,)` have a landmark where it `was` seen; it is `now`.
    """
    found, change = ZERO, was ^ now
    for j in range(np.uint64(len(digits))):
        digit, change = add_digit(digits[j], change, was)
        found |= digit if j else ZERO
    return found


@inlined
def add_share(sight, axes, a, x, y, z, nx, ny, nz, ox, oy, oz, precision, k, gain, sums, v, row):
    """Add to view v of `sums` what landmark k tells.

    Args:
        sight, axes, a: of the camera, and which of its orientations `(6, D)`.
        x, y, z, nx, ny, nz: offset from the camera and normal of the landmark.
        ox, oy, oz: offset of the camera from the body.
        precision: has the size of the tags.
        gain: see `gain_of`.
        sums, v: `(V, width)`, and which row.
        row: `(width,)` working memory.
    """
    weight = gain * pixel_density(sight, x, y, z, axes, a)
    (
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20],
    ) = about_body(landmark_moments(x, y, z, nx, ny, nz, precision, k), ox, oy, oz)  # fmt: skip
    if asks_apart(precision):
        rx, ry, rz, ux, uy, uz = upright_sides(half_of(precision, k), nx, ny, nz)
        (
            row[21], row[22], row[23], row[24], row[25]
        ) = mirrored_numbers(x, y, z, rx, ry, rz, ux, uy, uz, square_of(precision))  # fmt: skip
    for j in range(sums.shape[1]):
        sums[v, j] += share_of(row[j], weight)
