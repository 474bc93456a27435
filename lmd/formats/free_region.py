"""Floor plan of the free region of an occupancy grid."""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, real, vector
from lmd.formats.occupancy_grid import OccupancyGrid, read_occupancy_grid
from lmd.space.parts import check_metres
from lmd.space.polygon import edges
from lmd.space.prism import Prism, from_floor_plan
from lmd.space.relevance import Relevance

# Least area of a free region that a note mentions, square metres.
MENTIONED_M2 = 0.5
# Shortest stretch of an edge without occupied cells that excludes landmarks, metres; a wall has shorter gaps by chance.
SHORTEST_GAP_M = 0.2
# Greatest number of corners; a run with more would take hours.
MOST_CORNERS = 4000


class Region(NamedTuple):
    """Free region of a map, in cells from the corner of cell (0, 0)."""

    polygon: Any
    """Region with its holes, a shapely polygon."""
    to_wall: FloatArray
    """Distance of the centre of each cell to that of the nearest occupied cell, cells, `(H, W)`."""
    note: str
    """Sentence on the parts of the map that are left out."""


def read_map_room(
    path: Any,
    height: Any,
    reachable: Any,
    spacing: Any,
    tolerance: float = 0.1,
    speck: float = 0.2,
    passage: float = 0.3,
    start: Any = None,
    surfaces: Any = None,
    keep_out: Any = (),
    margin: float = 0.0,
    positions: str = "cells",
    relevance: Relevance | None = None,
    **plan: Any,
) -> Prism:
    """Room over the free region of an occupancy grid, in the frame of the map.

    Args:
        path: YAML file of the map.
        height: see `FloorPlan`.
        reachable, spacing, positions, relevance: see `Prism`.
        tolerance: greatest distance of a wall from the contour of the cells, metres.
        speck: groups of cells that are not free count as free if both sides are shorter than this, metres.
        passage: parts of the free region that are narrower than this, metres, are left out.
        start: point (x, y) of the map frame in the region, metres; None for the largest region.
        margin: see `FloorPlan`.
        surfaces: see `FloorPlan`; None for all walls with occupied cells.
        keep_out: see `FloorPlan`, in addition to stretches without occupied cells.
        plan: further arguments of `FloorPlan`.

    Raises:
        InputError: the file or a value is refused, or there is no free region.
    """
    grid, height, margin = read_occupancy_grid(path), real("height", height, above=0.0), real("margin", margin, low=0.0)
    region = free_region(
        grid,
        real("tolerance", tolerance, above=0.0) / grid.resolution,
        real("speck", speck, low=0.0) / grid.resolution,
        real("passage", passage, low=0.0) / grid.resolution,
        None if start is None else vector("start", start, 2),
    )
    holes = [np.array(ring.coords[:0:-1]) for ring in region.polygon.interiors]
    rings = [np.array(region.polygon.exterior.coords[:-1]), *holes]
    corners = sum(map(len, rings))
    if corners > MOST_CORNERS:
        raise InputError(
            f"tolerance = {tolerance:g} leaves {corners} corners of {str(path)!r}, more than {MOST_CORNERS}; a larger "
            "tolerance, speck or passage leaves fewer.",
            "tolerance",
        )
    names = ["wall_{}", *(f"hole_{i}_wall_{{}}" for i in range(len(rings) - 1))]
    walls: list[str] = []
    beyond: list[dict[str, Any]] = []
    for i, (ring, name) in enumerate(zip(rings, names, strict=True)):
        for j, edge in enumerate(edges(ring)):
            spans = _gaps(edge, region.to_wall, tolerance / grid.resolution + 1.5, SHORTEST_GAP_M / grid.resolution)
            length = float(np.linalg.norm(edge[1] - edge[0]))
            bare = np.diff([0.0, *(end for span in spans for end in span), length])[::2]
            if grid.resolution * bare.max() <= 2.0 * margin:
                continue
            walls.append(name.format(j))
            for span in spans:
                # The left end of a wall, as seen from the room, is the end of an edge of the outline.
                a, b = span if i else (length - span[1], length - span[0])
                left = [grid.resolution * a, grid.resolution * b]
                beyond.append({"surface": walls[-1], "from_left": left, "from_below": [0.0, height], "name": "no wall"})
    if not walls:
        raise InputError(f"path: {str(path)!r} has no walls around its free region, on which landmarks could hang.", "path")
    outline, *pillars = (grid.in_map(ring).tolist() for ring in rings)
    check_metres(
        [*np.ptp(np.array(outline), axis=0), height],
        f"path: {str(path)!r} with resolution = {grid.resolution:g} makes",
        "the resolution is in metres per pixel",
        "path",
    )
    return from_floor_plan(
        outline,
        height,
        reachable,
        spacing,
        positions,
        relevance,
        holes=pillars,
        surfaces=walls if surfaces is None else surfaces,
        keep_out=[*beyond, *keep_out],
        margin=margin,
        note="; ".join(filter(None, [grid.note, region.note])),
        **plan,
    )


def free_region(
    grid: OccupancyGrid, tolerance: float, speck: float, passage: float, start: tuple[float, ...] | None
) -> Region:
    """Find the free region of a map.

    Args:
        grid: map.
        tolerance, speck, passage: as in `read_map_room`, in cells.
        start: as in `read_map_room`.
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
    small = [i for i, box in enumerate(ndimage.find_objects(labels), 1) if _longest(box) < speck]
    specks = np.isin(labels, small)
    free, occupied = free | specks, occupied & ~specks

    radius = passage / 2.0
    core = free & (ndimage.distance_transform_edt(free) >= radius)
    labels, count = ndimage.label(core)
    if not count:
        raise InputError(f"passage is wider than every free region of {grid.path!r}.", "passage")
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    chosen = int(np.argmax(areas)) if start is None else _at(grid, labels, free, start, corner, radius)
    # A right-angled corner of the region is sqrt(2) radii from the core.
    region = free & (ndimage.distance_transform_edt(labels != chosen) <= math.sqrt(2.0) * radius)
    region = _without_pinches(region, labels == chosen)
    others = [(areas[i], i) for i in range(1, count + 1) if i != chosen and areas[i] * grid.resolution**2 > MENTIONED_M2]

    polygon = _simplified(_polygon(region), tolerance)
    told = [_left_out(grid, labels, others, corner)]
    if small:
        told.append(f"{len(small)} groups of cells smaller than {speck * grid.resolution:g} m count as free")
    note = f"{grid.path}: {'; '.join(filter(None, told))}" if any(told) else ""
    to_wall = np.full(np.add(grid.cells.shape, 2), np.inf)
    to_wall[top : bottom + 3, left : right + 3] = (
        ndimage.distance_transform_edt(~occupied) if occupied.any() else np.inf
    )
    return Region(shapely.transform(polygon, lambda at: at + corner), to_wall[1:-1, 1:-1], note)


def _longest(box: tuple[slice, ...]) -> int:
    return max(side.stop - side.start for side in box)


def _at(
    grid: OccupancyGrid, labels: IntArray, free: BoolArray, start: tuple[float, ...], corner: IntArray, radius: float
) -> int:
    """Label of the core nearest to a point in a free cell."""
    at = grid.in_cells(np.array(start)) - corner
    column, row = np.floor(at).astype(int)
    inside = 0 <= row < free.shape[0] and 0 <= column < free.shape[1]
    if not inside or not free[row, column]:
        raise InputError(f"start = {list(start)} is not in a free cell of {grid.path!r}.", "start")
    rows, columns = np.nonzero(labels)
    away = np.hypot(rows - row, columns - column)
    nearest = int(np.argmin(away))
    if away[nearest] > math.sqrt(2.0) * radius + 1.0:
        raise InputError(f"start = {list(start)} is in a part of {grid.path!r} that is narrower than passage.", "start")
    return int(labels[rows[nearest], columns[nearest]])


def _left_out(grid: OccupancyGrid, labels: IntArray, others: list[tuple[int, int]], corner: IntArray) -> str:
    if not others:
        return ""
    _, largest = max(others)
    rows, columns = np.nonzero(labels == largest)
    middle = len(rows) // 2
    x, y = grid.in_map(np.array([columns[middle], rows[middle]]) + 0.5 + corner)
    area = grid.resolution**2 * sum(size for size, _ in others)
    many = f"{len(others)} free areas, {area:.3g} m2 in all, are" if len(others) > 1 else f"a free area of {area:.3g} m2 is"
    return f"{many} left out; room.start=[{x:.2f},{y:.2f}] takes the {'largest' if len(others) > 1 else 'one'} of them"


def _without_pinches(region: BoolArray, core: BoolArray) -> BoolArray:
    """Part of a region that is connected to its core, without pairs of cells that only share a corner."""
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
    """Union of the cells of a connected mask, a shapely polygon in cells."""
    import shapely

    change = np.diff(np.pad(region.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (rows, starts), (_, stops) = np.nonzero(change == 1), np.nonzero(change == -1)
    return shapely.union_all(shapely.box(starts, rows, stops, rows + 1))


def _simplified(polygon: Any, tolerance: float) -> Any:
    """Polygon within `tolerance` of one of cells, whose rings do not touch."""
    import shapely

    while True:
        simple = shapely.orient_polygons(shapely.simplify(polygon, tolerance))
        rings = [simple.exterior, *simple.interiors]
        holes = shapely.STRtree(rings)
        pairs = holes.query(rings, predicate="intersects").T
        if simple.is_valid and (pairs[:, 0] == pairs[:, 1]).all():
            break
        tolerance /= 2.0
    return simple


def _gaps(edge: FloatArray, to_wall: FloatArray, most: float, shortest: float) -> list[tuple[float, float]]:
    """Stretches (from, to) of an edge, in cells from its start, that are farther than `most` cells from a wall."""
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
