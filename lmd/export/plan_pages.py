"""Pages of the mounting plan: titles, and tables on the right."""

import math
from typing import Any, NamedTuple

from lmd.export.paper import begin_page, write_text

# Lengths on the page, mm.
MARGIN = 12.0
HEAD = 18.0  # height for the title
TITLE, TEXT, SMALL = 5.0, 3.0, 2.4  # sizes of letters
ROW = 4.8  # height of the rows of tables
LIGHT = 0.85  # grey level of tags' squares, and of lines below rows


class Table(NamedTuple):
    """Table on the right of a page: widths of the columns, mm; lines of the head; columns that are boxes."""

    widths: tuple[float, ...]
    head: tuple[tuple[str, ...], ...]
    boxes: tuple[int, ...] = ()

    @property
    def width(self) -> float:
        """Width of all columns, mm."""
        return sum(self.widths)

    def fitting(self, height: float) -> int:
        """Number of rows that fit on a page of this height, mm."""
        return int((height - 2.0 * MARGIN - HEAD) // ROW) - len(self.head)

    def pages(self, rows: int, height: float) -> int:
        """Number of pages for this number of rows."""
        return max(1, math.ceil(rows / self.fitting(height)))


def begin_titled(canvas: Any, size: tuple[float, float], title: str, facts: str) -> None:
    """Begin a page of this size with a title, a line of facts below it, and its number."""
    begin_page(canvas, *size)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE, title, size=TITLE, bold=True)
    write_text(canvas, MARGIN, size[1] - MARGIN - TITLE - 1.5 * TEXT, facts, size=TEXT)
    write_text(canvas, size[0] - MARGIN, MARGIN / 2.0, f"page {canvas.getPageNumber()}", size=SMALL, align="right")


def draw_tables(
    canvas: Any, size: tuple[float, float], table: Table, rows: list[list[str]], title: str, facts: str
) -> None:
    """Draw the rows on the right of the page, continue on further pages, and end the last page."""
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
                side = min(width, 0.65 * ROW) if width < 2.0 * ROW else width - 2.0  # to tick, or to write in
                canvas.rect(x + width - side, y - 0.17 * ROW, side, 0.65 * ROW)
            write_text(canvas, x + width, y, text, size=SMALL, align="right", bold=line < len(table.head))
            x += width
        canvas.setStrokeGray(LIGHT)
        canvas.line(left, y - ROW / 4.0, left + table.width, y - ROW / 4.0)
        canvas.setStrokeGray(0.0)
