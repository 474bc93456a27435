"""How well the images of a rig fix its body: what `information` has of a camera, told of the body.

A camera at the offset o from the body's origin, world frame, moves by v - o x w when the body moves by v and turns by
w. What A, g and C say of the camera then tells of (v, w) of the body

    [ C       B           ]      B = -C [o]x - [g]x
    [ B^T     A'          ]      A' = A - [o]x C [o]x - [o]x [g]x - [g]x [o]x,

21 numbers. Cameras measure independently, so their information adds up, times the square of their focal lengths, of a
landmark that two of them see, too; it counts once among the n that a view needs. Each landmark's share of a view is
rounded as for a single camera, which makes sums exact in any order.
"""

import numpy as np

from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched
from lmd.geometry.camera import Camera
from lmd.objectives.localisation.information import SINGULAR, PosePrecision, Precision, SizedPrecision

# Numbers of a view: C, B row by row, and A', the symmetric ones as xx, xy, xz, yy, yz, zz; three fill up.
BODY_NUMBERS, BODY_WIDTH = 21, 24


def gain_of(camera: Camera, first: Camera) -> float:
    """What a pixel of a camera is worth in the units of the first one of its rig."""
    return float(np.prod(camera.focal_pixels)) / float(np.prod(first.focal_pixels))


@inlined
def about_body(moments, x, y, z):
    """The 21 numbers of the body from the 15 `information.moments` of a camera at the offset (x, y, z) from it."""
    axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz = moments
    bxx, bxy, bxz = cxz * y - cxy * z, cxx * z - cxz * x + gz, cxy * x - cxx * y - gy
    byx, byy, byz = cyz * y - cyy * z - gz, cxy * z - cyz * x, cyy * x - cxy * y + gx
    bzx, bzy, bzz = czz * y - cyz * z + gy, cxz * z - czz * x - gx, cyz * x - cxz * y
    along = gx * x + gy * y + gz * z  # A' = A + [o]x B - [g]x [o]x, and [g]x [o]x = o g^T - (o g) I
    return (
        cxx, cxy, cxz, cyy, cyz, czz, bxx, bxy, bxz, byx, byy, byz, bzx, bzy, bzz,
        axx + (y * bzx - z * byx) - x * gx + along, axy + (y * bzy - z * byy) - x * gy,
        axz + (y * bzz - z * byz) - x * gz, ayy + (z * bxy - x * bzy) - y * gy + along,
        ayz + (z * bxz - x * bzz) - y * gz, azz + (x * byz - y * bxz) - z * gz + along,
    )  # fmt: skip


@inlined
def body_schur(
    cxx, cxy, cxz, cyy, cyz, czz, bxx, bxy, bxz, byx, byy, byz, bzx, bzy, bzz, axx, axy, axz, ayy, ayz, azz
):  # fmt: skip
    """det A, the sum of the principal minors and the determinant of S det A, S = C - B A^-1 B^T, and the trace of A."""
    mxx, mxy, mxz = ayy * azz - ayz * ayz, axz * ayz - axy * azz, axy * ayz - axz * ayy
    myy, myz, mzz = axx * azz - axz * axz, axy * axz - axx * ayz, axx * ayy - axy * axy
    det, trace = axx * mxx + axy * mxy + axz * mxz, axx + ayy + azz
    pxx, pyx, pzx = (
        bxx * mxx + bxy * mxy + bxz * mxz, byx * mxx + byy * mxy + byz * mxz, bzx * mxx + bzy * mxy + bzz * mxz
    )  # fmt: skip
    pxy, pyy, pzy = (
        bxx * mxy + bxy * myy + bxz * myz, byx * mxy + byy * myy + byz * myz, bzx * mxy + bzy * myy + bzz * myz
    )  # fmt: skip
    pxz, pyz, pzz = (
        bxx * mxz + bxy * myz + bxz * mzz, byx * mxz + byy * myz + byz * mzz, bzx * mxz + bzy * myz + bzz * mzz
    )  # fmt: skip
    sxx = det * cxx - (pxx * bxx + pxy * bxy + pxz * bxz)
    sxy = det * cxy - (pxx * byx + pxy * byy + pxz * byz)
    sxz = det * cxz - (pxx * bzx + pxy * bzy + pxz * bzz)
    syy = det * cyy - (pyx * byx + pyy * byy + pyz * byz)
    syz = det * cyz - (pyx * bzx + pyy * bzy + pyz * bzz)
    szz = det * czz - (pzx * bzx + pzy * bzy + pzz * bzz)
    nxx, nxy, nxz = syy * szz - syz * syz, sxz * syz - sxy * szz, sxy * syz - sxz * syy
    minors = nxx + (sxx * szz - sxz * sxz) + (sxx * syy - sxy * sxy)
    return det, minors, sxx * nxx + sxy * nxy + sxz * nxz, trace


@inlined
def _variance(det, minors, rest, trace):
    """tr S^-1, and whether it is one: False where something is left open."""
    fixed = (det > SINGULAR * (trace * trace * trace)) & (minors > 0.0) & (rest > 0.0)
    return minors * det / rest, fixed


@inlined
def _of_position(sums, v, step):
    """`body_schur` of the position, of the numbers `sums[v]`, `sums[v + step]`, and so on."""
    return body_schur(
        sums[v], sums[v + step], sums[v + 2 * step], sums[v + 3 * step], sums[v + 4 * step], sums[v + 5 * step],
        sums[v + 6 * step], sums[v + 7 * step], sums[v + 8 * step], sums[v + 9 * step], sums[v + 10 * step],
        sums[v + 11 * step], sums[v + 12 * step], sums[v + 13 * step], sums[v + 14 * step], sums[v + 15 * step],
        sums[v + 16 * step], sums[v + 17 * step], sums[v + 18 * step], sums[v + 19 * step], sums[v + 20 * step],
    )  # fmt: skip


@inlined
def position_variance(sums, v, step):
    """The trace of the covariance of the position, and whether it has one; arguments as in `_of_position`."""
    det, minors, rest, trace = _of_position(sums, v, step)
    return _variance(det, minors, rest, trace)


@inlined
def rotation_variance(sums, v, step):
    """The same of the rotation: C and A' exchanged, and B turned over."""
    det, minors, rest, trace = body_schur(
        sums[v + 15 * step], sums[v + 16 * step], sums[v + 17 * step], sums[v + 18 * step], sums[v + 19 * step],
        sums[v + 20 * step], sums[v + 6 * step], sums[v + 9 * step], sums[v + 12 * step], sums[v + 7 * step],
        sums[v + 10 * step], sums[v + 13 * step], sums[v + 8 * step], sums[v + 11 * step], sums[v + 14 * step],
        sums[v], sums[v + step], sums[v + 2 * step], sums[v + 3 * step], sums[v + 4 * step], sums[v + 5 * step],
    )  # fmt: skip
    return _variance(det, minors, rest, trace)


@inlined
def body_log_det(sums, v, step):
    """The logarithm of the determinant of the whole information, det A det S."""
    det, _, rest, _ = _of_position(sums, v, step)
    return np.log(rest / (det * det))


@dispatched
def body_meets(precision, sums, v, step):
    """Whether a view is what `precision` asks for; arguments as in `_of_position`."""


@body_meets.register(Precision)
def _meets(precision, sums, v, step):
    position, fixed = position_variance(sums, v, step)
    return fixed & (position <= precision.position)


@body_meets.register(PosePrecision)
def _meets_both(precision, sums, v, step):
    position, fixed = position_variance(sums, v, step)
    rotation, steady = rotation_variance(sums, v, step)
    return fixed & steady & (position <= precision.position) & (rotation <= precision.rotation)


@body_meets.register(SizedPrecision)
def _meets_of(precision, sums, v, step):
    return body_meets(precision.of, sums, v, step)
