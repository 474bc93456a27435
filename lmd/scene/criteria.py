"""Interface of models of sight: whether a camera covers a landmark, in two stages, and which landmarks hide others.

Most of what decides depends on the camera's position alone, little on its orientation. So each criterion is told twice:
once for all orientations from a position (`from_position`), once for one orientation (`in_image`): the optical axis and
the image's right, which a model that asks for a round cone ignores. Whether another landmark is in the way is a third
question (`hide`). These functions are scalar, without a branch where it can be helped, and every kernel calls these and
no others.

A model has two sides:

- the thresholds that a user sets, a `Criteria`; its `covered` is the reference, NumPy, formula by formula;
- the same compiled for one camera, a named tuple of numbers with the fields and methods of `Sight`, which registers its
  functions with those below. Both must decide alike, bit for bit. A `Covering` has no such half.

Pruning uses conservative bounds: bands of axes use a cone that holds every axis that covers a landmark (`low`), tables
of directions use the field of view alone (`in_view`).
"""

import math
from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, lowest
from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.geometry.camera import Camera

# One tolerance for every closed inequality, so that a landmark exactly on a boundary is on it whichever way the
# number was rounded. Relative for lengths, absolute for cosines and probabilities.
TOLERANCE = 1e-9


class Sight(Protocol):
    """The fields and methods of a compiled model of sight, a named tuple."""

    @property
    def outer_cosine(self) -> float:
        """No axis farther than the angle with this cosine from a landmark's direction covers it."""

    @property
    def inset(self) -> float:
        """Every axis with the landmark's direction `in_view` by this angle, rad, does if its depth is `sure`."""

    @property
    def reach(self) -> float:
        """Squared distance from a line of sight beyond which a landmark hides nothing, m^2; negative: none does."""

    @property
    def horizon(self) -> float:
        """See `horizon_of`; a model that does not say sees infinitely far."""

    @property
    def tabulated(self) -> bool:
        """True if `in_image` is slower than looking up directions (`lmd.sight.directions`)."""

    def unhidden(self) -> "Sight":
        """The model in which no landmark hides another."""

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "Sight":
        """The model for these landmarks: `unhidden` if a quick test shows that none hides another.

        Args:
            low, high: corners of a box around all positions of the camera, `(3,)`, metres.
            landmarks, normals: of B deployments, `(B, 3, K)`.
        """

    def shrunk(self, size: float) -> "Sight":
        """The model in which the body of a landmark, which hides others, is `size` times as large."""


class Criteria(Protocol):
    """When a landmark counts as covered: what `visibility` of a scene must be."""

    @property
    def needs_roll(self) -> bool:
        """True if the camera's roll about its optical axis matters."""

    @property
    def spacing(self) -> float:
        """Distance between neighbouring landmarks at which none hides the other, metres."""

    def sight(self, camera: Camera) -> Any:
        """These criteria compiled for a camera, a `Sight`; None where there is only the reference."""

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """Mask of the landmarks that the camera covers, `(A, K)`: the reference.

        Args:
            position: p, `(3,)`, world frame, metres.
            axes: its optical axes and the image's right, `(A, 6)`: two unit vectors.
            landmarks, normals: `(K, 3)` positions, metres, and unit normals.
        """


class Covering(ABC):
    """Criteria in NumPy alone: a class that derives from this writes `covered`, see `Criteria`.

    All figures come from `covered` then (`lmd.sight.reference`), which takes longer than the compiled half.
    """

    needs_roll = True
    spacing = 0.0

    def sight(self, camera: Camera) -> Any:
        """None: there is no compiled half."""
        return None

    @abstractmethod
    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """See `Criteria.covered`."""


def horizon_of(sight: Sight) -> float:
    """The distance beyond which landmarks cannot matter, metres; infinite if there is none.

    A landmark farther than this from the camera is not covered and hides none that is; nor does one that is farther
    than this from the one it would hide.
    """
    return float(getattr(sight, "horizon", math.inf))


@overridable
def sized(sight, k):  # type: ignore[no-untyped-def]
    """The sight of landmark k of a deployment: that of a model whose numbers are columns where sizes differ.

    All functions below but `in_view` and `pixel_density` take the sight of one landmark.
    """
    return sight


@dispatched
def from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    """Bounds on the coverage of a landmark from a position, over all orientations of the camera.

    Args:
        x, y, z: offset of the landmark from the camera, world frame, metres.
        nx, ny, nz: its unit normal.
        slack: metres; the answer shall hold for every landmark that far away in the same plane (see `poses`).

    Returns:
        reached: False only if no orientation covers it.
        low, high: the least and the greatest depth along the optical axis, metres, with which an orientation may.
        sure: between `low` and this depth every orientation that has it well in view (`Sight.inset`) covers it;
            infinite if every such orientation does. There is no slack in `high` and `sure`.
    """


@overridable
def from_around(sight, x, y, z, nx, ny, nz, radius):  # type: ignore[no-untyped-def]
    """Bounds on `from_position` over all cameras less than `radius` metres from a point.

    Args:
        x, y, z: offset of the landmark from the point, world frame, metres.
        nx, ny, nz: its normal.
        radius: metres, more than 0.

    Returns:
        reached: False only if none of the cameras covers it with any orientation; most: the greatest depth along the
        optical axis, metres, with which one may; start, sure: from which depth on and up to which any camera does that
        has it well in view (`Sight.inset`); `sure` is -inf if none surely does, inf if no depth is too great, `start`
        -inf if none is too small.
    """
    return True, math.inf, 0.0, -math.inf


@dispatched
def in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    """True if the optical axis (ax, ay, az) covers a landmark that is `reached`, without occlusion.

    (rx, ry, rz) points to the right of the image, axis x right down.
    The other arguments are those and the answers of `from_position`; an infinite `low` is never covered.
    """


@dispatched
def in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    """True if every direction within an angle of the unit vector (x, y, z) is in view with an orientation.

    `sine` and `cosine` are those of the angle, less than a right one. With a negative sine: whether any direction may
    be that is so near. The directions in view are those of all landmarks that the model may cover.
    """


@inlined
def in_cone(least, x, y, z, sine, cosine, ax, ay, az):  # type: ignore[no-untyped-def]
    """`in_view` where that is a cone around the axis, `least` the cosine of its half-angle theta."""
    # Made narrower by the angle delta: cos(theta - delta), unless nothing or all is left.
    edge = least * cosine + math.sqrt(max(0.0, 1.0 - least * least)) * sine
    nothing, everything = (sine > 0.0) & (least > cosine), (sine < 0.0) & (least < -cosine)
    return ((ax * x + ay * y + az * z >= edge) | everything) & (not nothing)


@dispatched
def hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Tell if landmark A hides B, and if B hides A, from the camera's position.

    Args:
        ax, ay, az, bx, by, bz: offsets of the two from the camera, metres.
        a, b: their squared lengths.
        ux, uy, uz, vx, vy, vz: unit normals of A and of B.
    """


@overridable
def hide_between(sight, other, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """`hide`, given the compiled model for A and the `other` for B: see `sized`.

    A model that knows landmarks of several sizes registers this instead of `hide`.
    """
    return hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz)


@inlined
def covers(sight, x, y, z, nx, ny, nz, low, slack, axes, a):  # type: ignore[no-untyped-def]
    """`in_image` with orientation a of `axes` `(6, D)`: axis and right."""
    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
    return in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz)


@overridable
def frame_of(sight, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Argument of `covers_one` for a landmark with a normal; it serves all positions and orientations."""
    return nx, ny, nz


@overridable
def covers_one(sight, x, y, z, frame, low, high, sure, well, axes, a):  # type: ignore[no-untyped-def]
    """`covers` without slack, for single orientations: where much is to be tested, a model may do it in stages.

    Args:
        x, y, z, low, high, sure: as in `from_position`.
        frame: of `frame_of`.
        well: whether orientation a has it well in view, see `sure`.
        axes, a: as in `covers`.
    """
    nx, ny, nz = frame
    return covers(sight, x, y, z, nx, ny, nz, low, 0.0, axes, a)


@overridable
def pixel_density(sight, x, y, z, axes, a):  # type: ignore[no-untyped-def]
    """Image of a small solid angle around a landmark that orientation a covers, focal lengths squared, over distance^3.

    For a pinhole 1 / depth^3.
    """
    depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
    return 1.0 / (depth * depth * depth)


@overridable
def covering(sight, left, w, x, y, z, frame, low, high, sure, well, axes):  # type: ignore[no-untyped-def]
    """The axes of word w that are in the set `left` and cover the landmark; arguments as in `covers_one`, `well` a set.

    To test half a word at once is faster than to pick axes out, where a test is short.
    """
    nx, ny, nz = frame
    cap = ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            half = np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                half |= np.uint32(covers(sight, x, y, z, nx, ny, nz, low, 0.0, axes, a)) << np.uint32(lane)
            cap |= np.uint64(half) << first
    return cap & left


def depth_first(sight, left, w, x, y, z, frame, low, high, sure, well, axes):  # type: ignore[no-untyped-def]
    """`covering` for models with long tests: depths of all axes come first, since they decide most."""
    within, shallow = ZERO, ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            one, two = np.uint32(0), np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
                one |= np.uint32((depth >= low) & (depth <= high)) << np.uint32(lane)
                two |= np.uint32(depth <= sure) << np.uint32(lane)
            within, shallow = within | np.uint64(one) << first, shallow | np.uint64(two) << first
    left &= within
    cap = left & well & shallow
    left &= ~cap
    while left:
        bit: Any = lowest(left)
        a, central = w * np.uint64(BITS) + bit, (well >> bit & ONE) != ZERO
        cap |= np.uint64(covers_one(sight, x, y, z, frame, low, high, sure, central, axes, a)) << bit
        left &= left - ONE
    return cap
