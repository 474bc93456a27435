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
    """Bit set, for the orientations of word w, of the body's orientations at which landmark i hides landmark k from the
    camera of mount m (`hides_from`). Only the orientations in the set `left`, which are still to be tested, are
    considered.
    """
    found = ZERO
    while left:
        bit = lowest(left)
        left &= left - ONE
        found |= np.uint64(hides_from(group, m, w * np.uint64(BITS) + bit, i, k, body, one, other)) << bit
    return found


@inlined
def hides_from(group: Any, m: Integer, a: Integer, i: Integer, k: Integer, body: Vector, one: Any, other: Any) -> Any:
    """True if landmark i hides landmark k from mount m, for the body with orientation a at the position `body`, metres.

    `one` and `other` are position and unit normal of landmarks i and k, six numbers each.
    """
    camera, (a_place, u), (b_place, v) = camera_at(group, m, a, body), one, other
    first, second = minus3(a_place, camera), minus3(b_place, camera)
    mine, theirs = sized(group.sight, i), sized(group.sight, k)
    hides, _ = hide_between(mine, theirs, first, dot3(first, first), second, dot3(second, second), u, v)
    return hides


@inlined
def may_hide_around(a: Vector, b: Vector, radius: float, width: float) -> Any:
    """False only if neither of two landmarks hides the other from any camera within `radius` of a centre.

    Let a and b be the offsets of the landmarks from the centre. The offsets from a camera displaced by
    delta are a' = a - delta and b' = b - delta. So a' x b' = a x b - delta x (b - a). One landmark hides the other only
    within `width` = sqrt(reach) of the line of sight, that is if |a' x b'| <= width max(|a'|, |b'|).
    """
    e = minus3(b, a)
    c, longest, apart = cross3(a, e), math.sqrt(max(dot3(a, a), dot3(b, b))), math.sqrt(dot3(e, e))
    return dot3(c, c) <= hiding_bound(longest, apart, radius, width)


@inlined
def hiding_bound(longest: float, apart: float, radius: float, width: float) -> Any:
    """Upper bound, m^4, on |a x b|^2 of two landmarks of which one hides the other, see `may_hide_around`; `longest` is
    max(|a|, |b|), `apart` is |b - a|.
    """
    room = (width * (longest + radius) + radius * apart) * (1.0 + SINGLE_ERROR) + SINGLE_ERROR
    return room * room


@inlined
def _may_occlude(j: Integer, k: Integer, mine: Any, view: Any) -> Any:
    """False only if landmark j hides landmark k from no camera whose distance from the centre is at most the radius
    (`radius` of `find_suspects`). The computation is in float32; the result is True for j = k.

    If a position is within the radius of the centre, the direction of a landmark at the distance d turns by at most
    asin(radius / d). The landmark hides other landmarks within asin(width / (d - radius)) of its direction. So the sine
    of the angle between occluder j and landmark k is at most `close[j]` + `mine`. Here `close[j]` = radius / d_j +
    width / (d_j - radius), and `mine` = radius / d_k.
    """
    u, v, w = view.u, view.v, view.w
    cosine, sine = u[j] * u[k] + v[j] * v[k] + w[j] * w[k], view.close[j] + mine
    return cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR)


@inlined
def find_suspects(k: Integer, view: Any, count: Integer, radius: float, close: Any) -> Any:
    """Find the landmarks that may hide landmark k from any camera within `radius` of the centre, and write the set of
    these landmarks as bits into `close` `(blocks,)`. Return True if there is such a landmark.
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
    """Write to `occluders` those landmarks of the set `close` (from `find_suspects`) that may hide landmark k by the
    test `may_hide_around`. Return the number of these landmarks.
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
