"""Lens distortion: OpenCV's radial and tangential model with the coefficients (k1, k2, p1, p2, k3).

A ray (x, y, 1) in the camera's frame is imaged where an ideal lens would image D(x, y), with r^2 = x^2 + y^2, q = (p2,
p1) and the radial factor g = 1 + k1 r^2 + k2 r^4 + k3 r^6:

    D = (g + 2 q . (x, y)) (x, y) + r^2 q.

Its Jacobian is symmetric. Without q it has the eigenvalues g across and R' = d(r g)/dr along the radius, and q moves
both by at most 6 |q| r. As far as they stay positive, D maps a disc one to one, and |D| is at least h(r) = r g -
3 |q| r^2, which grows with r. Farther out D may turn back: a ray there is not imaged where the formula says.
"""

import math
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, vector

# Newton's method has found a ray when its last step was smaller.
CONVERGED = 1e-9
# Radii among which it finds a start.
STARTS = 64
# Rings in which the stretch is bounded.
RINGS = 2048
# A root whose imaginary part is a smaller share counts as real: then D at least comes close to turning back.
REAL = 1e-6


def bent(x: Any, y: Any, k1: float, k2: float, p1: float, p2: float, k3: float) -> tuple[Any, Any]:
    """D(x, y), of numbers or arrays; `lmd.sight.models.distorted_sight` compiles this very function."""
    square = x * x + y * y
    factor = 1.0 + square * (k1 + square * (k2 + square * k3)) + 2.0 * (p2 * x + p1 * y)
    return factor * x + square * p2, factor * y + square * p1


def slopes(x: Any, y: Any, k1: float, k2: float, p1: float, p2: float, k3: float) -> tuple[Any, Any, Any]:
    """The Jacobian of D, (dD_x/dx, dD_x/dy = dD_y/dx, dD_y/dy), of numbers or arrays; compiled likewise."""
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    slope = 2.0 * (k1 + square * (2.0 * k2 + 3.0 * square * k3))  # d(radial) / d(r^2), twice
    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return xx, slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y, yy


def coefficients(distortion: Any) -> tuple[float, ...]:
    """The five coefficients, or none for a lens that does not distort.

    Args:
        distortion: none, (k1, k2, p1, p2) or (k1, k2, p1, p2, k3).

    Raises:
        InputError: it is something else.
    """
    given = list(distortion) if np.ndim(distortion) == 1 else []
    if np.ndim(distortion) != 1 or len(given) not in (0, 4, 5):
        raise InputError(f"distortion must be [] or [k1, k2, p1, p2] or with k3, got {distortion!r}.", "distortion")
    five = vector("distortion", [*given, *[0.0] * (5 - len(given))], 5)
    return five if any(five) else ()


def distort(rays: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """D of rays (x / z, y / z), `(..., 2)`."""
    return np.stack(bent(rays[..., 0], rays[..., 1], *distortion), axis=-1)


def jacobian(rays: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """The Jacobian of `distort` at rays `(..., 2)`: `(..., 2, 2)`."""
    xx, xy, yy = slopes(rays[..., 0], rays[..., 1], *distortion)
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def undistort(image: FloatArray, distortion: tuple[float, ...], steps: int = 20) -> FloatArray:
    """The inverse of `distort`, `(..., 2)`, by Newton's method from where the radial terms alone would have it.

    NaN where it does not converge in `steps`: no ray below the `turning_point` is imaged there.
    """
    length = np.hypot(image[..., 0], image[..., 1])
    farthest = min(turning_point(distortion), widest_ray(distortion, np.nanmax(length, initial=CONVERGED)))
    radius = np.linspace(0.0, farthest, STARTS)
    k1, k2, _, _, k3 = distortion
    start = np.interp(length, bent(radius, 0.0, k1, k2, 0.0, 0.0, k3)[0], radius)
    found = image * (start / np.maximum(length, CONVERGED))[..., None]
    for _ in range(steps):
        xx, xy, yy = slopes(found[..., 0], found[..., 1], *distortion)
        a, b = np.moveaxis(image - distort(found, distortion), -1, 0)
        with np.errstate(all="ignore"):
            step = np.stack([yy * a - xy * b, xx * b - xy * a], axis=-1) / (xx * yy - xy * xy)[..., None]
            found += step
        if np.nanmax(np.abs(step), initial=0.0) < CONVERGED:
            break
    return np.where((np.abs(step) < CONVERGED).all(axis=-1, keepdims=True), found, np.nan)


def turning_point(distortion: tuple[float, ...]) -> float:
    """Up to which radius r the distortion surely maps one to one; infinity for any."""
    k1, k2, p1, p2, k3 = distortion
    sway = -6.0 * math.hypot(p1, p2)
    across, along = [1.0, sway, k1, 0.0, k2, 0.0, k3], [1.0, sway, 3.0 * k1, 0.0, 5.0 * k2, 0.0, 7.0 * k3]
    return min(_first_root(across), _first_root(along))


def widest_ray(distortion: tuple[float, ...], reach: float) -> float:
    """The radius r with h(r) = reach: no ray beyond it, and below the `turning_point`, is imaged nearer to the axis."""
    k1, k2, p1, p2, k3 = distortion
    return _first_root([-reach, 1.0, -3.0 * math.hypot(p1, p2), k1, 0.0, k2, 0.0, k3])


def greatest_stretch(distortion: tuple[float, ...], radius: float) -> float:
    """A bound of the eigenvalues of the Jacobian, g + 6 |q| r and R' + 6 |q| r, for all rays within `radius`.

    In each of many rings, what is added is taken at its outer edge and what is taken away at its inner one.
    """
    k1, k2, p1, p2, k3 = distortion
    edges = np.linspace(0.0, radius, RINGS + 1)
    inner, outer = (r[:, None] ** [2, 4, 6] for r in (edges[:-1], edges[1:]))
    across, along = np.array([k1, k2, k3]), np.array([3.0 * k1, 5.0 * k2, 7.0 * k3])
    grown = [(np.maximum(terms, 0.0) * outer + np.minimum(terms, 0.0) * inner).sum(axis=1) for terms in (across, along)]
    return float((1.0 + np.maximum(*grown) + 6.0 * math.hypot(p1, p2) * edges[1:]).max())


def _first_root(polynomial: list[float]) -> float:
    """The smallest positive root of a polynomial, its constant term first and not zero; infinity for none.

    Found by its inverse, the largest root of the polynomial read backwards: so the last terms may be as small as they
    like.
    """
    inverse = np.roots(polynomial)
    largest = inverse.real[np.abs(inverse.imag) <= REAL * np.abs(inverse)].max(initial=0.0)
    return float(1.0 / largest) if largest > 0.0 else math.inf
