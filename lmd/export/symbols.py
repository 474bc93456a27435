"""Symbols of doors, windows and furniture on paper, in black and white."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.export.paper import LINE, polygon, shortened, width_of, write_on_white, write_text

HATCH = 2.0  # distance between the hatch lines of furniture, mm
NAME = 2.4  # size of letters, mm
WALL = 0.7  # width of the line of a wall on a floor plan, mm


def draw_fixture(canvas: Any, kind: str, ring: FloatArray, name: str = "") -> None:
    """Draw a fixture on the view of a wall: `ring` `(N, 2)` on the page, mm.

    A door has two diagonals to the middle of its right side, a window a cross; furniture is hatched; other fixtures
    have an outline.
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
    """Draw a door, a window or another fixture in a wall, from above, between its `ends` `(2, 2)` on the page, mm.

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
    """Draw the legend of the symbols of a floor plan, in a line."""
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
