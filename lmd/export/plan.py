"""Mounting plan: a floor plan, then for each surface with tags a page with a drawing to scale and a table.

Tags are listed in the order of hanging (`TagMap.order`), with a box to tick and space for measured values.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.export.overview import draw_fixture, draw_floor_plan, numbers_of, scale_of
from lmd.export.paper import (
    GREY,
    LINE,
    PAPERS,
    begin_page,
    document,
    fill_polygon,
    shortened,
    up_arrow,
    write_on_white,
    write_text,
)
from lmd.formats.tag_map import TagMap
from lmd.geometry.camera import MM_PER_M
from lmd.space.space import lower_edge
from lmd.space.surface import FLAT, Surface

# Lengths on the page, mm.
MARGIN = 12.0
HEAD = 18.0  # height for the title
TITLE, TEXT, SMALL = 5.0, 3.0, 2.4  # sizes of letters
ROW = 4.8  # height of the rows of tables
LIGHT = 0.85  # grey level of tags' squares, and of lines below rows


class Table(NamedTuple):
    """Table on the right of a page.

    `widths` are the widths of the columns, mm; `head` has the lines of the head; `boxes` are the indices of the columns
    with boxes, to tick or to write in.
    """

    widths: tuple[float, ...]
    head: tuple[tuple[str, ...], ...]
    boxes: tuple[int, ...] = ()

    @property
    def width(self) -> float:
        """Width of all columns, mm."""
        return sum(self.widths)

    def fitting(self, height: float) -> int:
        """Number of rows that fit on a page with the height `height`, mm."""
        return int((height - 2.0 * MARGIN - HEAD) // ROW) - len(self.head)

    def pages(self, rows: int, height: float) -> int:
        """Number of pages that a table with `rows` rows needs on pages of the height `height`, mm."""
        return max(1, math.ceil(rows / self.fitting(height)))


def begin_titled(canvas: Any, size: tuple[float, float], title: str, facts: str) -> None:
    """Begin a page of the given `size`, mm, with a title, the line of text `facts` below it, and the page number."""
    begin_page(canvas, *size)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE, title, size=TITLE, bold=True)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE - 1.5 * TEXT, facts, size=TEXT)
    write_text(canvas, size[0] - MARGIN, MARGIN / 2.0, f"page {canvas.getPageNumber()}", size=SMALL, align="right")


def draw_tables(
    canvas: Any, size: tuple[float, float], table: Table, rows: list[list[str]], title: str, facts: str
) -> None:
    """Draw the `rows` of a table on the right of the current page, and on further pages if needed; end the last page.

    Further pages begin with the title and the line of text `facts`.
    """
    fitting = table.fitting(size[1])
    for first in range(0, len(rows), fitting):
        if first:
            canvas.showPage()
            begin_titled(canvas, size, title, facts)
        _draw_table(canvas, size, table, rows[first : first + fitting])
    canvas.showPage()


def _draw_table(canvas: Any, size: tuple[float, float], table: Table, rows: list[list[str]]) -> None:
    left, top = size[0] - MARGIN - table.width, size[1] - MARGIN - HEAD
    for line, row in enumerate((*table.head, *rows)):
        y, x = top - (line + 1) * ROW, left
        for column, (width, text) in enumerate(zip(table.widths, row, strict=True)):
            if line >= len(table.head) and column in table.boxes:
                side = min(width, 0.65 * ROW) if width < 2.0 * ROW else width - 2.0  # boxes to tick, or to write in
                canvas.rect(x + width - side, y - 0.17 * ROW, side, 0.65 * ROW)
            write_text(canvas, x + width, y, text, size=SMALL, align="right", bold=line < len(table.head))
            x += width
        canvas.setStrokeGray(LIGHT)
        canvas.line(left, y - ROW / 4.0, left + table.width, y - ROW / 4.0)
        canvas.setStrokeGray(0.0)


# Lengths on the page, mm.
DIMENSION = 6.0  # distance from the surface to its dimension lines
TICK = 1.5
SCALES = (1, 2, 5, 10, 15, 20, 25, 30, 40, 50, 75, 100, 150, 200, 250, 300, 400, 500, 1000, 2000, 5000)
EDGE_WIDTH = 12.0  # width of the column with the edge lengths of tags
FORBIDDEN = 0.94  # grey level of regions where no tag may hang

ORDER = Table((20.0, 38.0, 10.0, 12.0), (("order of hanging", "", "", ""), ("no.", "surface", "tags", "page")))
ON_SURFACE = Table(
    (5.0, 8.0, 10.0, 14.0, 15.0, 14.0, 15.0, 16.0, 16.0),
    (
        ("", "", "", "", "centre, mm", "", "lower left of paper", "", "measured, mm"),
        ("", "no.", "id", *3 * ("from left", "from {edge}")),
    ),
    (0, 7, 8),
)
FREE = Table(
    (5.0, 8.0, 11.0, 18.0, 18.0, 18.0, 16.0, 16.0, 16.0),
    (("", "", "", "", "", "centre, mm", "", "", "measured, mm"), ("", "no.", "id", *2 * ("x", "y", "z"))),
    (0, 6, 7, 8),
)


@dataclass(frozen=True)
class View:
    """View of a surface from its front: x to the right from the left edge, y up from the lower edge, metres."""

    surface: Surface

    @property
    def allowed(self) -> list[FloatArray]:
        """Polygons `(4, 2)` whose union is the region where tags may hang."""
        return list(self.place(self.surface.point(*np.moveaxis(self.surface.parts, -1, 0))))

    @property
    def direction(self) -> str:
        """Direction from which the surface is viewed, in words: from above, from below or from the front."""
        up = self.surface.normal[2]
        return "seen from above" if up > FLAT else "seen from below" if up < -FLAT else "seen from the front"

    def place(self, points: FloatArray) -> FloatArray:
        """Coordinates in this view, metres, `(..., 2)`, of points in the world frame, `(..., 3)`."""
        return self.surface.from_left_and_below(np.stack(self.surface.coordinates(points), axis=-1))

    def corner(self, right: bool, top: bool) -> FloatArray:
        """Corner of the surface, on its right or left and at its top or bottom, in the world frame, metres, `(3,)`."""
        width, height = self.surface.extent
        return self.surface.point(*self.surface.from_left_and_below(np.array([width * right, height * top])))


def write_plan(path: Path, tags: TagMap, paper: str) -> None:
    """Write `plan.pdf`; tags that are on no surface are in a table at the end.

    Args:
        path: path of the file.
        tags: tags of the plan.
        paper: one of `lmd.export.paper.PAPERS`, in landscape orientation.
    """
    size = PAPERS[paper][::-1]
    first, pages = ORDER.pages(len(tags.tags_by_surface), size[1]) + 1, {}
    for index, own in tags.tags_by_surface.items():
        pages[index] = first
        first += (FREE if index < 0 else ON_SURFACE).pages(len(own), size[1])
    with document(path, f"{len(tags.ids)} tags in a {tags.room.describe()}") as canvas:
        _draw_overview(canvas, size, tags, pages)
        for index, own in tags.tags_by_surface.items():
            if index < 0:
                _draw_free(canvas, size, tags, own)
            else:
                _draw_surface(canvas, size, tags, View(tags.room.surfaces()[index]), own)


def _draw_overview(canvas: Any, size: tuple[float, float], tags: TagMap, pages: dict[int, int]) -> None:
    """Draw the floor plan, and a table of surfaces in the order of hanging.

    `pages` are the page numbers of the surfaces, keyed by the surface's index.
    """
    rows = [
        [numbers_of(own), shortened(tags.place_of(int(tags.order[own[0]]))), str(len(own)), str(pages[index])]
        for index, own in tags.tags_by_surface.items()
    ]
    scale = scale_of(tags.room, size[0] - 3.0 * MARGIN - ORDER.width, size[1] - 2.0 * MARGIN - HEAD, SCALES)
    title = f"{len(tags.ids)} tags of {tags.tag.family}, {tags.edges_in_words}"
    facts = f"seen from above, scale 1 : {scale}; {tags.room.describe()}; triangles and ids are tags on walls"
    if (np.abs(tags.deployment.normals[:, 2]) > FLAT).any():
        facts += ", squares those on floors (black) and ceilings (white)"
    begin_titled(canvas, size, title, facts)
    draw_floor_plan(canvas, tags, MARGIN, size[1] - MARGIN - HEAD, scale)
    draw_tables(canvas, size, ORDER, rows, title, facts)


def _draw_surface(canvas: Any, size: tuple[float, float], tags: TagMap, view: View, places: IntArray) -> None:
    own = tags.order[places]
    width, height = (MM_PER_M * length for length in view.surface.extent)
    edge = "floor" if view.surface.is_upright else "below"
    head = tuple(tuple(text.format(edge=edge) for text in line) for line in ON_SURFACE.head)
    table = _sized(ON_SURFACE._replace(head=head), tags)
    room_x = size[0] - 3.0 * MARGIN - table.width - DIMENSION - TEXT
    room_y = size[1] - 2.0 * MARGIN - HEAD - DIMENSION - TEXT
    scale = next((one for one in SCALES if width <= one * room_x and height <= one * room_y), SCALES[-1])
    title = f"{view.surface.name}, {view.direction}"
    facts = f"{width:.0f} x {height:.0f} mm, tags: {len(own)}, scale 1 : {scale}; {tags.room.describe()}"
    facts += "" if view.surface.allowed is None else "; nothing hangs where it is grey"
    facts += next((f"; of {part.name}" for part in tags.fixtures if part.has(view.surface)), "")
    at, papers = MM_PER_M * tags.at[own], MM_PER_M * tags.papers[own]
    floor = MM_PER_M * lower_edge(tags.room, view.surface)
    rows = [
        [*_named(tags, place, k), *(f"{x:.0f}" for x in (*centre, *(centre - paper / 2.0))), "", ""]
        for place, k, centre, paper in zip(places, own, at + np.array([0.0, floor]), papers, strict=True)
    ]
    begin_titled(canvas, size, title, facts)
    origin = MARGIN + DIMENSION + TEXT, size[1] - MARGIN - HEAD - height / scale
    _draw_outline(canvas, origin, tags, view, scale)
    for k, centre in zip(own, at, strict=True):
        _draw_tag(canvas, origin, tags, int(k), centre, scale, at, papers)
    draw_tables(canvas, size, table, rows, title, facts)


def _draw_free(canvas: Any, size: tuple[float, float], tags: TagMap, places: IntArray) -> None:
    own = tags.order[places]
    rows = [
        [*_named(tags, place, k), *(f"{value:.0f}" for value in at), "", "", ""]
        for place, k, at in zip(places, own, MM_PER_M * tags.deployment.positions[own], strict=True)
    ]
    title, facts = "free in the room", f"on no surface, tags: {len(own)}; {tags.room.describe()}"
    begin_titled(canvas, size, title, facts)
    draw_tables(canvas, size, _sized(FREE, tags), rows, title, facts)


def _named(tags: TagMap, place: int, k: int) -> list[str]:
    """First cells of tag k's row in the table: an empty box, the number in the order of hanging, and the id.

    If the tags have several edge lengths, the edge length follows, mm. `place` is the number in the order, from 0.
    """
    edge = [f"{MM_PER_M * tags.sizes[k]:.4g}"] if len(tags.by_size) > 1 else []
    return ["", str(place + 1), str(tags.ids[k]), *edge]


def _sized(table: Table, tags: TagMap) -> Table:
    """Return `table` with an additional fourth column, for the edge lengths of tags.

    If all tags have one edge length, the table is returned unchanged.
    """
    if len(tags.by_size) == 1:
        return table
    head = tuple((*line[:3], text, *line[3:]) for line, text in zip(table.head, ("edge,", "mm"), strict=True))
    boxes = tuple(box + (box >= 3) for box in table.boxes)
    return Table((*table.widths[:3], EDGE_WIDTH, *table.widths[3:]), head, boxes)


def _draw_outline(canvas: Any, origin: tuple[float, float], tags: TagMap, view: View, scale: int) -> None:
    """Draw a surface: allowed regions, fixtures, size, and coordinates of corners in the world frame."""
    left, below = origin
    width, height = (MM_PER_M * length / scale for length in view.surface.extent)
    canvas.setFillGray(FORBIDDEN)
    canvas.rect(left, below, width, height, stroke=0, fill=1)
    canvas.setFillGray(1.0)
    for ring in view.allowed:
        fill_polygon(canvas, [(left + x, below + y) for x, y in MM_PER_M * ring / scale])
    canvas.setFillGray(0.0)
    for fixture in tags.fixtures:
        region = fixture.on(view.surface)
        if not region.is_empty and fixture.name != view.surface.name:
            ring = np.array(region.exterior.coords[:-1])
            draw_fixture(canvas, fixture.kind, origin + MM_PER_M * ring / scale, fixture.name)
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
    """Draw a dimension: a horizontal line of the length `length` with marked ends, and a text below its middle."""
    canvas.line(x, y, x + length, y)
    for end in (x, x + length):
        canvas.line(end, y - TICK, end, y + TICK)
    write_text(canvas, x + length / 2.0, y - TEXT, text, size=TEXT, align="centre")


def _draw_tag(
    canvas: Any,
    origin: tuple[float, float],
    tags: TagMap,
    k: int,
    centre: FloatArray,
    scale: int,
    at: FloatArray,
    papers: FloatArray,
) -> None:
    """Draw tag k: its paper, its square, a triangle that points up, and its id.

    An id that does not fit into the square is beside the tag, where it overlaps no other tag if possible.

    Args:
        canvas: canvas of the page.
        origin: lower left corner of the surface on the page, mm.
        tags: all tags.
        k: index of the tag.
        centre: centre of the tag on the surface, `(2,)`, mm.
        scale: s of the scale 1 : s.
        at: centres of the N tags on the surface, `(N, 2)`, mm.
        papers: edge lengths of these tags with their white margins, `(N,)`, mm.
    """
    x, y = origin + centre / scale
    plate, edge = (MM_PER_M * length / scale for length in (tags.papers[k], tags.sizes[k]))
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
    distance = np.abs(((at - centre) / scale)[:, None] - places).max(axis=2)
    free = np.flatnonzero((distance > (papers[:, None] / scale + SMALL) / 2.0).all(axis=0))
    right, up = places[free[0] if free.size else 0]
    write_on_white(canvas, x + right, y + up, str(tags.ids[k]), size=SMALL)
