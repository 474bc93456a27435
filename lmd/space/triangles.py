"""Triangles of a mesh that block lines of sight, in a hierarchy of boxes that is traversed without a stack.

A line from p to q crosses a triangle if p and q lie on different sides of the triangle's plane, both farther from the
plane than the tolerance. The line must also meet the plane within the triangle's edges. The effective extent at an edge
depends on the adjacent triangle.

- If the line crosses the planes of both triangles in the same direction, both triangles are extended over the edge by
  the tolerance, so that no line passes between both triangles.
- If the line crosses the planes in opposite directions, the line only touches the surface at the edge. Then both
  triangles are shortened by the tolerance. A triangle without a neighbour at an edge is shortened there, too.

A line through a corner only touches the surface if it only touches the surface at some edge of that corner. So a line
that touches an edge or a corner, or runs along a face, is clear, as in `lmd.space.blockers`.

Landmarks lie in the planes of their own triangles, which therefore never hide them.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import inner, kernel

# Maximum numbers of triangles: in a leaf; in a box that is cut at the median instead of by surface area.
LEAF, SMALL = 4, 48


def box_tree(
    low: FloatArray, high: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, IntArray, IntArray, IntArray]:
    """Build a hierarchy of boxes over T boxes, in which the search for the boxes on a ray is fast.

    Args:
        low: lower corners of the T boxes, `(T, 3)`.
        high: upper corners of the T boxes, `(T, 3)`.

    Returns:
        order: permutation of the T boxes, `(T,)`.
        centres, halves: centres and half the side lengths of the N boxes (nodes) of the hierarchy, `(N, 3)` each.
        skip: for each node, index of the first later node that is not inside this node, `(N,)`.
        first, stop: the boxes `order[first:stop]` belong to a node, `(N,)` each; only leaves have boxes.
    """
    middle = low + high
    order: list[IntArray] = []
    centres: list[FloatArray] = []
    halves: list[FloatArray] = []
    skip: list[int] = []
    first: list[int] = []
    stop: list[int] = []

    def grow(part: IntArray, placed: int) -> None:
        node = len(skip)
        lowest, highest = low[part].min(axis=0), high[part].max(axis=0)
        centres.append((lowest + highest) / 2.0)
        halves.append((highest - lowest) / 2.0)
        is_leaf = len(part) <= LEAF
        first.append(placed)
        stop.append(placed + len(part) if is_leaf else placed)
        skip.append(0)
        if is_leaf:
            order.append(part)
        else:
            one, other = _cut(part, low, high, middle)
            grow(one, placed)
            grow(other, placed + len(one))
        skip[node] = len(skip)

    grow(np.arange(len(low)), 0)
    numbers = (np.array(part, dtype=np.int64) for part in (skip, first, stop))
    return np.concatenate(order), np.array(centres), np.array(halves), *numbers  # type: ignore[return-value]


def _cut(part: IntArray, low: FloatArray, high: FloatArray, middle: FloatArray) -> Sequence[IntArray]:
    """Cut a set of boxes into two parts by the surface area heuristic (MacDonald and Booth, 1990).

    A set of at most `SMALL` boxes is cut at the median instead. `part` has the indices of the boxes of the set. All
    boxes have the corners `low` and `high`; `middle` is the sum of both corners. Return the indices of each part.
    """
    if len(part) <= SMALL:
        part = part[np.argsort(middle[part, np.argmax(np.ptp(middle[part], axis=0))], kind="stable")]
        return part[: len(part) // 2], part[len(part) // 2 :]
    best, least = part[:0], np.inf
    counts = np.arange(1, len(part))
    for axis in range(3):
        along = part[np.argsort(middle[part, axis], kind="stable")]
        before, after = (
            _areas(np.minimum.accumulate(low[way]), np.maximum.accumulate(high[way])) for way in (along, along[::-1])
        )
        cost = before[:-1] * counts + after[:-1][::-1] * counts[::-1]
        at = int(np.argmin(cost))
        if cost[at] < least:
            best, least, size = along, cost[at], at + 1
    return best[:size], best[size:]


def _areas(low: FloatArray, high: FloatArray) -> FloatArray:
    """Half the surface area of each of M boxes, `(M,)`; `low` and `high` `(M, 3)` are corners of the boxes."""
    x, y, z = (high - low).T
    return np.asarray(x * y + y * z + z * x)


# Padding of the boxes relative to the largest coordinate: more than rounding errors.
BOX_PADDING = 1e-12
# Least distance of a point from a plane, and least height of a triangle, metres; the square is the least area.
THINNEST_M = 1e-7


class Triangles(NamedTuple):
    """T triangles of a mesh, and the N boxes of a hierarchy in which triangles are searched; metres.

    Boxes are in the order of a depth-first traversal. Triangles are in the order of the boxes that contain them.
    """

    normals: np.ndarray
    """Unit normals, `(T, 3)`."""
    offsets: np.ndarray
    """Offset n . x of each plane, `(T,)`."""
    corners: np.ndarray
    """Corners of each triangle, `(T, 3, 3)`."""
    borders: np.ndarray
    """Inward unit normal m of each edge in the plane of the triangle, and offset m . x of the edge, `(T, 3, 4)`."""
    beyond: np.ndarray
    """Unit normal of the adjacent triangle at each edge, oriented consistently with `normals`, `(T, 3, 3)`; 0 without
    an adjacent triangle.
    """
    apex: np.ndarray
    """Index of the mesh's vertex at each corner of each triangle, `(T, 3)`."""
    ending: np.ndarray
    """First row of `spokes` for each vertex, `(V + 1,)`: rows `ending[v]` to `ending[v + 1] - 1` belong to the sides of
    triangles that end at vertex v.
    """
    spokes: np.ndarray
    """For each vertex and each side of a triangle that ends there: normals of this triangle and of its neighbour at the
    side, 0 for none, `(S, 2, 3)`.
    """
    centres: np.ndarray
    """Centres of the boxes, `(N, 3)`."""
    halves: np.ndarray
    """Half the side lengths of the boxes, `(N, 3)`."""
    skip: np.ndarray
    """For each box, index of the first later box that is not inside this box, `(N,)`."""
    first: np.ndarray
    """Index of the first triangle of each box, `(N,)`; only leaves, the boxes that contain no other box, have
    triangles.
    """
    stop: np.ndarray
    """Index after the last triangle of each box, `(N,)`; equal to `first` for boxes that contain other boxes."""
    tolerance: float
    """Largest distance from a triangle's plane or edge at which a line only touches the triangle, metres."""

    @classmethod
    def of(cls, vertices: FloatArray, faces: IntArray, tolerance: float) -> "Triangles":
        """Build the hierarchy of T triangles with the corners `vertices[faces]`; no triangle may be degenerate.

        Args:
            vertices: vertices of the mesh, metres, `(V, 3)`.
            faces: indices of the vertices of each triangle, `(T, 3)`.
            tolerance: see the class, metres.
        """
        corners = vertices[faces]
        normals = unit_normals(corners)
        way = np.roll(corners, -1, axis=1) - corners
        inwards = np.cross(normals[:, None], way / np.linalg.norm(way, axis=-1, keepdims=True))
        borders = np.concatenate([inwards, (inwards * corners).sum(axis=-1, keepdims=True)], axis=-1)
        beyond = _beyond(faces, normals)
        padding = tolerance + BOX_PADDING * np.abs(vertices).max()
        order, *tree = box_tree(corners.min(axis=1) - padding, corners.max(axis=1) + padding)
        parts = (normals, (normals * corners[:, 0]).sum(axis=-1), corners, borders, beyond, faces)
        ends = np.concatenate([faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)])
        sides = np.tile(np.stack([np.repeat(normals, 3, axis=0), beyond.reshape(-1, 3)], axis=1), (2, 1, 1))
        ending = np.append(0, np.cumsum(np.bincount(ends, minlength=len(vertices))))
        spokes = sides[np.argsort(ends, kind="stable")]
        ordered = [np.ascontiguousarray(part[order]) for part in parts]
        whole: list[Any] = [*ordered, ending, spokes, *tree, tolerance]
        return cls(*whole)

    def clear(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Mask of the lines between points `(..., 3)` that cross no triangle, `(...)`."""
        return ~self._of_each(_find_crossed, starts, ends)

    def distance(self, points: FloatArray, most: float) -> FloatArray:
        """Distance of each of the points `(..., 3)` from the nearest triangle, metres, `(...)`.

        A distance greater than `most` is replaced by `most`.
        """
        found = np.empty(points.shape[:-1])
        _find_distance(self, np.ascontiguousarray(points).reshape(-1, 3), most, found.reshape(-1))
        return found

    def keeps_away(self, starts: FloatArray, ends: FloatArray, clearance: float) -> BoolArray:
        """Mask of the straight paths between points `(..., 3)` that keep the clearance from all triangles, `(...)`.

        `clearance` is the least distance, metres. The function uses sphere tracing with steps of at least `STEP`.
        """
        return self._of_each(_find_kept, starts, ends, clearance)

    def _of_each(self, find: Callable[..., None], starts: FloatArray, ends: FloatArray, *more: float) -> BoolArray:
        """Result of the kernel `find` for each line between points `(..., 3)`, a mask `(...)`.

        `more` are further arguments of the kernel.
        """
        starts, ends = np.broadcast_arrays(starts, ends)
        found = np.empty(starts.shape[:-1], dtype=np.bool_)
        first, last = (np.ascontiguousarray(p).reshape(-1, 3) for p in (starts, ends))
        find(self, first, last, *more, found.reshape(-1))
        return found


# Least step and largest search distance of sphere tracing, metres.
STEP, AHEAD = 1e-3, 1.0


def unit_normals(corners: FloatArray) -> FloatArray:
    """Unit normals `(T, 3)` of triangles `(T, 3, 3)`, towards viewers that see the corners counter-clockwise."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True) + 0.0)


def _beyond(faces: IntArray, normals: FloatArray) -> FloatArray:
    """Compute `Triangles.beyond`: for each edge of each triangle, the unit normal of the triangle next to it.

    The axes of the result `(T, 3, 3)` are triangle, edge and coordinate. If more than two triangles share an edge, each
    of them gets its own normal there.
    """
    count = len(faces)
    edge = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    own = np.repeat(np.arange(count), 3)
    forwards = edge[:, 0] < edge[:, 1]
    _, which, times = np.unique(np.sort(edge, axis=1), axis=0, return_inverse=True, return_counts=True)
    beyond = np.where((times[which] > 2)[:, None], normals[own], 0.0)
    order = np.argsort(which, kind="stable")
    pairs = order[times[which[order]] == 2].reshape(-1, 2)
    for one, other in (pairs.T, pairs.T[::-1]):
        # Consistently oriented triangles traverse their common edge in opposite directions.
        sense = np.where(forwards[one] == forwards[other], -1.0, 1.0)
        beyond[one] = sense[:, None] * normals[own[other]]
    return beyond.reshape(count, 3, 3)


@inner
def is_crossed(triangles, px, py, pz, qx, qy, qz):  # type: ignore[no-untyped-def]
    """True if the line from p to q crosses a triangle."""
    normals, offsets, borders, beyond = triangles.normals, triangles.offsets, triangles.borders, triangles.beyond
    centres, halves, skip = triangles.centres, triangles.halves, triangles.skip
    first, stop, tolerance = triangles.first, triangles.stop, triangles.tolerance
    wx, wy, wz = qx - px, qy - py, qz - pz
    # Separating axis test of a box and the line, given by its middle m and half vector d: axes of the box, and their
    # cross products with the line.
    mx, my, mz = 0.5 * (px + qx), 0.5 * (py + qy), 0.5 * (pz + qz)
    dx, dy, dz = 0.5 * wx, 0.5 * wy, 0.5 * wz
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    node = 0
    while node < len(skip):
        hx, hy, hz = halves[node, 0], halves[node, 1], halves[node, 2]
        cx, cy, cz = mx - centres[node, 0], my - centres[node, 1], mz - centres[node, 2]
        if (
            abs(cx) > hx + ax
            or abs(cy) > hy + ay
            or abs(cz) > hz + az
            or abs(dy * cz - dz * cy) > hy * az + hz * ay
            or abs(dz * cx - dx * cz) > hz * ax + hx * az
            or abs(dx * cy - dy * cx) > hx * ay + hy * ax
        ):
            node = skip[node]
            continue
        for i in range(first[node], stop[node]):
            start = normals[i, 0] * px + normals[i, 1] * py + normals[i, 2] * pz - offsets[i]
            end = normals[i, 0] * qx + normals[i, 1] * qy + normals[i, 2] * qz - offsets[i]
            if min(start, end) >= -tolerance or max(start, end) <= tolerance:
                continue
            t, sense = start / (start - end), 1.0 if end > start else -1.0
            x, y, z = px + t * wx, py + t * wy, pz + t * wz
            within, near, far = True, 0, 0
            for e in range(3):
                along = wx * beyond[i, e, 0] + wy * beyond[i, e, 1] + wz * beyond[i, e, 2]
                inside = borders[i, e, 0] * x + borders[i, e, 1] * y + borders[i, e, 2] * z - borders[i, e, 3]
                within = within and inside > (-tolerance if sense * along > tolerance else tolerance)
                if inside > tolerance:
                    far = e
                else:
                    near += 1
            # A point near two edges is near their common corner, which is opposite the third edge `far`.
            if within and (near < 2 or not _is_touched(triangles, triangles.apex[i, (far + 2) % 3], wx, wy, wz)):
                return True
        node += 1
    return False


@inner
def _is_touched(triangles, corner, wx, wy, wz):  # type: ignore[no-untyped-def]
    """True if a line through a corner of the mesh only touches the surface at an edge of that corner.

    `corner` is the index of the vertex, and (wx, wy, wz) is the vector along the line.
    """
    spokes, tolerance = triangles.spokes, triangles.tolerance
    for s in range(triangles.ending[corner], triangles.ending[corner + 1]):
        one = wx * spokes[s, 0, 0] + wy * spokes[s, 0, 1] + wz * spokes[s, 0, 2]
        other = wx * spokes[s, 1, 0] + wy * spokes[s, 1, 1] + wz * spokes[s, 1, 2]
        if min(abs(one), abs(other)) <= tolerance or one * other < 0.0:
            return True
    return False


@inner
def _distance(triangles, x, y, z, most):  # type: ignore[no-untyped-def]
    """Distance of the point (x, y, z) from the nearest triangle, metres; `most` if the distance is greater."""
    normals, offsets, corners, borders = triangles.normals, triangles.offsets, triangles.corners, triangles.borders
    centres, halves, skip, first, stop = (
        triangles.centres, triangles.halves, triangles.skip, triangles.first, triangles.stop,
    )  # fmt: skip
    least, node = most * most, 0
    while node < len(skip):
        dx = max(abs(x - centres[node, 0]) - halves[node, 0], 0.0)
        dy = max(abs(y - centres[node, 1]) - halves[node, 1], 0.0)
        dz = max(abs(z - centres[node, 2]) - halves[node, 2], 0.0)
        if dx * dx + dy * dy + dz * dz >= least:
            node = skip[node]
            continue
        for i in range(first[node], stop[node]):
            height = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z - offsets[i]
            if height * height >= least:
                continue
            within = True
            for e in range(3):
                inside = borders[i, e, 0] * x + borders[i, e, 1] * y + borders[i, e, 2] * z - borders[i, e, 3]
                within = within and inside >= 0.0
            if within:
                least = height * height
                continue
            for e in range(3):
                a, b = corners[i, e], corners[i, (e + 1) % 3]
                ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], x - a[0], y - a[1], z - a[2]
                t = min(max((ux * vx + uy * vy + uz * vz) / (ux * ux + uy * uy + uz * uz), 0.0), 1.0)
                wx, wy, wz = vx - t * ux, vy - t * uy, vz - t * uz
                least = min(least, wx * wx + wy * wy + wz * wz)
        node += 1
    return np.sqrt(least)


@kernel
def _find_crossed(triangles, starts, ends, crossed):  # type: ignore[no-untyped-def]
    for i in range(len(starts)):
        p, q = starts[i], ends[i]
        crossed[i] = is_crossed(triangles, p[0], p[1], p[2], q[0], q[1], q[2])


@kernel
def _find_distance(triangles, points, most, found):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        found[i] = _distance(triangles, points[i, 0], points[i, 1], points[i, 2], most)


@kernel
def _find_kept(triangles, starts, ends, clearance, kept):  # type: ignore[no-untyped-def]
    for i in range(len(starts)):
        way = ends[i] - starts[i]
        length, at = np.sqrt((way * way).sum()), 0.0
        kept[i] = True
        while kept[i] and at <= length:
            share = at / length if length > 0.0 else 0.0
            x, y, z = starts[i, 0] + share * way[0], starts[i, 1] + share * way[1], starts[i, 2] + share * way[2]
            away = _distance(triangles, x, y, z, clearance + AHEAD) - clearance
            kept[i] = away >= -triangles.tolerance
            at += max(away, STEP)
