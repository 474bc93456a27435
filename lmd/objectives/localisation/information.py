"""Fisher information about the pose of a camera, or of the body of a rig, from the tag corners in a view.

Let d be the offset of a corner from the camera, r = |d|, and b = d / r the direction in which the camera sees the
corner. If the camera moves by v and turns by w, both in the world frame, b turns by b x w - (I - b b^T) v / r. With
isotropic noise, the corners together have an information of 15 numbers about (v, w), which do not depend on the
orientation of the camera. [g]x is the matrix of the cross product with g. The matrix:

    [ C       -[g]x ]       A = sum (I - b b^T),   g = sum b / r,   C = sum (I - b b^T) / r^2
    [ [g]x     A    ].

The information about the position, if the rotation is estimated too, is the Schur complement

    S = C - ((g^T A g) A - (A g) (A g)^T) / det A.

The standard deviation of the position is (sigma / f) sqrt(tr S^-1), with the noise sigma of a corner's coordinate and
the focal length f, both in pixels. Here tr S^-1 is the sum of the principal 2 x 2 minors of S, divided by det S. The
formulas for the rotation have A and C exchanged.

Noise is isotropic in pixels, not in directions. At the cosine c = z / r from the optical axis, a rotation of the
direction moves the image by 1 / c^2 radially and 1 / c tangentially. The 15 numbers of a landmark at the distance r and
the depth z are therefore weighted with (r / z)^3, which preserves the determinant of the information of each corner.
For a lens with distortion the weight is `lmd.scene.criteria.pixel_density`. The remaining error is a few per cent of
the standard deviation, see docs/accuracy.md. The exact information would need 21 numbers for each landmark, position
*and* orientation. Pixels are treated as square, with the geometric mean of the two focal lengths.

A point landmark counts as one corner. Two points leave the rotation about the line through them undetermined. A single
tag has two poses with nearly equal images, which these formulas ignore; see `ambiguity`.

The functions take numbers or arrays. Kernels compile the functions that the reference calls, so the results are equal
bit for bit. The numbers of view v are `sums[v + j * step]`, j from 0 to 14: A as xx, xy, xz, yy, yz, zz, then g, then
C. The contribution of a landmark is rounded to a multiple of `QUANTUM`. Sums are then exact in any order, so landmarks
can be added and removed again.

A camera at the offset o from the body's origin, world frame, moves by v - o x w when the body moves by v and turns by
w. The information about (v, w) of the body has 21 numbers, and follows from A, g and C of the camera. The matrix:

    [ C       B           ]      B = -C [o]x - [g]x
    [ B^T     A'          ]      A' = A - [o]x C [o]x - [o]x [g]x - [g]x [o]x.

Cameras measure independently, so their information, times the square of their focal lengths, adds up. A landmark that
two cameras see adds information twice, and counts once among the n landmarks that a view needs. Each landmark's
contribution to a view is rounded as for a single camera, which makes sums exact in any order.

The numbers of view v of a rig are `sums[v + j * step]`, j from 0 to 20: C as xx, xy, xz, yy, yz, zz, B row by row, and
A' as C.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import overridable
from lmd.geometry.camera import Camera
from lmd.geometry.vectors import Vector, adjugate3, dot3, invariants3, plus3, read3, read6, symmetric3, times3
from lmd.scene.criteria import TOLERANCE
from lmd.scene.tag import Tag

NUMBERS = 15  # numbers of a view: A, g and C
WIDTH = 16  # length of a row of `sums`: the 15 numbers, and the residual ratio of `ambiguity`
QUANTUM = 2.0**-36
# Adding and subtracting this number rounds numbers below 2^15 to multiples of `QUANTUM`; sums are exact below 2^17.
ROUNDER = 1.5 * 2.0**52 * QUANTUM
# Least squared distance of a corner, m^2; a closer corner counts as this far away, which keeps sums below 2^17.
NEAREST = 0.1**2
# Least det A / tr(A)^3; below it det A is a rounding error, as all corners lie in one direction.
SINGULAR = 1e-9

Number = Any  # a number in kernels, an array in the reference
# Offset of a landmark's centre from the camera, and vectors from the centre to the midpoints of its right and its upper
# edge, metres.
Square: TypeAlias = tuple[Vector, Vector, Vector]


class Precision(NamedTuple):
    """Limits that a localised view must satisfy. Variances are traces of covariances, divided by the square of the
    ratio that `deviation_per_variance` returns.

    For a limit that is None, kernels are compiled without the test.
    """

    halves: FloatArray
    """`(K,)` half the edge length of each tag, or `(1,)` if all tags have one size; metres, 0 for points."""
    share: float
    """Weight of each of the four corners of a landmark: 1, or 1/4 for a point."""
    position: float
    """Greatest variance of the position, see the class; infinite if n covered landmarks suffice."""
    rotation: float | None = None
    """Greatest variance of the rotation, see the class; None for no limit."""
    residual: float | None = None
    """Least squared residual of the mirrored pose of a single tag, in units of f^2: see `ambiguity`."""

    @property
    def asks(self) -> bool:
        """True if n covered landmarks do not suffice for a localised view: the pose must also be accurate."""
        return bool(np.isfinite(self.position)) or self.rotation is not None


@inlined
def half_of(precision: Precision, k: Integer) -> Any:
    """Half the edge length of tag k of a deployment, metres."""
    if len(precision.halves) == 1:
        return precision.halves[0]
    return precision.halves[k]


@overridable
def within(limit: float | None, variance: Number, fixed: Number) -> Any:
    """True if a variance is finite and at most `limit`; always True if `limit` is None.

    `fixed` is True if the variance is finite.
    """
    return fixed & (variance <= limit)


@within.register(type(None))
def _within_none(limit: None, variance: Number, fixed: Number) -> Any:
    return True


def deviation_per_variance(camera: Camera, pixel_noise: float) -> float:
    """Standard deviation, metres or rad, that belongs to the variance 1 in the units of this module: sigma / f.

    Args:
        camera: the camera, with the focal length f in pixels.
        pixel_noise: sigma, the standard deviation of each coordinate of a corner, pixels.
    """
    return float(pixel_noise / np.sqrt(np.prod(camera.focal_pixels)))


def precision(
    camera: Camera, tag: Tag, pixel_noise: float, tolerance: float, rotation: float | None = None,
    edges: Sequence[float] | None = None,
) -> Precision:  # fmt: skip
    """Make the limits of a localised view from its greatest standard deviations.

    Args:
        camera: the single camera, or the first camera of a rig.
        tag: the landmarks' tag.
        pixel_noise: standard deviation of each coordinate of a corner, pixels.
        tolerance: greatest standard deviation of the position, metres.
        rotation: greatest standard deviation of the rotation, rad; None for no limit.
        edges: edge lengths of the tags, `(K,)`, or one length for all, metres; None for the edge length of `tag`.
    """
    scale = deviation_per_variance(camera, pixel_noise)
    halves = np.array([0.0]) if tag.is_point else np.array(edges or (tag.size,)) / 2.0

    def limit(deviation: float) -> float:
        return (deviation / scale) ** 2 * (1.0 + TOLERANCE)

    turn = None if rotation is None else limit(rotation)
    return Precision(halves, 0.25 if tag.is_point else 1.0, limit(tolerance), turn)


@inlined
def moments(tag: Square, share: float) -> tuple[Number, ...]:
    """Information that a landmark gives about the camera's pose, before it is weighted for an orientation.

    The result is the 15 numbers A, g and C of the module, summed over the four corners, times the cube of the
    landmark's distance. The weight `pixel_density`, applied later, contains the inverse of the cube. `share` is the
    weight of each corner.
    """
    axx = axy = axz = ayy = ayz = azz = gx = gy = gz = cxx = cxy = cxz = cyy = cyz = czz = 0.0
    for i in range(4):
        right, up = times3(1.0 - 2.0 * (i // 2), tag[1]), times3(1.0 - 2.0 * (i % 2), tag[2])
        dx, dy, dz = d = plus3(plus3(tag[0], right), up)
        q = 1.0 / np.maximum(dot3(d, d), NEAREST)
        bx, by, bz = times3(q, d)
        pxx, pxy, pxz = 1.0 - dx * bx, -(dx * by), -(dx * bz)
        pyy, pyz, pzz = 1.0 - dy * by, -(dy * bz), 1.0 - dz * bz
        axx, axy, axz, ayy, ayz, azz = axx + pxx, axy + pxy, axz + pxz, ayy + pyy, ayz + pyz, azz + pzz
        gx, gy, gz = gx + bx, gy + by, gz + bz
        cxx, cxy, cxz = cxx + pxx * q, cxy + pxy * q, cxz + pxz * q
        cyy, cyz, czz = cyy + pyy * q, cyz + pyz * q, czz + pzz * q
    squared = dot3(tag[0], tag[0])
    w = share * (squared * np.sqrt(squared))
    return (
        w * axx, w * axy, w * axz, w * ayy, w * ayz, w * azz, w * gx, w * gy, w * gz,
        w * cxx, w * cxy, w * cxz, w * cyy, w * cyz, w * czz,
    )  # fmt: skip


@inlined
def share_of(moment: Number, weight: Number) -> Number:
    """Contribution of a landmark to one number of a view's information, rounded to a multiple of `QUANTUM`.

    `moment` is this number in the landmark's `moments`, and `weight` the `pixel_density` of the landmark in the view.
    """
    return (moment * weight + ROUNDER) - ROUNDER


@inlined
def _schur(sums: Any, v: Integer, step: Integer, first: int, last: int) -> tuple[Number, Number, Number, Number]:
    """Four numbers from which `inverse_trace` computes the variance of the position, or of the rotation, in view v.

    The module defines the Schur complement S and the matrices A and C. The numbers are det A, then two numbers of the
    matrix (det A) S, then tr A. The two numbers are the sum of the principal 2 x 2 minors, and the determinant.

    Number j of the view's information is `sums[v + j * step]`. The six numbers of A begin at number `first`, those of C
    at number `last`: (0, 9) for the position, (9, 0) for the rotation, for which A and C are exchanged.
    """
    a, g = read6(sums, v + first * step, step), read3(sums, v + 6 * step, step)
    (axx, axy, axz, ayy, ayz, azz), (cxx, cxy, cxz, cyy, cyz, czz) = a, read6(sums, v + last * step, step)
    (_, det), (hx, hy, hz) = invariants3(a), symmetric3(a, g)
    q = dot3(g, (hx, hy, hz))
    sxx, sxy, sxz = det * cxx - q * axx + hx * hx, det * cxy - q * axy + hx * hy, det * cxz - q * axz + hx * hz
    syy, syz, szz = det * cyy - q * ayy + hy * hy, det * cyz - q * ayz + hy * hz, det * czz - q * azz + hz * hz
    minors, rest = invariants3((sxx, sxy, sxz, syy, syz, szz))
    return det, minors, rest, axx + ayy + azz


@inlined
def inverse_trace(det: Number, minors: Number, rest: Number, trace: Number) -> tuple[Number, Number]:
    """Variance of the position or of the rotation, tr S^-1, and a flag that is False if the variance is infinite.

    S is the information about the position or about the rotation, see the module. The arguments are the four results of
    `_schur` or `_body_schur`. The variance is infinite if the corners leave a motion undetermined; the first result
    then has no meaning.
    """
    fixed = (det > SINGULAR * (trace * trace * trace)) & (minors > 0.0) & (rest > 0.0)
    return minors * det / rest, fixed


@inlined
def variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """Variance of the camera's position in view v, divided by (sigma / f)^2; and a flag.

    The variance is the trace of the covariance, m^2. The ratio sigma / f of a corner's noise to the focal length is
    the result of `deviation_per_variance`. The flag is False if the variance is infinite; the first result then has no
    meaning. Number j of the view's information is `sums[v + j * step]`.
    """
    det, minors, rest, trace = _schur(sums, v, step, 0, 9)
    return inverse_trace(det, minors, rest, trace)


@inlined
def rotation_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """Variance of the camera's rotation in view v, divided by (sigma / f)^2; and a flag.

    The variance is the trace of the covariance, rad^2. The ratio sigma / f of a corner's noise to the focal length is
    the result of `deviation_per_variance`. The flag is False if the variance is infinite; the first result then has no
    meaning. Number j of the view's information is `sums[v + j * step]`.
    """
    det, minors, rest, trace = _schur(sums, v, step, 9, 0)
    return inverse_trace(det, minors, rest, trace)


@inlined
def log_det(sums: Any, v: Integer, step: Integer) -> Number:
    """Logarithm of the determinant of the information (a 6 x 6 matrix) about the camera's pose in view v.

    Number j of the view's information is `sums[v + j * step]`.
    """
    det, _, rest, _ = _schur(sums, v, step, 0, 9)
    return np.log(rest / (det * det))


@inlined
def meets(precision: Precision, sums: Any, v: Integer, step: Integer) -> Any:
    """True if the variances of view v are within the limits of `precision`; ambiguity is not tested.

    Number j of the view's information is `sums[v + j * step]`.
    """
    position, fixed = variance(sums, v, step)
    rotation, steady = rotation_variance(sums, v, step)
    return within(precision.position, position, fixed) & within(precision.rotation, rotation, steady)


BODY_NUMBERS = 21  # numbers of a view: C, B and A'
BODY_WIDTH = 24  # length of a row of `sums`; rows begin at multiples of 64 bytes


def gain_of(camera: Camera, first: Camera) -> float:
    """Ratio of the information per pixel of a camera to that of the rig's first camera.

    The ratio is that of the squared focal lengths.
    """
    return float(np.prod(camera.focal_pixels)) / float(np.prod(first.focal_pixels))


@inlined
def about_body(moments: tuple[Number, ...], arm: Vector) -> tuple[Number, ...]:
    """Information of a landmark about the pose of a rig's body, 21 numbers, from its `moments` for one camera.

    The camera is at the offset `arm` from the body's origin, metres.
    """
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
def _body_schur(c: Any, rows: Any, a: Any) -> tuple[Number, Number, Number, Number]:
    """Four numbers from which `inverse_trace` computes tr S^-1, for the 3 x 3 matrix S = C - B A^-1 B^T.

    The numbers are det A, then two numbers of the matrix (det A) S, then tr A. The two numbers are the sum of the
    principal 2 x 2 minors, and the determinant. `c` and `a` are the symmetric matrices C and A, six numbers each: xx,
    xy, xz, yy, yz, zz. `rows` are the three rows of B.
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
    """Four numbers from which `inverse_trace` computes the variance of the position of a rig's body in view v.

    The numbers are the result of `_body_schur` for S = C - B A'^-1 B^T, with the blocks C, B and A' that the module
    defines. Number j of the view's information is `sums[v + j * step]`.
    """
    x, y, z = v + 6 * step, v + 9 * step, v + 12 * step
    rows = read3(sums, x, step), read3(sums, y, step), read3(sums, z, step)
    return _body_schur(read6(sums, v, step), rows, read6(sums, v + 15 * step, step))


@inlined
def body_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """Variance of the position of a rig's body in view v, divided by (sigma / f)^2; and a flag.

    The variance is the trace of the covariance, m^2. The ratio sigma / f of a corner's noise to the focal length is
    the result of `deviation_per_variance`. The flag is False if the variance is infinite; the first result then has no
    meaning. Number j of the view's information is `sums[v + j * step]`.
    """
    det, minors, rest, trace = _position_schur(sums, v, step)
    return inverse_trace(det, minors, rest, trace)


@inlined
def body_rotation_variance(sums: Any, v: Integer, step: Integer) -> tuple[Number, Number]:
    """Variance of the rotation of a rig's body in view v, divided by (sigma / f)^2; and a flag.

    The variance is the trace of the covariance, rad^2. The ratio sigma / f of a corner's noise to the focal length is
    the result of `deviation_per_variance`. The flag is False if the variance is infinite; the first result then has no
    meaning. Number j of the view's information is `sums[v + j * step]`.
    """
    x, far = v + 6 * step, 3 * step
    columns = read3(sums, x, far), read3(sums, x + step, far), read3(sums, x + 2 * step, far)
    det, minors, rest, trace = _body_schur(read6(sums, v + 15 * step, step), columns, read6(sums, v, step))
    return inverse_trace(det, minors, rest, trace)


@inlined
def body_log_det(sums: Any, v: Integer, step: Integer) -> Number:
    """Logarithm of the determinant of the information (a 6 x 6 matrix) about the pose of a rig's body in view v.

    Number j of the view's information is `sums[v + j * step]`.
    """
    det, _, rest, _ = _position_schur(sums, v, step)
    return np.log(rest / (det * det))


@inlined
def body_meets(precision: Precision, sums: Any, v: Integer, step: Integer) -> Any:
    """True if the body's variances in view v of a rig are within the limits of `precision`; ambiguity is not tested.

    Number j of the view's information is `sums[v + j * step]`.
    """
    position, fixed = body_variance(sums, v, step)
    rotation, steady = body_rotation_variance(sums, v, step)
    return within(precision.position, position, fixed) & within(precision.rotation, rotation, steady)
