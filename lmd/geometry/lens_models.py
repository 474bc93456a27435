"""Lens models as scalar functions: the projection of a point, and its derivatives.

A model is a named tuple of its coefficients, with OpenCV's names. NumPy code calls the functions with arrays, and
compiled code (kernels) contains the same functions, so the results of both are bit-identical. Points (u, v, w) are in
the camera frame: right, down, along the optical axis. Projected points are given relative to the principal point, in
focal lengths.

`BrownConrady` projects points in front of the camera. Let x = u / w, y = v / w and s = x^2 + y^2. The projected point
is

    (x g + 2 p1 x y + p2 (s + 2 x^2) + s1 s + s2 s^2, y g + p1 (s + 2 y^2) + 2 p2 x y + s3 s + s4 s^2),
    g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3).

`Equidistant` is a fisheye (Kannala and Brandt, 2006). This lens projects a point at the angle theta from the optical
axis to the distance t(theta) from the principal point. Points behind the camera are projected, too. Here
t(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

Sources: `cv2.projectPoints`, `cv2.fisheye`; `sensor_msgs/distortion_models` for the names.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched

HALF_TURN = np.pi / 2.0
# Lower bound on divisors: on the axis, numerator and divisor are zero.
TINY = 1e-300
# atan(p) = p (1 - p^2 (A0 - A1 p^2 + ...)) to rounding for |p| < 7/16, from FreeBSD's s_atan.c.
A0, A1, A2 = 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01
A3, A4, A5 = -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02
A6, A7, A8 = 6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02
A9, A10 = -3.65315727442169155270e-02, 1.62858201153657823623e-02


class BrownConrady(NamedTuple):
    """Pinhole with radial (rational), tangential and thin-prism distortion, of Brown and Conrady."""

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float
    k5: float
    k6: float
    s1: float
    s2: float
    s3: float
    s4: float


class Equidistant(NamedTuple):
    """Fisheye of Kannala and Brandt."""

    k1: float
    k2: float
    k3: float
    k4: float


@dispatched
def image_of(lens: Any, u: Any, v: Any, w: Any) -> Any:
    """Project a point (u, v, w); return its image coordinates to the right and down, focal lengths."""


@dispatched
def slope_of(lens: Any, u: Any, v: Any, w: Any) -> Any:
    """Jacobian of the projection, row by row: derivatives with respect to u, v and w. The first three are those of the
    image coordinate to the right, the last three those of the coordinate down.
    """


@dispatched
def depth_of(lens: Any, u: Any, v: Any, w: Any) -> Any:
    """Depth of a point: its coordinate w for a pinhole, its distance from the camera for a fisheye. The defocus blur
    and the apparent size of the point depend on it.
    """


@inlined
def area_per_solid_angle(lens: Any, u: Any, v: Any, w: Any) -> Any:
    """Image area per solid angle around a point, divided by the cube of the point's distance; 1 / w^3 for a pinhole."""
    xu, xv, xw, yu, yv, yw = slope_of(lens, u, v, w)
    # The cross product of the rows is parallel to the point.
    along = (xv * yw - xw * yv) * u + (xw * yu - xu * yw) * v + (xu * yv - xv * yu) * w
    return along / (u * u + v * v + w * w)


@image_of.register(BrownConrady)
def _image_brown_conrady(lens, u, v, w):  # type: ignore[no-untyped-def]
    per = 1.0 / w
    x, y = u * per, v * per
    s = x * x + y * y
    above = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    below = 1.0 + s * (lens.k4 + s * (lens.k5 + s * lens.k6))
    factor = above / below + 2.0 * (lens.p2 * x + lens.p1 * y)
    return factor * x + s * (lens.p2 + lens.s1 + s * lens.s2), factor * y + s * (lens.p1 + lens.s3 + s * lens.s4)


@slope_of.register(BrownConrady)
def _slope_brown_conrady(lens, u, v, w):  # type: ignore[no-untyped-def]
    per = 1.0 / w
    x, y = u * per, v * per
    s = x * x + y * y
    under = 1.0 / (1.0 + s * (lens.k4 + s * (lens.k5 + s * lens.k6)))
    radial = (1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))) * under
    above = lens.k1 + s * (2.0 * lens.k2 + 3.0 * s * lens.k3)
    below = lens.k4 + s * (2.0 * lens.k5 + 3.0 * s * lens.k6)
    twice = 2.0 * (above - radial * below) * under
    right, down = 2.0 * (lens.s1 + 2.0 * s * lens.s2), 2.0 * (lens.s3 + 2.0 * s * lens.s4)
    both = twice * x * y + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y
    xx = (radial + twice * x * x + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x + right * x) * per
    yy = (radial + twice * y * y + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x + down * y) * per
    xy, yx = (both + right * y) * per, (both + down * x) * per
    return xx, xy, -(xx * x + xy * y), yx, yy, -(yx * x + yy * y)


@depth_of.register(BrownConrady)
def _depth_brown_conrady(lens, u, v, w):  # type: ignore[no-untyped-def]
    return w


@inlined
def _polar(r: Any, w: Any) -> Any:
    """Polar coordinates of a point at the distance r from the optical axis and the coordinate w along the axis. Returns
    its angle theta in [0, pi] from the axis, theta / r, and r^2 + w^2.

    The arctangent is computed by a polynomial, as the last bits differ between libraries.
    """
    squared = r * r + w * w
    both = np.sqrt(squared) + abs(w)
    q = r / both
    root = 1.0 + np.sqrt(1.0 + q * q)
    p = q / root
    z = p * p
    high = A5 + z * (A6 + z * (A7 + z * (A8 + z * (A9 + z * A10))))
    series = 1.0 - z * (A0 + z * (A1 + z * (A2 + z * (A3 + z * (A4 + z * high)))))
    front = np.copysign(1.0, w)
    behind = (1.0 - front) * HALF_TURN
    return (
        behind + front * (4.0 * p * series),
        behind / np.maximum(r, TINY) + front * (4.0 * series / (root * both)),
        squared,
    )


@image_of.register(Equidistant)
def _image_equidistant(lens, u, v, w):  # type: ignore[no-untyped-def]
    theta, per, _ = _polar(np.sqrt(u * u + v * v), w)
    s = theta * theta
    scale = per * (1.0 + s * (lens.k1 + s * (lens.k2 + s * (lens.k3 + s * lens.k4))))
    return scale * u, scale * v


@slope_of.register(Equidistant)
def _slope_equidistant(lens, u, v, w):  # type: ignore[no-untyped-def]
    # With the image m (u, v), m = t / r, and theta' = (w, -r) / d^2 by (r, w).
    around = u * u + v * v
    theta, per, squared = _polar(np.sqrt(around), w)
    s = theta * theta
    scale = per * (1.0 + s * (lens.k1 + s * (lens.k2 + s * (lens.k3 + s * lens.k4))))
    steep = 1.0 + s * (3.0 * lens.k1 + s * (5.0 * lens.k2 + s * (7.0 * lens.k3 + s * (9.0 * lens.k4))))
    back = steep / squared
    bend = (back * w - scale) / np.maximum(around, TINY)
    across = bend * u * v
    return scale + bend * u * u, across, -(back * u), across, scale + bend * v * v, -(back * v)


@depth_of.register(Equidistant)
def _depth_equidistant(lens, u, v, w):  # type: ignore[no-untyped-def]
    return np.sqrt(u * u + v * v + w * w)
