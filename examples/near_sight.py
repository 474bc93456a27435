"""The criterion of `near`, compiled."""

import math
from typing import Any, NamedTuple

from lmd.geometry.camera import Camera
from lmd.geometry.vectors import dot3
from lmd.scene.criteria import TOLERANCE, from_position, hide, in_cone, in_image, in_view
from near import COSINE, Near


class NearSight(NamedTuple):
    """The criterion for one camera: its range, metres; the rest is what `Sight` asks for."""

    range: float
    outer_cosine: float = COSINE - TOLERANCE
    inset: float = 0.0
    reach: float = -1.0

    def unhidden(self) -> "NearSight":
        """The same, as nobody hides anybody."""
        return self

    def among(self, *_: Any) -> "NearSight":
        """The same, too."""
        return self

    def shrunk(self, size: float) -> "NearSight":
        """The same, too."""
        return self


class CompiledNear(Near):
    """`Near` with its compiled half."""

    def sight(self, camera: Camera) -> NearSight:
        """The criterion compiled for a camera."""
        return NearSight(self.range)


@from_position.register(NearSight)
def _from_position(sight, offset, normal, slack):  # type: ignore[no-untyped-def]
    nearest = math.sqrt(dot3(offset, offset)) - slack
    facing = dot3(normal, offset) < 0.0  # the same for all of a wall
    return (nearest <= sight.range) & facing, COSINE * nearest - slack, math.inf, -math.inf


@in_image.register(NearSight)
def _in_image(sight, offset, normal, low, slack, axis, right):  # type: ignore[no-untyped-def]
    return dot3(axis, offset) >= low


@in_view.register(NearSight)
def _in_view(sight, way, sine, cosine, axis, right):  # type: ignore[no-untyped-def]
    return in_cone(COSINE + (TOLERANCE if sine > 0.0 else -TOLERANCE), way, sine, cosine, axis)


@hide.register(NearSight)
def _hide(sight, a, aa, b, bb, u, v):  # type: ignore[no-untyped-def]
    return False, False
