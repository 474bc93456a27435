"""Layout of tags on sheets of paper, mm: whole tags in rows and columns, tags larger than a sheet in pieces."""

import math
from typing import NamedTuple

from lmd.core.checks import InputError
from lmd.export.paper import PAPERS
from lmd.geometry.camera import MM_PER_M
from lmd.scene.tag import Tag

MARGIN = 8.0  # border of a sheet, on which many printers do not print
FOOTER = 7.0  # height of the ruler's strip
MARK, MARK_GAP = 4.0, 1.0  # length of a cut mark, and its distance from the cut piece
LABEL, SMALLEST_LABEL = 3.2, 1.0  # height of the letters of the largest and of the smallest label
LABEL_GAP = 0.8  # distance of a label from the edge of the paper
LABEL_SHARE = 0.36  # greatest share of the white margin for a label; the part next to the black square stays white
STRIP = 10.0  # width of the strip of a piece on which the next piece is glued
MOST_PIECES = 100  # greatest number of pieces of a tag
ROUNDING = 1e-6


class Whole(NamedTuple):
    """Sheets with whole tags, separated by straight cuts. Lengths in mm.

    page: width and height. columns, rows: numbers of papers. left, top: corner of all papers. pitch: distance of rows.
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


class Pieces(NamedTuple):
    """Sheets, each with a piece of a tag. Lengths in mm.

    page: width and height. columns, rows: numbers of pieces. width, height: size of a piece without its glue strip.
    """

    page: tuple[float, float]
    columns: int
    rows: int
    width: float
    height: float

    @property
    def per_tag(self) -> int:
        """Number of sheets of a tag."""
        return self.columns * self.rows


def label_size(tag: Tag) -> float:
    """Height of a label in the white margin of a tag, mm; 0 if the margin is too narrow for a label."""
    size = min(LABEL, LABEL_SHARE * (tag.paper_edge - tag.picture_edge) / 2.0 * MM_PER_M)
    return size if size >= SMALLEST_LABEL else 0.0


def layout(tag: Tag, paper: str) -> Whole | Pieces:
    """Layout, portrait or landscape, with the most tags on a sheet, or with the fewest sheets for a large tag.

    Raises:
        InputError: a tag would take more than `MOST_PIECES` sheets.
    """
    whole = _fullest(tag, paper)
    if whole.per_sheet:
        return whole
    pieces = min((_pieces(tag, page) for page in _pages(paper)), key=lambda sheets: sheets.per_tag)
    if pieces.per_tag > MOST_PIECES:
        raise InputError(
            f"edge = {tag.size:g} m ({tag.square}) takes {pieces.per_tag} sheets of {paper} for a tag, more than "
            f"{MOST_PIECES}; a larger paper_size takes fewer, and a list of formats without sheets none.",
            "edge",
        ).within("tag")
    return pieces


def largest_whole(tag: Tag, paper: str) -> float:
    """Largest edge of a tag like `tag`, metres, with which it is not in pieces."""
    low, high = 0.0, max(PAPERS[paper]) / MM_PER_M
    while high - low > ROUNDING:
        middle = (low + high) / 2.0
        low, high = (middle, high) if _fullest(tag.of_size(middle), paper).per_sheet else (low, middle)
    return low


def _pages(paper: str) -> tuple[tuple[float, float], ...]:
    width, height = PAPERS[paper]
    return (width, height), (height, width)


def _fullest(tag: Tag, paper: str) -> Whole:
    return max((_whole(tag, page) for page in _pages(paper)), key=lambda sheets: sheets.per_sheet)


def _whole(tag: Tag, page: tuple[float, float]) -> Whole:
    plate, edge = (MM_PER_M * length for length in (tag.paper_edge, tag.picture_edge))
    width, height = page[0] - 2.0 * MARGIN, page[1] - 2.0 * MARGIN - FOOTER
    pitch = plate if label_size(tag) else plate + LABEL + 2.0 * LABEL_GAP
    rows = int((height + ROUNDING) // pitch)
    # Papers may fill the whole page, as their outer white margins need no printing.
    columns = int(min(page[0] + ROUNDING, width + ROUNDING + plate - edge) // plate)
    left, spare = (page[0] - columns * plate) / 2.0, height - rows * pitch
    return Whole(page, columns, rows, left, page[1] - MARGIN - spare / 2.0, pitch)


def _pieces(tag: Tag, page: tuple[float, float]) -> Pieces:
    plate, around = MM_PER_M * tag.paper_edge, 2.0 * (MARGIN + MARK_GAP + MARK)
    label = LABEL + LABEL_GAP
    columns, rows = (
        1 if plate <= room else math.ceil(plate / (room - STRIP))
        for room in (page[0] - around, page[1] - around - FOOTER - label)
    )
    return Pieces(page, columns, rows, plate / columns, plate / rows)
