"""Search for the room that the lines of the walls in a drawing enclose."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, bounded
from lmd.space.blockers import edges

# Half the thickness given to lines, metres; walls move by this length.
LINE_M = 1e-4
# Half the thickness of a wall that is a single line with the room on both sides, metres.
PARTITION_M = 0.01
# Greatest distance of a wall's face from the lines of walls, metres.
NEAR_M = 0.011
# Distance of the lines from a frame that is drawn around all lines, metres.
FRAME_M = 10.0
# Growth of the box of a door or a window, so that the box meets the wall, metres.
BOX_M = 0.05
# Greatest width of a region that is taken for the inside of a wall, metres.
THICKEST_M = 0.5
# Greatest numbers: of lines of walls and windows (a hospital has 20,000), of pairs of lines that meet, and of pairs of
# lines that cross or overlap (a plan has few).
MOST_SEGMENTS, MOST_MEETINGS, MOST_CROSSINGS = 50_000, 1_000_000, 10_000


class Stretch(NamedTuple):
    """Part of an edge of a floor plan that must not carry landmarks, such as a door."""

    ring: int
    """Index of the ring: 0 for the outline, 1 for the first hole."""
    edge: int
    """Index of the edge in its ring."""
    start: float
    """Distance of the part's start from the first vertex of the edge, metres."""
    stop: float
    """Distance of the part's end from the first vertex of the edge, metres."""
    name: str
    """Name on drawings."""


class ReadPlan(NamedTuple):
    """Floor plan that was found in a file, such as a drawing or a map."""

    rings: Sequence[FloatArray]
    """Vertices of the outline and of the holes, counter-clockwise, metres, `(N, 2)` each."""
    stretches: Sequence[Stretch]
    """Parts of the walls that must not carry landmarks, such as doors."""
    scale: str
    """Text that states the unit of the file, such as `resolution = 0.05`, for messages."""
    note: str = ""
    """Remark on omitted or ambiguous parts, a sentence; empty without a remark."""

    @classmethod
    def of(
        cls, path: str, polygon: Any, openings: Callable[[FloatArray], Iterable[Any]], scale: str, *clauses: str
    ) -> "ReadPlan":
        """Make a floor plan from a shapely polygon with holes.

        Args:
            path: path of the file, for messages.
            polygon: outline and holes.
            openings: function that takes an edge `(2, 2)`, and returns start, end and name of each part of the edge
                that may not carry landmarks.
            scale: text that states the unit of the file, for messages.
            clauses: remarks, which are joined to one sentence in the field `note`; empty remarks are left out.
        """
        rings = [
            np.array(ring.coords[:-1]) for ring in (polygon.exterior, *(hole.reverse() for hole in polygon.interiors))
        ]
        each = ((i, j, edge) for i, ring in enumerate(rings) for j, edge in enumerate(edges(ring)))
        stretches = [Stretch(i, j, *span) for i, j, edge in each for span in openings(edge)]
        note = "; ".join(filter(None, clauses))
        return cls(rings, stretches, scale, f"{path}: {note}" if note else "")


class Drawing(NamedTuple):
    """Lines of a drawing, metres."""

    walls: Any
    """Lines of the walls, a shapely geometry."""
    windows: Any
    """Lines of the windows, which close gaps between walls."""
    boxes: list[tuple[str, Any]]
    """Doors and windows that are inserted in the drawing as blocks (symbols): for each, the word `door` or `window`,
    and its box, a shapely polygon.
    """
    unit: str
    """Name of the drawing's unit of length."""
    note: str
    """Clause of a message about the layers of the drawing that are not read."""


def plan_of(path: str, drawing: Drawing, gap: float, start: Sequence[float] | None) -> ReadPlan:
    """Find the room in a drawing; the plan is in the frame of the drawing.

    Gaps between walls are closed by the straight lines between their ends. The room is a region that no line crosses;
    lines inside the region, such as those of a pillar, are allowed.

    Args:
        path: path of the file, for messages.
        drawing: lines of the file.
        gap: widest gap between walls that is closed, metres.
        start: point inside the room, metres; None for the largest region.

    Raises:
        InputError: walls enclose no room, or there are too many lines.
    """
    import shapely

    _check_lines(f"path: {path!r}", drawing)
    room, others = _enclosed(path, drawing, gap, start)
    room = room.buffer(LINE_M, join_style="mitre")
    partitions = drawing.walls.intersection(room.buffer(-2.0 * LINE_M))
    room = room.difference(partitions.buffer(PARTITION_M, cap_style="square", join_style="mitre"))
    room = max(shapely.get_parts(room), key=lambda part: float(part.area))
    room = shapely.orient_polygons(shapely.simplify(room, 4.0 * LINE_M))
    near = drawing.walls.buffer(NEAR_M)
    unit = f"unit = {drawing.unit}"
    return ReadPlan.of(path, room, lambda edge: _openings(edge, near, drawing.boxes), unit, drawing.note, others)


def _check_lines(source: str, drawing: Drawing) -> None:
    """Raise `InputError` if a drawing has too many lines, or too many lines that meet."""
    import shapely

    at, of = shapely.get_coordinates(shapely.get_parts([drawing.walls, drawing.windows]), return_index=True)
    lines = shapely.linestrings(np.stack([at[:-1], at[1:]], axis=1)[of[:-1] == of[1:]])
    bounded("lines of walls and windows", len(lines), MOST_SEGMENTS, source, "path")
    tree, meetings, crossings = shapely.STRtree(lines), 0, 0
    for part in np.array_split(lines, 1 + len(lines) // 100):
        one, other = tree.query(part, predicate="intersects")
        meetings += len(one)
        bounded("meetings of two lines", meetings, MOST_MEETINGS, source, "path")
        crossings += int(np.count_nonzero(~shapely.touches(part[one], lines[other]))) - len(part)  # a line meets itself
        bounded("crossings of two lines", crossings // 2, MOST_CROSSINGS, source, "path")


def _enclosed(path: str, drawing: Drawing, gap: float, start: Sequence[float] | None) -> tuple[Any, str]:
    """Find the region of the room; the arguments are those of `plan_of`.

    Returns:
        shapely polygon of the region, and a remark about the largest other region, for messages; the remark may be
        empty.
    """
    import shapely
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    lines = shapely.union_all([drawing.walls, drawing.windows], grid_size=LINE_M)
    solid = lines.buffer(LINE_M, cap_style="square", join_style="mitre")
    low, high = np.array(lines.bounds[:2]) - FRAME_M, np.array(lines.bounds[2:]) + FRAME_M
    free = shapely.box(*low, *high).difference(solid)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(free))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    first, second, length = _shared(corners)
    count = len(corners)

    def labelled(passable: BoolArray) -> IntArray:
        pairs = (first[passable], second[passable])
        graph = coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count))
        return np.asarray(connected_components(graph, directed=False)[1])

    labels, area = labelled(length > gap), shapely.area(triangles)
    areas = np.bincount(labels, area)
    outside = labels[(corners == low).all(axis=2).any(axis=1)]
    areas[outside] = 0.0
    if start is None:
        chosen = int(np.argmax(areas))
    else:
        at = np.flatnonzero(shapely.covers(triangles, shapely.Point(start)))
        chosen = int(labels[at[0]]) if len(at) else int(outside[0])
    # Small parts that only a short line separates from the room belong to the room, such as a niche.
    is_small = (areas[labels] <= gap**2) & (labels != chosen) & ~np.isin(labels, outside)
    clusters = labelled(is_small[first] & is_small[second])
    beside = np.concatenate([np.stack([first, second], axis=1), np.stack([second, first], axis=1)])
    leads = is_small[beside[:, 0]] & ~is_small[beside[:, 1]] & (labels[beside[:, 1]] != chosen)
    meets = is_small[beside[:, 0]] & (labels[beside[:, 1]] == chosen)
    pockets = np.setdiff1d(clusters[beside[meets, 0]], clusters[beside[leads, 0]])
    inside = (labels == chosen) | (is_small & np.isin(clusters, pockets))
    room = max(shapely.get_parts(shapely.union_all(triangles[inside])), key=lambda part: float(part.area))
    if areas[chosen] == 0.0 or room.buffer(-THICKEST_M / 2.0).is_empty:
        where = "the walls" if start is None else f"start = {list(start)}: the walls"
        raise InputError(
            f"path: {where} of {path!r} do not enclose a room; a gap is wider than gap = {gap:g}, or walls are in "
            "another layer.",
            "path",
        )
    areas[chosen] = 0.0
    other = int(np.argmax(areas))
    if areas[other] <= gap**2:
        return room, ""
    x, y = corners[np.flatnonzero(labels == other)[0]].mean(axis=0)
    return room, f"a region of {areas[other]:.3g} m2 is left out: start = [{x:.2f},{y:.2f}] takes it"


def _shared(corners: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Find the edges that two of the triangles `(T, 3, 2)` share.

    Returns:
        for each shared edge, the index of one triangle, the index of the other triangle, and the length of the edge.
    """
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    swap = (sides[:, 0, 0] > sides[:, 1, 0]) | ((sides[:, 0, 0] == sides[:, 1, 0]) & (sides[:, 0, 1] > sides[:, 1, 1]))
    sides[swap] = sides[swap][:, ::-1]
    order = np.lexsort(sides.reshape(-1, 4).T)
    same = (sides[order[1:]] == sides[order[:-1]]).all(axis=(1, 2))
    pairs = np.stack([order[:-1][same], order[1:][same]])
    length = np.linalg.norm(sides[pairs[0], 1] - sides[pairs[0], 0], axis=1)
    return pairs[0] // 3, pairs[1] // 3, length


def _openings(edge: FloatArray, near: Any, boxes: list[tuple[str, Any]]) -> Iterator[tuple[float, float, str]]:
    """Yield start, end and name of each part of an edge that has no wall, or that has a door or window.

    Start and end are distances from the first vertex of the edge, metres. `near` is the area near the lines of walls,
    and `boxes` are the named boxes of doors and windows, see `Drawing.boxes`.
    """
    import shapely

    line, spans = shapely.LineString(edge), []
    for kind, box in [("", None), *boxes]:
        met = line.difference(near) if box is None else line.intersection(box.buffer(BOX_M))
        for part in shapely.get_parts(met)[~shapely.is_empty(shapely.get_parts(met))]:
            ends = shapely.line_locate_point(line, shapely.points(part.coords))
            if np.ptp(ends) > NEAR_M:
                name = kind or next((each for each, other in boxes if other.intersects(part)), "opening")
                spans.append((max(ends.min() - NEAR_M, 0.0), min(ends.max() + NEAR_M, line.length), name))
    reached = -1.0
    for start, stop, name in sorted(spans, key=lambda span: (span[0], -span[1])):
        if stop > reached:
            yield float(max(start, reached)), float(stop), name
            reached = stop
