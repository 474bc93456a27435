"""Covariance of a Kalman filter on SE(3) along drives; each operation of a step handles several drives at once.

Each drive occupies a *lane*, so that the loops over lanes vectorise. Number j of lane l lies at `array[j * LANES + l]`.

As in the invariant Kalman filter of `lmd.estimation.fusion`, the true pose is X = X^ exp(e). X^ is the estimate, and
the error e is a twist in the axes of the body. P is the covariance of the error. The motion T between two frames and
the information I of the tags in view update P:

    P <- Ad(T^-1) P Ad(T^-1)^T + Q,        P^-1 <- P^-1 + I.

The code expresses the error in the axes of the world: v is the error of the camera's position and w the error of its
rotation. In these axes, Ad(T^-1) replaces v by v + w x d with the displacement d of the camera, and keeps w. Odometry
with equal noise along all axes has the covariance Q = diag(m^2 h, t^2 h) in any axes. Here m and t are the noise
densities of position and rotation, and h is the time. I is the information of `lmd.objectives.localisation.information`
times `Tolerance.scale`, which contains the noise of the images.

A covariance or an information is 21 numbers, in three blocks. The first is the block of v as xx, xy, xz, yy, yz, zz.
Then come the block of v and w row by row, and the block of w in the order of the block of v. The functions take numbers
or arrays; kernels compile the functions that the reference calls, so the results are equal bit for bit.

The information of a view is rounded to multiples of `information.QUANTUM`. In a direction that the view leaves
undetermined, the rounded information is a small number of either sign. If P is large, such numbers matter, so
`update_beyond_rounding` leaves out such directions.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.core.dispatch import overridable
from lmd.geometry.vectors import Vector, cross3, dot3, plus3, read3, symmetric3

NUMBERS = 21  # numbers of a covariance
TURN = 15  # first number of the block of w
BLOCK, CROSS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]]), np.arange(6, TURN).reshape(3, 3)
# Index of each entry of the symmetric 6 x 6 matrix among the 21 numbers.
ENTRIES = np.block([[BLOCK, CROSS], [CROSS.T, BLOCK + TURN]])
# Rounding error of a variance, relative to the trace of the covariance.
COVARIANCE_ERROR = 1e-13

Number = Any  # a number in kernels, an array in the reference


@inlined
def predicted(p: Any, way: Vector, motion: Number, turn: Number) -> tuple[Number, ...]:
    """Covariance after a motion, from the covariance `p` before the motion.

    Each covariance is 21 numbers, in the order that the module states. The displacement is `way`, metres. The odometry
    has the variances `motion` [m^2] along each axis and `turn` [rad^2] about each axis.
    """
    vxx, vxy, vxz, vyy, vyz, vzz, xxx, xxy, xxz, xyx, xyy, xyz, xzx, xzy, xzz, wxx, wxy, wxz, wyy, wyz, wzz = p
    # X' = X - [d]x W, with the rows of X as covariances of v_i with w.
    yxx, yyx, yzx = plus3((xxx, xyx, xzx), cross3((wxx, wxy, wxz), way))
    yxy, yyy, yzy = plus3((xxy, xyy, xzy), cross3((wxy, wyy, wyz), way))
    yxz, yyz, yzz = plus3((xxz, xyz, xzz), cross3((wxz, wyz, wzz), way))
    # V' = V - [d]x X^T - X' [d]x^T: entry ij loses (d x X_j)_i + (d x X'_i)_j.
    x, y, z = cross3(way, (xxx, xxy, xxz)), cross3(way, (xyx, xyy, xyz)), cross3(way, (xzx, xzy, xzz))
    a, b, c = cross3(way, (yxx, yxy, yxz)), cross3(way, (yyx, yyy, yyz)), cross3(way, (yzx, yzy, yzz))
    uxx, uxy, uxz = vxx - (x[0] + a[0]), vxy - (y[0] + a[1]), vxz - (z[0] + a[2])
    uyy, uyz, uzz = vyy - (y[1] + b[1]), vyz - (z[1] + b[2]), vzz - (z[2] + c[2])
    return (
        uxx + motion, uxy, uxz, uyy + motion, uyz, uzz + motion, yxx, yxy, yxz, yyx, yyy, yyz, yzx, yzy, yzz,
        wxx + turn, wxy, wxz, wyy + turn, wyz, wzz + turn,
    )  # fmt: skip


@inlined
def _inverse(matrix: Any) -> tuple[Number, Number, Number, Number, Number, Number]:
    """Inverse of a positive definite 3 x 3 matrix, by the factorisation L D L^T. Matrix and inverse are six numbers
    each: xx, xy, xz, yy, yz, zz.
    """
    xx, xy, xz, yy, yz, zz = matrix
    a = 1.0 / xx
    p, q = xy * a, xz * a
    b = 1.0 / (yy - p * xy)
    m = yz - p * xz
    r = m * b
    c = 1.0 / ((zz - q * xz) - r * m)
    s = p * r - q  # L^-1 has the rows (1), (-p, 1), (s, -r, 1)
    sc, rc = s * c, r * c
    return a + (p * p * b + s * sc), -(p * b) - r * sc, sc, b + r * rc, -rc, c


@inlined
def inverted(p: Any) -> tuple[Number, ...]:
    """Inverse of a symmetric positive definite 6 x 6 matrix, computed from blocks of 3 x 3. Matrix and inverse are 21
    numbers each, in the order that the module's docstring states.
    """
    vxx, vxy, vxz, vyy, vyz, vzz, xxx, xxy, xxz, xyx, xyy, xyz, xzx, xzy, xzz, wxx, wxy, wxz, wyy, wyz, wzz = p
    a = _inverse((vxx, vxy, vxz, vyy, vyz, vzz))
    # G = V^-1 X by columns, and the Schur complement W - X^T G.
    x, y, z = (xxx, xyx, xzx), (xxy, xyy, xzy), (xxz, xyz, xzz)
    gxx, gyx, gzx = gx = symmetric3(a, x)
    gxy, gyy, gzy = gy = symmetric3(a, y)
    gxz, gyz, gzz = gz = symmetric3(a, z)
    d = _inverse((
        wxx - dot3(x, gx), wxy - dot3(x, gy), wxz - dot3(x, gz), wyy - dot3(y, gy), wyz - dot3(y, gz),
        wzz - dot3(z, gz),
    ))  # fmt: skip
    # H = G D by rows; the inverse has the blocks V^-1 + H G^T, -H and D.
    g, h, k = (gxx, gxy, gxz), (gyx, gyy, gyz), (gzx, gzy, gzz)
    (hxx, hxy, hxz), (hyx, hyy, hyz), (hzx, hzy, hzz) = p, q, r = symmetric3(d, g), symmetric3(d, h), symmetric3(d, k)
    return (
        a[0] + dot3(p, g), a[1] + dot3(p, h), a[2] + dot3(p, k), a[3] + dot3(q, h), a[4] + dot3(q, k),
        a[5] + dot3(r, k), -hxx, -hxy, -hxz, -hyx, -hyy, -hyz, -hzx, -hzy, -hzz, d[0], d[1], d[2], d[3], d[4], d[5],
    )  # fmt: skip


@inlined
def updated(p: Any, i: Any, scale: float) -> tuple[Number, ...]:
    """Covariance of a pose after an image, from the covariance `p` before the image. The information of the image is
    `scale` times `i`. Covariances and `i` are 21 numbers each, in the order that the module's docstring states.
    """
    (
        l0, l1, l2, l3, l4, l5, l6, l7, l8, l9, l10, l11, l12, l13, l14, l15, l16, l17, l18, l19, l20
    ) = inverted(p)  # fmt: skip
    return inverted((
        l0 + scale * i[0], l1 + scale * i[1], l2 + scale * i[2], l3 + scale * i[3], l4 + scale * i[4],
        l5 + scale * i[5], l6 + scale * i[6], l7 + scale * i[7], l8 + scale * i[8], l9 + scale * i[9],
        l10 + scale * i[10], l11 + scale * i[11], l12 + scale * i[12], l13 + scale * i[13], l14 + scale * i[14],
        l15 + scale * i[15], l16 + scale * i[16], l17 + scale * i[17], l18 + scale * i[18], l19 + scale * i[19],
        l20 + scale * i[20],
    ))  # fmt: skip


@inner
def update_beyond_rounding(
    rows: FloatArray, sums: FloatArray, lane: Integer, step: Integer, scale: float, least: float, work: FloatArray
) -> None:
    """Update a covariance in place with the information of an image, except in directions where it is a rounding error.

    The information is decomposed into terms d h h^T with a pivot d and a direction h, the largest pivot first. Each
    term updates the covariance P as a scalar measurement: P <- P - P h h^T P / (h^T P h + r) with r = 1 / (scale d).
    The variance r is increased to `COVARIANCE_ERROR` times tr P if it is smaller.

    Args:
        rows, sums: covariances and information of all lanes (drives that are filtered in parallel).
        lane, step: the lane's covariance has the numbers `rows[lane + j * step]`, and its information the numbers
            `sums[lane + j * step]`, j from 0 to 20, in the order of the module.
        scale: factor of the information.
        least: least pivot d that counts as information; smaller pivots are rounding errors.
        work: working memory, `(3, 6, 6)`.
    """
    p, rest, h, g = work[0], work[1], work[2, 0], work[2, 1]
    for e in range(36):
        entry = lane + ENTRIES[e // 6, e % 6] * step
        p[e // 6, e % 6], rest[e // 6, e % 6] = rows[entry], sums[entry]
    for _ in range(6):
        k, trace = 0, 0.0
        for r in range(6):
            k, trace = r if rest[r, r] > rest[k, k] else k, trace + p[r, r]
        d = rest[k, k]
        if not d > least:
            break
        for r in range(6):
            h[r] = rest[r, k] / d
        spread = max(1.0 / (scale * d), COVARIANCE_ERROR * trace)
        for r in range(6):
            g[r] = 0.0
            for c in range(6):
                g[r] += p[r, c] * h[c]
                rest[r, c] -= d * (h[r] * h[c])
            spread += h[r] * g[r]
        for e in range(36):
            p[e // 6, e % 6] -= g[e // 6] * g[e % 6] / spread
    for e in range(36):
        rows[lane + ENTRIES[e // 6, e % 6] * step] = p[e // 6, e % 6]


@inlined
def position_variance(p: Any) -> Number:
    """Variance of the position, m^2: the trace of the block of position errors (v) in a covariance of 21 numbers."""
    return p[0] + p[3] + p[5]


@inlined
def rotation_variance(p: Any) -> Number:
    """Variance of the rotation, rad^2: the trace of the block of rotation errors (w) in a covariance of 21 numbers."""
    return p[15] + p[18] + p[20]


LANES = 16  # fewer would be unrolled and not vectorised
MOVES = 5  # numbers of a move, see `Drives.moves`
# First entry of each number of the lanes, unsigned: numba tests whether a signed index is negative.
(
    _1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, _17, _18, _19, _20
) = (np.uint64(LANES * j) for j in range(1, NUMBERS))  # fmt: skip


class Tolerance(NamedTuple):
    """Limits up to which a pose counts as known, scale of an image's information, and threshold of rounding errors."""

    position: float
    """Greatest trace of the covariance of the position, m^2."""
    rotation: float
    """Greatest trace of the covariance of the rotation, rad^2; infinite for no limit."""
    scale: float
    """Information that belongs to one unit of the sums: the squared focal length divided by the squared noise of a
    corner, both in pixels.
    """
    least: float | None
    """Least information of a direction that counts; smaller values are rounding errors. In units of the sums; None if
    the initial estimate is good enough that rounding does not matter.
    """


class Lanes(NamedTuple):
    """Working memory for `LANES` Kalman filters that run in parallel, each along its own drive (a lane)."""

    covariance: FloatArray
    """`(21 LANES,)` covariance of the pose in each lane."""
    information: FloatArray
    """`(21 LANES,)` information of the current frame of each lane."""
    moves: FloatArray
    """`(5 LANES,)` row of `Drives.moves` for the current frame of each lane."""
    informed: np.ndarray
    """`(LANES,)` uint8, 1 if the information of the lane's current frame is used."""
    frames: IntArray
    """`(2, LANES)` next frame of each lane, and end of the drive in that lane; both are equal for an idle lane."""
    dense: FloatArray
    """`(3, 6, 6)` working memory of `update_beyond_rounding`."""


def lanes() -> Lanes:
    """New working memory of the Kalman filters, filled with zeros."""
    return Lanes(
        np.zeros(NUMBERS * LANES), np.zeros(NUMBERS * LANES), np.zeros(MOVES * LANES), np.zeros(LANES, np.uint8),
        np.zeros((2, LANES), np.int64), np.zeros((3, 6, 6)),
    )  # fmt: skip


@inlined
def column(rows: FloatArray, lane: Integer) -> tuple[Any, ...]:
    """Read the covariance or the information of one lane (one of the drives filtered in parallel), 21 numbers.

    `rows` `(21 LANES,)` has number j of lane l at `j * LANES + l`.
    """
    return (
        rows[lane], rows[lane + _1], rows[lane + _2], rows[lane + _3], rows[lane + _4], rows[lane + _5],
        rows[lane + _6], rows[lane + _7], rows[lane + _8], rows[lane + _9], rows[lane + _10], rows[lane + _11],
        rows[lane + _12], rows[lane + _13], rows[lane + _14], rows[lane + _15], rows[lane + _16], rows[lane + _17],
        rows[lane + _18], rows[lane + _19], rows[lane + _20],
    )  # fmt: skip


@inlined
def _write(rows: FloatArray, lane: Integer, p: Any) -> None:
    """Write the covariance `p` of one lane (one of the drives filtered in parallel), 21 numbers, into `rows`.

    `rows` `(21 LANES,)` has number j of lane l at `j * LANES + l`.
    """
    (
        rows[lane], rows[lane + _1], rows[lane + _2], rows[lane + _3], rows[lane + _4], rows[lane + _5],
        rows[lane + _6], rows[lane + _7], rows[lane + _8], rows[lane + _9], rows[lane + _10], rows[lane + _11],
        rows[lane + _12], rows[lane + _13], rows[lane + _14], rows[lane + _15], rows[lane + _16], rows[lane + _17],
        rows[lane + _18], rows[lane + _19], rows[lane + _20],
    ) = p  # fmt: skip


@inner
def predict_lanes(lanes: Lanes) -> None:
    """Predict the covariance at the next frame from the odometry, in each lane (drive) in place."""
    rows, moves = lanes.covariance, lanes.moves
    for lane in range(np.uint64(LANES)):
        way = read3(moves, lane, _1)
        _write(rows, lane, predicted(column(rows, lane), way, moves[lane + _3], moves[lane + _4]))


@overridable
def update_lanes(least: Any, lanes: Lanes, scale: float) -> None:
    """Update the covariance in each lane (drive) in place with the information of the lane's current frame.

    Lanes whose frame has too few tags in view (`Lanes.informed`) keep their covariance. For `least` and `scale` see
    `Tolerance`.
    """
    for lane in range(LANES):
        if lanes.informed[lane]:
            update_beyond_rounding(lanes.covariance, lanes.information, lane, LANES, scale, least, lanes.dense)


@update_lanes.register(type(None))
def _update_lanes_none(least: None, lanes: Lanes, scale: float) -> None:
    rows, sums, informed = lanes.covariance, lanes.information, lanes.informed
    for lane in range(np.uint64(LANES)):
        known = informed[lane] != 0
        p = column(rows, lane)
        u = updated(p, column(sums, lane), scale)
        _write(rows, lane, (
            u[0] if known else p[0], u[1] if known else p[1], u[2] if known else p[2], u[3] if known else p[3],
            u[4] if known else p[4], u[5] if known else p[5], u[6] if known else p[6], u[7] if known else p[7],
            u[8] if known else p[8], u[9] if known else p[9], u[10] if known else p[10], u[11] if known else p[11],
            u[12] if known else p[12], u[13] if known else p[13], u[14] if known else p[14],
            u[15] if known else p[15], u[16] if known else p[16], u[17] if known else p[17],
            u[18] if known else p[18], u[19] if known else p[19], u[20] if known else p[20],
        ))  # fmt: skip


@inlined
def is_known(p: Any, tolerance: Tolerance) -> Any:
    """True if the covariance `p` of a pose is within the limits of `tolerance`."""
    return (position_variance(p) <= tolerance.position) & (rotation_variance(p) <= tolerance.rotation)


@kernel
def filter_drives(
    first: IntArray, moves: FloatArray, sums: FloatArray, informed: np.ndarray, start: FloatArray,
    tolerance: Tolerance, work: Lanes, known: np.ndarray, kept: FloatArray,
) -> None:  # fmt: skip
    """Run a Kalman filter along each of D drives; the results are written into `known` and `kept`.

    Args:
        first, moves, start: index of the first frame of each drive, `(D + 1,)`; motion before each frame, `(F, 5)`;
            initial covariance, `(21,)`; see `Drives`.
        sums: information of each frame, `(F, 21)`.
        informed: uint8, 1 for frames whose information is used, `(F,)`.
        tolerance: limits of the covariance up to which a pose counts as known.
        work: working memory.
        known: receives 1 for frames in which the pose is known to the tolerance, uint8, `(F,)`.
        kept: receives the covariance of each frame, `(F, 21)`.
    """
    drives = len(first) - 1
    for group in range(0, drives, LANES):
        longest = np.int64(0)
        for lane in range(LANES):
            d = min(group + lane, drives - 1)
            work.frames[0, lane], work.frames[1, lane] = first[d], first[d + 1] if group + lane < drives else first[d]
            longest = max(longest, work.frames[1, lane] - work.frames[0, lane])
            for j in range(NUMBERS):
                work.covariance[j * LANES + lane] = start[j]
        for step in range(longest):
            some = False
            for lane in range(LANES):
                f = work.frames[0, lane] + step
                there = f < work.frames[1, lane]
                work.informed[lane] = informed[f] if there else np.uint8(0)
                some |= work.informed[lane] != 0
                for j in range(MOVES):
                    work.moves[j * LANES + lane] = moves[f, j] if there else 0.0
                if there:
                    for j in range(NUMBERS):
                        work.information[j * LANES + lane] = sums[f, j]
            predict_lanes(work)
            if some:
                update_lanes(tolerance.least, work, tolerance.scale)
            for lane in range(LANES):
                f = work.frames[0, lane] + step
                if f < work.frames[1, lane]:
                    known[f] = is_known(column(work.covariance, lane), tolerance)
                    for j in range(NUMBERS):
                        kept[f, j] = work.covariance[j * LANES + lane]
