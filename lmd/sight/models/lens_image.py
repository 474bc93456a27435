"""Projection of a tag through a lens with distortion for one orientation; used by `lmd.sight.models.lens_sight`.

Points (u, v, w) are in the camera frame, metres. Image lengths are in focal lengths.
"""

import math
from typing import Any

import numpy as np

from lmd.core.compiled import inlined
from lmd.geometry.lens_models import depth_of, image_of, slope_of
from lmd.geometry.vectors import Vector, dot3, minus3, plus3, times3
from lmd.scene.criteria import TOLERANCE


@inlined
def _polynomial(coefficients: Any, h: float) -> Any:
    """Value at h of the polynomial of degree 5 whose `coefficients` belong to h^0, h^1, ..., h^5."""
    a, b, c, d, e, f = coefficients
    s = h * h
    return a + b * h + s * (c + d * h + s * (e + f * h))


@inlined
def stretch_at(sight: Any, height: float) -> Any:
    """Upper bound on the local scale of the lens near the optical axis, in focal lengths per radian.

    The local scale is the distance by which an image point moves, divided by the angle by which its direction turns.
    The bound holds up to the angle theta from the axis with 1 - cos(theta) = `height`.
    """
    return _polynomial(sight.stretch, min(height, sight.stretch_end))


@inlined
def room_within(sight: Any, point: Vector, per: float) -> Any:
    """Approximate distance of the image of a point from the nearest border of the image, in focal lengths.

    The distance is negative outside the image, and its error is at most `image_error`. `point` is in the camera frame,
    and 1 / `per` is its distance from the camera.
    """
    flat, scale = sight.flat, per * _polynomial(sight.approximation, 1.0 - point[2] * per)
    across, down = scale * point[0], scale * point[1]
    return min(flat.right - across, flat.left + across, flat.bottom - down, flat.top + down)


@inlined
def in_rectangle(sight: Any, point: Vector) -> Any:
    """True if the image contains a point of the camera frame; the point is projected exactly."""
    flat, (across, down) = sight.flat, image_of(sight.lens, point[0], point[1], point[2])
    inside = point[2] >= sight.cosine * math.sqrt(dot3(point, point))
    return inside & (-flat.left <= across) & (across <= flat.right) & (-flat.top <= down) & (down <= flat.bottom)


@inlined
def is_inside(sight: Any, point: Vector) -> Any:
    """True if the image contains a point of the camera frame. The point is projected exactly (`in_rectangle`) only if
    the approximate projection does not decide.
    """
    per = 1.0 / np.sqrt(dot3(point, point))
    room = room_within(sight, point, per)
    if (point[2] * per > sight.cosine + TOLERANCE) & (abs(room) > sight.image_error):
        return room > 0.0
    return in_rectangle(sight, point)


@inlined
def corners_inside(sight: Any, tag: tuple[Vector, Vector, Vector]) -> Any:
    """True if the image contains all corners of a tag.

    `tag` has the centre, metres, and the unit vectors right and up of the tag, in the camera frame.
    """
    (centre, right, up), half = tag, sight.flat.half
    p, q = times3(half, plus3(right, up)), times3(half, minus3(right, up))  # offsets of a corner and of its neighbour
    inside = is_inside(sight, plus3(centre, p)) and is_inside(sight, minus3(centre, p))
    return inside and is_inside(sight, plus3(centre, q)) and is_inside(sight, minus3(centre, q))


@inlined
def resolves(sight: Any, tag: tuple[Vector, Vector, Vector]) -> Any:
    """True if the pitch (least image length of a module) and the image area of a tag suffice.

    `tag` has the centre, metres, and the unit vectors right and up of the tag, in the camera frame.
    """
    flat, ((u, v, w), right, up) = sight.flat, tag
    xu, xv, xw, yu, yv, yw = slope_of(sight.lens, u, v, w)
    x, y, fu, fv = (xu, xv, xw), (yu, yv, yw), flat.focal_u, flat.focal_v
    one, two, three, four = dot3(x, right), dot3(x, up), dot3(y, right), dot3(y, up)
    square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
    determinant = fu * fv * abs(one * four - two * three)
    blur = flat.defocus - flat.focus * (1.0 / depth_of(sight.lens, u, v, w))
    least = flat.sharp + flat.blurred * (blur * blur)
    clear = (2.0 * least <= square) & (determinant >= flat.area)
    return clear & (least * least + determinant * determinant >= square * least)
