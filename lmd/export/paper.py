"""Pages in millimetres from their lower left corner, as PDF; the same drawing gives the same bytes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lmd.optional import optional

# Width and height of a page that stands upright, mm.
PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
POINTS = 72.0 / 25.4  # of PDF in a millimetre
FONT, BOLD = "Helvetica", "Helvetica-Bold"
LINE = 0.15  # width of thin lines, mm
GREY = 0.5


@contextmanager
def document(path: Path, title: str) -> Iterator[Any]:
    """A canvas of reportlab, saved to `path` when left; a page begins with `begin_page` and ends with `showPage`."""
    canvas = optional("reportlab.pdfgen.canvas", "export").Canvas(str(path), invariant=1)
    canvas.setTitle(title)
    canvas.setCreator("lmd")
    yield canvas
    canvas.save()


def begin_page(canvas: Any, width: float, height: float) -> None:
    """Begin a page of this size, mm; from here on everything is in mm, sizes of letters too."""
    canvas.setPageSize((width * POINTS, height * POINTS))
    canvas.scale(POINTS, POINTS)
    canvas.setLineWidth(LINE)


def write_text(
    canvas: Any, x: float, y: float, text: str, *, size: float = 3.0, bold: bool = False, align: str = "left"
) -> None:
    """Write a line of text that begins at, ends at or is centred on (x, y), as `align` says: left, right or centre."""
    canvas.setFont(BOLD if bold else FONT, size)
    {"left": canvas.drawString, "right": canvas.drawRightString, "centre": canvas.drawCentredString}[align](x, y, text)


def fill_polygon(canvas: Any, points: list[tuple[float, float]]) -> None:
    """Fill a polygon."""
    shape = canvas.beginPath()
    shape.moveTo(*points[0])
    for point in points[1:]:
        shape.lineTo(*point)
    shape.close()
    canvas.drawPath(shape, stroke=0, fill=1)


def up_arrow(canvas: Any, x: float, y: float, size: float) -> None:
    """A triangle that points up, centred on x, its base at y."""
    fill_polygon(canvas, [(x - size / 2.0, y), (x + size / 2.0, y), (x, y + size)])
