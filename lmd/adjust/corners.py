"""Reprojection errors of sightings: residuals, Jacobians, robust weights and normal equations.

A sighting has 8 residuals e, pixels, see `lmd.adjust.sightings`. Errors are modelled by a multivariate Student
distribution with nu degrees of freedom. With chi^2 = |e|^2 / sigma^2 of d residuals, the robust loss is (nu + d) / 2
log(1 + chi^2 / nu), and the weight in iteratively reweighted least squares is (nu + d) / (nu + chi^2).

Source: Lange et al., "Robust Statistical Modeling Using the t Distribution".
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.adjust.frames import LEAST_DAMPING, solved
from lmd.adjust.sightings import RESIDUALS, SHAPES, Sightings
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import cross, exp, inverse

DEGREES_OF_FREEDOM = 4.0  # nu
# Minimum depth of a corner in front of the camera, metres. Nearer corners, and corners behind the camera, have
# residuals of NOWHERE pixels.
NEAREST, NOWHERE = 1e-3, 1e4
RESECTION_STEPS = 10  # Gauss-Newton steps of resection


@dataclass(frozen=True)
class Poses:
    """Poses of tags, frames and mounts."""

    tags: FloatArray
    """`(K, 4, 4)` tag to world; NaN if not known."""
    frames: FloatArray
    """`(F, 4, 4)` body to world at the time of each frame; NaN if not known."""
    mounts: FloatArray
    """`(C, 4, 4)` camera to body; the first camera is the body."""

    def of(self, sightings: Sightings) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Poses `(N, 4, 4)` of the tag, the frame and the mount of each sighting."""
        return self.tags[sightings.tag], self.frames[sightings.frame], self.mounts[sightings.camera]

    def with_tags(self, tags: FloatArray) -> "Poses":
        """Poses with other poses of the tags, `(K, 4, 4)`."""
        return replace(self, tags=tags)


class Reprojection:
    """Residuals of sightings at some poses, and their Jacobians with respect to right-hand twists: X -> X exp(twist).

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
        """Directions of the corners by the poses, unit vectors in the camera's frame, `(N, 4, 3)`."""
        return np.asarray(self._seen / np.linalg.norm(self._seen, axis=-1, keepdims=True))

    @cached_property
    def _by_seen(self) -> FloatArray:
        """Derivatives of the residuals by the corners in the camera's frame, `(N, 4, 2, 3)`."""
        some, depth = self._sightings, self._depth[..., None]
        error = self.error.reshape(-1, 4, 2, 1)
        slope = (some.tangents - error * some.directions[..., None, :]) / np.maximum(depth, NEAREST)
        return np.asarray(slope * (depth > NEAREST))

    @cached_property
    def _by_body(self) -> FloatArray:
        """Derivatives of the residuals by the corners in the body's frame, `(N, 4, 2, 3)`."""
        return np.asarray(self._by_seen @ np.swapaxes(self._mounted, 1, 2)[:, None])

    @cached_property
    def _by_corner(self) -> FloatArray:
        """Derivatives of the residuals by the corners in the tag's frame, `(N, 4, 2, 3)`."""
        return np.asarray(self._by_body @ self._turn[:, None])

    @cached_property
    def by_tag(self) -> FloatArray:
        """Jacobian of the residuals by the pose of the tag, `(N, 8, 6)`."""
        return self._rows(cross(self._corners[:, :, None], self._by_corner), self._by_corner)

    @cached_property
    def by_shape(self) -> FloatArray:
        """Jacobian of the residuals by the shape of the tag, see `Sightings.shapes`, `(N, 8, 6)`."""
        return np.asarray(np.einsum("nqij,sqj->nqis", self._by_corner, SHAPES)).reshape(-1, RESIDUALS, 6)

    @cached_property
    def by_size(self) -> FloatArray:
        """Derivative of the residuals by the logarithm of the tag's edge, `(N, 8, 1)`."""
        way = self.by_tag[..., 3:].reshape(-1, 4, 2, 3)
        return np.asarray(way @ self._corners[..., None]).reshape(-1, RESIDUALS, 1)

    @cached_property
    def by_frame(self) -> FloatArray:
        """Jacobian of the residuals by the pose of the body, `(N, 8, 6)`."""
        return self._rows(cross(self._by_body, self._body[:, :, None]), -self._by_body)

    @cached_property
    def by_mount(self) -> FloatArray:
        """Jacobian of the residuals by the pose of the camera on the body, `(N, 8, 6)`."""
        return self._rows(cross(self._by_seen, self._seen[:, :, None]), -self._by_seen)

    def _rows(self, turn: FloatArray, way: FloatArray) -> FloatArray:
        return np.concatenate([turn, way], axis=-1).reshape(-1, RESIDUALS, 6)


def squared_errors(sightings: Sightings, poses: Poses) -> FloatArray:
    """Squared error |e|^2 of each sighting, pixels^2, `(N,)`; NaN if its tag or frame has no pose."""
    return Reprojection(sightings, *poses.of(sightings)).squared


def student_weight(square: FloatArray, residuals: int | IntArray = RESIDUALS) -> FloatArray:
    """Weights (nu + d) / (nu + chi^2) for d residuals."""
    return np.asarray((DEGREES_OF_FREEDOM + residuals) / (DEGREES_OF_FREEDOM + square))


def student_loss(square: FloatArray, residuals: int = RESIDUALS) -> float:
    """Sum of the losses (nu + d) / 2 log(1 + chi^2 / nu) for d residuals."""
    return float((DEGREES_OF_FREEDOM + residuals) / 2.0 * np.log1p(square / DEGREES_OF_FREEDOM).sum())


def weighted_product(one: FloatArray, other: FloatArray, weight: FloatArray) -> FloatArray:
    """A^T w B of each sighting, `(N, a, b)`, for A `(N, r, a)`, B `(N, r, b)` and weights `(N,)`."""
    return np.asarray((np.swapaxes(one, 1, 2) * weight[:, None, None]) @ other)


def normal_equations(
    jacobian: FloatArray, error: FloatArray, weight: FloatArray, summed: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Sums of J^T w J `(n, m, m)` and J^T w e `(n, m)` by owner, for J `(N, r, m)`, e `(N, r)`; see `sums_by`."""
    right = weighted_product(jacobian, error[..., None], weight)[..., 0]
    return summed(weighted_product(jacobian, jacobian, weight)), summed(right)


def sums_by(owner: IntArray, count: int) -> Callable[[FloatArray], FloatArray]:
    """Make a function that sums values `(N, ...)` of sightings over the sightings of each owner, to `(count, ...)`."""
    from scipy.sparse import csc_array

    matrix = csc_array((np.ones(len(owner)), owner, np.arange(len(owner) + 1)), shape=(count, len(owner)))

    def summed(values: FloatArray) -> FloatArray:
        shape = values.shape[1:]
        return np.asarray((matrix @ values.reshape(len(owner), int(np.prod(shape)))).reshape(count, *shape))

    return summed


def resected(sightings: Sightings, poses: Poses, floor: float) -> Poses:
    """Poses with the frames of some sightings refined, while tags and mounts are fixed (resection)."""
    seen, owner = np.unique(sightings.frame, return_inverse=True)
    summed, variance = sums_by(owner, len(seen)), sightings.variance(floor)
    for _ in range(RESECTION_STEPS):
        at = Reprojection(sightings, *poses.of(sightings))
        weight = student_weight(at.squared / variance) / variance
        matrix, right = normal_equations(at.by_frame, at.error, weight, summed)
        frames = poses.frames.copy()
        frames[seen] = frames[seen] @ exp(-solved(matrix + LEAST_DAMPING * np.eye(6), right))
        poses = replace(poses, frames=frames)
    return poses
