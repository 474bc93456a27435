"""Fisher information of the images of a rig on the pose of its body, from the information on the poses of its cameras.

A camera at the offset o from the body's origin, world frame, moves by v - o x w when the body moves by v and turns by
w. With A, g and C of the camera (`information`), the information on (v, w) of the body is

    [ C       B           ]      B = -C [o]x - [g]x
    [ B^T     A'          ]      A' = A - [o]x C [o]x - [o]x [g]x - [g]x [o]x,

21 numbers. Cameras measure independently, so their information, times the square of their focal lengths, adds up. A
landmark that two cameras see adds information twice, and counts once among the n landmarks that a view needs. Each
landmark's contribution to a view is rounded as for a single camera, which makes sums exact in any order.

The numbers of view v are `sums[v + j * step]`, j from 0 to 20: C as xx, xy, xz, yy, yz, zz, B row by row, and A' as C.
"""

from typing import Any

import numpy as np

from lmd.core.bits import Integer
from lmd.core.compiled import inlined
from lmd.geometry.camera import Camera
from lmd.objectives.localisation.information import Number, Precision, inverse_trace, within

BODY_NUMBERS = 21  # numbers of a view: C, B and A'
BODY_WIDTH = 24  # length of a row of `sums`; rows begin at multiples of 64 bytes


def gain_of(camera: Camera, first: Camera) -> float:
    """Information per pixel of a camera relative to the first camera of its rig: ratio of the squared focal lengths."""
    return float(np.prod(camera.focal_pixels)) / float(np.prod(first.focal_pixels))


@inlined
def about_body(moments: tuple[Number, ...], x: Number, y: Number, z: Number) -> tuple[Number, ...]:
    """The 21 numbers of the body from the 15 `information.moments` of a camera at the offset (x, y, z) [m]."""
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
def _schur(
    cxx: Number, cxy: Number, cxz: Number, cyy: Number, cyz: Number, czz: Number,
    bxx: Number, bxy: Number, bxz: Number, byx: Number, byy: Number, byz: Number, bzx: Number, bzy: Number, bzz: Number,
    axx: Number, axy: Number, axz: Number, ayy: Number, ayz: Number, azz: Number,
) -> tuple[Number, Number, Number, Number]:  # fmt: skip
    """det A, the sum of the principal minors and the determinant of S det A, S = C - B A^-1 B^T, and tr A."""
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
def _position_schur(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number, Number, Number]:
    """`_schur` for the position of the body."""
    return _schur(
        sums[v], sums[v + step], sums[v + 2 * step], sums[v + 3 * step], sums[v + 4 * step], sums[v + 5 * step],
        sums[v + 6 * step], sums[v + 7 * step], sums[v + 8 * step], sums[v + 9 * step], sums[v + 10 * step],
        sums[v + 11 * step], sums[v + 12 * step], sums[v + 13 * step], sums[v + 14 * step], sums[v + 15 * step],
        sums[v + 16 * step], sums[v + 17 * step], sums[v + 18 * step], sums[v + 19 * step], sums[v + 20 * step],
    )  # fmt: skip


@inlined
def body_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """`information.inverse_trace` for the position of the body."""
    det, minors, rest, trace = _position_schur(sums, v, step)
    return inverse_trace(det, minors, rest, trace)


@inlined
def body_rotation_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """`information.inverse_trace` for the rotation of the body: C and A' are exchanged, and B is transposed."""
    det, minors, rest, trace = _schur(
        sums[v + 15 * step], sums[v + 16 * step], sums[v + 17 * step], sums[v + 18 * step], sums[v + 19 * step],
        sums[v + 20 * step], sums[v + 6 * step], sums[v + 9 * step], sums[v + 12 * step], sums[v + 7 * step],
        sums[v + 10 * step], sums[v + 13 * step], sums[v + 8 * step], sums[v + 11 * step], sums[v + 14 * step],
        sums[v], sums[v + step], sums[v + 2 * step], sums[v + 3 * step], sums[v + 4 * step], sums[v + 5 * step],
    )  # fmt: skip
    return inverse_trace(det, minors, rest, trace)


@inlined
def body_log_det(sums: Any, v: Integer, step: Integer) -> Number:
    """Logarithm of the determinant of the information, det A det S."""
    det, _, rest, _ = _position_schur(sums, v, step)
    return np.log(rest / (det * det))


@inlined
def body_meets(precision: Precision, sums: Any, v: Integer, step: Integer) -> Any:
    """True if the information of a view has the required `precision`; ambiguity is not tested."""
    position, fixed = body_variance(sums, v, step)
    rotation, steady = body_rotation_variance(sums, v, step)
    return within(precision.position, position, fixed) & within(precision.rotation, rotation, steady)
