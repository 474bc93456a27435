"""Distorting lenses: projection, unprojection, and bounds on the local scale.

Image points are given relative to the principal point, in focal lengths; points and directions `(..., 3)` are in the
camera frame. See `lmd.geometry.lens_models` for the formulas.

At the angle theta from the optical axis, the local scale of a lens (image length per angle) is `along` in the radial
direction and `across` in the tangential direction. Tangential distortion and a thin prism change each of the two scales
by at most `sway`. The projection is injective as long as both scales exceed `sway`; the `fold` is the angle theta up to
which this holds. A lens model is invalid beyond its fold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, choice, vector
from lmd.geometry.lens_models import BrownConrady, Equidistant, image_of, slope_of

EQUIDISTANT = "equidistant"
MODELS = ("plumb_bob", "rational_polynomial", EQUIDISTANT)
# Numbers of coefficients that OpenCV accepts: up to p2, k3, k6, s4, or the tilt of the sensor.
COEFFICIENT_COUNTS = (4, 5, 8, 12, 14)
# Index of the first coefficient of the sensor's tilt.
FIRST_TILT = 12
ORDER_IN_WORDS = "[] or [k1, k2, p1, p2], optionally followed by k3, by k3 to k6, or by k3 to k6 and s1 to s4"
WHY_TILTED = "is of a tilted sensor, which is not supported: calibrate without CALIB_TILTED_MODEL."
# Number of angles at which a lens is sampled. Bounds assume that a value between two neighbouring samples differs from
# each sample by at most the difference of the two samples.
ANGLE_SAMPLES = 4096
# Newton's method: largest error of the image at convergence, focal lengths, and maximum number of steps.
IMAGE_TOLERANCE, NEWTON_STEPS = 1e-12, 20
# Degree of polynomial approximations, and bound on their rounding error.
DEGREE, ROUNDED = 5, 1e-9


class Profile(NamedTuple):
    """Radius in the image and local scales (image length per angle) of a lens, at given angles from the optical axis.
    All arrays have the shape of the angles theta.
    """

    inner: FloatArray
    """Lower bound on the distance of the projected point from the principal point, focal lengths."""
    along: FloatArray
    """Local scale in the radial direction, focal lengths per rad."""
    across: FloatArray
    """Local scale in the tangential direction, focal lengths per rad."""
    sway: FloatArray
    """Largest change of either scale that tangential distortion and thin prism cause, focal lengths per rad."""

    @property
    def least(self) -> FloatArray:
        """Lower bound on the local scale (image length per angle) in any direction, for each angle theta, focal lengths
        per rad.
        """
        return np.asarray(np.minimum(self.along, self.across) - self.sway)

    @property
    def most(self) -> FloatArray:
        """Upper bound on the local scale (image length per angle) in any direction, for each angle theta, focal lengths
        per rad.
        """
        return np.asarray(np.maximum(self.along, self.across) + self.sway)


class Stretch(NamedTuple):
    """Bounds on the local scale of a lens (image length per angle), see `Lens.stretch`. The bounds are valid up to some
    angle from the optical axis.
    """

    least: float
    """Lower bound on image length per angle, focal lengths per rad."""
    most: float
    """Upper bound on image length per angle, focal lengths per rad."""
    least_area: float
    """Lower bound on image area per solid angle, square focal lengths per sr."""
    most_area: float
    """Upper bound on image area per solid angle, square focal lengths per sr."""


@dataclass(frozen=True)
class Lens:
    """Lens with distortion.

    Raises:
        InputError: the model is unknown, the number of coefficients is wrong, or a coefficient is not finite.
    """

    model: str
    """Name of the model, one of `MODELS`; the first two models differ only in the number of coefficients."""
    coefficients: tuple[float, ...]
    """Coefficients in OpenCV's order: the first 4, 5, 8 or 12 of k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4. All 12
    may be followed by two zeros for the sensor's tilt. For `equidistant`: k1, k2, k3, k4.
    """

    def __post_init__(self) -> None:
        choice("distortion_model", self.model, MODELS)
        fisheye = self.model == EQUIDISTANT
        given = list(self.coefficients) if np.ndim(self.coefficients) == 1 else []
        if len(given) not in ((len(Equidistant._fields),) if fisheye else COEFFICIENT_COUNTS):
            known = "of an equidistant lens must be [k1, k2, k3, k4]" if fisheye else f"must be {ORDER_IN_WORDS}"
            raise InputError(f"distortion {known}, got {self.coefficients!r}.", "distortion")
        numbers = vector("distortion", given, len(given))
        if not fisheye:
            if any(numbers[FIRST_TILT:]):
                raise InputError(f"distortion {list(numbers)} {WHY_TILTED}", "distortion")
            numbers = (*numbers[:FIRST_TILT], *(0.0,) * (FIRST_TILT - len(numbers)))
            numbers = next(numbers[:size] for size in COEFFICIENT_COUNTS[1:] if not any(numbers[size:]))
        object.__setattr__(self, "coefficients", numbers)

    @cached_property
    def model_numbers(self) -> BrownConrady | Equidistant:
        """Coefficients as a named tuple. Compiled code selects the functions of `lens_models` by the class of this
        tuple.
        """
        if self.model == EQUIDISTANT:
            return Equidistant(*self.coefficients)
        return BrownConrady(*self.coefficients, *(0.0,) * (FIRST_TILT - len(self.coefficients)))

    def project(self, points: FloatArray) -> FloatArray:
        """Project points `(..., 3)` to the image, `(..., 2)`. Points beyond the fold, where the model is invalid, are
        projected, too.
        """
        with np.errstate(all="ignore"):
            return np.stack(image_of(self.model_numbers, *np.moveaxis(points, -1, 0)), axis=-1)

    def jacobian(self, points: FloatArray) -> FloatArray:
        """Jacobian of the projection with respect to the points, focal lengths per metre, `(..., 2, 3)`."""
        with np.errstate(all="ignore"):
            slopes = slope_of(self.model_numbers, *np.moveaxis(points, -1, 0))
        return np.stack(slopes, axis=-1).reshape(*points.shape[:-1], 2, 3)

    def directions(self, image: FloatArray) -> FloatArray:
        """Unproject image points `image` `(..., 2)` to unit vectors `(..., 3)`. NaN for points to which no direction
        within the fold is projected; beyond the fold the model is invalid.

        Newton's method first finds the angle theta without the tangential terms and the prism, and then refines the
        direction with all terms.
        """
        length = np.hypot(image[..., 0], image[..., 1])
        radii, angles = self._radii
        with np.errstate(all="ignore"):
            angle = np.interp(length, radii, angles)
            for _ in range(NEWTON_STEPS):
                here = self.profile(angle)
                step = (length - here.across * np.sin(angle)) / here.along
                angle = np.clip(angle + step, 0.0, self.fold)
                if not (np.abs(step) > IMAGE_TOLERANCE).any():
                    break
            around = np.sin(angle) / np.where(length > 0.0, length, 1.0)
            found = np.concatenate([around[..., None] * image, np.cos(angle)[..., None]], axis=-1)
            if here.sway.any():
                found = self._refined(found, image)
            off = np.abs(self.project(found) - image).max(axis=-1)
            theta = np.arctan2(np.hypot(found[..., 0], found[..., 1]), found[..., 2])
        return np.where(((off < 1e3 * IMAGE_TOLERANCE) & (theta < self.fold))[..., None], found, np.nan)

    @cached_property
    def _radii(self) -> tuple[FloatArray, FloatArray]:
        """Table of the projection without tangential terms and prism. The first array has distances from the principal
        point, focal lengths, the second the angles from the optical axis that are projected to these distances,
        `(ANGLE_SAMPLES,)` each. Angles end at the fold.
        """
        theta = np.linspace(0.0, self.fold, ANGLE_SAMPLES)
        return self.profile(theta).across * np.sin(theta), theta

    def _refined(self, start: FloatArray, image: FloatArray) -> FloatArray:
        """Refine unit vectors `start`, which have z > 0, so that they are projected to `image`. Newton's method changes
        the points where the vectors meet the plane z = 1.
        """
        found = start / start[..., 2:]
        for _ in range(NEWTON_STEPS):
            slope, (a, b) = self.jacobian(found), np.moveaxis(image - self.project(found), -1, 0)
            xx, xy, yx, yy = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 0], slope[..., 1, 1]
            step = np.stack([yy * a - xy * b, xx * b - yx * a], axis=-1) / (xx * yy - xy * yx)[..., None]
            found[..., :2] += step
            if not (np.abs(step) > IMAGE_TOLERANCE).any():
                break
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    @cached_property
    def fold(self) -> float:
        """Angle from the optical axis up to which the projection is injective, rad; it is below pi / 2, or below pi for
        a fisheye.
        """
        theta = np.linspace(0.0, np.pi if self.model == EQUIDISTANT else np.pi / 2.0, ANGLE_SAMPLES)[:-1]

        def folds(angle: Any) -> Any:
            with np.errstate(all="ignore"):
                return ~(self.profile(angle).least > 0.0)

        bad = np.flatnonzero(folds(theta))
        return _border(folds, theta[bad[0] - 1], theta[bad[0]]) if bad.size else float(theta[-1])

    def widest(self, reach: float) -> float:
        """Angle from the optical axis, rad, beyond which points appear at least `reach` from the principal point.

        `reach` is in focal lengths. The angle is at most the fold, up to which the model is valid.
        """
        if not self.profile(np.float64(self.fold)).inner > reach:
            return self.fold
        return _border(lambda angle: self.profile(angle).inner >= reach, 0.0, self.fold)

    def stretch(self, widest: float, power: int = 0) -> Stretch:
        """Bounds on the lens's image length per angle (local scale) and image area per solid angle. The bounds hold up
        to the angle `widest` from the optical axis, rad.

        With `power` 0, the bounds are on the lens's own scales. With `power` 1, the bounds are on ratios of these
        scales to those of a pinhole. At the angle theta, a pinhole's least scale is 1 / cos(theta), its largest scale
        1 / cos(theta)^2, and its area per solid angle 1 / cos(theta)^3.
        """
        theta = np.linspace(0.0, widest, ANGLE_SAMPLES)
        profile, cosine = self.profile(theta), np.cos(theta) ** power
        low, high = cosine * profile.least, cosine**2 * profile.most
        small = cosine**3 * (profile.along - profile.sway) * (profile.across - profile.sway)
        large = cosine**3 * (profile.along + profile.sway) * (profile.across + profile.sway)
        return Stretch(-_above(-low), _above(high), -_above(-small), _above(large))

    def profile(self, theta: Any) -> Profile:
        """Radius in the image and local scales at the angles `theta` (any shape) from the optical axis, rad."""
        lens = self.model_numbers
        if isinstance(lens, Equidistant):
            powers = theta * theta
            scale = np.polynomial.polynomial.polyval(powers, [1.0, *lens])
            steep = np.polynomial.polynomial.polyval(powers, np.array([1.0, *lens]) * [1, 3, 5, 7, 9])
            return Profile(theta * scale, steep, scale / np.sinc(theta / np.pi), np.zeros_like(theta))
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = lens
        r, cosine = np.tan(theta), np.cos(theta)
        s = r * r
        above, below = 1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6))
        steep = (k1 + s * (2.0 * k2 + 3.0 * s * k3) - above / below * (k4 + s * (2.0 * k5 + 3.0 * s * k6))) / below
        radial = np.where(below > 0.0, above / below, np.nan)  # the model is invalid beyond a pole
        shift, prism, wide = 3.0 * np.hypot(p1, p2), np.hypot(s1, s3), np.hypot(s2, s4)
        sway = r * (2.0 * (shift + prism) + 4.0 * wide * s)
        inner = r * radial - s * (shift + prism + wide * s)
        return Profile(inner, (radial + 2.0 * s * steep) / cosine**2, radial / cosine, sway / cosine**2)


# Cached, as a fit takes milliseconds and is repeated for each tag size.
@lru_cache(maxsize=64)
def approximation(lens: Lens, widest: float) -> tuple[tuple[float, ...], float]:
    """Approximate the projection of directions up to the angle `widest` from the optical axis, rad, by a polynomial.

    Returns:
        coefficients of s(h), where a unit vector (x, y, z) is projected to (s(h) x, s(h) y) with h = 1 - z; upper bound
        on the error, focal lengths.
    """
    theta = np.linspace(0.0, widest, ANGLE_SAMPLES)
    profile, height, around = lens.profile(theta), 1.0 - np.cos(theta), np.sin(theta)
    fit = np.polynomial.polynomial.polyfit(height, profile.across, DEGREE)
    off = around * np.abs(np.polynomial.polynomial.polyval(height, fit) - profile.across)
    return tuple(fit.tolist()), _above(off + around * profile.across - profile.inner) + ROUNDED


@lru_cache(maxsize=64)
def ceiling(lens: Lens, widest: float) -> tuple[float, ...]:
    """Coefficients of a polynomial in h = 1 - cos(theta) that is an upper bound on the local scale (image length per
    angle). The bound is valid at angles theta <= `widest` from the optical axis, rad.
    """
    theta = np.linspace(0.0, widest, ANGLE_SAMPLES)
    height, most = 1.0 - np.cos(theta), np.maximum.accumulate(lens.profile(theta).most)
    fit = np.polynomial.polynomial.polyfit(height, most, DEGREE)
    fit[0] += _above(most - np.polynomial.polynomial.polyval(height, fit)) + ROUNDED
    return tuple(fit.tolist())


def lens_of(model: str, distortion: Any) -> Lens | None:
    """Make the lens of a model with the coefficients `distortion`; None for a pinhole (no coefficients, or only zeros).

    Raises:
        InputError: the model is unknown, the number of coefficients is wrong, or a coefficient is not finite.
    """
    choice("distortion_model", model, MODELS)
    if model != EQUIDISTANT and np.ndim(distortion) == 1 and len(distortion) == 0:
        return None
    lens = Lens(model, distortion)
    return lens if model == EQUIDISTANT or any(lens.coefficients) else None


def _border(reached: Callable[[Any], Any], low: float, high: float) -> float:
    """Largest number in [low, high) at which the condition `reached` is false, by bisection. The condition must be
    false below this number and true above.
    """
    while low < (middle := (low + high) / 2.0) < high:
        low, high = (low, middle) if reached(np.float64(middle)) else (middle, high)
    return float(low)


def _above(values: FloatArray) -> float:
    """Upper bound on a sampled function: the largest sample plus the largest difference between neighbouring
    samples.
    """
    return float(values.max() + np.abs(np.diff(values)).max(initial=0.0))
