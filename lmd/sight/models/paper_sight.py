"""The paper's criteria as scalar functions: `lmd.sight.models.paper` compiled for a camera."""

import math
from typing import NamedTuple

from lmd.core.checks import FloatArray
from lmd.scene.criteria import TOLERANCE, from_around, from_position, hide, in_cone, in_image, in_view


class PaperSight(NamedTuple):
    """The criteria as bounds on the depth, tolerance included; a `lmd.scene.criteria.Sight`."""

    min_cosine: float
    """Of the cone of view."""
    min_depth: float
    """Metres."""
    max_depth: float
    """Metres."""
    reach: float
    """Squared nu, m^2."""
    whole_line: bool
    """Whether a landmark hides another from behind the camera, too, and from beyond it."""

    @property
    def outer_cosine(self) -> float:
        """See `Sight.outer_cosine`."""
        return self.min_cosine - TOLERANCE

    @property
    def inset(self) -> float:
        """See `Sight.inset`: a landmark is a point."""
        return 0.0

    @property
    def horizon(self) -> float:
        """See `Sight.horizon`: a landmark on the whole line hides others from however far away."""
        if self.min_cosine <= 0.0 or (self.whole_line and self.reach >= 0.0):
            return math.inf
        return (self.max_depth / self.min_cosine + math.sqrt(max(self.reach, 0.0))) * (1.0 + 2.0 * TOLERANCE)

    @property
    def tabulated(self) -> bool:
        """See `Sight.tabulated`: a depth and two comparisons."""
        return False

    def unhidden(self) -> "PaperSight":
        """See `Sight.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "PaperSight":
        """See `Sight.among`: a landmark may hide any other."""
        return self

    def shrunk(self, size: float) -> "PaperSight":
        """See `Sight.shrunk`."""
        return self._replace(reach=self.reach * size**2)


@from_position.register(PaperSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    distance = math.sqrt(x * x + y * y + z * z)
    nearest = distance - slack
    low = max(nearest * sight.min_cosine, sight.min_depth) - slack
    in_depth = (nearest * sight.min_cosine <= sight.max_depth) & (
        (distance + slack) * (1.0 + TOLERANCE) >= sight.min_depth
    )
    facing = -(nx * x + ny * y + nz * z) > TOLERANCE * nearest
    limited = (distance * sight.min_cosine < sight.min_depth) | (distance * (1.0 + TOLERANCE) > sight.max_depth)
    return in_depth & facing, low, sight.max_depth, sight.max_depth if limited else math.inf


@from_around.register(PaperSight)
def _from_around(sight, x, y, z, nx, ny, nz, radius):  # type: ignore[no-untyped-def]
    distance, along = math.sqrt(x * x + y * y + z * z), -(nx * x + ny * y + nz * z)
    nearest, farthest = max(distance - radius, 0.0), (distance + radius) * (1.0 + TOLERANCE)
    least = min(nearest * sight.min_cosine, farthest * sight.min_cosine)
    reached = (least <= sight.max_depth) & (farthest >= sight.min_depth) & (along + radius > 0.0)
    start = sight.min_depth if least < sight.min_depth else -math.inf
    sure = sight.max_depth if farthest > sight.max_depth else math.inf
    facing = along - radius > TOLERANCE * farthest
    return reached, sight.max_depth, start, sure if facing else -math.inf


@in_image.register(PaperSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    depth = ax * x + ay * y + az * z
    return (depth >= low) & (depth <= sight.max_depth + slack)


@in_view.register(PaperSight)
def _in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    return in_cone(sight.min_cosine + (TOLERANCE if sine > 0.0 else -TOLERANCE), x, y, z, sine, cosine, ax, ay, az)


@hide.register(PaperSight)
def _hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    cx = ay * bz - az * by
    cy = az * bx - ax * bz
    cz = ax * by - ay * bx
    cross = cx * cx + cy * cy + cz * cz
    one, two = cross <= sight.reach * b, cross <= sight.reach * a
    if not sight.whole_line:
        in_front = bx * ax + by * ay + bz * az > 0.0
        one = one & in_front & (a <= b * (1.0 + TOLERANCE))
        two = two & in_front & (b <= a * (1.0 + TOLERANCE))
    return one, two
