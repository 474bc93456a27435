"""What a detector sees of fiducial tags as scalar functions: `lmd.sight.models.fiducial` compiled for a camera.

The same operations in the same order as the reference there, hence the same bits.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.core.dispatch import entry
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
    in_image,
    in_view,
    sized,
)
from lmd.scene.deployment import NORMAL_TOLERANCE
from lmd.sight.obstacles import half_edge

# Of Newton's method, from the distance down to the greatest depth at which the pitch may suffice.
NEWTON_STEPS = 3
# Bounds of depths are wider by this, far more than they are rounded.
MARGIN = 1e-6
SIZED = ("half", "footprint", "area", "sharp", "blurred")  # fields of `FiducialSight` that depend on a tag's size


Column = float | FloatArray


class FiducialSight(NamedTuple):
    """The criteria as numbers, tolerance included; a `lmd.scene.criteria.Sight`.

    What depends on a tag's size is a number where all tags have one, else a column `(K,)`: `sized` has that of one tag.
    Other numbers are those of the largest tags, which hold for all.
    """

    outer_cosine: float
    """See `Sight.outer_cosine`."""
    inset: float
    """See `Sight.inset`."""
    reach: float
    """See `Sight.reach`."""
    facing: float
    """Cosine of the greatest incidence."""
    half: Column
    """Half the edge of the black square, metres."""
    footprint: Column
    """Half the edge of the paper, metres."""
    level: float
    """See `lmd.geometry.squares.upright`."""
    left: float
    """Tangent of the angle to the left border, less the margin."""
    right: float
    """The same to the right."""
    top: float
    """The same to the top."""
    bottom: float
    """The same to the bottom."""
    focal_u: float
    """Focal length along the image's rows, pixels."""
    focal_v: float
    """Focal length along its columns, pixels."""
    area: Column
    """Least |det J|, pixels^2 / metre^2."""
    sharp: Column
    """Of the least eigenvalue of J^T J that is asked for, sharp + blurred (defocus - focus / depth)^2, in pixels^2 /
    metre^2."""
    blurred: Column
    """See `sharp`."""
    defocus: float
    """See `sharp`."""
    focus: float
    """See `sharp`, metres."""
    in_focus: float
    """The depth at which nothing is blurred, metres; 0 if that is infinite."""

    @property
    def horizon(self) -> float:
        """See `Sight.horizon`: where a tag in the corner of the image that faces the camera is `resolved`."""
        least = self.outer_cosine**3 * max(np.min(self.area), np.min(self.sharp))
        seen = math.sqrt(self.focal_u * self.focal_v / least) if least else math.inf
        return (seen + math.sqrt(max(self.reach, 0.0))) * (1.0 + NORMAL_TOLERANCE)

    @property
    def tabulated(self) -> bool:
        """See `Sight.tabulated`."""
        return True

    def unhidden(self) -> "FiducialSight":
        """See `Sight.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "FiducialSight":
        """See `Sight.among`: flush footprints of a convex room never hide each other."""
        return self if may_hide(self, self.horizon, low, high, landmarks, normals) else self.unhidden()

    def shrunk(self, size: float) -> "FiducialSight":
        """See `Sight.shrunk`."""
        return self._replace(footprint=self.footprint * size)


def of_sizes(sights: Sequence[FiducialSight]) -> FiducialSight:
    """The sight of K tags, given that of each by itself."""
    largest = max(sights, key=lambda sight: sight.half)
    columns: dict[str, Any] = {name: np.array([getattr(sight, name) for sight in sights]) for name in SIZED}
    return largest._replace(**columns)


@sized.register(FiducialSight)
def _sized(sight, k):  # type: ignore[no-untyped-def]
    return FiducialSight(
        sight.outer_cosine, sight.inset, sight.reach, sight.facing, entry(sight.half, k), entry(sight.footprint, k),
        sight.level, sight.left, sight.right, sight.top, sight.bottom, sight.focal_u, sight.focal_v,
        entry(sight.area, k), entry(sight.sharp, k), entry(sight.blurred, k), sight.defocus, sight.focus,
        sight.in_focus,
    )  # fmt: skip


@from_position.register(FiducialSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    # Project the tag onto the sphere around the camera, where its pitch is c / d with the cosine c of the incidence,
    # then from there onto the image plane, which stretches by d / w one way and (d / w)^2 the other. So the smaller
    # singular value of J is between f c / w and f c d / w^2, and least(w) as in `lmd.sight.models.fiducial` bounds w.
    distance = np.sqrt(x * x + y * y + z * z)
    nearest = distance - slack
    along = -(nx * x + ny * y + nz * z)
    least = nearest * sight.outer_cosine
    product = sight.focal_u * sight.focal_v * along  # |det J| w^3
    most, fewest = max(sight.focal_u, sight.focal_v) * along, min(sight.focal_u, sight.focal_v) * along
    resolved = least * least * least * max(sight.area, sight.sharp) <= product * (1.0 + TOLERANCE)
    # w^4 least(w) <= most^2: beyond the depth in focus the left side is convex, and Newton's steps stay above the root.
    high = distance
    for _ in range(NEWTON_STEPS):
        out = sight.defocus * high - sight.focus
        excess = high * high * (sight.sharp * high * high + sight.blurred * out * out) - most * most
        slope = 4.0 * sight.sharp * high * high + 2.0 * sight.blurred * out * (out + sight.defocus * high)
        high = max(high - max(excess, 0.0) / (high * slope), min(sight.in_focus, high))
    high = min(high, np.sqrt(max(product, 0.0) / (sight.area * least))) * (1.0 + MARGIN)
    # w^2 least(w) <= (fewest / d)^2, a parabola in w; |det J| >= area follows from w^2 d area <= product.
    square = sight.sharp + sight.blurred * sight.defocus * sight.defocus
    middle = sight.blurred * sight.defocus * sight.focus
    right = fewest / distance
    inside = middle * middle - square * (sight.blurred * sight.focus * sight.focus - right * right)
    root = math.sqrt(max(inside, 0.0))
    near = (middle - root) / square * (1.0 + MARGIN)
    far = min((middle + root) / square, np.sqrt(max(product, 0.0) / (sight.area * distance))) * (1.0 - MARGIN)
    steady = distance * math.sin(sight.inset) >= 1.5 * sight.half  # more than half the diagonal
    sure = far if steady & (inside > 0.0) & (near <= least) else -math.inf
    reached = (along >= sight.facing * nearest) & (along >= 0.0) & resolved & ((slack > 0.0) | (high >= least))
    return reached, least - slack, high, math.inf if sure >= distance else sure


@from_around.register(FiducialSight)
def _from_around(sight, x, y, z, nx, ny, nz, radius):  # type: ignore[no-untyped-def]
    """A tag that no camera faces is not reached."""
    distance, along = math.sqrt(x * x + y * y + z * z), radius - (nx * x + ny * y + nz * z)
    nearest, farthest = max(distance - radius, 0.0), distance + radius
    reached = (along >= min(sight.facing * nearest, sight.facing * farthest)) & (along >= 0.0)
    return reached, math.inf, 0.0, -math.inf


@half_edge.register(FiducialSight)
def _half_edge(sight):  # type: ignore[no-untyped-def]
    return sight.half


@frame_of.register(FiducialSight)
def _frame_of(sight, nx, ny, nz):  # type: ignore[no-untyped-def]
    return nx, ny, nz, *upright_axes(nx, ny, nz, sight.level)


@inlined
def _inside(sight, u, v, w, tu, tv, tw, uu, uv, uw):  # type: ignore[no-untyped-def]
    """Whether the corners are in the image: centre, right and up of the tag in the camera's frame."""
    half, left, right, top, bottom = sight.half, sight.left, sight.right, sight.top, sight.bottom
    inside = half * (abs(tw) + abs(uw)) < w
    inside &= u + half * (abs(tu - right * tw) + abs(uu - right * uw)) <= right * w
    inside &= half * (abs(tu + left * tw) + abs(uu + left * uw)) - u <= left * w
    inside &= v + half * (abs(tv - bottom * tw) + abs(uv - bottom * uw)) <= bottom * w
    return inside & (half * (abs(tv + top * tw) + abs(uv + top * uw)) - v <= top * w)


@inlined
def _clear(sight, u, v, w, tu, tv, tw, uu, uv, uw, along):  # type: ignore[no-untyped-def]
    """Whether pitch and area suffice; `along` is n . d."""
    per = 1.0 / w
    fu, fv, at_u, at_v = sight.focal_u * per, sight.focal_v * per, u * per, v * per
    one, two, three, four = tu - at_u * tw, uu - at_u * uw, tv - at_v * tw, uv - at_v * uw
    square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
    determinant = fu * fv * per * abs(along)
    blur = sight.defocus - sight.focus * per
    least = sight.sharp + sight.blurred * (blur * blur)
    clear = (2.0 * least <= square) & (determinant >= sight.area)
    return clear & (least * least + determinant * determinant >= square * least)


@in_image.register(FiducialSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    tx, ty, tz, ux, uy, uz = upright_axes(nx, ny, nz, sight.level)
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    # The centre, and the tag's right and up, in the camera's frame.
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    clear = _clear(sight, u, v, w, tu, tv, tw, uu, uv, uw, nx * x + ny * y + nz * z)
    return (_inside(sight, u, v, w, tu, tv, tw, uu, uv, uw) & clear & (w >= low)) | ((slack > 0.0) & (w >= low))


@covers_one.register(FiducialSight)
def _covers_one(sight, x, y, z, frame, low, high, sure, well, axes, a):  # type: ignore[no-untyped-def]
    nx, ny, nz, tx, ty, tz, ux, uy, uz = frame
    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
    w = ax * x + ay * y + az * z
    if (w < low) | (w > high):
        return False
    if well & (w <= sure):
        return True
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    u, v = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z
    # The centre must be in the image, too.
    if (u > sight.right * w) | (-u > sight.left * w) | (v > sight.bottom * w) | (-v > sight.top * w):
        return False
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    if not (well & (sure > -math.inf) or _inside(sight, u, v, w, tu, tv, tw, uu, uv, uw)):
        return False
    return w <= sure or _clear(sight, u, v, w, tu, tv, tw, uu, uv, uw, nx * x + ny * y + nz * z)


covering.register(FiducialSight)(depth_first)


@in_view.register(FiducialSight)
def _in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    left, right, top, bottom = sight.left, sight.right, sight.top, sight.bottom
    # How far it is from the four planes through the camera and a border of the image.
    seen = right * w - u >= sine * math.sqrt(1.0 + right * right)
    seen &= left * w + u >= sine * math.sqrt(1.0 + left * left)
    seen &= bottom * w - v >= sine * math.sqrt(1.0 + bottom * bottom)
    return seen & (top * w + v >= sine * math.sqrt(1.0 + top * top))


@inner
def _hides(sight, half, ax, ay, az, nx, ny, nz, bx, by, bz, mx, my, mz):  # type: ignore[no-untyped-def]
    """Whether footprint A with normal n hides the centre or a corner of B with normal m and `half` an edge."""
    height = -(nx * ax + ny * ay + nz * az)
    tx, ty, tz, ux, uy, uz = upright_axes(nx, ny, nz, sight.level)
    rx, ry, rz, sx, sy, sz = upright_axes(mx, my, mz, sight.level)
    rx, ry, rz = half * rx, half * ry, half * rz
    sx, sy, sz = half * sx, half * sy, half * sz
    for i in range(5):
        # The centre, then r + s, -(r + s), r - s and -(r - s) from it.
        way, up = (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), (1.0 if i < 3 else -1.0)
        cx, cy, cz = bx + way * (rx + up * sx), by + way * (ry + up * sy), bz + way * (rz + up * sz)
        side = nx * cx + ny * cy + nz * cz + height
        if (height > 0.0 and side < -TOLERANCE) or (height < 0.0 and side > TOLERANCE):
            share = height / (height - side)
            qx, qy, qz = share * cx - ax, share * cy - ay, share * cz - az
            along, across = abs(tx * qx + ty * qy + tz * qz), abs(ux * qx + uy * qy + uz * qz)
            if along <= sight.footprint and across <= sight.footprint:
                return True
    return False


@hide_between.register(FiducialSight)
def _hide(sight, other, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    # Mostly the camera is in front of both planes, and no corner behind the other's: half the diagonal times the sine
    # of the angle between the planes is how far a corner may be below the centre.
    cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    below_a, below_b = 1.5 * other.half * sine - 0.5 * TOLERANCE, 1.5 * sight.half * sine - 0.5 * TOLERANCE
    above_a, above_b = -(ux * ax + uy * ay + uz * az), -(vx * bx + vy * by + vz * bz)
    b_above_a, a_above_b = ux * bx + uy * by + uz * bz + above_a, vx * ax + vy * ay + vz * az + above_b
    one, two = not (above_a > 0.0 and b_above_a >= below_a), not (above_b > 0.0 and a_above_b >= below_b)
    if one:
        one = _hides(sight, other.half, ax, ay, az, ux, uy, uz, bx, by, bz, vx, vy, vz)
    if two:
        two = _hides(other, sight.half, bx, by, bz, vx, vy, vz, ax, ay, az, ux, uy, uz)
    return one, two


def may_hide(
    sight: FiducialSight, horizon: float, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> bool:
    """False only if all cameras are in front of all footprints, and no corner is behind one within the `horizon`.

    The other arguments are those of `Sight.among`.
    """
    return sight.reach >= 0.0 and _some_behind(
        low, high, landmarks, normals, float(np.max(sight.half)), sight.level, horizon
    )


@kernel
def _some_behind(low, high, landmarks, normals, half, level, horizon):  # type: ignore[no-untyped-def]
    count = landmarks.shape[2]
    for b in range(len(landmarks)):
        for j in range(count):
            x, y, z = landmarks[b, 0, j], landmarks[b, 1, j], landmarks[b, 2, j]
            nx, ny, nz = normals[b, 0, j], normals[b, 1, j], normals[b, 2, j]
            height = min(nx * (low[0] - x), nx * (high[0] - x))
            height += min(ny * (low[1] - y), ny * (high[1] - y)) + min(nz * (low[2] - z), nz * (high[2] - z))
            if not height >= TOLERANCE:
                return True
            for k in range(count):
                dx, dy, dz = landmarks[b, 0, k] - x, landmarks[b, 1, k] - y, landmarks[b, 2, k] - z
                if dx * dx + dy * dy + dz * dz > horizon * horizon:
                    continue
                tx, ty, tz, ux, uy, uz = upright_axes(normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], level)
                side = nx * dx + ny * dy + nz * dz
                side -= half * (abs(nx * tx + ny * ty + nz * tz) + abs(nx * ux + ny * uy + nz * uz))
                if side < -0.1 * TOLERANCE:
                    return True
    return False
