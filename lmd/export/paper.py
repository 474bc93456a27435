"""Pages as PDF, in millimetres from the lower left corner; equal drawings give equal bytes."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from lmd.core.optional import optional

# Width and height of a page in portrait orientation, mm.
PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
POINTS = 72.0 / 25.4  # points of PDF per millimetre
FONT, BOLD = "Helvetica", "Helvetica-Bold"
LINE = 0.15  # width of thin lines, mm
GREY = 0.5
LONGEST = 24  # greatest number of letters of a name


@contextmanager
def document(path: Path, title: str) -> Iterator[Any]:
    """Context with a reportlab canvas, saved to `path` at its end; a page begins with `begin_page`, ends with
    `showPage`.
    """
    canvas = optional("reportlab.pdfgen.canvas", "export").Canvas(str(path), invariant=1)
    canvas.setTitle(title)
    canvas.setCreator("lmd")
    yield canvas
    canvas.save()


def begin_page(canvas: Any, width: float, height: float) -> None:
    """Begin a page of this size, mm; all lengths on the page are in mm, including sizes of letters."""
    canvas.setPageSize((width * POINTS, height * POINTS))
    canvas.scale(POINTS, POINTS)
    canvas.setLineWidth(LINE)


@cache
def _own_font(bold: bool) -> str:
    """Register matplotlib's font, which has more letters than PDF's own fonts, and return its name."""
    from matplotlib import get_data_path

    metrics, fonts = (optional(f"reportlab.pdfbase.{name}", "export") for name in ("pdfmetrics", "ttfonts"))
    name = "DejaVuSans-Bold" if bold else "DejaVuSans"
    metrics.registerFont(fonts.TTFont(name, str(Path(get_data_path(), "fonts", "ttf", f"{name}.ttf"))))
    return name


def font_of(text: str, bold: bool) -> str:
    """Font of a text: the viewer's font for Western European letters, else a font embedded in the file."""
    try:
        text.encode("cp1252")
    except UnicodeEncodeError:
        return _own_font(bold)
    return BOLD if bold else FONT


def width_of(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text, mm."""
    width = optional("reportlab.pdfbase.pdfmetrics", "export").stringWidth(text, font_of(text, bold), size)
    return float(width)


def shortened(text: str) -> str:
    """Name shortened to at most `LONGEST` letters."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}\N{HORIZONTAL ELLIPSIS}"


def write_text(
    canvas: Any,
    x: float,
    y: float,
    text: str,
    *,
    size: float = 3.0,
    bold: bool = False,
    align: str = "left",
    turn: float = 0.0,
) -> None:
    """Write a line of text that begins at, ends at or is centred on (x, y), as `align` says: left, right or centre.

    The text is rotated about (x, y) by `turn`, degrees, counter-clockwise.
    """
    canvas.saveState()
    canvas.setFont(font_of(text, bold), size)
    canvas.translate(x, y)
    canvas.rotate(turn)
    {"left": canvas.drawString, "right": canvas.drawRightString, "centre": canvas.drawCentredString}[align](0, 0, text)
    canvas.restoreState()


def write_on_white(canvas: Any, x: float, y: float, text: str, *, size: float, turn: float = 0.0) -> None:
    """Write a line of text centred on (x, y), on a white background that hides the drawing below."""
    width = width_of(text, size)
    canvas.saveState()
    canvas.translate(x, y)
    canvas.rotate(turn)
    canvas.setFillGray(1.0)
    canvas.rect(-width / 2.0 - 0.3, -0.6 * size, width + 0.6, 1.2 * size, stroke=0, fill=1)
    canvas.setFillGray(0.0)
    write_text(canvas, 0.0, -0.35 * size, text, size=size, align="centre")
    canvas.restoreState()


def polygon(canvas: Any, points: Iterable[Sequence[float]]) -> Any:
    """Path around points."""
    shape, (first, *others) = canvas.beginPath(), points
    shape.moveTo(*first)
    for point in others:
        shape.lineTo(*point)
    shape.close()
    return shape


def fill_polygon(canvas: Any, points: Iterable[Sequence[float]]) -> None:
    """Fill a polygon."""
    canvas.drawPath(polygon(canvas, points), stroke=0, fill=1)


def up_arrow(canvas: Any, x: float, y: float, size: float) -> None:
    """Draw a triangle that points up, centred on x, with its base at y."""
    fill_polygon(canvas, [(x - size / 2.0, y), (x + size / 2.0, y), (x, y + size)])
