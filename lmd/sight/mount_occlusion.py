"""Occlusion of one landmark by another from the cameras of a rig.

Bounds that hold for all cameras around a centre exclude most pairs of landmarks; the exact test of `criteria` decides
the other pairs.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import BITS, LANES, ONE, ZERO, Integer, lowest
from lmd.core.compiled import inlined
from lmd.geometry.vectors import Vector, cross3, dot3, minus3
from lmd.scene.criteria import hide_between, sized
from lmd.sight.blocks import SINGLE_ERROR
from lmd.sight.mounts import camera_at


@inlined
def hidden_bits(
    group: Any, m: Integer, w: Integer, left: Any, i: Integer, k: Integer, body: Vector, one: Any, other: Any
) -> Any:
    """Find those of the orientations in `left` at which landmark i hides landmark k from the camera on mount m.

    `left` and the result are word w of bit sets of the body's orientations, with 64 orientations in a word. The other
    arguments are those of `hides_from`.
    """
    found = ZERO
    while left:
        bit = lowest(left)
        left &= left - ONE
        found |= np.uint64(hides_from(group, m, w * np.uint64(BITS) + bit, i, k, body, one, other)) << bit
    return found


@inlined
def hides_from(group: Any, m: Integer, a: Integer, i: Integer, k: Integer, body: Vector, one: Any, other: Any) -> Any:
    """True if landmark i hides landmark k from the camera on mount m of a rig, for orientation a of its body.

    `group` is the `MountGroup` that contains mount m, and `body` the position of the body, metres. `one` is the
    position and the unit normal of landmark i, `other` of landmark k.
    """
    camera, (a_place, u), (b_place, v) = camera_at(group, m, a, body), one, other
    first, second = minus3(a_place, camera), minus3(b_place, camera)
    mine, theirs = sized(group.sight, i), sized(group.sight, k)
    hides, _ = hide_between(mine, theirs, first, dot3(first, first), second, dot3(second, second), u, v)
    return hides


@inlined
def may_hide_around(a: Vector, b: Vector, radius: float, width: float) -> Any:
    """True if one of two landmarks may hide the other from some camera near a centre; False if this is impossible.

    The offsets of the landmarks from the centre are a and b, metres. A camera is at a displacement delta from the
    centre, at most `radius` long. The offsets from the camera are a' = a - delta and b' = b - delta, so a' x b' = a x b
    - delta x (b - a). A landmark hides the other only if it is at most `width` from the line of sight to the other, so
    that |a' x b'| <= width max(|a'|, |b'|). `width`, metres, is the square root of `SightModel.reach`.
    """
    e = minus3(b, a)
    c, longest, apart = cross3(a, e), math.sqrt(max(dot3(a, a), dot3(b, b))), math.sqrt(dot3(e, e))
    return dot3(c, c) <= hiding_bound(longest, apart, radius, width)


@inlined
def hiding_bound(longest: float, apart: float, radius: float, width: float) -> Any:
    """Upper bound, m^4, on |a x b|^2 for two landmarks of which one hides the other from a camera near a centre.

    a and b are the offsets of the landmarks from the centre. `may_hide_around` derives the bound.

    Args:
        longest: max(|a|, |b|), metres.
        apart: |b - a|, metres.
        radius: greatest distance of the camera from the centre, metres.
        width: greatest distance from a line of sight at which a landmark hides another, metres.
    """
    room = (width * (longest + radius) + radius * apart) * (1.0 + SINGLE_ERROR) + SINGLE_ERROR
    return room * room


@inlined
def _may_occlude(j: Integer, k: Integer, mine: Any, view: Any) -> Any:
    """True if landmark j may hide landmark k from some camera within a radius of a centre; True for j = k.

    `view` is a `Viewpoint` as seen from the centre. The computation is in float32.

    Seen from a camera and from the centre, the directions of a landmark at the distance d from the centre differ by at
    most asin(radius / d). Seen from the camera, the landmark hides only landmarks within asin(width / (d - radius)) of
    its direction. So if landmark j hides landmark k, the sine of the angle between both directions is at most
    `view.close[j]` + `mine`. Here `view.close[j]` = radius / d_j + width / (d_j - radius), and `mine` = radius / d_k.
    `width` is the greatest distance of an occluder from a line of sight.
    """
    u, v, w = view.u, view.v, view.w
    cosine, sine = u[j] * u[k] + v[j] * v[k] + w[j] * w[k], view.close[j] + mine
    return cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR)


@inlined
def find_suspects(k: Integer, view: Any, count: Integer, radius: float, close: Any) -> Any:
    """Find the landmarks that may hide landmark k from some camera within `radius`, metres, of the centre.

    The first `count` landmarks of `view`, a `Viewpoint` as seen from the centre, are tested. The bit set of those found
    is written into `close`, 32 landmarks per entry. Return True if any landmark is found.
    """
    # An upper bound radius / d on the sine of the angle by which the direction of landmark k may turn.
    mine = np.float32(min(radius / math.sqrt(view.squared[k]), 1.0) if view.squared[k] > 0.0 else 1.0)
    any_found = np.uint32(0)
    for b in range((count + LANES - 1) // LANES):
        found = np.uint32(0)
        for lane in range(np.uint64(LANES)):
            j = np.uint64(b * LANES) + lane
            found |= np.uint32(_may_occlude(j, k, mine, view)) << np.uint32(lane)
        if b == k // LANES:
            found &= ~(np.uint32(1) << np.uint32(k % LANES))
        if b == count // LANES:  # padding
            found &= (np.uint32(1) << np.uint32(count % LANES)) - np.uint32(1)
        close[b] = found
        any_found |= found
    return any_found != 0


@inlined
def list_occluders(
    k: Integer, view: Any, radius: float, width: float, close: Any, blocks: Integer, occluders: np.ndarray
) -> Any:
    """List the landmarks that may hide landmark k from a camera near a centre; return their number.

    The landmarks that `find_suspects` has found, the bit set `close`, are tested with `may_hide_around`. The indices of
    those that pass the test are written to `occluders`.
    """
    x, y, z, kept = view.x, view.y, view.z, 0
    for b in range(blocks):
        left = np.uint64(close[b])
        while left:
            j = b * LANES + np.int64(lowest(left))
            left &= left - ONE
            occluders[kept] = j
            kept += may_hide_around((x[j], y[j], z[j]), (x[k], y[k], z[k]), radius, width)
    return kept
