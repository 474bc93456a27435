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
from lmd.geometry.vectors import Vector, adjugate3, dot3, invariants3, read3, read6, symmetric3
from lmd.objectives.localisation.information import Number, Precision, inverse_trace, within

BODY_NUMBERS = 21  # numbers of a view: C, B and A'
BODY_WIDTH = 24  # length of a row of `sums`; rows begin at multiples of 64 bytes


def gain_of(camera: Camera, first: Camera) -> float:
    """Information per pixel of a camera relative to the first camera of its rig: ratio of the squared focal lengths."""
    return float(np.prod(camera.focal_pixels)) / float(np.prod(first.focal_pixels))


@inlined
def about_body(moments: tuple[Number, ...], arm: Vector) -> tuple[Number, ...]:
    """The 21 numbers of the body from the 15 `information.moments` of a camera at the offset `arm` [m]."""
    x, y, z = arm
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
def _schur(c: Any, rows: Any, a: Any) -> tuple[Number, Number, Number, Number]:
    """det A, the sum of the principal minors and the determinant of S det A, S = C - B A^-1 B^T, and tr A.

    C and A are symmetric, six numbers each; B is given by its three rows.
    """
    m, (_, det), (x, y, z) = adjugate3(a), invariants3(a), rows
    px, py, pz = symmetric3(m, x), symmetric3(m, y), symmetric3(m, z)
    minors, rest = invariants3((
        det * c[0] - dot3(px, x), det * c[1] - dot3(px, y), det * c[2] - dot3(px, z), det * c[3] - dot3(py, y),
        det * c[4] - dot3(py, z), det * c[5] - dot3(pz, z),
    ))  # fmt: skip
    return det, minors, rest, a[0] + a[3] + a[5]


@inlined
def _position_schur(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number, Number, Number]:
    """`_schur` for the position of the body."""
    x, y, z = v + 6 * step, v + 9 * step, v + 12 * step
    rows = read3(sums, x, step), read3(sums, y, step), read3(sums, z, step)
    return _schur(read6(sums, v, step), rows, read6(sums, v + 15 * step, step))


@inlined
def body_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """`information.inverse_trace` for the position of the body."""
    det, minors, rest, trace = _position_schur(sums, v, step)
    return inverse_trace(det, minors, rest, trace)


@inlined
def body_rotation_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """`information.inverse_trace` for the rotation of the body: C and A' are exchanged, and B is transposed."""
    x, far = v + 6 * step, 3 * step
    columns = read3(sums, x, far), read3(sums, x + step, far), read3(sums, x + 2 * step, far)
    det, minors, rest, trace = _schur(read6(sums, v + 15 * step, step), columns, read6(sums, v, step))
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
