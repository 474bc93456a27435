"""What a detector sees through a lens that distorts: `lmd.sight.models.fiducial` as scalar functions for a camera.

The criteria are those of `fiducial_sight`, with two differences: each corner is imaged by itself, and must be within
the rectangle and no farther from the axis than the widest ray; and J has the Jacobian of the distortion between the
focal lengths and the rest. In view is the cone of the widest ray, and every axis that may cover a landmark is tested.
"""

import math
from typing import NamedTuple

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.geometry import distortion
from lmd.geometry.squares import upright_axes
from lmd.scene.criteria import covering, depth_first, from_position, hide, in_cone, in_image, in_view
from lmd.sight.models.fiducial_sight import FiducialSight, may_hide
from lmd.sight.obstacles import half_edge

_bent = inlined(distortion.bent)
_slopes = inlined(distortion.slopes)


class DistortedSight(NamedTuple):
    """The criteria as numbers, tolerance included; a `lmd.scene.criteria.Sight`.

    flat: all but the distortion, the borders in the distorted image; bound: the same with focal lengths that are longer
    by as much as the distortion stretches anything at most, so that every tag has at least as many pixels; reach: that
    of `flat`; k1, k2, p1, p2, k3: see `lmd.geometry.distortion`; widest: square of the distance from the axis, at depth
    1, of the farthest ray that may be in the image.
    """

    flat: FiducialSight
    bound: FiducialSight
    reach: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    widest: float

    @property
    def outer_cosine(self) -> float:
        """See `Sight.outer_cosine`."""
        return self.flat.outer_cosine

    @property
    def inset(self) -> float:
        """See `Sight.inset`: no depth is sure."""
        return 0.0

    @property
    def horizon(self) -> float:
        """See `Sight.horizon`."""
        return self.bound._replace(reach=self.reach).horizon

    @property
    def tabulated(self) -> bool:
        """See `Sight.tabulated`."""
        return True

    def unhidden(self) -> "DistortedSight":
        """See `Sight.unhidden`."""
        return self._of(self.flat.unhidden())

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "DistortedSight":
        """See `Sight.among`."""
        return self if may_hide(self.flat, self.horizon, low, high, landmarks, normals) else self.unhidden()

    def shrunk(self, size: float) -> "DistortedSight":
        """See `Sight.shrunk`."""
        return self._of(self.flat.shrunk(size))

    def _of(self, flat: FiducialSight) -> "DistortedSight":
        return self._replace(flat=flat, reach=flat.reach)


@half_edge.register(DistortedSight)
def _half_edge(sight):  # type: ignore[no-untyped-def]
    return sight.flat.half


@from_position.register(DistortedSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    reached, low, high, _ = from_position(sight.bound, x, y, z, nx, ny, nz, slack)
    return reached, low, high, -math.inf  # no depth is sure


@in_view.register(DistortedSight)
def _in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    return in_cone(sight.bound.outer_cosine, x, y, z, sine, cosine, ax, ay, az)


covering.register(DistortedSight)(depth_first)


@inlined
def _in_rectangle(sight, u, v, w):  # type: ignore[no-untyped-def]
    """Whether a point (u, v, w) in the camera's frame is in the image."""
    flat, x, y = sight.flat, u / w, v / w
    across, down = _bent(x, y, sight.k1, sight.k2, sight.p1, sight.p2, sight.k3)
    inside = (w > 0.0) & (x * x + y * y <= sight.widest)
    return inside & (-flat.left <= across) & (across <= flat.right) & (-flat.top <= down) & (down <= flat.bottom)


@in_image.register(DistortedSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    flat = sight.flat
    tx, ty, tz, ux, uy, uz = upright_axes(nx, ny, nz, flat.level)
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    # The centre, and the tag's right and up, in the camera's frame.
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    half = flat.half
    pu, pv, pw = half * (tu + uu), half * (tv + uv), half * (tw + uw)  # to one corner, and to its neighbour
    qu, qv, qw = half * (tu - uu), half * (tv - uv), half * (tw - uw)
    inside = _in_rectangle(sight, u + pu, v + pv, w + pw) & _in_rectangle(sight, u - pu, v - pv, w - pw)
    inside &= _in_rectangle(sight, u + qu, v + qv, w + qw) & _in_rectangle(sight, u - qu, v - qv, w - qw)
    per = 1.0 / w
    fu, fv, at_u, at_v = flat.focal_u * per, flat.focal_v * per, u * per, v * per
    one, two, three, four = tu - at_u * tw, uu - at_u * uw, tv - at_v * tw, uv - at_v * uw
    xx, xy, yy = _slopes(at_u, at_v, sight.k1, sight.k2, sight.p1, sight.p2, sight.k3)
    one, two, three, four = xx * one + xy * three, xx * two + xy * four, xy * one + yy * three, xy * two + yy * four
    square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
    determinant = fu * fv * per * abs(nx * x + ny * y + nz * z) * abs(xx * yy - xy * xy)
    blur = flat.defocus - flat.focus * per
    least = flat.sharp + flat.blurred * (blur * blur)
    clear = (2.0 * least <= square) & (determinant >= flat.area)
    clear &= least * least + determinant * determinant >= square * least
    covered = inside & clear & (w >= low)
    return covered | ((slack > 0.0) & (w >= low))


@hide.register(DistortedSight)
def _hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    return hide(sight.flat, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz)
