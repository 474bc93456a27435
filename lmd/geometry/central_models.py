"""Camera models of other programs, each approximated by a lens of `lmd.geometry.lens`. All have one centre of
projection.

Let r be the distance of a point (u, v, w) from the camera. The first three models project the point to (u, v) / d, in
units of the model's focal lengths, and differ in d.

- the double sphere of Usenko, Demmel and Cremers (2018), `ds`: d = alpha sqrt(u^2 + v^2 + s^2) + (1 - alpha) s with
  s = xi r + w.
- the extended unified model of Khomutenko, Garcia and Martinet (2016), `eucm`: d = alpha sqrt(beta (u^2 + v^2) + w^2) +
  (1 - alpha) w.
- the unified model of Mei and Rives (2007), `omni` or `MEI`: d = w + xi r, followed by Brown-Conrady distortion.

The other two models, of RealSense, are pinholes with a polynomial of (x, y) = (u, v) / w, similar to that of Brown and
Conrady. Let s = x^2 + y^2 and g = 1 + k1 s + k2 s^2 + k3 s^3.

- `modified_brown_conrady`: the tangential terms are evaluated at (g x, g y) instead of (x, y).
- `inverse_brown_conrady`: the polynomial maps the projected point to (x, y).

`nearest_lens` fits a lens to a model by least squares of the differences between projected points, pixels, over the
whole image.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.lens_models import BrownConrady, Equidistant, image_of

# Largest differences between lens and model, pixels. A fit within `GOOD_PIXELS` ends the search for a lens; a fit
# beyond `MOST_PIXELS` is refused.
GOOD_PIXELS, MOST_PIXELS = 0.05, 1.0
# Sampling of a model: largest angle theta from the optical axis, rad; numbers of angles theta and of azimuths.
WIDEST, ANGLES, AROUND = 2.6, 160, 144
# Largest angle from the optical axis, rad, in images to which the rational model is fitted.
WIDEST_PINHOLE = 1.45
# Fixed-point iteration that inverts a polynomial: maximum number of steps; convergence threshold of the step, focal
# lengths.
INVERSION_STEPS, INVERTED = 60, 1e-9
# Offset from the border of a pixel to its centre, pixels.
CENTRE = 0.5
Model = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


class Restated(NamedTuple):
    """Lens and intrinsics that were fitted to a camera model of another program."""

    focal_pixels: tuple[float, float]
    """Focal lengths (f / s_u, f / s_v), pixels."""
    principal_point: tuple[float, float]
    """Principal point (c_x, c_y), pixels; pixel coordinates have the same origin as in the camera model that was
    fitted.
    """
    model: str
    """Name of the lens model, see `lmd.geometry.lens`."""
    coefficients: tuple[float, ...]
    """Coefficients of the lens, see `lmd.geometry.lens`."""
    worst: float
    """Largest error of the fit, pixels: the distance between the image of a point through the lens and its image
    through the other program's model.
    """


def double_sphere(xi: Any, alpha: Any) -> Model:
    """Projection function of the double sphere model `ds` with the parameters `xi` and `alpha`."""
    xi, alpha = real("xi", xi, above=-1.0), real("alpha", alpha, low=0.0, high=1.0)
    share = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
    least = -(share + xi) / np.sqrt(2.0 * share * xi + xi * xi + 1.0)

    def image(u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        r = np.sqrt(u * u + v * v + w * w)
        s = xi * r + w
        return _divided(u, v, alpha * np.sqrt(u * u + v * v + s * s) + (1.0 - alpha) * s, w > least * r)

    return image


def extended_unified(alpha: Any, beta: Any) -> Model:
    """Projection function of the extended unified model `eucm` with the parameters `alpha` and `beta`."""
    alpha, beta = real("alpha", alpha, low=0.0, high=1.0), real("beta", beta, above=0.0)

    def image(u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        rho = np.sqrt(beta * (u * u + v * v) + w * w)
        least = 0.0 if alpha <= 0.5 else (alpha - 1.0) / (2.0 * alpha - 1.0)
        return _divided(u, v, alpha * rho + (1.0 - alpha) * w, (w > least * rho) | (alpha <= 0.5))

    return image


def unified(xi: Any, k1: Any = 0.0, k2: Any = 0.0, p1: Any = 0.0, p2: Any = 0.0) -> Model:
    """Projection function of the unified model `omni` with the parameter `xi`, followed by Brown-Conrady distortion."""
    xi, *distortion = (real(*of) for of in (("xi", xi), ("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2)))
    lens = BrownConrady._make([*distortion, *(0.0,) * 8])

    def image(u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        r = np.sqrt(u * u + v * v + w * w)
        flat = _divided(u, v, w + xi * r, w > -r * (min(xi, 1.0 / xi) if xi > 0.0 else 0.0))
        return image_of(lens, *flat, 1.0)  # type: ignore[no-any-return]

    return image


def modified_brown_conrady(k1: float, k2: float, p1: float, p2: float, k3: float) -> Model:
    """Projection function of the RealSense model `modified_brown_conrady`. The tangential terms are computed from the
    radially distorted point.
    """

    def image(u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = _divided(u, v, w, True)
        s = x * x + y * y
        g = 1.0 + s * (k1 + s * (k2 + s * k3))
        x, y = g * x, g * y
        return x + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x), y + 2.0 * p2 * x * y + p1 * (s + 2.0 * y * y)

    return image


def inverse_brown_conrady(k1: float, k2: float, p1: float, p2: float, k3: float) -> Model:
    """Projection function of the RealSense model whose polynomial undistorts a point. The function inverts the
    polynomial by a fixed-point iteration, and returns NaN where this iteration does not converge.
    """

    def image(u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = a, b = _divided(u, v, w, True)
        for _ in range(INVERSION_STEPS):
            s = a * a + b * b
            g = 1.0 + s * (k1 + s * (k2 + s * k3))
            across, down = _tangential(a, b, p1, p2)
            last, a, b = a, (x - across) / g, (y - down) / g
        return np.where(np.abs(a - last) < INVERTED, a, np.nan), b

    return image


def _tangential(x: FloatArray, y: FloatArray, p1: float, p2: float) -> tuple[FloatArray, FloatArray]:
    """Displacements of the point (x, y) in x and in y by tangential distortion with OpenCV's coefficients p1 and p2."""
    s = x * x + y * y
    return 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x), 2.0 * p2 * x * y + p1 * (s + 2.0 * y * y)


def _divided(u: FloatArray, v: FloatArray, depth: FloatArray, is_seen: Any) -> tuple[FloatArray, FloatArray]:
    depth = np.where(is_seen & (depth > 0.0), depth, np.nan)
    return u / depth, v / depth


# Constructors of the models by name, with the names of their parameters in Kalibr's order.
MODELS: dict[str, tuple[Callable[..., Model], tuple[str, ...]]] = {
    "ds": (double_sphere, ("xi", "alpha")),
    "eucm": (extended_unified, ("alpha", "beta")),
    "omni": (unified, ("xi",)),
}
PINHOLE, DISTORTION = ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")


def restated(name: str, values: Mapping[str, Any], size: Any) -> Restated:
    """Fit a lens to a camera model of another program.

    Args:
        name: name of the model, one of `MODELS`.
        values: parameters of the model, focal lengths and principal point (`PINHOLE`), keyed by name; for `omni` also
            the distortion coefficients `DISTORTION`, 0 if missing. The principal point is in pixels from the centre of
            the first pixel.
        size: width and height of the image, pixels.

    Raises:
        InputError: a parameter is not a number, the model projects no point near the optical axis, or all fitted lenses
            differ from the model by more than `MOST_PIXELS`.
        KeyError: a parameter is missing.
    """
    make, own = MODELS[name]
    fx, fy, cx, cy = (real(key, values[key]) for key in PINHOLE)
    distortion = [values.get(key, 0.0) for key in DISTORTION] if make is unified else []
    return nearest_lens(make(*(values[key] for key in own), *distortion), (fx, fy), (cx, cy), size)


def nearest_lens(model: Model, focal: Any, centre: Any, size: Any, guess: Sequence[float] = ()) -> Restated:
    """Fit a lens to a projection function.

    Args:
        model: function that projects points to `(x, y)`, in focal lengths; NaN for points that have no projection.
        focal: focal lengths (f_x, f_y), pixels.
        centre: principal point (c_x, c_y), pixels from the centre of the first pixel.
        size: width and height of the image, pixels.
        guess: first coefficients of a `BrownConrady` lens that is similar to the model, from which the fit starts. If
            empty, or if this fit is poor, a fisheye is fitted.

    Raises:
        InputError: the model projects no point near the optical axis, or all fitted lenses differ from the model by
            more than `MOST_PIXELS`.
    """
    (fx, fy), (cx, cy), size = focal, centre, vector("size", list(size), 2, above=0.0)
    theta = np.linspace(0.0, WIDEST, ANGLES)[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    points = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi)
    with np.errstate(all="ignore"):
        u, v = model(*points)
        pixels = np.stack([fx * u + cx, fy * v + cy])
        rises = np.diff(np.hypot(u, v), axis=0, prepend=-1.0) > 0.0  # False beyond the fold of the model
    inside = ((pixels > -CENTRE) & (pixels < np.reshape(size, (2, 1, 1)) - CENTRE)).all(axis=0)
    shown = np.logical_and.accumulate(inside & rises, axis=0)
    if not shown[1].all():
        raise InputError("the model projects no points near its axis: check its parameters.")
    points, pixels = tuple(of[shown] for of in points), pixels[:, shown]
    start = [np.hypot(u[1], v[1]).mean() / theta[1, 0] * length for length in (fx, fy)]
    widest = float((theta * shown).max())
    if guess:
        begin = [fx, fy, cx, cy, *guess, *(0.0,) * (len(BrownConrady._fields) - len(guess))]
        found = _fitted("rational_polynomial", BrownConrady._make, points, pixels, begin)
        if found.worst <= GOOD_PIXELS:
            return found
    wide = _fitted(EQUIDISTANT, lambda k: Equidistant(*k), points, pixels, [*start, cx, cy, *(0.0,) * 4])
    found = min(found, wide, key=lambda fit: fit.worst) if guess else wide
    if found.worst > GOOD_PIXELS and widest < WIDEST_PINHOLE:  # the rational model also fits tangential terms
        full = [*start, cx, cy, *(0.0,) * 8]
        rational = _fitted("rational_polynomial", lambda k: BrownConrady._make([*k, *[0.0] * 4]), points, pixels, full)
        found = min(found, rational, key=lambda fit: fit.worst)
    if found.worst > MOST_PIXELS:
        raise InputError(
            f"no supported lens model comes closer than {found.worst:.2g} pixels to the lens of the file: calibrate "
            "with Kalibr's pinhole-equi (Kannala-Brandt)."
        )
    return found


def _fitted(
    name: str, lens: Callable[[Any], Any], points: tuple[FloatArray, ...], pixels: FloatArray, start: Any
) -> Restated:
    from scipy.optimize import least_squares  # slow to load

    def off(numbers: FloatArray) -> FloatArray:
        x, y = image_of(lens(numbers[4:]), *points)
        return np.concatenate([numbers[0] * x + numbers[2] - pixels[0], numbers[1] * y + numbers[3] - pixels[1]])

    # To the end: some coefficients hardly change the image, and would otherwise depend on the machine.
    found = least_squares(off, start, jac="3-point", x_scale="jac", ftol=1e-15, xtol=1e-15, gtol=1e-15)
    fx, fy, cx, cy, *coefficients = map(float, found.x)
    worst = float(np.hypot(*found.fun.reshape(2, -1)).max())
    return Restated((fx, fy), (cx, cy), name, tuple(coefficients), worst)
