"""How well a view fixes the camera: the Fisher information of the corners of the tags that it covers.

A corner at the offset d from the camera, r = |d|, b = d / r, is seen in the direction b. Moving the camera by v and
turning it by w, both in the world frame, turns that direction by b x w - (I - b b^T) v / r. With noise of the same size
in all directions, corners together have the information

    [ C       -[g]x ]       A = sum (I - b b^T),   g = sum b / r,   C = sum (I - b b^T) / r^2
    [ [g]x     A    ]

on (v, w): 15 numbers, which do not depend on where the camera looks. What is left for the position once the rotation is
estimated too is the Schur complement

    S = C - ((g^T A g) A - (A g) (A g)^T) / det A,

and the standard deviation of the position is (sigma / f) sqrt(tr S^-1), where tr S^-1 is the sum of the principal 2 x 2
minors of S over det S. That of the rotation is the same with A and C exchanged.

Pixels are not directions: at an angle with the cosine c = z / r from the optical axis a pixel is worth 1 / c^2 along
the way to the image's centre, and 1 / c across. A landmark's 15 numbers are therefore weighed with (r / z)^3, r its
distance and z its depth, which keeps the determinant of each corner's information; behind a lens that distorts with how
many pixels its model gives a solid angle there (`lmd.scene.criteria.pixel_density`). What that leaves is an error of
some per cent of the standard deviation, see docs/accuracy.md; the exact information would have 21 numbers for each
landmark, position *and* orientation. Pixels count as square with the geometric mean of the two focal lengths.

A landmark that is a point counts as one corner. Two points leave a turn about the line through them open. One tag alone
has two poses that look nearly alike, of which these formulas know nothing: see `ambiguity`.

The functions here take numbers or arrays alike: kernels compile what the reference calls, so that both
decide by the same bits. Each landmark's share of a view is rounded to a multiple of `QUANTUM`: sums of such are exact
in any order, so that landmarks may be added and taken away again.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.geometry.camera import Camera
from lmd.scene.criteria import TOLERANCE
from lmd.scene.tag import Tag

# Numbers of a view: A, g and C, of symmetric matrices xx, xy, xz, yy, yz, zz, and what `ambiguity` has of it.
WIDTH = 16
QUANTUM = 2.0**-36
# Added and taken away again it rounds to multiples of the quantum, for numbers below 2^15; sums are exact below 2^17.
ROUNDER = 1.5 * 2.0**52 * QUANTUM
NEAREST = 0.1**2  # squared distance, m^2: a corner closer than this counts as so far away, which keeps sums small
# Below this share of tr(A)^3, det A is rounding: all corners lie in one direction.
SINGULAR = 1e-9


class Precision(NamedTuple):
    """What a view must reach to be localised, in the units of `variance`.

    half of the tag's edge, metres; share of each of four corners, 1/4 for a point; position the greatest variance,
    infinite where landmarks only have to be covered.
    """

    half: float
    share: float
    position: float

    @property
    def asks(self) -> bool:
        """Whether more is asked than that landmarks are covered."""
        return bool(np.isfinite(self.position))


class PosePrecision(NamedTuple):
    """The same for position and rotation, of which at least one is finite."""

    half: float
    share: float
    position: float
    rotation: float

    @property
    def asks(self) -> bool:
        """See `Precision.asks`."""
        return True


class SizedPrecision(NamedTuple):
    """The same for tags of several sizes: what another precision asks, and half the edge of each tag, `(K,)` metres."""

    of: Any
    halves: np.ndarray
    share: float
    position: float

    @property
    def rotation(self) -> float:
        """The greatest variance of the rotation."""
        return float(getattr(self.of, "rotation", np.inf))

    @property
    def asks(self) -> bool:
        """See `Precision.asks`."""
        return bool(self.of.asks)


def sized_precision(asked: Any, edges: Sequence[float]) -> SizedPrecision:
    """What is asked of tags with these edges, `(K,)` metres."""
    return SizedPrecision(asked, np.array(edges) / 2.0, asked.share, asked.position)


@overridable
def half_of(precision, k):
    """Half the edge of tag k of a deployment, metres."""
    return precision.half


@half_of.register(SizedPrecision)
def _half_of(precision, k):
    return precision.halves[k]


def deviation_per_variance(camera: Camera, pixel_noise: float) -> float:
    """sigma / f: the standard deviation for a `variance` of 1, metres or rad.

    Args:
        camera: the camera.
        pixel_noise: sigma, of each coordinate of a corner, pixels.
    """
    return float(pixel_noise / np.sqrt(np.prod(camera.focal_pixels)))


def precision(
    camera: Camera,
    tag: Tag,
    pixel_noise: float,
    tolerance: float,
    rotation: float | None = None,
    edge: float | None = None,
) -> Precision | PosePrecision:
    """What greatest standard deviations of position, metres, and if you like rotation, rad, ask of a view.

    The edge is that of all landmarks, metres, if it is not the tag's.
    """
    scale = deviation_per_variance(camera, pixel_noise)
    half, share = (0.0, 0.25) if tag.is_point else ((edge or tag.size) / 2.0, 1.0)

    def most(deviation: float) -> float:
        return (deviation / scale) ** 2 * (1.0 + TOLERANCE)

    asked: Precision | PosePrecision = Precision(half, share, most(tolerance))
    if rotation is not None:
        asked = PosePrecision(half, share, most(tolerance), most(rotation))
    return asked


@inlined
def moments(x, y, z, rx, ry, rz, ux, uy, uz, share):
    """A, g and C of a landmark's four corners times r^3, as 15 numbers.

    Args:
        x, y, z: offset of its centre from the camera, metres, and r is how far that is.
        rx, ry, rz, ux, uy, uz: from the centre to the middle of its right and of its upper edge, metres.
        share: of each corner.
    """
    axx = axy = axz = ayy = ayz = azz = gx = gy = gz = cxx = cxy = cxz = cyy = cyz = czz = 0.0
    for i in range(4):
        right, up = 1.0 - 2.0 * (i // 2), 1.0 - 2.0 * (i % 2)
        dx, dy, dz = x + right * rx + up * ux, y + right * ry + up * uy, z + right * rz + up * uz
        q = 1.0 / np.maximum(dx * dx + dy * dy + dz * dz, NEAREST)
        bx, by, bz = dx * q, dy * q, dz * q
        pxx, pxy, pxz = 1.0 - dx * bx, -(dx * by), -(dx * bz)
        pyy, pyz, pzz = 1.0 - dy * by, -(dy * bz), 1.0 - dz * bz
        axx, axy, axz, ayy, ayz, azz = axx + pxx, axy + pxy, axz + pxz, ayy + pyy, ayz + pyz, azz + pzz
        gx, gy, gz = gx + bx, gy + by, gz + bz
        cxx, cxy, cxz = cxx + pxx * q, cxy + pxy * q, cxz + pxz * q
        cyy, cyz, czz = cyy + pyy * q, cyz + pyz * q, czz + pzz * q
    squared = x * x + y * y + z * z
    w = share * (squared * np.sqrt(squared))
    return (
        w * axx, w * axy, w * axz, w * ayy, w * ayz, w * azz, w * gx, w * gy, w * gz,
        w * cxx, w * cxy, w * cxz, w * cyy, w * cyz, w * czz,
    )  # fmt: skip


@inlined
def share_of(moment, weight):
    """What a landmark adds to one of the 15 numbers of a view: its moment times `pixel_density`, rounded."""
    return (moment * weight + ROUNDER) - ROUNDER


@inlined
def schur(
    axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    """det A, and the sum of the principal minors and the determinant of S det A."""
    mxx, mxy, mxz = ayy * azz - ayz * ayz, axz * ayz - axy * azz, axy * ayz - axz * ayy
    det = axx * mxx + axy * mxy + axz * mxz
    hx, hy, hz = axx * gx + axy * gy + axz * gz, axy * gx + ayy * gy + ayz * gz, axz * gx + ayz * gy + azz * gz
    q = gx * hx + gy * hy + gz * hz
    sxx, sxy, sxz = det * cxx - q * axx + hx * hx, det * cxy - q * axy + hx * hy, det * cxz - q * axz + hx * hz
    syy, syz, szz = det * cyy - q * ayy + hy * hy, det * cyz - q * ayz + hy * hz, det * czz - q * azz + hz * hz
    nxx, nxy, nxz = syy * szz - syz * syz, sxz * syz - sxy * szz, sxy * syz - sxz * syy
    minors = nxx + (sxx * szz - sxz * sxz) + (sxx * syy - sxy * sxy)
    return det, minors, sxx * nxx + sxy * nxy + sxz * nxz


@inlined
def variance(
    axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    """tr S^-1, and whether it is one: False where the corners leave something open. Rotation: exchange A and C."""
    det, minors, rest = schur(axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
    trace = axx + ayy + azz
    fixed = (det > SINGULAR * (trace * trace * trace)) & (minors > 0.0) & (rest > 0.0)
    return minors * det / rest, fixed


@inlined
def log_det(
    axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    """The logarithm of the determinant of the whole information, det A det S."""
    det, _, rest = schur(axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
    return np.log(rest / (det * det))


@dispatched
def meets(
    precision, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    """Whether the information of a view is what `precision` asks for."""


@meets.register(Precision)
def _meets(
    precision, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    position, fixed = variance(axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
    return fixed & (position <= precision.position)


@meets.register(PosePrecision)
def _meets_both(
    precision, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    position, fixed = variance(axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
    rotation, steady = variance(cxx, cxy, cxz, cyy, cyz, czz, gx, gy, gz, axx, axy, axz, ayy, ayz, azz)
    return fixed & steady & (position <= precision.position) & (rotation <= precision.rotation)


@meets.register(SizedPrecision)
def _meets_of(
    precision, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    return meets(precision.of, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
