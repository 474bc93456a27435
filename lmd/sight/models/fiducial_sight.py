"""Criteria of `lmd.sight.models.fiducial`, compiled for one camera, and occlusion of one tag by another.

The functions repeat the operations of the reference in their order, so the results are equal bit for bit.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner, kernel
from lmd.core.dispatch import entry
from lmd.geometry.squares import upright_axes
from lmd.geometry.vectors import Vector, column3, cross3, dot3, in_frame, minus3, pair3, plus3, times3
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


@inner
def footprint_hides(sight: Any, half: float, a: Vector, n: Vector, b: Vector, m: Vector) -> Any:
    """True if the footprint of tag A with normal n hides the centre or a corner of tag B with normal m.

    A footprint is a tag's square with its quiet zone. `half` is half the edge length of B; `a` and `b` are the offsets
    of A and B from the camera, metres.
    """
    height, (t, u), (r, s) = -dot3(n, a), upright_axes(n, sight.level), upright_axes(m, sight.level)
    r, s = times3(half, r), times3(half, s)
    for i in range(5):
        # The centre b, then b + (r + s), b - (r + s), b + (r - s), b - (r - s).
        way, up = (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), (1.0 if i < 3 else -1.0)
        c = plus3(b, times3(way, plus3(r, times3(up, s))))
        side = dot3(n, c) + height
        if (height > 0.0 and side < -TOLERANCE) or (height < 0.0 and side > TOLERANCE):
            q = minus3(times3(height / (height - side), c), a)
            if abs(dot3(t, q)) <= sight.footprint and abs(dot3(u, q)) <= sight.footprint:
                return True
    return False


def may_hide(
    sight: Any, horizon: float, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> bool:
    """False only if no landmark can hide another from any position of the camera.

    The function returns False if all camera positions are in front of all footprints, and no corner of a tag is behind
    a footprint within the `horizon` (metres). `low` and `high` are opposite corners of a box around the camera
    positions, metres. `landmarks` and `normals` are the tags' centres, metres, and unit normals, `(B, 3, K)` each, of B
    deployments.
    """
    return sight.reach >= 0.0 and _some_behind(
        low, high, landmarks, normals, float(np.max(sight.half)), sight.level, horizon
    )


@kernel
def _some_behind(
    low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray, half: float, level: float,
    horizon: float,
) -> bool:  # fmt: skip
    count = landmarks.shape[2]
    for b in range(len(landmarks)):
        for j in range(count):
            at, n = column3(landmarks[b], j), column3(normals[b], j)
            height = min(n[0] * (low[0] - at[0]), n[0] * (high[0] - at[0]))
            height += min(n[1] * (low[1] - at[1]), n[1] * (high[1] - at[1])) + min(
                n[2] * (low[2] - at[2]), n[2] * (high[2] - at[2])
            )
            if not height >= TOLERANCE:
                return True
            for k in range(count):
                d = minus3(column3(landmarks[b], k), at)
                if dot3(d, d) > horizon * horizon:
                    continue
                t, u = upright_axes(column3(normals[b], k), level)
                if dot3(n, d) - half * (abs(dot3(n, t)) + abs(dot3(n, u))) < -0.1 * TOLERANCE:
                    return True
    return False


# Number of steps of Newton's method for the greatest depth at which the pitch may suffice.
NEWTON_STEPS = 3
# Relative safety margin of the bounds on the depth; it exceeds their rounding errors.
MARGIN = 1e-6
SIZED = ("half", "footprint", "area", "sharp", "blurred")  # fields of `FiducialSight` that depend on a tag's size


Column = float | FloatArray


class FiducialSight(NamedTuple):
    """Compiled thresholds of a tag detector's criteria for one camera; a `lmd.scene.criteria.SightModel`.

    The thresholds include tolerances for rounding. If the tags have several sizes, a field that depends on the size is
    a column `(K,)`, from which `sized` selects; other fields are computed for the largest tag.
    """

    outer_cosine: float
    """See `SightModel.outer_cosine`."""
    inset: float
    """See `SightModel.inset`."""
    reach: float
    """See `SightModel.reach`."""
    facing: float
    """Cosine of the greatest incidence angle at which a tag is detected."""
    half: Column
    """Half the edge length of the whole picture, which in some families is larger than the black square, metres."""
    footprint: Column
    """Half the edge length of the footprint (black square and quiet zone), metres."""
    level: float
    """Tolerance for vertical normals, see `lmd.geometry.squares.upright`."""
    left: float
    """Tangent of the angle between the optical axis and the left border of the image, less the margin."""
    right: float
    """Tangent of the angle between the optical axis and the right border, less the margin."""
    top: float
    """Tangent of the angle between the optical axis and the top border, less the margin."""
    bottom: float
    """Tangent of the angle between the optical axis and the bottom border, less the margin."""
    focal_u: float
    """Focal length along the image's rows, pixels."""
    focal_v: float
    """Focal length along the image's columns, pixels."""
    area: Column
    """Least |det J| at which a tag is detected, pixels^2 / metre^2; for J see `lmd.sight.models.fiducial`."""
    sharp: Column
    """Lower limit, pixels^2 / metre^2, on the smaller eigenvalue of J^T J (`lmd.sight.models.fiducial`) for the
    detection of a tag without defocus.

    With defocus, the eigenvalue at the depth w must be at least sharp + blurred (defocus - focus / w)^2.
    """
    blurred: Column
    """Coefficient of the squared defocus, 1 / metre^2, see `sharp`."""
    defocus: float
    """Blur sigma at infinite depth, pixels, see `sharp`."""
    focus: float
    """Product of `defocus` and the depth in focus, pixels metre, see `sharp`."""
    in_focus: float
    """Depth in focus, metres; 0 if it is infinite."""

    @property
    def horizon(self) -> float:
        """See `SightModel.horizon`: greatest distance at which a tag is seen or hides a tag that is seen, metres."""
        least = self.outer_cosine**3 * max(np.min(self.area), np.min(self.sharp))
        seen = math.sqrt(self.focal_u * self.focal_v / least) if least else math.inf
        return (seen + math.sqrt(max(self.reach, 0.0))) * (1.0 + NORMAL_TOLERANCE)

    @property
    def tabulated(self) -> bool:
        """See `SightModel.tabulated`."""
        return True

    def unhidden(self) -> "FiducialSight":
        """See `SightModel.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "FiducialSight":
        """See `SightModel.among`: a model without occlusion if no tag can hide another.

        Tags flush with the walls of a convex room do not hide each other.
        """
        return self if may_hide(self, self.horizon, low, high, landmarks, normals) else self.unhidden()

    def shrunk(self, size: float) -> "FiducialSight":
        """See `SightModel.shrunk`."""
        return self._replace(footprint=self.footprint * size)


def of_sizes(sights: Sequence[FiducialSight]) -> FiducialSight:
    """Join the compiled models of K tags, one for each tag's size, into one model."""
    largest = max(sights, key=lambda sight: sight.half)
    columns: dict[str, Any] = {name: np.array([getattr(sight, name) for sight in sights]) for name in SIZED}
    return largest._replace(**columns)


@sized.register(FiducialSight)
def _sized(sight: Any, k: Integer) -> Any:
    return FiducialSight(
        sight.outer_cosine, sight.inset, sight.reach, sight.facing, entry(sight.half, k), entry(sight.footprint, k),
        sight.level, sight.left, sight.right, sight.top, sight.bottom, sight.focal_u, sight.focal_v,
        entry(sight.area, k), entry(sight.sharp, k), entry(sight.blurred, k), sight.defocus, sight.focus,
        sight.in_focus,
    )  # fmt: skip


@from_position.register(FiducialSight)
def _from_position(sight: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    # Let c be the cosine of the incidence angle. The projection onto the sphere around the camera scales the tag by at
    # least c / d. The projection from the sphere onto the image plane magnifies by d / w in one direction and (d / w)^2
    # in the other. So the smaller singular value of J is between f c / w and f c d / w^2. The least admissible singular
    # value at the depth w, see `lmd.sight.models.fiducial`, bounds w.
    distance, along = np.sqrt(dot3(offset, offset)), -dot3(normal, offset)
    nearest = distance - slack
    least = nearest * sight.outer_cosine
    product = sight.focal_u * sight.focal_v * along  # |det J| w^3
    most, fewest = max(sight.focal_u, sight.focal_v) * along, min(sight.focal_u, sight.focal_v) * along
    resolved = least * least * least * max(sight.area, sight.sharp) <= product * (1.0 + TOLERANCE)
    # w^4 least(w) <= most^2; beyond the depth in focus the left side is convex, so Newton's steps stay above the root.
    high = distance
    for _ in range(NEWTON_STEPS):
        out = sight.defocus * high - sight.focus
        excess = high * high * (sight.sharp * high * high + sight.blurred * out * out) - most * most
        if excess <= 0.0:  # also where neither pitch nor blur is limited, and the slope is zero
            break
        slope = 4.0 * sight.sharp * high * high + 2.0 * sight.blurred * out * (out + sight.defocus * high)
        high = max(high - excess / (high * slope), min(sight.in_focus, high))
    high = min(high, np.sqrt(max(product, 0.0) / (sight.area * least))) * (1.0 + MARGIN)
    # w^2 least(w) <= (fewest / d)^2, a parabola in w; |det J| >= area follows from w^2 d area <= product.
    square = sight.sharp + sight.blurred * sight.defocus * sight.defocus
    middle = sight.blurred * sight.defocus * sight.focus
    right = fewest / distance
    inside = middle * middle - square * (sight.blurred * sight.focus * sight.focus - right * right)
    root = math.sqrt(max(inside, 0.0))
    near = (middle - root) / square * (1.0 + MARGIN)
    far = min((middle + root) / square, np.sqrt(max(product, 0.0) / (sight.area * distance))) * (1.0 - MARGIN)
    steady = distance * math.sin(sight.inset) >= 1.5 * sight.half  # 1.5 half edges exceed half the diagonal of the tag
    sure = far if steady & (inside > 0.0) & (near <= least) else -math.inf
    reached = (along >= sight.facing * nearest) & (along >= 0.0) & resolved & ((slack > 0.0) | (high >= least))
    return reached, least - slack, high, math.inf if sure >= distance else sure


@from_around.register(FiducialSight)
def _from_around(sight: Any, offset: Vector, normal: Vector, radius: float) -> Any:
    """See `criteria.from_around`. Only the limit on the incidence angle is used, so the bounds are loose."""
    distance, along = math.sqrt(dot3(offset, offset)), radius - dot3(normal, offset)
    nearest, farthest = max(distance - radius, 0.0), distance + radius
    reached = (along >= min(sight.facing * nearest, sight.facing * farthest)) & (along >= 0.0)
    return reached, math.inf, 0.0, -math.inf


@half_edge.register(FiducialSight)
def _half_edge(sight: Any) -> Any:
    return sight.half


@frame_of.register(FiducialSight)
def _frame_of(sight: Any, normal: Vector) -> Any:
    right, up = upright_axes(normal, sight.level)
    return normal, right, up


@inlined
def _inside(sight: Any, tag: tuple[Vector, Vector, Vector]) -> Any:
    """True if the image contains all corners of a tag.

    `tag` has the centre (u, v, w), metres, and the unit vectors right (tu, tv, tw) and up (uu, uv, uw) of the tag, in
    the camera frame.
    """
    (u, v, w), (tu, tv, tw), (uu, uv, uw) = tag
    half, left, right, top, bottom = sight.half, sight.left, sight.right, sight.top, sight.bottom
    inside = half * (abs(tw) + abs(uw)) < w
    inside &= u + half * (abs(tu - right * tw) + abs(uu - right * uw)) <= right * w
    inside &= half * (abs(tu + left * tw) + abs(uu + left * uw)) - u <= left * w
    inside &= v + half * (abs(tv - bottom * tw) + abs(uv - bottom * uw)) <= bottom * w
    return inside & (half * (abs(tv + top * tw) + abs(uv + top * uw)) - v <= top * w)


@inlined
def _clear(sight: Any, tag: tuple[Vector, Vector, Vector], along: float) -> Any:
    """True if the pitch (least image length of a module) and the image area of a tag suffice.

    `tag` has the centre, metres, and the unit vectors right and up of the tag, in the camera frame. `along` is the
    inner product of the tag's unit normal and its offset from the camera.
    """
    (u, v, w), (tu, tv, tw), (uu, uv, uw) = tag
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
def _in_image(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axis: Vector, right: Vector) -> Any:
    frame, (along, up) = (right, cross3(axis, right), axis), upright_axes(normal, sight.level)
    tag = in_frame(frame, offset), in_frame(frame, along), in_frame(frame, up)
    clear, w = _clear(sight, tag, dot3(normal, offset)), tag[0][2]
    return (_inside(sight, tag) & clear & (w >= low)) | ((slack > 0.0) & (w >= low))


@covers_one.register(FiducialSight)
def _covers_one(sight: Any, offset: Vector, frame: Any, depths: Vector, well: Any, axes: FloatArray, a: Integer) -> Any:
    (normal, along, up), (low, high, sure), (axis, right) = frame, depths, pair3(axes, a)
    w = dot3(axis, offset)
    if (w < low) | (w > high):
        return False
    if well & (w <= sure):
        return True
    down = cross3(axis, right)
    u, v = dot3(right, offset), dot3(down, offset)
    # Early exit: the centre is outside the image.
    if (u > sight.right * w) | (-u > sight.left * w) | (v > sight.bottom * w) | (-v > sight.top * w):
        return False
    tag = (u, v, w), in_frame((right, down, axis), along), in_frame((right, down, axis), up)
    if not (well & (sure > -math.inf) or _inside(sight, tag)):
        return False
    return w <= sure or _clear(sight, tag, dot3(normal, offset))


covering.register(FiducialSight)(depth_first)


@in_view.register(FiducialSight)
def _in_view(sight: Any, way: Vector, sine: float, cosine: float, axis: Vector, right: Vector) -> Any:
    u, v, w = in_frame((right, cross3(axis, right), axis), way)
    # Distances from the four planes through the camera and a border of the image.
    seen = sight.right * w - u >= sine * math.sqrt(1.0 + sight.right * sight.right)
    seen &= sight.left * w + u >= sine * math.sqrt(1.0 + sight.left * sight.left)
    seen &= sight.bottom * w - v >= sine * math.sqrt(1.0 + sight.bottom * sight.bottom)
    return seen & (sight.top * w + v >= sine * math.sqrt(1.0 + sight.top * sight.top))


@hide_between.register(FiducialSight)
def _hide(sight: Any, other: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    # Early exit: the camera is in front of both planes, and no corner is behind the other tag's plane. The height of
    # the centre above a corner is at most half the diagonal times the sine of the angle between the planes.
    c = cross3(u, v)
    sine = math.sqrt(dot3(c, c))
    below_a, below_b = 1.5 * other.half * sine - 0.5 * TOLERANCE, 1.5 * sight.half * sine - 0.5 * TOLERANCE
    above_a, above_b = -dot3(u, a), -dot3(v, b)
    b_above_a, a_above_b = dot3(u, b) + above_a, dot3(v, a) + above_b
    one, two = not (above_a > 0.0 and b_above_a >= below_a), not (above_b > 0.0 and a_above_b >= below_b)
    if one:
        one = footprint_hides(sight, other.half, a, u, b, v)
    if two:
        two = footprint_hides(other, sight.half, b, v, a, u)
    return one, two
