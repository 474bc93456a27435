"""Floor plan of the free region of an occupancy grid, such as a robot's map."""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, bounded
from lmd.space.blockers import edges
from lmd.space.wall_lines import ReadPlan

NO_WALL = "no wall"

# Least area of a free region that a note mentions, square metres.
MENTIONED_M2 = 0.5
# Shortest part of an edge without occupied cells that excludes landmarks, metres; shorter gaps are noise.
SHORTEST_GAP_M = 0.2
# Greatest ratio of a ring's tolerance to its shorter side; a pillar is such a ring.
PILLAR_SHARE = 0.2
# Least sine of the angle between edges whose lines are intersected.
LEAST_ANGLE_SINE = 0.2
# Tolerance of the comparison of distances, cells.
ROUNDING = 1e-9
# Greatest number of corners; with more corners, a run would take hours.
MOST_CORNERS = 4000


class OccupancyGrid(NamedTuple):
    """Occupancy grid of H x W cells."""

    path: str
    """Path of the map's file, for messages."""
    cells: IntArray
    """Occupancy in per cent, -1 for unknown, `(H, W)`; row 0 has the lowest y before `origin` rotates and moves the
    map.
    """
    resolution: float
    """Side of a cell, metres."""
    origin: tuple[float, float, float]
    """Pose of the outer corner of cell (0, 0) in the map frame: x, y, metres, and yaw, rad."""
    is_occupied: BoolArray
    """Mask of the occupied cells, `(H, W)`."""
    is_free: BoolArray
    """Mask of the free cells, `(H, W)`."""
    note: str = ""
    """Clause of a message about ambiguities of the file; empty without ambiguities."""

    def in_map(self, at: FloatArray) -> FloatArray:
        """Convert points (column, row), in cells from the outer corner of cell (0, 0), to the map frame, metres."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        return np.asarray(self.resolution * np.asarray(at) @ turn.T + [x, y])

    def in_cells(self, points: FloatArray) -> FloatArray:
        """Convert points of the map frame, metres, to points (column, row) in cells; inverse of `in_map`."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        return np.asarray((np.asarray(points) - [x, y]) @ turn / self.resolution)


class Region(NamedTuple):
    """Free region of a map; coordinates are counted in cells from the outer corner of cell (0, 0)."""

    polygon: Any
    """Region with its holes, a shapely polygon."""
    to_wall: FloatArray
    """Distance from the centre of each cell to the centre of the nearest occupied cell, in cells, `(H, W)`."""
    note: str
    """Text about parts of the map that are omitted, to be added to a message; it may be empty."""


def plan_of_grid(
    grid: OccupancyGrid, tolerance: float, speck: float, passage: float, start: tuple[float, ...] | None
) -> ReadPlan:
    """Find the floor plan of a map's free region; the plan is in the frame of the map.

    Args:
        grid: map.
        tolerance: maximum distance of a wall of the plan from the border of the free cells, metres.
        speck: a group of cells that are not free counts as free if both sides of its bounding box are shorter than
            this, metres.
        passage: minimum width of parts of the free region, metres; narrower parts are left out.
        start: point (x, y) in the region, metres; None for the largest region.

    Raises:
        InputError: there is no free region, `passage` is too wide, `start` is not in a free region, or the plan would
            have too many corners.
    """
    cell = grid.resolution
    region = _free_region(grid, tolerance / cell, speck / cell, passage / cell, start)
    most, shortest = tolerance / cell + 1.5, SHORTEST_GAP_M / cell

    def gaps(edge: FloatArray) -> list[tuple[float, float, str]]:
        return [(cell * a, cell * b, NO_WALL) for a, b in _gaps(edge, region.to_wall, most, shortest)]

    found = ReadPlan.of(grid.path, region.polygon, gaps, f"resolution = {cell:g}", grid.note, region.note)
    return found._replace(rings=[grid.in_map(ring) for ring in found.rings])


def _free_region(
    grid: OccupancyGrid, tolerance: float, speck: float, passage: float, start: tuple[float, ...] | None
) -> Region:
    """Find the free region of a map; the arguments are those of `plan_of_grid`.

    `tolerance`, `speck` and `passage` are in cells, but `start` is in metres.
    """
    import shapely
    from scipy import ndimage

    known = grid.is_free | grid.is_occupied
    if not grid.is_free.any():
        raise InputError(f"path: {grid.path!r} has no free cells.", "path")
    (top, left), (bottom, right) = (f(np.argwhere(known), axis=0) for f in (np.min, np.max))
    crop = (slice(top, bottom + 1), slice(left, right + 1))
    free, occupied = (np.pad(cells[crop], 1) for cells in (grid.is_free, grid.is_occupied))
    corner = np.array([left - 1, top - 1])

    labels, _ = ndimage.label(~free, np.ones((3, 3)))
    small = [
        i
        for i, box in enumerate(ndimage.find_objects(labels), 1)
        if max(side.stop - side.start for side in box) < speck
    ]
    specks = np.isin(labels, small)
    free, occupied = free | specks, occupied & ~specks

    radius = passage / 2.0
    core = free & (ndimage.distance_transform_edt(free) >= radius)
    labels, count = ndimage.label(core)
    if not count:
        raise InputError(
            f"passage = {passage * grid.resolution:g} is wider than every free region of {grid.path!r}.", "passage"
        )
    away, nearest = ndimage.distance_transform_edt(~core, return_indices=True)
    # A right-angled corner of the region is sqrt(2) radii from the core.
    parts = np.where(free & (away <= math.sqrt(2.0) * radius), labels[tuple(nearest)], 0)
    areas = np.bincount(parts.ravel())
    areas[0] = 0
    chosen = int(np.argmax(areas)) if start is None else _at(grid, parts, start, corner)
    region = _without_pinches(parts == chosen, labels == chosen)
    others = [
        (areas[i], i) for i in range(1, count + 1) if i != chosen and areas[i] * grid.resolution**2 > MENTIONED_M2
    ]

    _, holes = ndimage.label(~region, np.ones((3, 3)))
    bounded("obstacles in its free region", holes, MOST_CORNERS // 3, f"path: {grid.path!r}", "path")
    polygon = _simplified(_polygon(region), tolerance, grid)
    told = [_left_out(grid, labels, others, corner)]
    if small:
        told.append(f"{len(small)} groups of cells smaller than {speck * grid.resolution:g} m count as free")
    to_wall = np.full(np.add(grid.cells.shape, 2), np.inf)
    to_wall[top : bottom + 3, left : right + 3] = (
        ndimage.distance_transform_edt(~occupied) if occupied.any() else np.inf
    )
    return Region(
        shapely.transform(polygon, lambda at: at + corner), to_wall[1:-1, 1:-1], "; ".join(filter(None, told))
    )


def _at(grid: OccupancyGrid, parts: IntArray, start: tuple[float, ...], corner: IntArray) -> int:
    """Label (number) of the connected part of the free cells that contains the point `start`.

    `parts` has the label of each cell in a section of the map. `corner` is the column and row, in the map, of the first
    cell of this section. `start` is in the frame of the map, metres.
    """
    column, row = np.floor(grid.in_cells(np.array(start)) - corner).astype(int)
    inside = 0 <= row < parts.shape[0] and 0 <= column < parts.shape[1]
    if not inside or not parts[row, column]:
        raise InputError(
            f"start = {list(start)} is not in a free cell of {grid.path!r}, or passage is too wide there.", "start"
        )
    return int(parts[row, column])


def _left_out(grid: OccupancyGrid, labels: IntArray, others: list[tuple[int, int]], corner: IntArray) -> str:
    if not others:
        return ""
    _, largest = max(others)
    rows, columns = np.nonzero(labels == largest)
    middle = len(rows) // 2
    x, y = grid.in_map(np.array([columns[middle], rows[middle]]) + 0.5 + corner)
    area = grid.resolution**2 * sum(size for size, _ in others)
    many = (
        f"{len(others)} free areas, {area:.3g} m2 in all, are"
        if len(others) > 1
        else f"a free area of {area:.3g} m2 is"
    )
    return f"{many} left out; start = [{x:.2f},{y:.2f}] takes the {'largest' if len(others) > 1 else 'one'} of them"


def _without_pinches(region: BoolArray, core: BoolArray) -> BoolArray:
    """Remove cells from a region until no two cells touch only at a corner; return the mask of its cells.

    So the border of the region does not touch itself. Parts that are not connected to the cells `core` are dropped.
    """
    from scipy import ndimage

    while True:
        labels, _ = ndimage.label(region)
        region = np.isin(labels, np.setdiff1d(np.unique(labels[core]), [0]))
        a, b, c, d = region[:-1, :-1], region[:-1, 1:], region[1:, :-1], region[1:, 1:]
        falling, rising = a & d & ~b & ~c, b & c & ~a & ~d
        if not (falling | rising).any():
            return region
        region = region.copy()
        region[1:, 1:][falling] = False
        region[1:, :-1][rising] = False


def _polygon(region: BoolArray) -> Any:
    """Union of the cells of a connected mask: a shapely polygon whose unit of length is a cell."""
    import shapely

    change = np.diff(np.pad(region.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (rows, starts), (_, stops) = np.nonzero(change == 1), np.nonzero(change == -1)
    return shapely.union_all(shapely.box(starts, rows, stops, rows + 1))


def _simplified(polygon: Any, tolerance: float, grid: OccupancyGrid) -> Any:
    """Simplify a polygon that is a union of cells; return a polygon with fewer vertices.

    The edges of the result are at most `tolerance`, in cells, from the border of the given polygon. The rings of the
    result do not touch each other.
    """
    import shapely

    contours = []
    for ring in (polygon.exterior, *polygon.interiors):
        vertices = np.array(ring.coords[:-1])
        # The simplification keeps the first vertex, so this vertex must be a corner.
        first = np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1))
        contours.append(np.roll(vertices, -first, axis=0))
    asked = tolerance
    sides = [np.ptp(contour, axis=0).min() for contour in contours]
    while True:
        simple, fitted = [], []
        for contour, side in zip(contours, sides, strict=True):
            own = min(tolerance, PILLAR_SHARE * side)
            corners = shapely.get_coordinates(shapely.simplify(shapely.Polygon(contour), own))[:-1]
            simple.append(corners)
            if (count := sum(map(len, simple))) > MOST_CORNERS:
                raise InputError(
                    f"tolerance = {asked * grid.resolution:g} leaves {count} or more corners of {grid.path!r}, but at "
                    f"most {MOST_CORNERS} are allowed; raise tolerance, speck or passage.",
                    "tolerance",
                )
            fitted.append(_fitted(corners, contour, own))
        for exterior, *holes in (fitted, simple):
            found = shapely.Polygon(exterior, holes)
            rings = [found.exterior, *found.interiors]
            touching = shapely.STRtree(rings).query(rings, predicate="intersects")
            if found.is_valid and touching.shape[1] == len(rings):
                return shapely.orient_polygons(found)
        tolerance /= 2.0


def _fitted(simple: FloatArray, contour: FloatArray, tolerance: float) -> FloatArray:
    """Fit the edges of a ring to a contour by least squares; return the vertices of the fitted ring, `(N, 2)`.

    A vertex is not moved if an edge of the ring would then be farther than the tolerance from the contour.

    Args:
        simple: vertices of the ring, a subset of the contour's vertices, `(N, 2)`.
        contour: vertices of the contour, `(M, 2)`.
        tolerance: greatest distance of the contour from an edge, cells.
    """
    import shapely

    index = {tuple(vertex): i for i, vertex in enumerate(contour.tolist())}
    first = [index[tuple(vertex)] for vertex in simple.tolist()]
    samples, middles, ways = [], np.empty_like(simple), np.empty_like(simple)
    for k, (start, stop) in enumerate(zip(first, np.roll(first, -1).tolist(), strict=True)):
        along = contour[np.arange(start, stop + (len(contour) if stop <= start else 0) + 1) % len(contour)]
        points = shapely.get_coordinates(shapely.segmentize(shapely.LineString(along), 0.5))
        centred = (points[1:] + points[:-1]) / 2.0
        away = np.linalg.norm(centred[:, None] - along[[0, -1]], axis=-1).min(axis=1)
        inner = away > tolerance  # points away from corners, as corners are known only within the tolerance
        centred = centred[inner] if inner.mean() > 0.5 else centred
        middles[k] = centred.mean(axis=0)
        ways[k] = np.linalg.svd(centred - middles[k], full_matrices=False)[2][0]
        samples.append(shapely.points(points))
    moved = simple.copy()
    for k, vertex in enumerate(simple):
        (a, b), (u, v) = middles[[k - 1, k]], ways[[k - 1, k]]
        across = u[0] * v[1] - u[1] * v[0]
        if abs(across) > LEAST_ANGLE_SINE:
            moved[k] = a + u * ((b - a)[0] * v[1] - (b - a)[1] * v[0]) / across
        else:
            moved[k] = (a + u * ((vertex - a) @ u) + b + v * ((vertex - b) @ v)) / 2.0
    kept = np.linalg.norm(moved - simple, axis=1) > tolerance
    while True:
        ring = np.where(kept[:, None], simple, moved)
        far = np.array(
            [shapely.distance(shapely.LineString(e), at).max() for e, at in zip(edges(ring), samples, strict=True)]
        )
        late = (far > tolerance + ROUNDING) & ~(kept & np.roll(kept, -1))
        if not late.any():
            return ring
        kept |= late | np.roll(late, 1)


def _gaps(edge: FloatArray, to_wall: FloatArray, most: float, shortest: float) -> list[tuple[float, float]]:
    """Find the parts of a floor plan's edge that are farther than `most` cells from the nearest occupied cell.

    Args:
        edge: ends of the edge, in cells, `(2, 2)`.
        to_wall: distance of each cell from the nearest occupied cell, in cells, `(H, W)`.
        most: distance, in cells.
        shortest: least length of a part, in cells; shorter parts are omitted, unless the part is the whole edge.

    Returns:
        start and end of each part, in cells from the start of the edge.
    """
    length = float(np.linalg.norm(edge[1] - edge[0]))
    count = max(math.ceil(2.0 * length), 1)
    share = (np.arange(count) + 0.5) / count
    at = np.floor(edge[0] + share[:, None] * (edge[1] - edge[0])).astype(int)
    high = np.array(to_wall.shape)[::-1] - 1
    column, row = np.clip(at, 0, high).T
    steps = np.diff(np.concatenate([[0], (to_wall[row, column] > most).astype(int), [0]]))
    starts, stops = (np.flatnonzero(steps == way) * length / count for way in (1, -1))
    whole = [(0.0, length)] if len(starts) and stops[0] - starts[0] == length else []
    return whole or [(float(a), float(b)) for a, b in zip(starts, stops, strict=True) if b - a >= shortest]
