"""Where a lens that distorts images a tag, and how well: what `lmd.sight.models.lens_sight` asks of one orientation."""

import math

import numpy as np

from lmd.core.compiled import inlined
from lmd.geometry.lens_models import depth_of, image_of, slope_of
from lmd.scene.criteria import TOLERANCE


@inlined
def _polynomial(coefficients, h):  # type: ignore[no-untyped-def]
    """The value at h of a polynomial of the fifth degree."""
    a, b, c, d, e, f = coefficients
    s = h * h
    return a + b * h + s * (c + d * h + s * (e + f * h))


@inlined
def stretch_at(sight, height):  # type: ignore[no-untyped-def]
    """How far the image of a direction moves at most with it up to h = `height`, focal lengths for a radian."""
    return _polynomial(sight.stretch, min(height, sight.highest))


@inlined
def room_within(sight, u, v, w, per):  # type: ignore[no-untyped-def]
    """How far within the borders a point at the distance 1 / `per` is imaged, to `off`; negative outside."""
    flat, scale = sight.flat, per * _polynomial(sight.rough, 1.0 - w * per)
    across, down = scale * u, scale * v
    return min(flat.right - across, flat.left + across, flat.bottom - down, flat.top + down)


@inlined
def in_rectangle(sight, u, v, w):  # type: ignore[no-untyped-def]
    """Whether a point (u, v, w) in the camera's frame is in the image."""
    flat = sight.flat
    across, down = image_of(sight.lens, u, v, w)
    inside = w >= sight.cosine * math.sqrt(u * u + v * v + w * w)
    return inside & (-flat.left <= across) & (across <= flat.right) & (-flat.top <= down) & (down <= flat.bottom)


@inlined
def is_inside(sight, u, v, w):  # type: ignore[no-untyped-def]
    """The same, exactly only where the rough image does not tell."""
    per = 1.0 / np.sqrt(u * u + v * v + w * w)
    room = room_within(sight, u, v, w, per)
    if (w * per > sight.cosine + TOLERANCE) & (abs(room) > sight.off):
        return room > 0.0
    return in_rectangle(sight, u, v, w)


@inlined
def corners_inside(sight, u, v, w, tu, tv, tw, uu, uv, uw):  # type: ignore[no-untyped-def]
    """Whether the corners are in the image: centre, right and up of the tag in the camera's frame."""
    half = sight.flat.half
    pu, pv, pw = half * (tu + uu), half * (tv + uv), half * (tw + uw)  # to one corner, and to its neighbour
    qu, qv, qw = half * (tu - uu), half * (tv - uv), half * (tw - uw)
    inside = is_inside(sight, u + pu, v + pv, w + pw) and is_inside(sight, u - pu, v - pv, w - pw)
    return inside and is_inside(sight, u + qu, v + qv, w + qw) and is_inside(sight, u - qu, v - qv, w - qw)


@inlined
def resolves(sight, u, v, w, tu, tv, tw, uu, uv, uw):  # type: ignore[no-untyped-def]
    """Whether pitch and area suffice."""
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
