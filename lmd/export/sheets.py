"""Print sheets with tags of true size, to be cut out.

The smallest tags come first, and tags of one size are in the order of hanging.

The white margin of each tag has an arrow that points up, the number of the tag and the name of its surface. A tag that
is larger than a sheet has a page of its own size, for a print shop. A printed ruler shows whether the printer kept the
scale. The black modules of a tag are one path, so that no viewer shows seams between them.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from lmd.export.paper import (
    FOOTER,
    GREY,
    LABEL,
    LABEL_GAP,
    MARGIN,
    MARK,
    MARK_GAP,
    PAPERS,
    Layout,
    begin_page,
    document,
    label_size,
    layout,
    up_arrow,
    width_of,
    write_text,
)
from lmd.formats.tag_map import TagMap
from lmd.geometry.camera import MM_PER_M
from lmd.scene.tag import Tag

# Lengths, mm.
RULER = 100.0


def describe_sheets(tags: TagMap, paper: str) -> str:
    """Text that states, for each tag size, the number of sheets and the number of tags on a sheet."""
    every = [_described(tag, paper, len(own)) for tag, own in tags.by_size]
    if len(every) == 1:
        return every[0]
    sizes = [f"{MM_PER_M * tag.size:g} mm: {text}" for (tag, _), text in zip(tags.by_size, every, strict=True)]
    return "; ".join(sizes)


def _described(tag: Tag, paper: str, count: int) -> str:
    sheets = layout(tag, paper)
    if sorted(sheets.page) == sorted(PAPERS[paper]):
        return f"{-(-count // sheets.per_sheet)} of {paper}, {sheets.per_sheet} to a sheet"
    width, height = sheets.page
    own = f"{count} of {width:.0f} x {height:.0f} mm"
    return f"{own}: a tag is larger than {paper}; there is paper_size={'|'.join(PAPERS)}"


def write_sheets(path: Path, tags: TagMap, paper: str) -> None:
    """Write `sheets.pdf`.

    Args:
        path: path of the file.
        tags: tags to print.
        paper: one of `lmd.export.paper.PAPERS`.
    """
    with document(path, f"{len(tags.order)} tags of {tags.tag.family}") as canvas:
        for tag, own in tags.by_size:
            sheets = layout(tag, paper)
            for first in range(0, len(own), sheets.per_sheet):
                _draw_sheet(canvas, tags, tag, sheets, own[first : first + sheets.per_sheet].tolist())


def _draw_sheet(canvas: Any, tags: TagMap, tag: Tag, sheets: Layout, chosen: list[int]) -> None:
    """Draw a sheet with tags of one size, row by row from the top; `chosen` are the indices of these tags."""
    plate = MM_PER_M * tag.paper_edge
    begin_page(canvas, *sheets.page)
    xs, ys = set(), set()
    for place, k in enumerate(chosen):
        row, column = divmod(place, sheets.columns)
        x, y = sheets.left + column * plate, sheets.top - (row + 1) * sheets.pitch
        _draw_tag(canvas, tags, tag, k, x, y, min(x + plate, sheets.page[0] - MARGIN))
        xs |= {x, x + plate}
        ys |= {y, y + plate}
    _draw_cuts(canvas, sheets.page, xs, ys)
    trimmed = f": cut {sheets.left:.1f} mm off left and right" if sheets.left < MARGIN - 0.05 else ""
    _draw_footer(canvas, tag, trimmed)
    canvas.showPage()


def _draw_tag(canvas: Any, tags: TagMap, tag: Tag, k: int, x: float, y: float, right: float) -> None:
    """Draw tag k with the lower left corner of its paper at (x, y), mm.

    The label is in the margin, or above the tag if the margin is too narrow, and does not extend beyond x = `right`.
    """
    number = tags.ids[k]
    plate, edge, module = (MM_PER_M * length for length in (tag.paper_edge, tag.picture_edge, tag.module))
    black = canvas.beginPath()
    for row, column in np.argwhere(~tag.picture(number)):
        left, top = x + (plate - edge) / 2.0 + column * module, y + (plate + edge) / 2.0 - row * module
        black.rect(left, top - module, module, module)
    canvas.drawPath(black, stroke=0, fill=1)
    label, size = f"{number}   {tags.place_of(k)}", label_size(tag)
    away = size / 4.0 or LABEL_GAP
    start, top = max(x, MARGIN) + away, y + plate - away if size else y + plate + LABEL_GAP + LABEL
    _write_label(canvas, label, start, top, size or LABEL, right)


def _write_label(canvas: Any, text: str, x: float, top: float, size: float, right: float) -> None:
    """Draw an arrow that points up and a text, both below y = `top`, from x on.

    Letters are smaller than `size` if the text would extend beyond x = `right`.
    """
    size *= min(1.0, (right - x) / (1.75 * size + width_of(text, size)))
    up_arrow(canvas, x + size / 2.0, top - 0.75 * size, 0.75 * size)
    write_text(canvas, x + 1.5 * size, top - 0.75 * size, text, size=size)


def _draw_cuts(canvas: Any, page: tuple[float, float], xs: Iterable[float], ys: Iterable[float]) -> None:
    """Draw cutting marks for vertical cuts at `xs` and horizontal cuts at `ys`, mm.

    Each cut has a mark beyond each of its ends. A mark for which the sheet has no space there is on the cut itself.
    """
    away = MARK_GAP + MARK
    lefts, rights = max(min(xs) - away, MARGIN), min(max(xs) + away, page[0] - MARGIN)
    bottoms, tops = max(min(ys) - away, MARGIN + FOOTER - 1.0), min(max(ys) + away, page[1] - MARGIN)
    for y in ys:
        canvas.line(lefts, y, lefts + MARK, y)
        canvas.line(rights - MARK, y, rights, y)
    for x in xs:
        canvas.line(x, bottoms, x, bottoms + MARK)
        canvas.line(x, tops - MARK, x, tops)


def _draw_footer(canvas: Any, tag: Tag, more: str) -> None:
    for mm in range(int(RULER) + 1):
        length = 5.0 if mm % 50 == 0 else 4.0 if mm % 10 == 0 else 2.0
        canvas.line(MARGIN + mm, MARGIN, MARGIN + mm, MARGIN + length)
    canvas.line(MARGIN, MARGIN, MARGIN + RULER, MARGIN)
    beside = MARGIN + RULER + 4.0
    canvas.setFillGray(GREY)
    write_text(canvas, beside, MARGIN + 3.5, f"Print at 100 %: the ruler is {RULER:g} mm long.", size=2.6)
    edge, plate = (MM_PER_M * length for length in (tag.size, tag.paper_edge))
    size = f"{tag.family}: {tag.square} {edge:.4g} mm, paper {plate:.4g} mm{more}"
    write_text(canvas, beside, MARGIN, size, size=2.6)
    canvas.setFillGray(0.0)
