"""First page of the mounting plan: floor plan of the room with symbols, and the order in which tags are hung."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.export.paper import LINE, fill_polygon, polygon, shortened, width_of, write_on_white, write_text
from lmd.formats.tag_map import TagMap
from lmd.space.fixture import KINDS
from lmd.space.space import Space, outwards
from lmd.space.surface import FLAT

HATCH = 2.0  # distance between the hatch lines of furniture, mm
NAME = 2.4  # size of letters, mm
WALL = 0.7  # width of the line of a wall on a floor plan, mm


def draw_fixture(canvas: Any, kind: str, ring: FloatArray, name: str = "") -> None:
    """Draw a fixture with its `name`; its outline has the vertices `ring` `(N, 2)` on the page, mm.

    A door has two diagonals to the middle of its right side, a window has a cross, furniture is hatched, and other
    fixtures have only an outline.
    """
    (left, bottom), (right, top) = ring.min(axis=0).tolist(), ring.max(axis=0).tolist()
    middle = (left + right) / 2.0, (bottom + top) / 2.0
    canvas.saveState()
    canvas.clipPath(polygon(canvas, ring.tolist()), stroke=0, fill=0)
    for line in _lines(kind, left, bottom, right, top):
        canvas.line(*line)
    canvas.restoreState()
    canvas.setLineWidth(2.0 * LINE)
    canvas.drawPath(polygon(canvas, ring.tolist()), stroke=1, fill=0)
    canvas.setLineWidth(LINE)
    if name:
        write_on_white(canvas, *middle, shortened(name), size=NAME)


def _lines(kind: str, left: float, bottom: float, right: float, top: float) -> list[tuple[float, float, float, float]]:
    across, up = (left + right) / 2.0, (bottom + top) / 2.0
    if kind == "door":
        return [(left, bottom, right, up), (left, top, right, up)]
    if kind == "window":
        return [(left, up, right, up), (across, bottom, across, top)]
    if kind == "furniture":
        height = top - bottom
        return [(x, bottom, x + height, top) for x in np.arange(left - height, right, HATCH).tolist()]
    return []


def draw_opening(canvas: Any, kind: str, ends: FloatArray) -> None:
    """Draw a door, a window or another fixture of a wall, seen from above, between its `ends` `(2, 2)` on the page, mm.

    A door is a gap in the wall, a window is two lines, and another fixture is a broken line.
    """
    (x, y), (x_end, y_end) = ends.tolist()
    canvas.saveState()
    canvas.setStrokeGray(1.0)
    canvas.setLineWidth(2.0 * WALL)
    canvas.line(x, y, x_end, y_end)
    canvas.restoreState()
    along = np.array([x_end - x, y_end - y]) / max(np.hypot(x_end - x, y_end - y), 1e-9)
    aside = WALL * np.array([-along[1], along[0]])
    canvas.saveState()
    for way in {"window": (-0.7, 0.7), "door": ()}.get(kind, (0.0,)):
        if kind != "window":
            canvas.setDash(1.0, 0.7)
        canvas.line(*(ends[0] + way * aside).tolist(), *(ends[1] + way * aside).tolist())
    canvas.restoreState()
    for end in ends:
        canvas.line(*(end - 1.5 * aside).tolist(), *(end + 1.5 * aside).tolist())


def draw_legend(canvas: Any, x: float, y: float, kinds: Sequence[str]) -> None:
    """Draw a floor plan's legend on one line from (x, y), mm: the symbols and names of the fixture `kinds`."""
    for kind in kinds:
        if kind == "furniture":
            draw_fixture(canvas, kind, np.array([(x, y), (x + 6.0, y), (x + 6.0, y + 3.0), (x, y + 3.0)]))
        else:
            canvas.setLineWidth(WALL)
            canvas.line(x, y + 1.0, x + 8.0, y + 1.0)
            canvas.setLineWidth(LINE)
            draw_opening(canvas, kind, np.array([(x + 2.0, y + 1.0), (x + 6.0, y + 1.0)]))
        write_text(canvas, x + 10.0, y, kind, size=NAME)
        x += 14.0 + width_of(kind, NAME)


# On the page, mm.
AROUND = 11.0  # width of the border around the room, for names
NAME_GAP, OUTER_NAME_GAP = 3.0, 6.0  # distance of a name from its wall, inside and outside of the room
# Shifts of a name to avoid other texts: away from its wall and along the wall, the shortest first.
SHIFTS = np.stack(np.meshgrid(np.arange(-6.0, 21.0, 1.5), np.arange(-20.0, 21.0, 2.5)), axis=-1).reshape(-1, 2)
SHIFTS = SHIFTS[np.argsort(np.abs(SHIFTS).sum(axis=1), kind="stable")]
TAG, ID = 1.8, 2.0  # height of the triangle of a tag, and of the letters of its id
IDS_STEPS = 8  # number of places that are tried for ids in front of a tag
MANY = 1000  # number of edges; rooms with more edges are drawn with thinner lines
ARROW = 6.3  # length of the arrows of the axes


def scale_of(room: Space, width: float, height: float, scales: tuple[int, ...]) -> int:
    """The number s of the scale 1 : s of the floor plan on the page.

    The number is the first of `scales` at which the plan fits into `width` x `height`, mm, or the last if none fits.
    """
    low, high = room.bounds()
    across, up = (1000.0 * (high - low)[:2]).tolist()
    fits = [one for one in scales if across <= one * (width - 2.0 * AROUND) and up <= one * (height - 2.0 * AROUND)]
    return fits[0] if fits else scales[-1]


def draw_floor_plan(canvas: Any, tags: TagMap, left: float, top: float, scale: int) -> Callable[..., FloatArray]:
    """Draw the room from above, with tags and names; x is to the right.

    Args:
        canvas: canvas of the page.
        tags: the tags and their room.
        left, top: upper left corner of the plan on the page, mm.
        scale: s of the scale 1 : s.

    Returns:
        function that maps points in the world frame, metres, `(..., 3)`, to the page, mm, `(..., 2)`.
    """
    import shapely

    low, high = tags.room.bounds()
    origin = np.array([left + AROUND, top - AROUND - 1000.0 * (high - low)[1] / scale])

    def place(points: FloatArray) -> FloatArray:
        return np.asarray(origin + 1000.0 * (np.asarray(points)[..., :2] - low[:2]) / scale)

    fixtures = tags.fixtures
    bodies = [fixture for fixture in fixtures if fixture.kind == "furniture"]
    openings = [fixture for fixture in fixtures if fixture.kind != "furniture"]
    for body in bodies:
        draw_fixture(canvas, body.kind, place(np.array(body.footprint.exterior.coords[:-1])))
    drawn = place(tags.room.outline()["room"])
    canvas.setLineWidth(2.0 * LINE if len(drawn) < MANY else LINE / 2.0)
    for start, end in drawn.tolist():
        canvas.line(*start, *end)
    upright = [surface for surface in tags.room.surfaces() if abs(surface.normal[2]) <= FLAT]
    canvas.setLineWidth(WALL)
    taken: list[Any] = []
    for surface in upright:
        start, end = place(surface.point(np.array([0.0, surface.extent[0]]), np.zeros(2))).tolist()
        canvas.line(*start, *end)
        taken.append(shapely.LineString([start, end]))
    canvas.setLineWidth(LINE)
    for opening in openings:
        ends = place(_ends(opening.footprint))
        draw_opening(canvas, opening.kind, ends)
        wall = next((surface for surface in upright if opening.on(surface).area > 0.0), None)
        way = np.array([0.0, 1.0]) if wall is None else outwards(tags.room, wall)
        _write_along(canvas, shortened(opening.name), ends, way, NAME_GAP, taken)
    for body in bodies:
        x, y = place(body.corners).mean(axis=0).tolist()
        write_on_white(canvas, x, y, shortened(body.name), size=NAME)
    ids: dict[tuple[float, ...], list[int]] = {}  # one text for tags above each other
    for number, at, normal in zip(tags.ids, place(tags.deployment.positions), tags.deployment.normals, strict=True):
        _draw_tag(canvas, at, normal)
        front = np.array([0.0, -1.0]) if abs(normal[2]) > FLAT else normal[:2] / np.linalg.norm(normal[:2])
        ids.setdefault((*np.round(at), *np.round(front, 3), np.sign(normal[2].round(3))), []).append(number)
    for (x, y, *front_xy, _), numbers in ids.items():
        _write_ids(canvas, ", ".join(map(str, sorted(numbers))), np.array([x, y]), np.array(front_xy), taken)
    hung = {index: numbers_of(own) for index, own in tags.tags_by_surface.items() if index >= 0}
    # Names of surfaces with tags come first; other names are left out if there is no room for them.
    for index in sorted(range(len(tags.room.surfaces())), key=lambda index: index not in hung):
        surface = tags.room.surfaces()[index]
        if abs(surface.normal[2]) > FLAT:
            continue
        # A surface without tags needs no name if it belongs to a named fixture.
        own = any(fixture.name == surface.name or fixture.has(surface) for fixture in fixtures)
        if own and index not in hung:
            continue
        ends = place(surface.point(np.array([0.0, surface.extent[0]]), np.zeros(2)))
        text = shortened(tags.names[index]) + (f": no. {hung[index]}" if index in hung else "")
        way = surface.normal[:2] if own else outwards(tags.room, surface)
        beside = any(fixture.on(surface).area > 0.0 for fixture in openings if not fixture.has(surface))
        away = OUTER_NAME_GAP if beside and not own else NAME_GAP
        _write_along(canvas, text, ends, way, away, taken, bold=True, needed=index in hung)
    below = float(origin[1]) - AROUND
    kinds = [kind for kind in KINDS if any(fixture.kind == kind for fixture in fixtures)]
    for angle, name in ((0.0, "x"), (math.pi / 2.0, "y")):
        draw_arrow(canvas, left, below - 2.0, ARROW, angle, name)
    draw_legend(canvas, left + 16.0, below, kinds)
    return place


def numbers_of(places: IntArray) -> str:
    """Text such as `3 to 7` for tags that follow one another in the order of hanging, or `3` for a single tag.

    `places` are the positions of the tags in this order, from 0 on and ascending; the text counts from 1.
    """
    first, last = int(places[0]) + 1, int(places[-1]) + 1
    return f"{first}" if first == last else f"{first} to {last}"


def _ends(footprint: Any) -> FloatArray:
    """The two vertices of a shapely line or polygon that are farthest from each other, `(2, 2)`."""
    corners = np.array(getattr(footprint, "exterior", footprint).coords)
    distance = np.linalg.norm(corners[:, None] - corners, axis=-1)
    return corners[list(np.unravel_index(distance.argmax(), distance.shape))]


def _write_along(
    canvas: Any,
    text: str,
    ends: FloatArray,
    way: FloatArray,
    away: float,
    taken: list[Any],
    bold: bool = False,
    needed: bool = True,
) -> None:
    """Write a text beside a line with the ends `ends` `(2, 2)`, mm, on the side to which the unit vector `way` points.

    The text is at the distance `away` from the line, mm. The text is parallel to the line, or horizontal if the line is
    too short. A text that would overlap a shape in `taken` is shifted; after a long shift, a thin line connects text
    and line. A text without free space nearby is left out, unless `needed` is True. The box of the text is added to
    `taken`.
    """
    import shapely

    length, width = float(np.linalg.norm(ends[1] - ends[0])), width_of(text, NAME, bold)
    middle, turn = ends.mean(axis=0) + away * way, 0.0
    if width <= length + 2.0 * away:
        turn = math.degrees(math.atan2(*(ends[1] - ends[0])[::-1]))
        turn = (turn + 80.0) % 180.0 - 80.0  # no text is upside down; on nearly parallel walls texts run alike
    else:
        middle = middle + abs(way[0]) * (width - NAME) / 2.0 * way
    box = shapely.affinity.rotate(shapely.box(-width / 2.0, -NAME / 2.0, width / 2.0, NAME / 2.0), turn, origin=(0, 0))
    others, shifts = np.array(taken), SHIFTS if needed else SHIFTS[np.linalg.norm(SHIFTS, axis=1) <= NAME]
    for shift in shifts @ np.array([way, [-way[1], way[0]]]):
        if not shapely.intersects(others, shapely.affinity.translate(box, *(middle + shift))).any():
            break
    else:
        if not needed:
            return
        shift = np.zeros(2)
    if np.linalg.norm(shift) > NAME:
        canvas.line(*ends.mean(axis=0).tolist(), *(middle + shift - 0.5 * NAME * way).tolist())
    taken.append(shapely.affinity.translate(box, *(middle + shift)))
    aside = 0.35 * NAME * np.array([math.sin(math.radians(turn)), -math.cos(math.radians(turn))])
    x, y = (middle + shift + aside).tolist()
    write_text(canvas, x, y, text, size=NAME, bold=bold, align="centre", turn=turn)


def _draw_tag(canvas: Any, at: FloatArray, normal: FloatArray) -> None:
    """Draw a tag at `at`, mm: a triangle for a tag on a wall, a filled square if it faces up, an empty one if down."""
    if abs(normal[2]) > FLAT:
        canvas.rect(*(at - TAG / 3.0).tolist(), TAG / 1.5, TAG / 1.5, stroke=1, fill=int(normal[2] > 0.0))
        return
    out = normal[:2] / np.linalg.norm(normal[:2])
    beside = np.array([-out[1], out[0]]) * TAG / 2.0
    fill_polygon(canvas, [(at + beside).tolist(), (at - beside).tolist(), (at + TAG * out).tolist()])


def _write_ids(canvas: Any, text: str, at: FloatArray, way: FloatArray, taken: list[Any]) -> None:
    """Write ids in front of a tag at `at`, on the side to which `way` points.

    If possible, the ids overlap none of the shapes in `taken`. The box of the ids is added to `taken`.
    """
    import shapely

    half = np.array([width_of(text, ID), ID]) / 2.0
    for step in range(IDS_STEPS):
        low = at + (TAG + 0.1 * ID + step * ID + np.abs(way) @ half) * way - half
        box = shapely.box(*low, *(low + 2.0 * half))
        if not shapely.intersects(np.array(taken), box).any():
            break
    taken.append(box)
    write_text(canvas, low[0] + half[0], low[1] + 0.15 * ID, text, size=ID, align="centre")


def draw_arrow(canvas: Any, x: float, y: float, length: float, angle: float, name: str) -> None:
    """Draw an arrow from (x, y), at `angle` from the page's x axis, rad, with a name beyond its tip."""
    canvas.saveState()
    canvas.translate(x, y)
    canvas.rotate(math.degrees(angle))
    canvas.line(0.0, 0.0, length, 0.0)
    fill_polygon(canvas, [(length, 0.0), (length - 2.0, 0.8), (length - 2.0, -0.8)])
    canvas.restoreState()
    beyond = length + NAME
    place = x + beyond * math.cos(angle), y + beyond * math.sin(angle) - 0.35 * NAME
    write_text(canvas, *place, name, size=NAME, bold=True, align="centre")
