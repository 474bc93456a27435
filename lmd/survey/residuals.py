"""What sightings are off by at some poses, how that changes with these, and how much each counts.

The residuals e are those of `lmd.survey.sightings`, pixels; `lmd.survey.adjustment` says what is made of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import cross, inverse, log
from lmd.survey.sightings import SHAPES, Sightings
from lmd.survey.student import RESIDUALS, cost_of, weight_of

if TYPE_CHECKING:
    from lmd.survey.boards import Sheets
    from lmd.survey.motion import Motion

# A corner that is hardly in front of the camera, or behind it, fits nowhere: metres, and pixels.
NEAREST, NOWHERE = 1e-3, 1e4
# Standard deviation of what is taken for exact, metres and rad.
EXACT_SIGMA = 1e-6


@dataclass(frozen=True)
class Poses:
    """Where everything is; each pose maps to what it is mounted in.

    Args:
        tags: to the world, `(K, 4, 4)`; NaN where it is not known.
        frames: of the body, to the world, `(F, 4, 4)`; likewise.
        mounts: of the cameras, to the body, `(C, 4, 4)`; the first is the body.
    """

    tags: FloatArray
    frames: FloatArray
    mounts: FloatArray


@dataclass(frozen=True)
class Prior:
    """What is known of tags before they were seen.

    Args:
        tags: their poses, `(K, 4, 4)`; whatever it is where nothing is known.
        information: one over the variance of the turn about each axis of the tag, and of the way along each, `(K, 6)`.
        sheets: tags that were printed together, all of them placed; None for none.
        mounts: of the cameras, see `Poses`; None where these are to be found.
        motion: between the frames; None where they are independent of each other.
    """

    tags: FloatArray
    information: FloatArray
    sheets: "Sheets | None" = None
    mounts: FloatArray | None = None
    motion: "Motion | None" = None

    @property
    def exact(self) -> BoolArray:
        """True for tags that are exactly where they are known to be, `(K,)`: no sighting moves them."""
        return np.asarray((self.information >= 0.5 * EXACT_SIGMA**-2.0).all(axis=1))

    def off(self, tags: FloatArray) -> FloatArray:
        """How far `tags` are from what is known of them: twists, `(K, 6)`; 0 where nothing is known."""
        known = self.information.any(axis=1)
        twists = np.zeros((len(tags), 6))
        twists[known] = log(inverse(self.tags[known]) @ tags[known])
        return twists

    def squares(self, off: FloatArray) -> FloatArray:
        """chi^2 of each, `(K,)`, by how far `off` they are."""
        return np.asarray((self.information * off**2).sum(axis=1))

    def weights(self, squares: FloatArray) -> FloatArray:
        """Weights of the tags, `(K,)`, by their chi^2: what is exact always counts in full."""
        return weight_of(np.where(self.exact, 0.0, squares), 6)

    def cost(self, squares: FloatArray) -> float:
        """The part of the prior in the sum that is minimised, by chi^2 of each tag."""
        exact = self.exact
        return cost_of(squares[~exact], 6) + float(weight_of(np.zeros(1), 6)[0] / 2.0 * squares[exact].sum())


def in_cameras(sightings: Sightings, tags: FloatArray, frames: FloatArray, mounts: FloatArray) -> FloatArray:
    """The corners of each sighting in the frame of its camera, `(N, 4, 3)`, for the poses `(N, 4, 4)`."""
    motion = inverse(mounts) @ inverse(frames) @ tags
    return np.asarray(sightings.corners @ np.swapaxes(motion[:, :3, :3], 1, 2) + motion[:, None, :3, 3])


def residuals(sightings: Sightings, seen: FloatArray) -> FloatArray:
    """The residuals e, pixels, `(N, 4, 2)`, of corners at `seen` `(N, 4, 3)` in the frames of their cameras."""
    depth = (sightings.directions * seen).sum(axis=-1)[..., None]
    error = (sightings.tangents @ seen[..., None])[..., 0] / np.maximum(depth, NEAREST)
    return np.asarray(np.where(depth <= NEAREST, NOWHERE, error))


def errors_at(sightings: Sightings, poses: Poses) -> FloatArray:
    """The squared error |e|^2 of each sighting, pixels^2, `(N,)`; NaN if its tag or frame is not placed."""
    mounted = gathered(sightings, poses)
    return np.asarray((residuals(sightings, in_cameras(sightings, *mounted)) ** 2).sum(axis=(1, 2)))


def gathered(sightings: Sightings, poses: Poses) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The poses `(N, 4, 4)` of the tag, the frame and the mount of each sighting."""
    return poses.tags[sightings.tag], poses.frames[sightings.frame], poses.mounts[sightings.camera]


@dataclass(frozen=True)
class Linearised:
    """Residuals and how they change with right-hand twists of the poses: X becomes X exp(twist).

    Args:
        error: the residuals, `(N, 8)`.
        corners, body, seen: the corners in the frames of the tag, the body and the camera, `(N, 4, 3)`.
        slope, at_body: how residuals change as a corner moves in the camera's frame and in the body's, `(N, 4, 2, 3)`.
        turn: of the tag to the body, `(N, 3, 3)`.
    """

    error: FloatArray
    corners: FloatArray
    body: FloatArray
    seen: FloatArray
    slope: FloatArray
    at_body: FloatArray
    turn: FloatArray

    @cached_property
    def by_tag(self) -> FloatArray:
        """How residuals change with the pose of the tag, `(N, 8, 6)`."""
        at_tag = self.at_body @ self.turn[:, None]
        return self._rows(cross(self.corners[:, :, None], at_tag), at_tag)

    @cached_property
    def by_shape(self) -> FloatArray:
        """With the shape of the tag, see `Sightings.shapes`."""
        at_tag = self.at_body @ self.turn[:, None]
        return np.asarray(np.einsum("nqij,sqj->nqis", at_tag, SHAPES)).reshape(len(self.error), RESIDUALS, 6)

    @cached_property
    def by_frame(self) -> FloatArray:
        """With that of the body."""
        return self._rows(cross(self.at_body, self.body[:, :, None]), -self.at_body)

    @cached_property
    def by_mount(self) -> FloatArray:
        """With that of the camera on the body."""
        return self._rows(cross(self.slope, self.seen[:, :, None]), -self.slope)

    def _rows(self, turn: FloatArray, way: FloatArray) -> FloatArray:
        return np.concatenate([turn, way], axis=-1).reshape(len(self.error), RESIDUALS, 6)


def linearise(sightings: Sightings, tags: FloatArray, frames: FloatArray, mounts: FloatArray) -> Linearised:
    """The residuals at poses `(N, 4, 4)` of each sighting."""
    to_body = inverse(frames) @ tags
    body = sightings.corners @ np.swapaxes(to_body[:, :3, :3], 1, 2) + to_body[:, None, :3, 3]
    turned = mounts[:, :3, :3]
    seen = (body - mounts[:, None, :3, 3]) @ turned
    error = residuals(sightings, seen)
    depth = (sightings.directions * seen).sum(axis=-1)[..., None, None]
    slope = (sightings.tangents - error[..., None] * sightings.directions[..., None, :]) / np.maximum(depth, NEAREST)
    slope *= depth > NEAREST
    at_body = slope @ np.swapaxes(turned, 1, 2)[:, None]
    error = error.reshape(len(sightings), RESIDUALS)
    return Linearised(error, sightings.corners, body, seen, slope, at_body, to_body[:, :3, :3])


def summing(owner: IntArray, count: int) -> Callable[[FloatArray], FloatArray]:
    """A function from values `(N, ...)` to their sums over what each of `count` owners has, `(count, ...)`."""
    from scipy.sparse import csc_array

    matrix = csc_array((np.ones(len(owner)), owner, np.arange(len(owner) + 1)), shape=(count, len(owner)))

    def summed(values: FloatArray) -> FloatArray:
        return np.asarray((matrix @ values.reshape(len(owner), -1)).reshape(count, *values.shape[1:]))

    return summed
