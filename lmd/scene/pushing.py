"""Kernel that pushes footprints apart: each footprint is moved to the nearest place free of earlier footprints."""

import numpy as np

from lmd.core.compiled import inner, kernel
from lmd.space.allowed import allows, nearest

# Relative rounding tolerance of overlap: footprints that share an edge do not overlap.
TOUCHING = 1e-9
# Radius of the first search for a free place, in edges of the largest footprint; a second search has no limit.
NEARBY_EDGES = 3.0


@inner
def _is_free(k, a, b, s, surface, at, edge):  # type: ignore[no-untyped-def]
    """True if footprint k, centred at (a, b) on surface s, would overlap none of the footprints 0 to k - 1.

    `surface`, `at` and `edge` are those of `push`.
    """
    free = True
    for j in range(k):
        least = (edge[j] + edge[k]) / 2.0 * (1.0 - TOUCHING)
        free = free and (surface[j] != s or max(abs(at[j, 0] - a), abs(at[j, 1] - b)) >= least)
    return free


@inner
def _blocked(k, a, b, s, surface, at, edge, beside):  # type: ignore[no-untyped-def]
    """Find the interval around b whose places (a, q) are blocked for footprint k; return its lower and upper end.

    A place (a, q) on surface s is blocked if footprint k, centred there, would overlap an earlier footprint. Both ends
    are b if (a, b) is free. `surface`, `at` and `edge` are those of `push`; `beside` `(2, K)` is working memory.
    """
    low, high, count, grows = b, b, 0, True
    for j in range(k):
        reach = (edge[j] + edge[k]) / 2.0 * (1.0 - 2.0 * TOUCHING)
        if surface[j] == s and abs(at[j, 0] - a) < reach:
            beside[0, count], beside[1, count] = at[j, 1] - reach, at[j, 1] + reach
            count += 1
    while grows:
        grows = False
        for i in range(count):
            bottom, top = beside[0, i], beside[1, i]
            if bottom < high and top > low and (bottom < low or top > high):
                low, high, grows = min(low, bottom), max(high, top), True
    return low, high


@inner
def _nearest_free(k, s, a, b, within, surface, at, pieces, start, stop, edge, lines, beside, found):  # type: ignore[no-untyped-def]
    """Find the free place for footprint k nearest to (a, b) on surface s, and write its coordinates into `found`.

    At the nearest place, footprint k touches another footprint or the border of the allowed centres. Only coordinates
    with such a contact are tried. Footprints more than `within` metres from (a, b) are not considered for a contact.
    Rows `start` to `stop - 1` of `pieces` are trapezoids of allowed centres. `lines` and `beside` are working memory;
    `surface`, `at` and `edge` are those of `push`.

    Returns:
        True if there is a free place.
    """
    lines[0, 0], lines[1, 0] = a, b
    across, up = 1, 1
    for t in range(start, stop):
        for i in range(2):
            lines[0, across + i] = pieces[t, i]
        for i in range(4):
            lines[1, up + i] = pieces[t, 2 + i]
        across, up = across + 2, up + 4
    for j in range(k):
        if surface[j] == s and max(abs(at[j, 0] - a), abs(at[j, 1] - b)) <= within:
            touching = (edge[j] + edge[k]) / 2.0
            lines[0, across], lines[0, across + 1] = at[j, 0] - touching, at[j, 0] + touching
            lines[1, up], lines[1, up + 1] = at[j, 1] - touching, at[j, 1] + touching
            across, up = across + 2, up + 2
    shortest = np.inf
    for i in range(across):
        p = lines[0, i]
        if (p - a) * (p - a) >= shortest:
            continue
        low, high = _blocked(k, p, b, s, surface, at, edge, beside)
        for j in range(up):
            q = lines[1, j]
            away = (p - a) * (p - a) + (q - b) * (q - b)
            is_nearer = away < shortest and not low < q < high and allows(pieces, start, stop, p, q)
            if is_nearer and _is_free(k, p, q, s, surface, at, edge):
                shortest, found[0], found[1] = away, p, q
    return shortest < np.inf


@kernel
def push(fixed, surface, at, pieces, first, of, edge, moved):  # type: ignore[no-untyped-def]
    """Push K footprints apart, updating the arrays in place; return False if there is no room for all footprints.

    Args:
        fixed: number of footprints at the beginning that are not moved.
        surface: surface of each footprint, `(K,)`; updated.
        at: centres in surface coordinates, metres, `(K, 2)`; updated.
        pieces: trapezoids of the allowed centres of footprints of S sizes, `(T, 6)`, see `lmd.space.allowed`.
        first: `(S, W + 1)`; rows `first[c, s]` to `first[c, s + 1] - 1` of `pieces` are the trapezoids for size c on
            surface s.
        of: index c of the size of each footprint, `(K,)`.
        edge: edge lengths of the footprints, metres, `(K,)`.
        moved: receives True for each footprint that is moved, `(K,)`.
    """
    lines, beside = np.empty((2, 2 * len(at) + 4 * len(pieces) + 1)), np.empty((2, len(at)))
    found, count = np.empty(2), first.shape[1] - 1
    for k in range(fixed, len(at)):
        own = first[of[k]]
        _, a, b = nearest(pieces, own[surface[k]], own[surface[k] + 1], at[k, 0], at[k, 1])
        # An offset below the rounding tolerance is not corrected.
        rounding = edge[k] - edge[k] * (1.0 - TOUCHING)
        if abs(a - at[k, 0]) + abs(b - at[k, 1]) < rounding and _is_free(k, a, b, surface[k], surface, at, edge):
            continue
        has_room, moved[k], s = False, True, surface[k]
        for turn in range(count + 1):
            within = NEARBY_EDGES * edge.max() if turn == 0 else np.inf
            s = (surface[k] + max(turn - 1, 0)) % count
            _, p, q = nearest(pieces, own[s], own[s + 1], a, b)
            if _nearest_free(k, s, p, q, within, surface, at, pieces, own[s], own[s + 1], edge, lines, beside, found):
                has_room = True
                break
        if not has_room:
            return False
        surface[k], at[k, 0], at[k, 1] = s, found[0], found[1]
    return True
