"""Projection of a tag through a lens with distortion for one orientation; used by `lmd.sight.models.lens_sight`.

Points (u, v, w) are in the camera frame, metres. Image lengths are in focal lengths.
"""

import math
from typing import Any

import numpy as np

from lmd.core.compiled import inlined
from lmd.geometry.lens_models import depth_of, image_of, slope_of
from lmd.scene.criteria import TOLERANCE


@inlined
def _polynomial(coefficients: Any, h: float) -> Any:
    """Value at h of a polynomial of degree 5 with the `coefficients` of h^0 to h^5."""
    a, b, c, d, e, f = coefficients
    s = h * h
    return a + b * h + s * (c + d * h + s * (e + f * h))


@inlined
def stretch_at(sight: Any, height: float) -> Any:
    """Upper bound on the image motion per rotation of the direction, for 1 - cos(theta) <= `height`.

    The bound is in focal lengths per radian.
    """
    return _polynomial(sight.stretch, min(height, sight.stretch_end))


@inlined
def room_within(sight: Any, u: float, v: float, w: float, per: float) -> Any:
    """Approximate distance of the image of a point from the nearest border, in focal lengths; negative outside.

    The error is at most `image_error`; 1 / `per` is the distance of the point.
    """
    flat, scale = sight.flat, per * _polynomial(sight.approximation, 1.0 - w * per)
    across, down = scale * u, scale * v
    return min(flat.right - across, flat.left + across, flat.bottom - down, flat.top + down)


@inlined
def in_rectangle(sight: Any, u: float, v: float, w: float) -> Any:
    """True if the image contains the point (u, v, w); exact."""
    flat = sight.flat
    across, down = image_of(sight.lens, u, v, w)
    inside = w >= sight.cosine * math.sqrt(u * u + v * v + w * w)
    return inside & (-flat.left <= across) & (across <= flat.right) & (-flat.top <= down) & (down <= flat.bottom)


@inlined
def is_inside(sight: Any, u: float, v: float, w: float) -> Any:
    """Result of `in_rectangle`; the exact test is made only if the approximate projection does not decide."""
    per = 1.0 / np.sqrt(u * u + v * v + w * w)
    room = room_within(sight, u, v, w, per)
    if (w * per > sight.cosine + TOLERANCE) & (abs(room) > sight.image_error):
        return room > 0.0
    return in_rectangle(sight, u, v, w)


@inlined
def corners_inside(
    sight: Any, u: float, v: float, w: float, tu: float, tv: float, tw: float, uu: float, uv: float, uw: float
) -> Any:
    """True if the image contains all corners of the tag with centre (u, v, w), right (tu, tv, tw), up (uu, uv, uw)."""
    half = sight.flat.half
    pu, pv, pw = half * (tu + uu), half * (tv + uv), half * (tw + uw)  # offsets of a corner and of its neighbour
    qu, qv, qw = half * (tu - uu), half * (tv - uv), half * (tw - uw)
    inside = is_inside(sight, u + pu, v + pv, w + pw) and is_inside(sight, u - pu, v - pv, w - pw)
    return inside and is_inside(sight, u + qu, v + qv, w + qw) and is_inside(sight, u - qu, v - qv, w - qw)


@inlined
def resolves(
    sight: Any, u: float, v: float, w: float, tu: float, tv: float, tw: float, uu: float, uv: float, uw: float
) -> Any:
    """True if pitch and area of the tag suffice; arguments as in `corners_inside`."""
    flat = sight.flat
    xu, xv, xw, yu, yv, yw = slope_of(sight.lens, u, v, w)
    one, two = xu * tu + xv * tv + xw * tw, xu * uu + xv * uv + xw * uw
    three, four = yu * tu + yv * tv + yw * tw, yu * uu + yv * uv + yw * uw
    fu, fv = flat.focal_u, flat.focal_v
    square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
    determinant = fu * fv * abs(one * four - two * three)
    blur = flat.defocus - flat.focus * (1.0 / depth_of(sight.lens, u, v, w))
    least = flat.sharp + flat.blurred * (blur * blur)
    clear = (2.0 * least <= square) & (determinant >= flat.area)
    return clear & (least * least + determinant * determinant >= square * least)
