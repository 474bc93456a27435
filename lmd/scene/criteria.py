"""Interface of visibility models: tests if a camera covers a landmark, and if one landmark hides another.

Most criteria depend mainly on the camera's position, so a model is evaluated in stages:

- `from_position` bounds the result for all orientations at a position.
- `in_image` tests one orientation, given by two unit vectors: the optical axis, and the direction to the right in the
  image (the *image's right*). A model with a conical field of view ignores the second vector.
- `hide` tests if one landmark occludes another.

These functions are scalar, with as few branches as possible. Kernels call only the functions of this module.

A visibility model has two parts:

- a `Criteria` with the thresholds that a user sets. The method `Criteria.covered` is the NumPy reference.
- a `SightModel`, the *model of sight*: a named tuple of numbers, made for one camera. The type of this tuple is
  registered with the functions of this module.

Both parts must give equal results, bit for bit. A `Covering` has the NumPy reference only, without a model of sight.

Few orientations need the exact test, because two fast methods exclude most of the others. The first method sorts the
orientations by the z coordinate of the optical axis. The optical axis of an orientation that covers a landmark is in a
cone around the direction of the landmark, so only a band of z coordinates is possible. The second method looks up the
orientations in tables by the direction of the landmark. The tables depend only on the field of view (`in_view`).
"""

import math
from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, Integer, lowest
from lmd.core.checks import BoolArray, FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.geometry.camera import Camera
from lmd.geometry.vectors import Vector, column3, dot3, pair3

# Tolerance of every closed inequality, so that a landmark on a boundary meets the criterion despite rounding; relative
# for lengths, absolute for cosines and probabilities.
TOLERANCE = 1e-9


class SightModel(Protocol):
    """Interface of a model of sight: the numbers of a visibility model for one camera, read by compiled code."""

    @property
    def outer_cosine(self) -> float:
        """Lower bound on the cosine of the angle between the optical axis and the direction of a covered landmark."""

    @property
    def inset(self) -> float:
        """Angular margin, rad, from the border of the field of view, with which a landmark is *well in view*.

        The field of view then contains the cone with this half-angle around the landmark's direction (tested by
        `in_view`). A landmark that is well in view is covered if its depth along the optical axis is between the bounds
        `low` and `sure`, which `from_position` returns.
        """

    @property
    def reach(self) -> float:
        """Square of the largest distance, m^2, from a line of sight at which a landmark can block this line.

        The value is negative if no landmark can block a line of sight.
        """

    @property
    def horizon(self) -> float:
        """Distance beyond which a landmark has no effect, metres, see `horizon_of`.

        An optional field, by default infinite.
        """

    @property
    def tabulated(self) -> bool:
        """True if a look-up in a table of directions (`lmd.sight.directions`) is faster than `in_image`.

        An optional field, by default False. Use False if `in_image` has few operations.
        """

    def unhidden(self) -> "SightModel":
        """Copy of this model in which no landmark hides another from the camera."""

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "SightModel":
        """Fastest model for given landmarks: `unhidden()` if no landmark can hide another, else this model itself.

        The test is conservative: the result may be this model itself although no landmark is hidden.

        Args:
            low, high: corners of a box around all positions of the camera, `(3,)`, metres.
            landmarks: positions of the landmarks of B deployments, metres, `(B, 3, K)`.
            normals: unit normals, `(B, 3, K)`.
        """

    def shrunk(self, size: float) -> "SightModel":
        """Copy of this model in which each landmark hides others as if its size were multiplied by `size`."""


class Criteria(Protocol):
    """Interface of visibility criteria, the type of `Scene.visibility`."""

    @property
    def needs_roll(self) -> bool:
        """True if coverage depends on the camera's roll about its optical axis."""

    @property
    def spacing(self) -> float:
        """Least distance between neighbouring landmarks at which neither can hide the other, metres."""

    def sight(self, camera: Camera) -> Any:
        """Make the `SightModel` of these criteria for `camera`; None if the criteria have only the method `covered`."""

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """Reference mask of the landmarks that the camera covers with each of A orientations, `(A, K)`.

        Args:
            camera: intrinsics.
            position: position p of the camera, world frame, metres, `(3,)`.
            axes: two unit vectors for each orientation, the optical axis and the direction to the right in the image,
                world frame, `(A, 6)`.
            landmarks: positions, world frame, metres, `(K, 3)`.
            normals: unit normals, `(K, 3)`.
        """


class Covering(ABC):
    """Base of criteria without a compiled model of sight; a subclass implements `covered`, see `Criteria`.

    All results are computed with `covered` (`lmd.sight.reference`), which is slower than a compiled model of sight.
    """

    needs_roll = True
    spacing = 0.0

    def sight(self, camera: Camera) -> Any:
        """Return None, as there is no compiled model of sight."""
        return None

    @abstractmethod
    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """See `Criteria.covered`."""


def horizon_of(sight: SightModel) -> float:
    """Distance beyond which landmarks have no effect, metres; infinite if there is no such distance.

    A landmark farther from the camera than this distance is not covered and hides no covered landmark. Two landmarks
    that are farther apart than this distance do not hide each other.
    """
    return float(getattr(sight, "horizon", math.inf))


@overridable
def sized(sight: Any, k: Integer) -> Any:
    """Return the model of sight for landmark k alone, given the model `sight` of all landmarks.

    A model for landmarks of several sizes stores arrays with one value per landmark; `sized` selects the values of
    landmark k. A model for landmarks of one size is returned unchanged. The tests of a landmark in this module, such as
    `from_position` and `in_image`, require the model of one landmark.
    """
    return sight


@dispatched
def from_position(sight: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    """Bounds on the coverage of a landmark from a position, over all orientations of the camera.

    Args:
        sight: model of sight of the landmark.
        offset: offset of the landmark from the camera, world frame, metres.
        normal: unit normal of the landmark.
        slack: distance, metres. `reached` and `low` also hold if the landmark is moved in its plane by up to this
            distance. The slack is 0 for a single landmark, and positive for a cell of a wall (`lmd.sight.poses`).

    Returns:
        reached: False only if no orientation covers the landmark.
        low, high: bounds on the depth of a covered landmark along the optical axis, metres; `high` ignores the slack.
        sure: depth, metres. An orientation covers the landmark if the landmark is well in view (`SightModel.inset`) at
            a depth between `low` and `sure`. `sure` is infinite if no depth is too large, and ignores the slack.
    """


@overridable
def from_around(sight: Any, offset: Vector, normal: Vector, radius: float) -> Any:
    """Bounds on the results of `from_position` that hold for all camera positions within `radius` of a point.

    Args:
        offset: offset of the landmark from the point, world frame, metres.
        normal: unit normal of the landmark.
        radius: metres, positive.

    Returns:
        reached: False only if no orientation at any of the positions covers the landmark.
        most: upper bound on the depth along the optical axis of a covered landmark, metres.
        start, sure: depths, metres. An orientation covers the landmark if the landmark is well in view
            (`SightModel.inset`) and its depth is between `start` and `sure`. `start` is -inf if no depth is too small.
            `sure` is inf if no depth is too large, and -inf if coverage is never certain.
    """
    return True, math.inf, 0.0, -math.inf


@dispatched
def in_image(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axis: Vector, right: Vector) -> Any:
    """True if an orientation covers a landmark; occlusion is ignored.

    `from_position` must have returned `reached` = True for this landmark.

    Args:
        offset: offset of the landmark from the camera, world frame, metres.
        normal: unit normal of the landmark.
        low: result of `from_position`; if `low` is infinite, the function returns False.
        slack: distance, metres. If positive, the result is True if the orientation may cover the landmark after the
            landmark is moved in its plane by up to this distance.
        axis: optical axis, unit vector.
        right: unit vector to the right in the image; the cross product of `axis` and `right` points down in the image.
    """


@dispatched
def in_view(sight: Any, way: Vector, sine: float, cosine: float, axis: Vector, right: Vector) -> Any:
    """True if the field of view contains the whole cone of half-angle delta around the unit vector `way`.

    If delta is negative, the result is True if the field of view may contain any part of the cone of half-angle -delta.
    The field of view contains the directions of all landmarks that the model may cover.

    Args:
        way: axis of the cone, world frame.
        sine, cosine: sin(delta) and cos(delta), |delta| < pi / 2.
        axis, right: optical axis and direction to the right in the image, unit vectors, world frame.
    """


@inlined
def in_cone(least: float, way: Vector, sine: float, cosine: float, axis: Vector) -> Any:
    """True if a conical field of view around the optical axis contains the whole cone around `way`, as in `in_view`.

    `least` is the cosine of the half-angle of the field of view. The other arguments are those of `in_view`.
    """
    # With the half-angle theta, the cone narrowed by delta has the cosine cos(theta - delta), unless it is empty or the
    # whole sphere.
    edge = least * cosine + math.sqrt(max(0.0, 1.0 - least * least)) * sine
    nothing, everything = (sine > 0.0) & (least > cosine), (sine < 0.0) & (least < -cosine)
    return ((dot3(axis, way) >= edge) | everything) & (not nothing)


@dispatched
def hide(sight: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    """Test if landmark A hides landmark B from the camera's position, and if B hides A; return two booleans.

    Args:
        a, b: offsets of A and B from the camera, metres.
        aa, bb: squared lengths of the offsets, m^2.
        u, v: unit normals of A and of B.
    """


@overridable
def hide_between(sight: Any, other: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    """Test as in `hide` for two landmarks A and B of different sizes; return two booleans.

    Each landmark has its own model of sight (see `sized`): `sight` for A, `other` for B. A model of sight for landmarks
    of several sizes registers this function instead of `hide`.
    """
    return hide(sight, a, aa, b, bb, u, v)


@inlined
def covers(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axes: FloatArray, a: Integer) -> Any:
    """True if the orientation in column `a` of `axes` `(6, D)` covers a landmark, as tested by `in_image`.

    `axes` has a column for each of D orientations. Rows 0 to 2 are the optical axis, rows 3 to 5 the direction to the
    right in the image. The other arguments are those of `in_image`.
    """
    axis, right = pair3(axes, a)
    return in_image(sight, offset, normal, low, slack, axis, right)


@overridable
def frame_of(sight: Any, normal: Vector) -> Any:
    """Return the vectors that describe how a landmark is turned, from the landmark's unit normal `normal`.

    By default the result is the normal itself. For tags, the result is the normal, the tag's direction to the right and
    the tag's up vector. The result is computed once, and used by `covers_one` for many orientations.
    """
    return normal


@overridable
def covers_one(sight: Any, offset: Vector, frame: Any, depths: Vector, well: Any, axes: FloatArray, a: Integer) -> Any:
    """True if the orientation in column `a` of `axes` covers a landmark; occlusion is ignored.

    By default this is the result of `covers`. A model with an expensive test may register a faster function.

    Args:
        sight: model of sight of the landmark.
        offset: offset of the landmark from the camera, world frame, metres.
        frame: vectors that describe how the landmark is turned, from `frame_of`.
        depths: the bounds `low`, `high` and `sure` on the landmark's depth, which `from_position` returns.
        well: True if the landmark is well in view at this orientation, see `SightModel.inset`.
        axes: orientations, one per column, `(6, D)`, as in `covers`.
        a: column of the orientation.
    """
    return covers(sight, offset, frame, depths[0], 0.0, axes, a)


@overridable
def pixel_density(sight: Any, offset: Vector, axes: FloatArray, a: Integer) -> Any:
    """Image area per solid angle in the direction of a landmark, divided by the cube of the landmark's distance.

    The information that a landmark's image gives about the camera's pose grows with this density. For a pinhole camera
    the result is 1 / depth^3. The unit is squared focal lengths per steradian and cubic metre.

    Args:
        offset: offset of the landmark from the camera, metres.
        axes: orientations, one per column, `(6, D)`, as in `covers`.
        a: column of an orientation that covers the landmark.
    """
    depth = dot3(column3(axes, a), offset)
    return 1.0 / (depth * depth * depth)


@overridable
def covering(
    sight: Any, left: Any, w: Integer, offset: Vector, frame: Any, depths: Vector, well: Any, axes: FloatArray
) -> Any:
    """Test which of 64 consecutive orientations cover a landmark; return a 64-bit integer with a bit for each.

    Bit i stands for the orientation in column 64 w + i of `axes`. If any bit in one half of `left` is set, the function
    tests all 32 orientations of this half. For a cheap test this is faster than iterating over the set bits.

    Args:
        left: 64-bit integer; bits are set for the orientations to test.
        w: index of the 64 orientations: they are the columns 64 w to 64 w + 63 of `axes`.
        offset: offset of the landmark from the camera, world frame, metres.
        frame: vectors that describe how the landmark is turned, from `frame_of`.
        depths: the bounds `low`, `high` and `sure` on the landmark's depth, which `from_position` returns.
        well: 64-bit integer; bits are set for the orientations at which the landmark is well in view, see
            `SightModel.inset`.
        axes: orientations, one per column, `(6, D)`, as in `covers`.

    Returns:
        64-bit integer; bits are set for the orientations in `left` that cover the landmark.
    """
    visible = ZERO
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            half = np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                half |= np.uint32(covers(sight, offset, frame, depths[0], 0.0, axes, a)) << np.uint32(lane)
            visible |= np.uint64(half) << first
    return visible & left


def depth_first(
    sight: Any, left: Any, w: Integer, offset: Vector, frame: Any, depths: Vector, well: Any, axes: FloatArray
) -> Any:
    """Test which of 64 orientations cover a landmark, as `covering` does, but faster for models with a slow test.

    The function first compares the landmark's depth with the bounds in `depths`. For most orientations this comparison
    decides the result. Arguments and result are those of `covering`.
    """
    within, shallow, (low, high, sure) = ZERO, ZERO, depths
    for first in range(np.uint64(0), np.uint64(BITS), np.uint64(LANES)):
        if left >> first << np.uint64(BITS - LANES):
            one, two = np.uint32(0), np.uint32(0)
            for lane in range(np.uint64(LANES)):
                a = w * np.uint64(BITS) + first + lane
                depth = dot3(column3(axes, a), offset)
                one |= np.uint32((depth >= low) & (depth <= high)) << np.uint32(lane)
                two |= np.uint32(depth <= sure) << np.uint32(lane)
            within, shallow = within | np.uint64(one) << first, shallow | np.uint64(two) << first
    left &= within
    visible = left & well & shallow
    left &= ~visible
    while left:
        bit: Any = lowest(left)
        a, central = w * np.uint64(BITS) + bit, (well >> bit & ONE) != ZERO
        visible |= np.uint64(covers_one(sight, offset, frame, depths, central, axes, a)) << bit
        left &= left - ONE
    return visible
