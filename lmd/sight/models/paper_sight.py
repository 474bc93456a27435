"""Criteria of `lmd.sight.models.paper` for one camera, compiled as scalar functions."""

import math
from typing import Any, NamedTuple

from lmd.core.checks import FloatArray
from lmd.geometry.vectors import Vector, cross3, dot3
from lmd.scene.criteria import TOLERANCE, from_around, from_position, hide, in_cone, in_image, in_view


class PaperSight(NamedTuple):
    """Bounds on the depth with tolerances for one camera; a `lmd.scene.criteria.SightModel`."""

    min_cosine: float
    """Cosine of the half-angle of the cone of view."""
    min_depth: float
    """Least depth, metres."""
    max_depth: float
    """Greatest depth, metres."""
    reach: float
    """Squared virtual diameter nu, m^2; negative without occlusion."""
    whole_line: bool
    """True if landmarks behind the camera, or farther than the hidden landmark, also hide a landmark."""

    @property
    def outer_cosine(self) -> float:
        """See `SightModel.outer_cosine`."""
        return self.min_cosine - TOLERANCE

    @property
    def inset(self) -> float:
        """See `SightModel.inset`; 0, as a landmark is a point."""
        return 0.0

    @property
    def horizon(self) -> float:
        """See `SightModel.horizon`; infinite for `whole_line`, as landmarks at any distance may hide others."""
        if self.min_cosine <= 0.0 or (self.whole_line and self.reach >= 0.0):
            return math.inf
        return (self.max_depth / self.min_cosine + math.sqrt(max(self.reach, 0.0))) * (1.0 + 2.0 * TOLERANCE)

    @property
    def tabulated(self) -> bool:
        """See `SightModel.tabulated`; the test is a depth and two comparisons."""
        return False

    def unhidden(self) -> "PaperSight":
        """See `SightModel.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "PaperSight":
        """See `SightModel.among`; no occlusion is excluded."""
        return self

    def shrunk(self, size: float) -> "PaperSight":
        """See `SightModel.shrunk`."""
        return self._replace(reach=self.reach * size**2)


@from_position.register(PaperSight)
def _from_position(sight: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    distance = math.sqrt(dot3(offset, offset))
    nearest = distance - slack
    low = max(nearest * sight.min_cosine, sight.min_depth) - slack
    in_depth = (nearest * sight.min_cosine <= sight.max_depth) & (
        (distance + slack) * (1.0 + TOLERANCE) >= sight.min_depth
    )
    facing = -dot3(normal, offset) > TOLERANCE * nearest
    limited = (distance * sight.min_cosine < sight.min_depth) | (distance * (1.0 + TOLERANCE) > sight.max_depth)
    return in_depth & facing, low, sight.max_depth, sight.max_depth if limited else math.inf


@from_around.register(PaperSight)
def _from_around(sight: Any, offset: Vector, normal: Vector, radius: float) -> Any:
    distance, along = math.sqrt(dot3(offset, offset)), -dot3(normal, offset)
    nearest, farthest = max(distance - radius, 0.0), (distance + radius) * (1.0 + TOLERANCE)
    least = min(nearest * sight.min_cosine, farthest * sight.min_cosine)
    reached = (least <= sight.max_depth) & (farthest >= sight.min_depth) & (along + radius > 0.0)
    start = sight.min_depth if least < sight.min_depth else -math.inf
    sure = sight.max_depth if farthest > sight.max_depth else math.inf
    facing = along - radius > TOLERANCE * farthest
    return reached, sight.max_depth, start, sure if facing else -math.inf


@in_image.register(PaperSight)
def _in_image(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axis: Vector, right: Vector) -> Any:
    depth = dot3(axis, offset)
    return (depth >= low) & (depth <= sight.max_depth + slack)


@in_view.register(PaperSight)
def _in_view(sight: Any, way: Vector, sine: float, cosine: float, axis: Vector, right: Vector) -> Any:
    return in_cone(sight.min_cosine + (TOLERANCE if sine > 0.0 else -TOLERANCE), way, sine, cosine, axis)


@hide.register(PaperSight)
def _hide(sight: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    c = cross3(a, b)
    cross = dot3(c, c)
    one, two = cross <= sight.reach * bb, cross <= sight.reach * aa
    if not sight.whole_line:
        in_front = dot3(b, a) > 0.0
        one = one & in_front & (aa <= bb * (1.0 + TOLERANCE))
        two = two & in_front & (bb <= aa * (1.0 + TOLERANCE))
    return one, two
