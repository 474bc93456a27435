"""Print sheets: the tags at their true size, to be cut out.

Each tag has marks at the corners of its paper, and above its upper edge an arrow that points up, its number and the
surface it belongs to. A ruler tells whether the printer kept the scale. The black modules of a tag are one path, so
that no viewer shows seams between them.
"""

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lmd.camera import MM_PER_M
from lmd.checks import InputError
from lmd.export.paper import FONT, GREY, PAPERS, begin_page, document, up_arrow, write_text
from lmd.export.tag_map import TagMap
from lmd.optional import optional
from lmd.tag import Tag

# All in mm.
MARGIN = 8.0  # where many printers do not print
FOOTER = 14.0  # for the ruler
GAP = 10.0  # between papers, for marks and labels
MARK, MARK_GAP = 4.0, 1.0  # length of a cut mark, and its distance from the corner
LABEL, LABEL_GAP = 3.0, 2.0  # size of the letters above a tag, and their distance from its paper
RULER = 100.0


def largest_paper(paper: str) -> float:
    """Edge of the largest paper of a tag that a sheet takes, mm."""
    width, height = PAPERS[paper]
    return min(width - 2.0 * MARGIN, height - 2.0 * MARGIN - FOOTER - GAP)


def check_sheets(tag: Tag, paper: str) -> None:
    """Raise `InputError` if a tag is larger than a sheet, or the package that knows its picture is missing."""
    optional("cv2", "export")
    if not _places(tag, paper):
        whole = {name: math.floor(largest_paper(name) * tag.size / tag.paper_edge) for name in PAPERS}
        fitting = ", ".join(f"{edge / MM_PER_M:g} m on {name}" for name, edge in whole.items())
        raise InputError(f"edge = {tag.size:g} m is too large for a sheet of {paper}; what fits is {fitting}.", "edge")


def write_sheets(path: Path, tags: TagMap, paper: str) -> None:
    """Write `sheets.pdf`, the tags in the order of the surfaces and of their numbers.

    Args:
        path: the file.
        tags: what is printed.
        paper: one of `PAPERS`.

    Raises:
        InputError: a tag is larger than a sheet.
    """
    check_sheets(tags.tag, paper)
    order = np.lexsort((tags.deployment.ids, tags.surfaces))
    places = _places(tags.tag, paper)
    with document(path, f"{len(order)} tags of {tags.tag.family}") as canvas:
        for first in range(0, len(order), len(places)):
            begin_page(canvas, *PAPERS[paper])
            for k, (x, y) in zip(order[first : first + len(places)], places, strict=False):
                _draw_tag(canvas, tags, int(k), x, y)
            _draw_footer(canvas, tags.tag)
            canvas.showPage()


def _places(tag: Tag, paper: str) -> list[tuple[float, float]]:
    """Lower left corners of the papers on a sheet, row by row from the top; none where a paper is too large."""
    width, height = PAPERS[paper]
    cell = tag.paper_edge * MM_PER_M + GAP
    columns = int((width - 2.0 * MARGIN + GAP) // cell)
    rows = int((height - 2.0 * MARGIN - FOOTER) // cell)
    grid = product(range(1, rows + 1), range(columns))
    return [(MARGIN + column * cell, height - MARGIN - row * cell) for row, column in grid]


def _draw_tag(canvas: Any, tags: TagMap, k: int, x: float, y: float) -> None:
    tag, number = tags.tag, tags.ids[k]
    plate, edge, module = (MM_PER_M * length for length in (tag.paper_edge, tag.size, tag.module))
    black = canvas.beginPath()
    for row, column in np.argwhere(~tag.picture(number)):
        left, top = x + (plate - edge) / 2.0 + column * module, y + (plate + edge) / 2.0 - row * module
        black.rect(left, top - module, module, module)
    canvas.drawPath(black, stroke=0, fill=1)
    for corner_x, way_x in ((x, -1.0), (x + plate, 1.0)):
        for corner_y, way_y in ((y, -1.0), (y + plate, 1.0)):
            near, far = MARK_GAP, MARK_GAP + MARK
            canvas.line(corner_x + way_x * near, corner_y, corner_x + way_x * far, corner_y)
            canvas.line(corner_x, corner_y + way_y * near, corner_x, corner_y + way_y * far)
    label, above = f"{number}   {tags.place_of(k)}", y + plate + LABEL_GAP
    size = min(LABEL, LABEL * plate / canvas.stringWidth(f"    {label}", FONT, LABEL))
    up_arrow(canvas, x + LABEL_GAP + size / 2.0, above, 0.8 * size)
    write_text(canvas, x + LABEL_GAP + 1.5 * size, above, label, size=size)


def _draw_footer(canvas: Any, tag: Tag) -> None:
    for mm in range(int(RULER) + 1):
        length = 5.0 if mm % 50 == 0 else 4.0 if mm % 10 == 0 else 2.0
        canvas.line(MARGIN + mm, MARGIN, MARGIN + mm, MARGIN + length)
    canvas.line(MARGIN, MARGIN, MARGIN + RULER, MARGIN)
    beside = MARGIN + RULER + 4.0
    canvas.setFillGray(GREY)
    write_text(canvas, beside, MARGIN + 4.0, f"Print at 100 %: the ruler is {RULER:g} mm long.")
    edge, plate = (MM_PER_M * length for length in (tag.size, tag.paper_edge))
    write_text(canvas, beside, MARGIN, f"{tag.family}: black square {edge:.4g} mm, paper {plate:.4g} mm")
    canvas.setFillGray(0.0)
