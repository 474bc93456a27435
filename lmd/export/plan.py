"""The mounting plan: a page for each surface that carries tags, to scale, with a table of where they go."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmd.camera import MM_PER_M
from lmd.checks import FloatArray, IntArray
from lmd.export.paper import GREY, LINE, PAPERS, begin_page, document, fill_polygon, up_arrow, write_text
from lmd.export.tag_map import TagMap
from lmd.space.surface import Surface

# On the page, all in mm.
MARGIN = 12.0
HEAD = 18.0  # for the title
DIMENSION = 6.0  # from the surface to the lines that say how long it is
TICK = 1.5
TITLE, TEXT, SMALL = 5.0, 3.0, 2.4  # letters
TABLE, ROW = 82.0, 4.2  # width of the table, height of its rows
COLUMNS = (10.0, 28.0, 46.0, 64.0, 82.0)  # right ends of the columns
SCALES = (1, 2, 5, 10, 15, 20, 25, 30, 40, 50, 75, 100, 150, 200, 250, 500, 1000, 2000, 5000)
LIGHT = 0.85  # grey of black squares, and of lines below rows
FORBIDDEN = 0.94  # grey of where nothing may hang
LEVEL = 0.5  # a normal with a larger vertical part is that of a floor or a ceiling


@dataclass(frozen=True)
class View:
    """A surface as it looks to whoever stands before it, x to the right from its left edge, y up, metres."""

    surface: Surface

    @property
    def allowed(self) -> list[FloatArray]:
        """Polygons `(4, 2)` that together are where tags may hang."""
        return list(self.place(self.surface.point(*np.moveaxis(self.surface.parts, -1, 0))))

    @property
    def seen(self) -> str:
        """From where, in words."""
        up = self.surface.normal[2]
        return "seen from above" if up > LEVEL else "seen from below" if up < -LEVEL else "seen from the front"

    def place(self, points: FloatArray) -> FloatArray:
        """Where world points `(..., 3)` are in this view, `(..., 2)`."""
        return self.surface.seen(np.stack(self.surface.coordinates(points), axis=-1))

    def corner(self, right: bool, top: bool) -> FloatArray:
        """A corner of the surface in the world, `(3,)`."""
        width, height = self.surface.extent
        return self.surface.point(*self.surface.seen(np.array([width * right, height * top])))


def write_plan(path: Path, tags: TagMap, paper: str) -> None:
    """Write `plan.pdf`; tags that stand free in the room are a table at the end.

    Args:
        path: the file.
        tags: what is mounted.
        paper: one of `lmd.export.paper.PAPERS`, laid on its side.
    """
    size = PAPERS[paper][::-1]
    with document(path, f"{len(tags.ids)} tags in a {tags.room.describe()}") as canvas:
        for index, surface in enumerate(tags.room.surfaces()):
            own = _by_number(tags, np.flatnonzero(tags.surfaces == index))
            if own.size:
                _draw_surface(canvas, size, tags, View(surface), own)
        free = _by_number(tags, np.flatnonzero(tags.surfaces < 0))
        if free.size:
            _draw_free(canvas, size, tags, free)


def _by_number(tags: TagMap, chosen: IntArray) -> IntArray:
    return chosen[np.argsort(tags.deployment.ids[chosen])]


def _draw_surface(canvas: Any, size: tuple[float, float], tags: TagMap, view: View, own: IntArray) -> None:
    width, height = (MM_PER_M * length for length in view.surface.extent)
    room_x = size[0] - 3.0 * MARGIN - TABLE - DIMENSION - TEXT
    room_y = size[1] - 2.0 * MARGIN - HEAD - DIMENSION - TEXT
    scale = next((one for one in SCALES if width <= one * room_x and height <= one * room_y), SCALES[-1])
    title = f"{view.surface.name}, {view.seen}"
    facts = f"{width:.0f} x {height:.0f} mm, tags: {len(own)}, scale 1 : {scale}; {tags.room.describe()}"
    facts += "" if view.surface.allowed is None else "; nothing hangs where it is grey"
    at = MM_PER_M * view.place(tags.deployment.positions[own])
    paper = MM_PER_M * tags.tag.paper_edge
    rows = [
        [str(tags.ids[k]), *(f"{length:.0f}" for length in (*centre, *(centre - paper / 2.0)))]
        for k, centre in zip(own, at, strict=True)
    ]
    head = [["", "", "centre, mm", "", "lower left of paper, mm"], ["id", *2 * ("from left", "from below")]]
    _begin(canvas, size, title, facts)
    origin = MARGIN + DIMENSION + TEXT, size[1] - MARGIN - HEAD - height / scale
    _draw_outline(canvas, origin, view, scale)
    for k, centre in zip(own, at, strict=True):
        _draw_tag(canvas, origin, tags, int(k), centre, scale, at)
    while rows := _draw_table(canvas, size[0] - MARGIN - TABLE, size, head, rows):
        canvas.showPage()
        _begin(canvas, size, title, facts)
    canvas.showPage()


def _draw_free(canvas: Any, size: tuple[float, float], tags: TagMap, own: IntArray) -> None:
    positions = MM_PER_M * tags.deployment.positions[own]
    rows = [[str(tags.ids[k]), *(f"{value:.0f}" for value in place)] for k, place in zip(own, positions, strict=True)]
    while rows:
        _begin(canvas, size, "free in the room", f"on no surface, tags: {len(own)}; {tags.room.describe()}")
        rows = _draw_table(canvas, MARGIN, size, [["", "", "", "centre, mm"], ["id", "x", "y", "z"]], rows)
        canvas.showPage()


def _begin(canvas: Any, size: tuple[float, float], title: str, facts: str) -> None:
    begin_page(canvas, *size)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE, title, size=TITLE, bold=True)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE - 1.5 * TEXT, facts, size=TEXT)


def _draw_outline(canvas: Any, origin: tuple[float, float], view: View, scale: int) -> None:
    """The surface and where on it tags may hang, its width and height, and where its corners are in the world."""
    left, below = origin
    width, height = (MM_PER_M * length / scale for length in view.surface.extent)
    canvas.setFillGray(FORBIDDEN)
    canvas.rect(left, below, width, height, stroke=0, fill=1)
    canvas.setFillGray(1.0)
    for ring in view.allowed:
        fill_polygon(canvas, [(left + x, below + y) for x, y in MM_PER_M * ring / scale])
    canvas.setFillGray(0.0)
    canvas.setLineWidth(2.0 * LINE)
    canvas.rect(left, below, width, height)
    canvas.setLineWidth(LINE)
    _draw_dimension(canvas, left, below - DIMENSION, width, f"{view.surface.extent[0]:.3f} m")
    canvas.saveState()
    canvas.translate(left - DIMENSION, below + height)
    canvas.rotate(-90.0)
    _draw_dimension(canvas, 0.0, 0.0, height, f"{view.surface.extent[1]:.3f} m")
    canvas.restoreState()
    canvas.setFillGray(GREY)
    for right in (False, True):
        for top in (False, True):
            x, y, z = view.corner(right, top) + 0.0
            place = left + width * right, below + (height + SMALL / 3.0 if top else -SMALL)
            text = f"({x:.4g}, {y:.4g}, {z:.4g})"
            write_text(canvas, *place, text, size=SMALL, align="right" if right else "left")
    canvas.setFillGray(0.0)


def _draw_dimension(canvas: Any, x: float, y: float, length: float, text: str) -> None:
    """A line of this length with its ends marked, its text below the middle."""
    canvas.line(x, y, x + length, y)
    for end in (x, x + length):
        canvas.line(end, y - TICK, end, y + TICK)
    write_text(canvas, x + length / 2.0, y - TEXT, text, size=TEXT, align="centre")


def _draw_tag(
    canvas: Any, origin: tuple[float, float], tags: TagMap, k: int, centre: FloatArray, scale: int, at: FloatArray
) -> None:
    """Paper and black square, with a triangle that points up and the number, beside it where no other tag hides it."""
    x, y = origin + centre / scale
    plate, edge = (MM_PER_M * length / scale for length in (tags.tag.paper_edge, tags.tag.size))
    canvas.rect(x - plate / 2.0, y - plate / 2.0, plate, plate)
    canvas.setFillGray(LIGHT)
    canvas.rect(x - edge / 2.0, y - edge / 2.0, edge, edge, stroke=0, fill=1)
    canvas.setFillGray(0.0)
    if edge >= 2.0 * TEXT:
        up_arrow(canvas, x, y + 0.1 * edge, 0.3 * edge)
        write_text(canvas, x, y - 0.4 * edge, str(tags.ids[k]), size=TEXT, align="centre")
        return
    up_arrow(canvas, x, y - 0.3 * edge, 0.6 * edge)
    away = plate / 2.0 + SMALL  # from the tag's centre to the middle of its number
    places = np.array([(away, 0.0), (-away, 0.0), (0.0, away), (0.0, -away)])
    distance = np.abs(((at - centre) / scale)[:, None] - places).max(axis=2).min(axis=0)
    free = np.flatnonzero(distance > (plate + SMALL) / 2.0)
    right, up = places[free[0] if free.size else 0]
    write_text(canvas, x + right, y + up - SMALL / 3.0, str(tags.ids[k]), size=SMALL, align="centre")


def _draw_table(
    canvas: Any, left: float, size: tuple[float, float], head: list[list[str]], rows: list[list[str]]
) -> list[list[str]]:
    """Draw as many rows as there is room for below the title; returns the others."""
    top = size[1] - MARGIN - HEAD
    fitting = int((top - MARGIN) // ROW) - len(head)
    for line, row in enumerate(head + rows[:fitting]):
        y = top - (line + 1) * ROW
        for right, text in zip(COLUMNS, row, strict=False):
            write_text(canvas, left + right, y, text, size=SMALL, align="right", bold=line < len(head))
        canvas.setStrokeGray(LIGHT)
        canvas.line(left, y - ROW / 4.0, left + TABLE, y - ROW / 4.0)
        canvas.setStrokeGray(0.0)
    return rows[fitting:]
