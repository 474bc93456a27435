"""Floor plans in DXF drawings."""

import io
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, choice
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.formats.plans import ReadPlan, Stretch
from lmd.formats.registry import File
from lmd.space.polygon import edges

# Metres in the units that may be asked for, and their codes in $INSUNITS.
UNITS = {"metres": 1.0, "millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}
CODES = {1: "inches", 2: "feet", 4: "millimetres", 5: "centimetres", 6: "metres"}
# Names of layers and blocks in the languages of drawings.
WALL = re.compile(r"wall|wand|waende|wände|mauer|mur|pared|parede|vegg|vägg|стен|墙|壁", re.IGNORECASE)
DOOR = re.compile(r"door|tür|tuer|porte|puerta|porta(?!l)|двер|门|ドア", re.IGNORECASE)
WINDOW = re.compile(r"window|wind\b|glaz|fenster|fenêtre|fenetre|ventana|janela|окн|窗|窓", re.IGNORECASE)
SHAPES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
# Version of DXF that has subclasses.
NEWER = b"AC1015"
NESTED = ("INSERT", "MLINE")
# Half the thickness of lines, metres; walls move by it.
LINE_M = 1e-4
# Half the thickness of a wall that is a single line with the room on both sides, metres.
PARTITION_M = 0.01
# Greatest distance of a wall's face from the lines of walls, metres.
NEAR_M = 0.011
# Distance of the lines from the frame around them, metres.
FRAME_M = 10.0
# Growth of the box of a door or a window so that it meets its wall, metres.
BOX_M = 0.05
# Greatest width of a region that is the inside of a wall, metres.
THICKEST_M = 0.5
# Greatest number of segments of lines.
MOST_SEGMENTS = 50_000


class Drawing(NamedTuple):
    """Lines of a drawing, metres."""

    walls: Any
    """Lines of the walls, a shapely geometry."""
    windows: Any
    """Lines of the windows, which close gaps."""
    boxes: list[tuple[str, Any]]
    """Doors and windows that are blocks: `door` or `window`, and its box, a shapely polygon."""
    unit: str
    """Name of the unit."""
    note: str
    """Clause on the layers that are left out."""


def read_drawing(file: File) -> ReadPlan:
    """Read the room in a drawing, in its frame.

    Gaps between walls are closed by the straight lines between their ends. The room is a region that no line crosses,
    except those in the region, such as a pillar.

    Args:
        file: drawing; `asked` has `layers`, `unit`, `gap`, `tolerance` and `start` of `read_plan_room`.

    Raises:
        InputError: the file cannot be read, a layer is unknown, the unit is not known, or walls enclose no room.
    """
    import shapely

    drawing = _lines(file)
    room, others = _enclosed(file, drawing)
    room = room.buffer(LINE_M, join_style="mitre")
    partitions = drawing.walls.intersection(room.buffer(-2.0 * LINE_M))
    room = room.difference(partitions.buffer(PARTITION_M, cap_style="square", join_style="mitre"))
    room = max(shapely.get_parts(room), key=lambda part: float(part.area))
    room = shapely.orient_polygons(shapely.simplify(room, 4.0 * LINE_M))
    rings = [np.array(room.exterior.coords[:-1]), *(np.array(ring.coords[:0:-1]) for ring in room.interiors)]
    near = drawing.walls.buffer(NEAR_M)
    stretches = [
        Stretch(i, j, *span)
        for i, ring in enumerate(rings)
        for j, edge in enumerate(edges(ring))
        for span in _openings(edge, near, drawing.boxes)
    ]
    note = "; ".join(filter(None, [drawing.note, others]))
    return ReadPlan(rings, stretches, f"unit = {drawing.unit}", f"{file.path}: {note}" if note else "")


def _lines(file: File) -> Drawing:
    import shapely

    ezdxf = optional("ezdxf", "drawings")
    content = read_bytes(file.path, "path")
    if b"\0" in content and not content.startswith(b"AutoCAD Binary DXF"):
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF: it is neither text nor binary DXF.", "path")
    optional("ezdxf.recover", "drawings")
    try:
        document, _ = ezdxf.recover.read(io.BytesIO(_with_subclasses(content)))
        found = list(_shapes(document.modelspace()))
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, ezdxf.DXFError) as error:
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF ({error}).", "path") from None
    drawn = Counter(layer for kind, layer, _ in found if kind == "line")
    if not drawn:
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF: it has no lines.", "path")
    layers = _layers(file, drawn)
    unit = _unit(
        file, int(document.header.get("$INSUNITS", 0) or 0), [e for k, n, e in found if k == "line" and n in layers]
    )
    scale = UNITS[unit]
    paths: dict[str, list[FloatArray]] = {"line": [], "window": []}
    boxes = []
    for kind, layer, entity in found:
        if kind == "line" and layer not in layers:
            continue
        vertices = scale * _flattened(entity, file.asked["tolerance"] / scale)
        if kind in paths and len(vertices) > 1:
            paths[kind].append(vertices)
        if kind in ("door", "window") and len(vertices) > 1:
            boxes.append((kind, shapely.box(*vertices.min(axis=0), *vertices.max(axis=0))))
    count = sum(map(len, paths["line"]))
    if not count or count > MOST_SEGMENTS:
        raise InputError(
            f"path: {str(file.path)!r} has {count} lines of walls, and 1 to {MOST_SEGMENTS} are taken.", "path"
        )
    left = [f"{name} ({number})" for name, number in drawn.most_common() if name not in layers]
    note = f"walls are the lines of {', '.join(sorted(layers))}"
    note += f", without those of {', '.join(left[:8])}{' and more' if len(left) > 8 else ''}" if left else ""
    walls, windows = (shapely.MultiLineString(lines) for lines in paths.values())
    return Drawing(walls, windows, boxes, unit, note)


def _with_subclasses(content: bytes) -> bytes:
    """A drawing whose polylines have the marks of subclasses, which some programs leave out."""
    lines = content.replace(b"\r\n", b"\n").split(b"\n")
    if b"LWPOLYLINE" not in content or b"AcDbPolyline" in content:
        return content
    result, i = [], 0
    while i + 1 < len(lines):
        result += lines[i : i + 2]
        i += 2
        if lines[i - 1].strip() == b"LWPOLYLINE":
            own: dict[bool, list[bytes]] = {True: [], False: []}
            while i + 1 < len(lines) and lines[i].strip() != b"0":
                own[lines[i].strip() in (b"5", b"6", b"8", b"62")] += lines[i : i + 2]
                i += 2
            result += [b"100", b"AcDbEntity", *own[True], b"100", b"AcDbPolyline", *own[False]]
    text = b"\n".join([*result, b""]).replace(b"AC1009", NEWER)
    return text if b"$ACADVER" in text else b"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n" + NEWER + b"\n0\nENDSEC\n" + text


def _shapes(entities: Any, kind: str = "line", outer: str = "0") -> Iterator[tuple[str, str, Any]]:
    """Kind (`line`, `door` or `window`), layer and entity of the shapes of a drawing, also of those in blocks."""
    for entity in entities:
        layer = entity.dxf.layer if entity.dxf.layer != "0" else outer
        name = f"{layer} {entity.dxf.get('name', '')}" if entity.dxftype() == "INSERT" else layer
        own = "window" if WINDOW.search(name) else "door" if DOOR.search(name) else kind
        if entity.dxftype() in NESTED:
            yield from _shapes(entity.virtual_entities(), own, layer)
        elif entity.dxftype() in SHAPES:
            yield own, layer, entity


def _flattened(entity: Any, tolerance: float) -> FloatArray:
    """Vertices of a shape, `(N, 2)`, in the unit of the drawing."""
    make_path = optional("ezdxf.path", "drawings").make_path
    return np.array([[at.x, at.y] for at in make_path(entity).flattening(tolerance)]).reshape(-1, 2)


def _layers(file: File, drawn: Counter[str]) -> set[str]:
    """Names of the layers with walls."""
    asked = file.asked["layers"]
    if asked is not None:
        if isinstance(asked, str) or not all(isinstance(name, str) for name in asked):
            raise InputError(f"layers must be a list of names, got {asked!r}.", "layers")
        known = {name.lower(): name for name in drawn}
        for name in asked:
            choice("layers", name.lower(), list(known))
        return {known[name.lower()] for name in asked}
    named = {name for name in drawn if WALL.search(name)}
    if named or len(drawn) == 1:
        return named or set(drawn)
    told = ", ".join(f"{name} ({number} lines)" for name, number in drawn.most_common(12)) or "none"
    raise InputError(f"layers must name those with the walls of {str(file.path)!r}, which has {told}.", "layers")


def _unit(file: File, code: int, entities: list[Any]) -> str:
    if file.asked["unit"] is not None:
        return choice("unit", file.asked["unit"], list(UNITS))
    if code in CODES:
        return CODES[code]
    corners = np.concatenate([_flattened(entity, 1.0) for entity in entities])
    size = np.ptp(corners, axis=0)
    told = [f"{name} make {size[0] * per:.3g} x {size[1] * per:.3g} m" for name, per in UNITS.items()]
    raise InputError(
        f"unit is needed, as {str(file.path)!r} names none ($INSUNITS = {code}): {', '.join(told)}.", "unit"
    )


def _enclosed(file: File, drawing: Drawing) -> tuple[Any, str]:
    """Region of the room, a shapely polygon, and a clause on other regions."""
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
    count, gap = len(corners), file.asked["gap"]

    def labelled(passable: BoolArray) -> IntArray:
        pairs = (first[passable], second[passable])
        graph = coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count))
        return np.asarray(connected_components(graph, directed=False)[1])

    labels, area = labelled(length > gap), shapely.area(triangles)
    areas = np.bincount(labels, area)
    outside = labels[(corners == low).all(axis=2).any(axis=1)]
    areas[outside] = 0.0
    if file.asked["start"] is None:
        chosen = int(np.argmax(areas))
    else:
        at = np.flatnonzero(shapely.covers(triangles, shapely.Point(file.asked["start"])))
        chosen = int(labels[at[0]]) if len(at) else int(outside[0])
    # Parts behind a short line that lead nowhere else, such as a niche, belong to the room.
    is_small = (areas[labels] <= gap**2) & (labels != chosen) & ~np.isin(labels, outside)
    clusters = labelled(is_small[first] & is_small[second])
    beside = np.concatenate([np.stack([first, second], axis=1), np.stack([second, first], axis=1)])
    leads = is_small[beside[:, 0]] & ~is_small[beside[:, 1]] & (labels[beside[:, 1]] != chosen)
    meets = is_small[beside[:, 0]] & (labels[beside[:, 1]] == chosen)
    pockets = np.setdiff1d(clusters[beside[meets, 0]], clusters[beside[leads, 0]])
    inside = (labels == chosen) | (is_small & np.isin(clusters, pockets))
    room = max(shapely.get_parts(shapely.union_all(triangles[inside])), key=lambda part: float(part.area))
    if areas[chosen] == 0.0 or room.buffer(-THICKEST_M / 2.0).is_empty:
        where = "the walls" if file.asked["start"] is None else f"start = {list(file.asked['start'])}: the walls"
        raise InputError(
            f"path: {where} of {str(file.path)!r} enclose no room; a gap is wider than gap = {gap:g}, or walls are in "
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
    """Edges that two triangles `(T, 3, 2)` share: indices of both triangles, and lengths."""
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    swap = (sides[:, 0, 0] > sides[:, 1, 0]) | ((sides[:, 0, 0] == sides[:, 1, 0]) & (sides[:, 0, 1] > sides[:, 1, 1]))
    sides[swap] = sides[swap][:, ::-1]
    order = np.lexsort(sides.reshape(-1, 4).T)
    same = (sides[order[1:]] == sides[order[:-1]]).all(axis=(1, 2))
    pairs = np.stack([order[:-1][same], order[1:][same]])
    length = np.linalg.norm(sides[pairs[0], 1] - sides[pairs[0], 0], axis=1)
    return pairs[0] // 3, pairs[1] // 3, length


def _openings(edge: FloatArray, near: Any, boxes: list[tuple[str, Any]]) -> Iterator[tuple[float, float, str]]:
    """Start, end and name of the parts of an edge without a wall, and of those at a door or a window."""
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
