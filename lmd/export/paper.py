"""Pages of PDF files, and the layout of tags on sheets.

Coordinates on a page are millimetres from its lower left corner. Equal drawings give files with equal bytes.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from lmd.core.optional import optional
from lmd.geometry.camera import MM_PER_M
from lmd.scene.tag import Tag

# Width and height of a page in portrait orientation, mm.
PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
POINTS = 72.0 / 25.4  # points of PDF per millimetre
FONT, BOLD = "Helvetica", "Helvetica-Bold"
LINE = 0.15  # width of thin lines, mm
GREY = 0.5
LONGEST = 24  # greatest number of letters of a name


@contextmanager
def document(path: Path, title: str) -> Iterator[Any]:
    """Context manager that yields a reportlab canvas, and saves it to `path` at the end.

    A page begins with `begin_page` and ends with the canvas's `showPage`.
    """
    canvas = optional("reportlab.pdfgen.canvas", "export").Canvas(str(path), invariant=1)
    canvas.setTitle(title)
    canvas.setCreator("lmd")
    yield canvas
    canvas.save()


def begin_page(canvas: Any, width: float, height: float) -> None:
    """Begin a page of `width` x `height`, mm; all lengths on the page, including sizes of letters, are in mm."""
    canvas.setPageSize((width * POINTS, height * POINTS))
    canvas.scale(POINTS, POINTS)
    canvas.setLineWidth(LINE)


@cache
def _own_font(bold: bool) -> str:
    """Register matplotlib's font, which has more letters than the standard fonts of PDF, and return its name."""
    from matplotlib import get_data_path

    metrics, fonts = (optional(f"reportlab.pdfbase.{name}", "export") for name in ("pdfmetrics", "ttfonts"))
    name = "DejaVuSans-Bold" if bold else "DejaVuSans"
    metrics.registerFont(fonts.TTFont(name, str(Path(get_data_path(), "fonts", "ttf", f"{name}.ttf"))))
    return name


def font_of(text: str, bold: bool) -> str:
    """Name of the font for a text.

    A text with Western European letters has a standard font of PDF viewers; other texts have a font that is embedded in
    the file.
    """
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
    """Return `text`, cut to at most `LONGEST` letters, the last of which is then an ellipsis."""
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
    """Write a line of text at (x, y), mm.

    The text begins at this point if `align` is `left`, ends there if `right`, and is centred there if `centre`.

    The text is rotated about the point by `turn`, degrees, counter-clockwise.
    """
    canvas.saveState()
    canvas.setFont(font_of(text, bold), size)
    canvas.translate(x, y)
    canvas.rotate(turn)
    {"left": canvas.drawString, "right": canvas.drawRightString, "centre": canvas.drawCentredString}[align](0, 0, text)
    canvas.restoreState()


def write_on_white(canvas: Any, x: float, y: float, text: str, *, size: float) -> None:
    """Write a line of text centred on (x, y), on a white background that hides the drawing below."""
    width = width_of(text, size)
    canvas.saveState()
    canvas.translate(x, y)
    canvas.setFillGray(1.0)
    canvas.rect(-width / 2.0 - 0.3, -0.6 * size, width + 0.6, 1.2 * size, stroke=0, fill=1)
    canvas.setFillGray(0.0)
    write_text(canvas, 0.0, -0.35 * size, text, size=size, align="centre")
    canvas.restoreState()


def polygon(canvas: Any, points: Iterable[Sequence[float]]) -> Any:
    """Closed path through `points` `(N, 2)`, mm, for the canvas to draw or fill."""
    shape, (first, *others) = canvas.beginPath(), points
    shape.moveTo(*first)
    for point in others:
        shape.lineTo(*point)
    shape.close()
    return shape


def fill_polygon(canvas: Any, points: Iterable[Sequence[float]]) -> None:
    """Fill the polygon with the vertices `points` `(N, 2)`, mm, on the canvas."""
    canvas.drawPath(polygon(canvas, points), stroke=0, fill=1)


def up_arrow(canvas: Any, x: float, y: float, size: float) -> None:
    """Draw a triangle that points up, centred on x, with its base at y."""
    fill_polygon(canvas, [(x - size / 2.0, y), (x + size / 2.0, y), (x, y + size)])


MARGIN = 8.0  # width of the border where many printers do not print
FOOTER = 7.0  # height of the ruler's strip
MARK, MARK_GAP = 4.0, 1.0  # length of a cut mark, and its distance from the cut piece
LABEL, SMALLEST_LABEL = 3.2, 1.0  # height of the letters of the largest and of the smallest label
LABEL_GAP = 0.8  # distance of a label from the edge of the paper
LABEL_SHARE = 0.36  # greatest share of the white margin for a label; the part next to the black square stays white
ROUNDING = 1e-6


class Layout(NamedTuple):
    """Arrangement of tags on sheets, separated by straight cuts; lengths in mm. A tag with its white margin is called a
    *paper*.

    page: width and height of a sheet. columns, rows: numbers of columns and of rows of papers on a sheet. left, top:
    upper left corner of the block of all papers. pitch: vertical distance from one row of papers to the next.
    """

    page: tuple[float, float]
    columns: int
    rows: int
    left: float
    top: float
    pitch: float

    @property
    def per_sheet(self) -> int:
        """Number of tags on a sheet."""
        return self.columns * self.rows


def label_size(tag: Tag) -> float:
    """Height of a label in the white margin of a tag, mm; 0 if the margin is too narrow for a label."""
    size = min(LABEL, LABEL_SHARE * (tag.paper_edge - tag.picture_edge) / 2.0 * MM_PER_M)
    return size if size >= SMALLEST_LABEL else 0.0


def layout(tag: Tag, paper: str) -> Layout:
    """Layout with the most tags on a sheet of the size `paper`, in portrait or landscape orientation.

    A tag larger than a sheet gets a page of its own size.
    """
    if (fullest := _fullest(tag, paper)).per_sheet:
        return fullest
    plate = MM_PER_M * tag.paper_edge
    return _on(tag, (plate + 2.0 * MARGIN, _pitch(tag) + 2.0 * MARGIN + FOOTER))


def largest_whole(tag: Tag, paper: str) -> float:
    """Largest edge length, metres, to which `tag` can be scaled and still fits on one sheet of the size `paper`.

    The margins are scaled in proportion to the edge length.
    """
    low, high = 0.0, max(PAPERS[paper]) / MM_PER_M
    while high - low > ROUNDING:
        middle = (low + high) / 2.0
        low, high = (middle, high) if _fullest(tag.of_size(middle), paper).per_sheet else (low, middle)
    return low


def _pages(paper: str) -> tuple[tuple[float, float], ...]:
    width, height = PAPERS[paper]
    return (width, height), (height, width)


def _fullest(tag: Tag, paper: str) -> Layout:
    return max((_on(tag, page) for page in _pages(paper)), key=lambda sheets: sheets.per_sheet)


def _pitch(tag: Tag) -> float:
    """Vertical distance from one row of tags to the next, mm.

    If the label does not fit into the margin of a tag, the distance includes space for the label above the tag.
    """
    return MM_PER_M * tag.paper_edge + (0.0 if label_size(tag) else LABEL + 2.0 * LABEL_GAP)


def _on(tag: Tag, page: tuple[float, float]) -> Layout:
    plate, edge = (MM_PER_M * length for length in (tag.paper_edge, tag.picture_edge))
    width, height = page[0] - 2.0 * MARGIN, page[1] - 2.0 * MARGIN - FOOTER
    rows = int((height + ROUNDING) // (pitch := _pitch(tag)))
    # Papers may fill the whole page, as the outer white margins need no printing.
    columns = int(min(page[0] + ROUNDING, width + ROUNDING + plate - edge) // plate)
    left, spare = (page[0] - columns * plate) / 2.0, height - rows * pitch
    return Layout(page, columns, rows, left, page[1] - MARGIN - spare / 2.0, pitch)
