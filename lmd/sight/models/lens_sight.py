"""Criteria of `lmd.sight.models.fiducial` for a lens with distortion, compiled as scalar functions.

The functions differ from `fiducial_sight` in two points:

- The centre and each corner are projected through the lens. The projections must lie in the image rectangle and within
  the camera's widest angle from the optical axis, which may exceed 90 degrees.
- J is the Jacobian of the projection through the lens.

Bounds follow from the local scale of the lens (`lmd.geometry.lens.Stretch`). Two inequalities hold anywhere in the
image, for a tag at the distance d with the incidence angle i.

    min_pitch cos(i) / d <= pitch <= max_pitch cos(i) / d,
    min_area cos(i) / d^2 <= |det J| <= max_area cos(i) / d^2.

Except for a fisheye, two pinholes with a shorter and a longer focal length also bound pitch and area at each depth.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray
from lmd.core.dispatch import overridable
from lmd.geometry.lens_models import BrownConrady, Equidistant, area_per_solid_angle, image_of
from lmd.geometry.squares import upright_axes
from lmd.geometry.vectors import Vector, cross3, dot3, in_frame, pair3
from lmd.scene.criteria import (
    TOLERANCE,
    covering,
    covers_one,
    depth_first,
    frame_of,
    from_around,
    from_position,
    hide_between,
    in_cone,
    in_image,
    in_view,
    pixel_density,
    sized,
)
from lmd.sight.models.fiducial_sight import FiducialSight, may_hide, of_sizes
from lmd.sight.models.lens_image import corners_inside, in_rectangle, resolves, room_within, stretch_at
from lmd.sight.obstacles import half_edge

# Relative safety margin of the bounds on pitch and area; it exceeds the error of a normal's squared length.
MARGIN = 1e-2
# Greatest angle from the field of view for which the image beyond 90 degrees is bounded, rad.
NEAR = 0.1
ARC = math.pi / 2.0 - 1.0  # constant of the bound asin(s) <= s (1 + ARC s^2)
DIAGONAL = 1.4143  # diagonal of a square over its edge, rounded up


class LensSight(NamedTuple):
    """Compiled thresholds of a tag detector's criteria for one camera with lens distortion.

    The class is a `lmd.scene.criteria.SightModel`. The thresholds include tolerances for rounding.
    """

    flat: FiducialSight
    """Thresholds that do not depend on the lens, and the borders of the distorted image."""
    lens: BrownConrady | Equidistant
    """Coefficients of the lens."""
    reach: float
    """See `SightModel.reach`."""
    inset: float
    """See `SightModel.inset`."""
    cosine: float
    """Cosine of the camera's widest angle from the optical axis."""
    min_depth_ratio: float
    """Least ratio of `lens_models.depth_of` to the distance, over all directions within the widest angle."""
    min_pitch: float
    """Least image length of a metre that faces the camera at a distance of 1 m, pixels."""
    max_pitch: float
    """Greatest image length of a metre that faces the camera at a distance of 1 m, pixels."""
    min_area: float
    """Least image area of a square metre that faces the camera at a distance of 1 m, pixels^2."""
    max_area: float
    """Greatest image area of a square metre that faces the camera at a distance of 1 m, pixels^2."""
    stretch: tuple[float, ...]
    """Coefficients of an upper bound on the local scale of the lens (motion of an image point per turn of its
    direction), see `lmd.geometry.lens.ceiling`.
    """
    stretch_end: float
    """1 - cos(theta) for the greatest angle theta at which the bound `stretch` holds."""
    approximation: tuple[float, ...]
    """Coefficients of an approximate projection, see `lmd.geometry.lens.approximation`."""
    image_error: float
    """Upper bound on the error of `approximation`, focal lengths."""
    pinholes: tuple[FiducialSight, FiducialSight] | tuple[()]
    """Two pinhole models. Pitch and area of the first model are lower bounds on pitch and area of the lens; pitch and
    area of the second model are upper bounds. Empty for a fisheye.
    """

    @property
    def outer_cosine(self) -> float:
        """See `SightModel.outer_cosine`; negative for a widest angle beyond 90 degrees."""
        return self.cosine - TOLERANCE

    @property
    def horizon(self) -> float:
        """See `SightModel.horizon`; it uses pitch^2 <= |det J|."""
        needed = max(np.min(self.flat.area), np.min(self.flat.sharp))
        seen = math.sqrt(self.max_area / needed) if needed else math.inf
        return (seen + math.sqrt(max(self.reach, 0.0))) * (1.0 + MARGIN)

    @property
    def tabulated(self) -> bool:
        """See `SightModel.tabulated`."""
        return True

    def unhidden(self) -> "LensSight":
        """See `SightModel.unhidden`."""
        return self._of(self.flat.unhidden())

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "LensSight":
        """See `SightModel.among`."""
        return self if may_hide(self.flat, self.horizon, low, high, landmarks, normals) else self.unhidden()

    def shrunk(self, size: float) -> "LensSight":
        """See `SightModel.shrunk`."""
        return self._of(self.flat.shrunk(size))

    def _of(self, flat: FiducialSight) -> "LensSight":
        return self._replace(flat=flat, reach=flat.reach)


def of_sizes_behind_lens(sights: Sequence[LensSight]) -> LensSight:
    """Join the compiled models of K tags, one for each tag's size, seen through a lens into one model."""
    largest = max(sights, key=lambda sight: sight.flat.half)
    pinholes: Any = tuple(of_sizes(each) for each in zip(*(sight.pinholes for sight in sights), strict=True))
    return largest._replace(flat=of_sizes([sight.flat for sight in sights]), pinholes=pinholes)


@sized.register(LensSight)
def _sized(sight: Any, k: Integer) -> Any:
    return LensSight(
        sized(sight.flat, k), sight.lens, sight.reach, sight.inset, sight.cosine, sight.min_depth_ratio,
        sight.min_pitch, sight.max_pitch, sight.min_area, sight.max_area, sight.stretch, sight.stretch_end,
        sight.approximation, sight.image_error, _sized_pinholes(sight.lens, sight.pinholes, k),
    )  # fmt: skip


@overridable
def _sized_pinholes(lens: Any, pinholes: Any, k: Integer) -> Any:
    return sized(pinholes[0], k), sized(pinholes[1], k)


@_sized_pinholes.register(Equidistant)
def _no_pinholes(lens: Any, pinholes: Any, k: Integer) -> Any:
    return pinholes


@from_around.register(LensSight)
def _from_around(sight: Any, offset: Vector, normal: Vector, radius: float) -> Any:
    return from_around(sight.flat, offset, normal, radius)


@half_edge.register(LensSight)
def _half_edge(sight: Any) -> Any:
    return sight.flat.half


@from_position.register(LensSight)
def _from_position(sight: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    flat, distance, along = sight.flat, np.sqrt(dot3(offset, offset)), -dot3(normal, offset)
    nearest = distance - slack
    # Blur at the least and at the greatest depth.
    per = 1.0 / distance
    near, far = flat.defocus - flat.focus * per / sight.min_depth_ratio, flat.defocus - flat.focus * per
    sharpest, softest = max(0.0, near, -far), max(abs(near), abs(far))
    sharpest = 0.0 if slack > 0.0 else sharpest
    fewest, needed = flat.sharp + flat.blurred * sharpest * sharpest, flat.sharp + flat.blurred * softest * softest
    pitch, area = sight.max_pitch * along, sight.max_area * along
    squared, cubed = nearest * nearest, nearest * nearest * nearest
    resolved = cubed * max(flat.area, fewest) <= area * (1.0 + MARGIN)
    resolved &= (fewest * squared * squared <= pitch * pitch * (1.0 + MARGIN)) | (nearest <= 0.0)
    pitch, area = sight.min_pitch * along, sight.min_area * along
    squared, cubed = distance * distance, distance * distance * distance
    surely = (needed * squared * squared <= pitch * pitch * (1.0 - MARGIN)) & (
        flat.area * cubed <= area * (1.0 - MARGIN)
    )
    reached = (along >= flat.facing * nearest) & (along >= 0.0) & resolved
    outer = sight.cosine - TOLERANCE
    low = min(outer * nearest, outer * (distance + slack)) - slack
    # Far enough away, all corners are in the image if the direction is well in view.
    steady = distance * math.sin(sight.inset) >= 1.5 * flat.half
    among, high, sure = _by_depth(sight.lens, sight.pinholes, offset, normal, slack)
    sure = math.inf if surely else max(sure, low - distance)
    return reached & among, low, min(high, distance * (1.0 + MARGIN)), sure if steady else -math.inf


@overridable
def _by_depth(lens: Any, pinholes: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    """Bounds on the coverage of a tag: the results `reached`, `high` and `sure` of `criteria.from_position`.

    `reached` is False only if no orientation covers the tag. `high` is the greatest depth at which the tag may be
    covered; up to the depth `sure`, a tag well in view is covered. The two models `pinholes` bound the pitch and the
    area of a tag seen through the lens.
    """
    _, _, _, sure = from_position(pinholes[0], offset, normal, slack)
    reached, _, high, _ = from_position(pinholes[1], offset, normal, slack)
    return reached, high, sure


@_by_depth.register(Equidistant)
def _by_distance(lens: Any, pinholes: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    return True, math.inf, -math.inf


@frame_of.register(LensSight)
def _frame_of(sight: Any, normal: Vector) -> Any:
    return frame_of(sight.flat, normal)


@in_view.register(LensSight)
def _in_view(sight: Any, way: Vector, sine: float, cosine: float, axis: Vector, right: Vector) -> Any:
    flat, least = sight.flat, sight.cosine + (TOLERANCE if sine > 0.0 else -TOLERANCE)
    u, v, w = in_frame((right, cross3(axis, right), axis), way)
    across, down = image_of(sight.lens, u, v, w)
    # The local scale at the middle of the arc bounds its first half, the local scale at its end the second half.
    angle, end = sine * (1.0 + ARC * sine * sine), 1.0 - w * cosine + math.sqrt(max(0.0, 1.0 - w * w)) * abs(sine)
    end = sight.stretch_end if w <= -cosine else end  # the arc passes the direction opposite to the axis
    halfway = min(end, 1.0 - w + abs(angle) / 2.0)
    room = angle * (stretch_at(sight, halfway) + stretch_at(sight, end)) / 2.0
    inside = (flat.right - across >= room) & (flat.left + across >= room)
    inside &= (flat.bottom - down >= room) & (flat.top + down >= room)
    # Beyond the widest angle the projection is undefined.
    unknown = (sine < 0.0) & ((w < sight.cosine) | ((sight.cosine < 0.0) & (sine < -NEAR)))
    return in_cone(least, way, sine, cosine, axis) & (inside | unknown)


@in_image.register(LensSight)
def _in_image(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axis: Vector, right: Vector) -> Any:
    frame, (along, up) = (right, cross3(axis, right), axis), upright_axes(normal, sight.flat.level)
    tag = in_frame(frame, offset), in_frame(frame, along), in_frame(frame, up)
    covered = in_rectangle(sight, tag[0]) & resolves(sight, tag)
    covered &= corners_inside(sight, tag)
    return (covered | (slack > 0.0)) & (tag[0][2] >= low)


@covers_one.register(LensSight)
def _covers_one(sight: Any, offset: Vector, frame: Any, depths: Vector, well: Any, axes: FloatArray, a: Integer) -> Any:
    (_, along, up), (low, high, sure), (axis, right) = frame, depths, pair3(axes, a)
    w = dot3(axis, offset)
    if (w < low) | (w > high):
        return False
    if well & (w <= sure):
        return True
    down = cross3(axis, right)
    centre, inside = (dot3(right, offset), dot3(down, offset), w), well & (sure > -math.inf)
    if not inside:
        # The compiler moves terms that depend on the landmark alone out of the loop over axes.
        per = 1.0 / np.sqrt(dot3(offset, offset))
        height, room = 1.0 - w * per, room_within(sight, centre, per)
        if room < -sight.image_error:
            return False
        if (room <= sight.image_error or w * per <= sight.cosine + TOLERANCE) and not in_rectangle(sight, centre):
            return False
        # Upper bounds on the angle between centre and corner, and on the distance between their images.
        sine = DIAGONAL * sight.flat.half * per
        angle = sine * (1.0 + ARC * sine * sine)
        inside = (sine <= 1.0) & (w * per >= sight.cosine + angle)
        inside &= room >= angle * stretch_at(sight, height + angle) + sight.image_error
    tag = centre, in_frame((right, down, axis), along), in_frame((right, down, axis), up)
    if w > sure and not resolves(sight, tag):
        return False
    return inside or corners_inside(sight, tag)


covering.register(LensSight)(depth_first)


@hide_between.register(LensSight)
def _hide(sight: Any, other: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    return hide_between(sight.flat, other.flat, a, aa, b, bb, u, v)


@pixel_density.register(LensSight)
def _pixel_density(sight: Any, offset: Vector, axes: FloatArray, a: Integer) -> Any:
    axis, right = pair3(axes, a)
    u, v, w = in_frame((right, cross3(axis, right), axis), offset)
    return area_per_solid_angle(sight.lens, u, v, w)
