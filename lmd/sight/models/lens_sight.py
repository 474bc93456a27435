"""What a detector sees through a lens that distorts: `lmd.sight.models.fiducial` as scalar functions for a camera.

The criteria are those of `fiducial_sight`, with two differences: centre and corners are imaged one by one, must be in
the rectangle and no farther from the axis than the camera's widest angle, which may be beyond a right one; and J is the
slope of the lens.

Bounds come from how the lens stretches small angles (`lmd.geometry.lens.Stretch`). A tag at the distance d with the
incidence i has a pitch between `least` cos(i) / d and `most` cos(i) / d, and |det J| between `least_area` cos(i) / d^2
and `most_area` cos(i) / d^2, wherever in the image it is. A lens that is no fisheye is also compared with pinholes of
a shorter and of a longer focal length, between whose pitches and areas its own are at each depth.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.dispatch import overridable
from lmd.geometry.lens_models import BrownConrady, Equidistant, density_of, image_of
from lmd.geometry.squares import upright_axes
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

# Bounds of pitch and area are wider by this, relative: what the square of a normal may be off, and more.
MARGIN = 1e-2
# The image beyond a right angle is bounded for directions so near to those in view, rad.
NEAR = 0.1
# asin(s) <= s (1 + (pi / 2 - 1) s^2).
ARC = math.pi / 2.0 - 1.0
DIAGONAL = 1.4143  # half of a square's diagonal in halves of its edge, rounded up


class LensSight(NamedTuple):
    """The criteria as numbers, tolerance included; a `lmd.scene.criteria.Sight`."""

    flat: FiducialSight
    """What does not depend on the lens, and the borders in the distorted image."""
    lens: BrownConrady | Equidistant
    """Coefficients of the lens."""
    reach: float
    """See `Sight.reach`."""
    inset: float
    """See `Sight.inset`."""
    cosine: float
    """Cosine of the widest angle."""
    shallowest: float
    """Least `depth_of` in view at a distance of 1."""
    least: float
    """Least pitch of a metre that faces the camera at a distance of 1 m, pixels."""
    most: float
    """Greatest such pitch, pixels."""
    least_area: float
    """Least |det J| there, pixels^2."""
    most_area: float
    """Greatest |det J| there, pixels^2."""
    stretch: tuple[float, ...]
    """See `Lens.ceiling`."""
    highest: float
    """1 - cos(theta) of the angle up to which `stretch` holds."""
    rough: tuple[float, ...]
    """See `Lens.approximation`."""
    off: float
    """How far `rough` is off at most, focal lengths."""
    pinholes: tuple[FiducialSight, FiducialSight] | tuple[()]
    """Pinholes that resolve no more than the lens, and no less; none for a fisheye."""

    @property
    def outer_cosine(self) -> float:
        """See `Sight.outer_cosine`: negative where the lens sees what is behind it."""
        return self.cosine - TOLERANCE

    @property
    def horizon(self) -> float:
        """See `Sight.horizon`: a pitch is no greater than the root of |det J|."""
        needed = max(np.min(self.flat.area), np.min(self.flat.sharp))
        seen = math.sqrt(self.most_area / needed) if needed else math.inf
        return (seen + math.sqrt(max(self.reach, 0.0))) * (1.0 + MARGIN)

    @property
    def tabulated(self) -> bool:
        """See `Sight.tabulated`."""
        return True

    def unhidden(self) -> "LensSight":
        """See `Sight.unhidden`."""
        return self._of(self.flat.unhidden())

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "LensSight":
        """See `Sight.among`."""
        return self if may_hide(self.flat, self.horizon, low, high, landmarks, normals) else self.unhidden()

    def shrunk(self, size: float) -> "LensSight":
        """See `Sight.shrunk`."""
        return self._of(self.flat.shrunk(size))

    def _of(self, flat: FiducialSight) -> "LensSight":
        return self._replace(flat=flat, reach=flat.reach)


def of_sizes_behind_lens(sights: Sequence[LensSight]) -> LensSight:
    """The sight of K tags, given that of each by itself."""
    largest = max(sights, key=lambda sight: sight.flat.half)
    pinholes: Any = tuple(of_sizes(each) for each in zip(*(sight.pinholes for sight in sights), strict=True))
    return largest._replace(flat=of_sizes([sight.flat for sight in sights]), pinholes=pinholes)


@sized.register(LensSight)
def _sized(sight, k):  # type: ignore[no-untyped-def]
    return LensSight(
        sized(sight.flat, k), sight.lens, sight.reach, sight.inset, sight.cosine, sight.shallowest, sight.least,
        sight.most, sight.least_area, sight.most_area, sight.stretch, sight.highest, sight.rough, sight.off,
        _sized_pinholes(sight.lens, sight.pinholes, k),
    )  # fmt: skip


@overridable
def _sized_pinholes(lens, pinholes, k):  # type: ignore[no-untyped-def]
    return sized(pinholes[0], k), sized(pinholes[1], k)


@_sized_pinholes.register(Equidistant)
def _no_pinholes(lens, pinholes, k):  # type: ignore[no-untyped-def]
    return pinholes


@from_around.register(LensSight)
def _from_around(sight, x, y, z, nx, ny, nz, radius):  # type: ignore[no-untyped-def]
    return from_around(sight.flat, x, y, z, nx, ny, nz, radius)


@half_edge.register(LensSight)
def _half_edge(sight):  # type: ignore[no-untyped-def]
    return sight.flat.half


@from_position.register(LensSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    flat = sight.flat
    distance = np.sqrt(x * x + y * y + z * z)
    nearest = distance - slack
    along = -(nx * x + ny * y + nz * z)
    # The blur at the least and at the greatest depth.
    per = 1.0 / distance
    near, far = flat.defocus - flat.focus * per / sight.shallowest, flat.defocus - flat.focus * per
    sharpest, softest = max(0.0, near, -far), max(abs(near), abs(far))
    sharpest = 0.0 if slack > 0.0 else sharpest
    fewest, needed = flat.sharp + flat.blurred * sharpest * sharpest, flat.sharp + flat.blurred * softest * softest
    pitch, area = sight.most * along, sight.most_area * along
    squared, cubed = nearest * nearest, nearest * nearest * nearest
    resolved = cubed * max(flat.area, fewest) <= area * (1.0 + MARGIN)
    resolved &= (fewest * squared * squared <= pitch * pitch * (1.0 + MARGIN)) | (nearest <= 0.0)
    pitch, area = sight.least * along, sight.least_area * along
    squared, cubed = distance * distance, distance * distance * distance
    surely = (needed * squared * squared <= pitch * pitch * (1.0 - MARGIN)) & (
        flat.area * cubed <= area * (1.0 - MARGIN)
    )
    reached = (along >= flat.facing * nearest) & (along >= 0.0) & resolved
    outer = sight.cosine - TOLERANCE
    low = min(outer * nearest, outer * (distance + slack)) - slack
    # Far enough away, its corners are in the image wherever its direction is well in view; that no depth is sure is
    # said by one that none has.
    steady = distance * math.sin(sight.inset) >= 1.5 * flat.half
    among, high, sure = _by_depth(sight.lens, sight.pinholes, x, y, z, nx, ny, nz, slack)
    sure = math.inf if surely else max(sure, low - distance)
    return reached & among, low, min(high, distance * (1.0 + MARGIN)), sure if steady else -math.inf


@overridable
def _by_depth(lens, pinholes, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    """Whether it is reached, the greatest depth and the `sure` one, see `from_position`, as the pinholes say."""
    _, _, _, sure = from_position(pinholes[0], x, y, z, nx, ny, nz, slack)
    reached, _, high, _ = from_position(pinholes[1], x, y, z, nx, ny, nz, slack)
    return reached, high, sure


@_by_depth.register(Equidistant)
def _by_distance(lens, pinholes, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    return True, math.inf, -math.inf


@frame_of.register(LensSight)
def _frame_of(sight, nx, ny, nz):  # type: ignore[no-untyped-def]
    return nx, ny, nz, *upright_axes(nx, ny, nz, sight.flat.level)


@in_view.register(LensSight)
def _in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    flat, least = sight.flat, sight.cosine + (TOLERANCE if sine > 0.0 else -TOLERANCE)
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    across, down = image_of(sight.lens, u, v, w)
    # The stretch halfway bounds the nearer half of the way, that at its end the farther one.
    angle, end = sine * (1.0 + ARC * sine * sine), 1.0 - w * cosine + math.sqrt(max(0.0, 1.0 - w * w)) * abs(sine)
    end = sight.highest if w <= -cosine else end  # the way leads past the opposite of the axis
    halfway = min(end, 1.0 - w + abs(angle) / 2.0)
    room = angle * (stretch_at(sight, halfway) + stretch_at(sight, end)) / 2.0
    inside = (flat.right - across >= room) & (flat.left + across >= room)
    inside &= (flat.bottom - down >= room) & (flat.top + down >= room)
    # Nothing is known of images beyond the widest angle.
    unknown = (sine < 0.0) & ((w < sight.cosine) | ((sight.cosine < 0.0) & (sine < -NEAR)))
    return in_cone(least, x, y, z, sine, cosine, ax, ay, az) & (inside | unknown)


@in_image.register(LensSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    tx, ty, tz, ux, uy, uz = upright_axes(nx, ny, nz, sight.flat.level)
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    # The centre, and the tag's right and up, in the camera's frame.
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    covered = in_rectangle(sight, u, v, w) & resolves(sight, u, v, w, tu, tv, tw, uu, uv, uw)
    covered &= corners_inside(sight, u, v, w, tu, tv, tw, uu, uv, uw)
    return (covered | (slack > 0.0)) & (w >= low)


@covers_one.register(LensSight)
def _covers_one(sight, x, y, z, frame, low, high, sure, well, axes, a):  # type: ignore[no-untyped-def]
    _, _, _, tx, ty, tz, ux, uy, uz = frame
    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
    w = ax * x + ay * y + az * z
    if (w < low) | (w > high):
        return False
    if well & (w <= sure):
        return True
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    u, v = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z
    inside = well & (sure > -math.inf)
    if not inside:
        # What depends on the landmark alone, the compiler moves out of the loop over axes.
        per = 1.0 / np.sqrt(x * x + y * y + z * z)
        height, room = 1.0 - w * per, room_within(sight, u, v, w, per)
        if room < -sight.off:
            return False
        if (room <= sight.off or w * per <= sight.cosine + TOLERANCE) and not in_rectangle(sight, u, v, w):
            return False
        # The angle between the centre and a corner at most, and how far that is in the image.
        sine = DIAGONAL * sight.flat.half * per
        angle = sine * (1.0 + ARC * sine * sine)
        inside = (sine <= 1.0) & (w * per >= sight.cosine + angle)
        inside &= room >= angle * stretch_at(sight, height + angle) + sight.off
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    if w > sure and not resolves(sight, u, v, w, tu, tv, tw, uu, uv, uw):
        return False
    return inside or corners_inside(sight, u, v, w, tu, tv, tw, uu, uv, uw)


covering.register(LensSight)(depth_first)


@hide_between.register(LensSight)
def _hide(sight, other, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    return hide_between(sight.flat, other.flat, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz)


@pixel_density.register(LensSight)
def _pixel_density(sight, x, y, z, axes, a):  # type: ignore[no-untyped-def]
    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    return density_of(sight.lens, u, v, w)
