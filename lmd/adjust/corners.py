"""Reprojection errors of sightings: residuals, Jacobians, noise, robust weights, and Gauss-Newton steps.

A sighting (one tag detected in one image) has 8 residuals e, pixels, see `lmd.adjust.sightings`. Errors are modelled by
a multivariate Student distribution with nu degrees of freedom. Let sigma be the standard deviation of a corner's
coordinate, and chi^2 = |e|^2 / sigma^2 for d residuals. The robust loss is (nu + d) / 2 log(1 + chi^2 / nu). The weight
in iteratively reweighted least squares is (nu + d) / (nu + chi^2).

The variance sigma^2 is the detector's variance plus the squared *floor*, which stands for errors of lens models and of
the shapes of tags. The floor is estimated such that the weighted mean of chi^2 equals its expected value for normal
errors.

Source: Lange et al., "Robust Statistical Modeling Using the t Distribution".
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.adjust.sightings import RESIDUALS, SHAPES, Sightings
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import cross, exp, inverse

DEGREES_OF_FREEDOM = 4.0  # nu
# Minimum depth of a corner in front of the camera, metres. Nearer corners, and corners behind the camera, have
# residuals of NOWHERE pixels.
NEAREST, NOWHERE = 1e-3, 1e4
RESECTION_STEPS, LEAST_DAMPING = 10, 1e-9  # Gauss-Newton steps of resection; least growth of diagonals in a solution
# Mean of (nu + 8) x / (nu + x) for x with the chi^2 distribution with 8 degrees of freedom.
NORMAL_MEAN = 7.5625
LEAST_FLOOR = 1e-9  # pixels
# A sighting is an outlier if its chi^2, with eight degrees of freedom, exceeds `OUTLIER_CHI_SQUARE`, and its RMS error
# exceeds `OUTLIER_PIXELS` and the share `OUTLIER_SHARE` of its shortest side. Blur and lenses cause smaller errors.
OUTLIER_CHI_SQUARE, OUTLIER_PIXELS, OUTLIER_SHARE = 60.0, 1.0, 0.02
# A sighting agrees with a rough pose if its RMS error, pixels, is at most `AGREES` times its size plus `AGREES_PIXELS`.
AGREES, AGREES_PIXELS = 0.15, 2.0


@dataclass(frozen=True)
class Poses:
    """Poses of tags, of the body at each frame, and of the cameras on the body (*mounts*)."""

    tags: FloatArray
    """`(K, 4, 4)` tag to world; NaN if not known."""
    frames: FloatArray
    """`(F, 4, 4)` body to world at the time of each frame; NaN if not known."""
    mounts: FloatArray
    """`(C, 4, 4)` camera to body; the first camera is the body."""

    def of(self, sightings: Sightings) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pose of the tag, of the frame and of the camera's mount of each sighting, `(N, 4, 4)` each."""
        return self.tags[sightings.tag], self.frames[sightings.frame], self.mounts[sightings.camera]

    @property
    def known_tags(self) -> BoolArray:
        """True for tags with a pose, `(K,)`."""
        return np.isfinite(self.tags[:, 0, 0])

    @property
    def known_frames(self) -> BoolArray:
        """True for frames with a pose, `(F,)`."""
        return np.isfinite(self.frames[:, 0, 0])


class Reprojection:
    """Residuals of sightings at given poses, and their Jacobians with respect to twists of the poses: X -> X
    exp(twist).

    Args:
        sightings: N sightings.
        tags, frames, mounts: poses of the tag, the frame and the mount of each sighting, `(N, 4, 4)`.
    """

    def __init__(self, sightings: Sightings, tags: FloatArray, frames: FloatArray, mounts: FloatArray) -> None:
        self._sightings, self._corners, self._mounted = sightings, sightings.corners, mounts[:, :3, :3]
        to_body = inverse(frames) @ tags
        self._turn = to_body[:, :3, :3]  # tag to body
        self._body = self._corners @ np.swapaxes(self._turn, 1, 2) + to_body[:, None, :3, 3]  # corners, (N, 4, 3)
        self._seen = (self._body - mounts[:, None, :3, 3]) @ self._mounted  # in the camera's frame
        self._depth = (sightings.directions * self._seen).sum(axis=-1)[..., None]
        error = (sightings.tangents @ self._seen[..., None])[..., 0] / np.maximum(self._depth, NEAREST)
        self.error = np.where(self._depth <= NEAREST, NOWHERE, error).reshape(len(sightings), RESIDUALS)
        """Residuals, pixels, `(N, 8)`; NaN where a pose is not known."""

    @property
    def squared(self) -> FloatArray:
        """Squared errors |e|^2, pixels^2, `(N,)`; NaN where a pose is not known."""
        return np.asarray((self.error**2).sum(axis=1))

    @property
    def directions(self) -> FloatArray:
        """Unit vectors to the corners as predicted by the poses, in the camera's frame, `(N, 4, 3)`."""
        return np.asarray(self._seen / np.linalg.norm(self._seen, axis=-1, keepdims=True))

    @cached_property
    def _by_seen(self) -> FloatArray:
        """Derivatives of the residuals with respect to the corners' positions in the camera's frame. The axes
        `(N, 4, 2, 3)` are sighting, corner, residual and coordinate.
        """
        some, depth = self._sightings, self._depth[..., None]
        error = self.error.reshape(-1, 4, 2, 1)
        slope = (some.tangents - error * some.directions[..., None, :]) / np.maximum(depth, NEAREST)
        return np.asarray(slope * (depth > NEAREST))

    @cached_property
    def _by_body(self) -> FloatArray:
        """Derivatives of the residuals with respect to the corners' positions in the body's frame. The axes
        `(N, 4, 2, 3)` are sighting, corner, residual and coordinate.
        """
        return np.asarray(self._by_seen @ np.swapaxes(self._mounted, 1, 2)[:, None])

    @cached_property
    def _by_corner(self) -> FloatArray:
        """Derivatives of the residuals with respect to the corners' positions in the tag's frame. The axes
        `(N, 4, 2, 3)` are sighting, corner, residual and coordinate.
        """
        return np.asarray(self._by_body @ self._turn[:, None])

    @cached_property
    def by_tag(self) -> FloatArray:
        """Jacobian of the residuals with respect to a twist of the tag's pose, `(N, 8, 6)`."""
        return -_by_twist(self._by_corner, self._corners)

    @cached_property
    def by_frame(self) -> FloatArray:
        """Jacobian of the residuals with respect to a twist of the body's pose, `(N, 8, 6)`."""
        return _by_twist(self._by_body, self._body)

    @cached_property
    def by_mount(self) -> FloatArray:
        """Jacobian of the residuals with respect to a twist of the camera's pose on the body, `(N, 8, 6)`."""
        return _by_twist(self._by_seen, self._seen)

    @cached_property
    def by_shape(self) -> FloatArray:
        """Jacobian of the residuals with respect to the tag's deformations along the six `SHAPES`, `(N, 8, 6)`."""
        return np.asarray(np.einsum("nqij,sqj->nqis", self._by_corner, SHAPES)).reshape(-1, RESIDUALS, 6)

    @cached_property
    def by_size(self) -> FloatArray:
        """Derivative of the residuals with respect to the logarithm of the tag's edge length, `(N, 8, 1)`."""
        return np.asarray(self._by_corner @ self._corners[..., None]).reshape(-1, RESIDUALS, 1)


def _by_twist(slope: FloatArray, points: FloatArray) -> FloatArray:
    """Jacobian of the residuals with respect to a twist of the frame in which points are given, `(N, 8, 6)`. `slope`
    `(N, 4, 2, 3)` has the derivatives of each corner's two residuals with respect to its point in `points` `(N, 4, 3)`.
    """
    return np.concatenate([cross(slope, points[:, :, None]), -slope], axis=-1).reshape(-1, RESIDUALS, 6)


def squared_errors(sightings: Sightings, poses: Poses) -> FloatArray:
    """Squared reprojection error |e|^2 of each sighting, pixels^2, `(N,)`; NaN if the tag or the frame has no pose."""
    return Reprojection(sightings, *poses.of(sightings)).squared


def agreeing(sightings: Sightings, error: FloatArray) -> BoolArray:
    """Mask of the sightings that agree with a rough pose, `(N,)`; False where the error is NaN. `error` `(N,)` has the
    squared errors of the sightings, pixels^2. A sighting agrees if the RMS error of its corners is below a limit, which
    grows with the tag's size in the image.
    """
    return np.asarray(np.sqrt(error / 4.0) < AGREES * sightings.sizes + AGREES_PIXELS)


def fitting(sightings: Sightings, error: FloatArray, floor: float) -> BoolArray:
    """Mask of the inliers among N sightings, `(N,)`; False where the error is NaN. `error` `(N,)` has the squared
    errors of the sightings, pixels^2. `floor`, pixels, is the standard deviation of corners in addition to the
    detector's own. A sighting is an inlier if its chi^2, or the RMS error of its corners, is below a limit.
    """
    near = np.sqrt(error / 4.0) <= np.maximum(OUTLIER_PIXELS, OUTLIER_SHARE * sightings.sizes)
    return np.asarray((error / sightings.variance(floor) <= OUTLIER_CHI_SQUARE) | near)


def student_weight(square: FloatArray, residuals: int | IntArray = RESIDUALS) -> FloatArray:
    """Robust weights (nu + d) / (nu + chi^2) for values `square` of chi^2. Each chi^2 has d `residuals`, and nu is the
    constant `DEGREES_OF_FREEDOM`.
    """
    return np.asarray((DEGREES_OF_FREEDOM + residuals) / (DEGREES_OF_FREEDOM + square))


def student_losses(square: FloatArray, residuals: int = RESIDUALS) -> FloatArray:
    """Robust losses 0.5 (nu + d) log(1 + chi^2 / nu) for values `square` of chi^2. Each chi^2 has d `residuals`, and nu
    is the constant `DEGREES_OF_FREEDOM`.
    """
    return np.asarray((DEGREES_OF_FREEDOM + residuals) / 2.0 * np.log1p(square / DEGREES_OF_FREEDOM))


def student_loss(square: FloatArray, residuals: int = RESIDUALS) -> float:
    """Sum of the robust losses 0.5 (nu + d) log(1 + chi^2 / nu) over all values `square` of chi^2, see
    `student_losses`.
    """
    return float(student_losses(square, residuals).sum())


def floor_of(error: FloatArray, noise: FloatArray, most: float) -> float:
    """Find the floor, pixels, at which the weighted mean of chi^2 equals its expected value for normal errors. The
    floor is the standard deviation of corners in addition to the detector's own, and chi^2 is error / (noise^2 +
    floor^2).

    Args:
        error: squared errors |e|^2 of sightings, divided by the fraction that is expected to remain after a fit,
            pixels^2, `(N,)`.
        noise: standard deviation of a coordinate of a corner according to the detector, pixels, `(N,)`.
        most: upper limit of the floor, pixels.
    """
    from scipy.optimize import brentq

    def beyond(floor: float) -> float:
        square = error / (noise**2 + floor**2)
        return float((student_weight(square) * square).mean() - NORMAL_MEAN)

    ends = [end for end, sign in ((LEAST_FLOOR, 1.0), (most, -1.0)) if sign * beyond(end) <= 0.0]
    return ends[0] if ends else float(brentq(beyond, LEAST_FLOOR, most, xtol=LEAST_FLOOR))


def efficiency(square: FloatArray) -> tuple[float, float]:
    """Slope and variance of residuals with robust weights, which give the covariance of a fit (sandwich formula).
    `square` `(N,)` has chi^2 of N sightings, each with 8 residuals.

    With residuals e, in standard deviations, and weights w(chi^2), the slope is the mean derivative of w e with respect
    to e: the mean of w + 2 w' chi^2 / 8. The variance is the mean square of w e: the mean of w^2 chi^2 / 8. Least
    squares in which all sightings have the weight slope^2 / variance have the covariance of the robust fit.
    """
    weight = student_weight(square)
    slope = (weight - 2.0 / RESIDUALS * square * weight / (DEGREES_OF_FREEDOM + square)).mean()
    return float(slope), float((weight**2 * square).mean() / RESIDUALS)


def weighted_product(one: FloatArray, other: FloatArray, weight: FloatArray) -> FloatArray:
    """Product A^T w B of each sighting, `(N, a, b)`. A is `one` `(N, r, a)`, B is `other` `(N, r, b)`, and w is
    `weight` `(N,)`.
    """
    return np.asarray((np.swapaxes(one, 1, 2) * weight[:, None, None]) @ other)


def sums_by(owner: IntArray, count: int) -> Callable[[FloatArray], FloatArray]:
    """Make a function that sums values of sightings by owner. `owner` `(N,)` has the index of the frame or tag to which
    each sighting belongs. The function maps values `(N, ...)` of the sightings to sums `(count, ...)`, one for each
    owner.
    """
    from scipy.sparse import csc_array

    matrix = csc_array((np.ones(len(owner)), owner, np.arange(len(owner) + 1)), shape=(count, len(owner)))

    def summed(values: FloatArray) -> FloatArray:
        shape = values.shape[1:]
        return np.asarray((matrix @ values.reshape(len(owner), int(np.prod(shape)))).reshape(count, *shape))

    return summed


def add_at(cells: FloatArray, first: IntArray, second: IntArray, values: FloatArray) -> None:
    """Add values `(N, ...)` to the entries `cells[first, second]` of an array `(n, m, ...)`, in place. Pairs of indices
    may repeat. This is many times faster than `numpy.add.at`.
    """
    keys, pair = np.unique(first * cells.shape[1] + second, return_inverse=True)
    cells[np.divmod(keys, cells.shape[1])] += sums_by(pair, len(keys))(values)


def solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions `(n, m)` of n linear systems with `matrices` `(n, m, m)` and right sides `right` `(n, m)`."""
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0], dtype=np.float64)


def newton_step(
    jacobian: FloatArray,
    error: FloatArray,
    weight: FloatArray,
    summed: Callable[[FloatArray], FloatArray],
    damping: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton steps `(n, m)` and normal matrices `(n, m, m)` of n poses with m unknowns each. Each pose is that of
    a frame or tag, the *owner* of some of the N sightings.

    Args:
        jacobian: derivatives of each sighting's r residuals with respect to the unknowns of its owner, `(N, r, m)`.
        error: residuals of each sighting, `(N, r)`.
        weight: weight of each sighting, `(N,)`.
        summed: function that adds up an array over the sightings of each owner, see `sums_by`.
        damping: matrix that is added to each normal matrix, `(m, m)`.
    """
    matrix = summed(weighted_product(jacobian, jacobian, weight)) + damping
    return -solved(matrix, summed(weighted_product(jacobian, error[..., None], weight)[..., 0])), matrix


def resected(sightings: Sightings, poses: Poses, floor: float) -> Poses:
    """Copy of `poses` in which the frames of the sightings are refined with fixed tags and mounts (resection). `floor`,
    pixels, is the standard deviation of corners in addition to the detector's own.
    """
    seen, owner = np.unique(sightings.frame, return_inverse=True)
    summed, variance, frames = sums_by(owner, len(seen)), sightings.variance(floor), poses.frames.copy()
    for _ in range(RESECTION_STEPS):
        at = Reprojection(sightings, *replace(poses, frames=frames).of(sightings))
        weight = student_weight(at.squared / variance) / variance
        step, _ = newton_step(at.by_frame, at.error, weight, summed, LEAST_DAMPING * np.eye(6))
        frames[seen] = frames[seen] @ exp(step)
    return replace(poses, frames=frames)
