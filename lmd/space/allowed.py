"""Allowed regions of a surface for landmarks, cut into trapezoids for compiled code.

A region is a shapely polygon or multipolygon in the coordinates (a, b) of the surface, metres: a along the surface's
unit vector u, b along its unit vector v. A trapezoid has two sides parallel to v, the left and the right side. A
trapezoid is stored as a row of six numbers in three pairs: coordinate a, lower b and upper b. The first number of a
pair belongs to the left side, the second to the right side. Trapezoids cover the region exactly without overlaps.
"""

import itertools
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, kernel

# Distance from a closed region that counts as inside, metres.
EDGE_TOLERANCE = 1e-9
# Least area of a region, square metres; smaller regions are rounding errors.
MIN_AREA = 1e-9
# Numbers of a trapezoid.
TRAPEZOID_NUMBERS = 6


def trapezoids(region: Any) -> FloatArray:
    """Cut a region into T trapezoids; return one row of six numbers for each trapezoid, `(T, 6)`.

    The region has coordinates (a, b), metres; it is cut along lines of constant a through its vertices. The columns are
    a (left, right), lower b (left, right) and upper b (left, right).
    """
    import shapely

    rings = [np.asarray(ring.coords)[:, :2] for ring in shapely.get_parts(shapely.boundary(region))]
    edges = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    edges = np.where((edges[:, :1, :1] > edges[:, 1:, :1]), edges[:, ::-1], edges)  # from left to right
    (left, low), (right, high) = edges[:, 0].T, edges[:, 1].T
    found = []
    for start, stop in itertools.pairwise(np.unique(edges[..., 0])):
        across = (left <= start) & (right >= stop)
        slope = (high[across] - low[across]) / (right[across] - left[across])
        # At the ends of an edge, b is exactly the b of the vertex.
        first = np.where(left[across] == start, low[across], low[across] + slope * (start - left[across]))
        last = np.where(right[across] == stop, high[across], low[across] + slope * (stop - left[across]))
        order = np.argsort(first + last, kind="stable")
        for lower, upper in order.reshape(-1, 2):
            # Where borders meet, rounding may make them cross.
            top, end = max(first[lower], first[upper]), max(last[lower], last[upper])
            found.append((start, stop, first[lower], last[lower], top, end))
    return np.array(found).reshape(-1, TRAPEZOID_NUMBERS)


def sizes(pieces: FloatArray) -> FloatArray:
    """Areas of T trapezoids, square metres, `(T,)`; `pieces` `(T, 6)` has rows as returned by `trapezoids`."""
    left, right, low_left, low_right, high_left, high_right = pieces.T
    return np.asarray((right - left) * (0.5 * (high_left - low_left) + 0.5 * (high_right - low_right)))


def eroded(region: Any, margin: float) -> Any:
    """Return the part of a region that remains after an erosion by a square.

    A point (a, b) remains if the square around it lies in the region. The square has the edge length 2 `margin`,
    metres, and sides along a and b.
    """
    import shapely

    if not margin:
        return region
    ways = margin * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    rings = [np.asarray(ring.coords)[:, :2] for ring in shapely.get_parts(shapely.boundary(region))]
    swept = [
        shapely.MultiPoint((np.array(edge)[:, None] + ways).reshape(-1, 2)).convex_hull
        for ring in rings
        for edge in itertools.pairwise(ring)
    ]
    return polygons(region.difference(shapely.union_all(swept)))


def polygons(region: Any) -> Any:
    """Return a region without its connected pieces of at most `MIN_AREA`, square metres, in shapely's normal form."""
    import shapely

    parts = [part for part in shapely.get_parts(region) if part.area > MIN_AREA]
    return shapely.normalize(shapely.union_all(parts))


def _spread(
    left: Any, right: Any, low_left: Any, low_right: Any, high_left: Any, high_right: Any, x: Any, y: Any
) -> tuple[Any, Any]:
    """Map x and y in [0, 1] to the coordinates (a, b) of a point in a trapezoid.

    x leads from the left to the right side, y from the lower to the upper side. Uniformly distributed x and y give
    uniformly distributed points. The first six arguments describe the trapezoid as the columns of `trapezoids` do. All
    arguments are numbers or arrays.
    """
    one, two = high_left - low_left, high_right - low_right
    even = one == two
    root = np.sqrt(np.maximum(one * one + (two * two - one * one) * x, 0.0))
    share = even * x + (1 - even) * (x * (one + two) / np.maximum(one + root, 1e-300))
    low = low_left + share * (low_right - low_left)
    return left + share * (right - left), low + y * (high_left + share * (high_right - high_left) - low)


def spread(pieces: FloatArray, at: FloatArray) -> FloatArray:
    """Map points of the unit square to points of trapezoids; return coordinates (a, b), metres, `(..., 2)`.

    Uniformly distributed points of the square give uniformly distributed points of the trapezoids.

    Args:
        pieces: trapezoid for each point, a row as returned by `trapezoids`, `(..., 6)`.
        at: points of the unit square, `(..., 2)`.
    """
    columns = [*np.moveaxis(pieces, -1, 0), *np.moveaxis(at, -1, 0)]
    return np.stack(_spread(*columns), axis=-1)


def gathered(pieces: FloatArray, places: FloatArray) -> FloatArray:
    """Map points of trapezoids to points of the unit square, `(..., 2)`; inverse of `spread`.

    Args:
        pieces: trapezoid of each point, a row as returned by `trapezoids`, `(..., 6)`.
        places: coordinates (a, b) of the points, metres, `(..., 2)`.
    """
    left, right, low_left, low_right, high_left, high_right = np.moveaxis(pieces, -1, 0)
    one, two = high_left - low_left, high_right - low_right
    share = (places[..., 0] - left) / np.maximum(right - left, 1e-300)
    x = np.where(one == two, share, share * (2.0 * one + share * (two - one)) / np.maximum(one + two, 1e-300))
    low = low_left + share * (low_right - low_left)
    y = (places[..., 1] - low) / np.maximum(high_left + share * (high_right - high_left) - low, 1e-300)
    return np.clip(np.stack([x, y], axis=-1), 0.0, 1.0)


spread_one = inlined(_spread)


@inlined
def nearest(pieces, start, stop, a, b):  # type: ignore[no-untyped-def]
    """Find the trapezoid nearest to the point (a, b) among the rows `start` to `stop - 1` of `pieces`.

    Return the index of its row, and the coordinates of the point in the trapezoid that is nearest to (a, b). These
    coordinates are exact if (a, b) is in a trapezoid or if the trapezoid is a rectangle. Otherwise they are
    approximate.
    """
    piece, least, at_a, at_b = start, np.inf, a, b
    for t in range(start, stop):
        left, right = pieces[t, 0], pieces[t, 1]
        p = min(max(a, left), right)
        share = (p - left) / max(right - left, 1e-300)
        low = pieces[t, 2] + share * (pieces[t, 3] - pieces[t, 2])
        high = pieces[t, 4] + share * (pieces[t, 5] - pieces[t, 4])
        q = min(max(b, low), high)
        away = (p - a) * (p - a) + (q - b) * (q - b)
        if away < least:
            piece, least, at_a, at_b = t, away, p, q
    return piece, at_a, at_b


@inlined
def allows(pieces, start, stop, a, b):  # type: ignore[no-untyped-def]
    """True if the point (a, b) is in one of the trapezoids in rows `start` to `stop - 1` of `pieces`.

    A point that is outside by at most `EDGE_TOLERANCE`, metres, counts as inside.
    """
    _, p, q = nearest(pieces, start, stop, a, b)
    return abs(p - a) + abs(q - b) <= EDGE_TOLERANCE


@kernel
def find_nearest(pieces, first, surface, at, out, piece):  # type: ignore[no-untyped-def]
    """For each of N points on surfaces, find the nearest allowed place on the point's surface.

    Args:
        pieces: trapezoids of all surfaces, `(T, 6)`.
        first: rows `first[s]` to `first[s + 1] - 1` of `pieces` are the trapezoids of surface s.
        surface: index of the surface of each point, `(N,)`.
        at: coordinates (a, b) of each point on its surface, metres, `(N, 2)`.
        out: receives the coordinates of the nearest places, `(N, 2)`.
        piece: receives the index of the trapezoid of each place, `(N,)`.
    """
    for k in range(len(at)):
        start, stop = first[surface[k]], first[surface[k] + 1]
        piece[k], out[k, 0], out[k, 1] = nearest(pieces, start, stop, at[k, 0], at[k, 1])
