"""Geometry, colours and wording that figures share."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, printable
from lmd.scene.deployment import Deployment
from lmd.space.space import Space

ARROW_LENGTH = 0.35  # length of the arrow along the normal of a landmark, metres
LANDMARK = "#d62728"
FIXED = "#1f77b4"  # colour of landmarks that existed before the optimisation
ROOM = "#000000"
REACHABLE = "#8a8a8a"
OBSTACLE = "#8c564b"
KEPT_OUT = "#ff7f0e"
# Colour of each part of `Space.outline`, and True if the part is dashed. A room need not have all parts.
PARTS = {
    "room": (ROOM, False),
    "obstacles": (OBSTACLE, False),
    "nothing hangs here": (KEPT_OUT, False),
    "reachable area": (REACHABLE, True),
}
QUALIFIED = "#1a9641"
UNQUALIFIED = "#9e9e9e"
HUES = 10  # distinct hues of matplotlib's cycle of colours, tab10
DASHES = ("-", "--", ":", "-.")
COLOUR_MAP = "viridis"  # its lightness is even, so it can be printed in grey
AXIS_LABELS = ("x [m]", "y [m]", "z [m]")
BEHIND_ID = {"facecolor": "white", "alpha": 0.7, "linewidth": 0.0, "pad": 0.5}
LETTERS_PER_INCH = 9.0  # of titles
LEAST_TICKS = 3  # least number of ticks of a logarithmic axis, if there are enough round numbers
# Number of positions whose nearest neighbours are sought; a search tree of all positions would load scipy for each
# figure.
SPACING_SAMPLE = 256
ELEVATION, AZIMUTH = 16.0, -66.0  # direction of the viewer in static figures, degrees


def viewer() -> FloatArray:
    """Unit vector `(3,)` from the middle of the room towards the viewer of static figures, world frame."""
    elevation, azimuth = np.radians((ELEVATION, AZIMUTH))
    horizontal = np.cos(elevation)
    return np.array((horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)))


def size_of(room: Space) -> FloatArray:
    """Length, width and height of the box around a room, `(3,)`, metres."""
    low, high = room.bounds()
    return high - low


def spacing_of(room: Space, positions: FloatArray) -> float:
    """Typical distance between neighbouring positions `(P, 3)`, metres; for one position, the size of the room.

    The result is the median of the distances from a position to the nearest other position.
    """
    some = positions[:: max(1, len(positions) // SPACING_SAMPLE)]
    away = (np.linalg.norm(positions - one, axis=1) for one in some)
    nearest = [np.partition(distances, 1)[1] if len(positions) > 1 else np.inf for distances in away]
    return min(float(np.median(nearest)), float(np.linalg.norm(size_of(room))))


def ball_scale(room: Space, positions: FloatArray) -> float:
    """Factor for the diameter of the balls that are drawn at positions, at most 1.

    The factor is less than 1 if the positions are closer together, relative to the room's diagonal, than in the paper.
    """
    return min(1.0, spacing_of(room, positions) / float(np.linalg.norm(size_of(room))) / 0.046)


def logarithmic_ticks(low: float, high: float) -> FloatArray:
    """Choose a few round numbers as ticks of a logarithmic axis from `low` to `high`.

    There are several ticks even if `low` and `high` are close.
    """
    from matplotlib.ticker import MaxNLocator

    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for steps in ((1.0, 10.0), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
        ticks = np.unique(np.outer(decades, steps))
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        if len(ticks) >= LEAST_TICKS:
            return np.asarray(ticks)
    ticks = np.asarray(MaxNLocator(nbins=4).tick_values(low, high))
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    return ticks if len(ticks) else np.array([low])


def set_log_ticks(axis: Any, low: float, high: float) -> None:
    """Set a few round ticks on a logarithmic axis or colour bar from `low` to `high`, and remove minor ticks."""
    set_ticks(axis, logarithmic_ticks(low, high))


def set_ticks(axis: Any, ticks: FloatArray) -> None:
    """Set the ticks of an axis or a colour bar, labelled with short numbers, and remove minor ticks."""
    axis.set_ticks(ticks.tolist(), labels=[f"{tick:g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def dress(axes: Any, legend: bool = False, **settings: Any) -> None:
    """Set the labels and limits of axes, and add a faint grid and, if wanted, a legend without a frame."""
    axes.set(**settings)
    axes.grid(alpha=0.3)
    if legend:
        axes.legend(frameon=False)


def draw_band(axes: Any, x: Any, band: Any, label: str | None, mark: str = "", **style: Any) -> None:
    """Draw a line through the middle values, and a faint area from the low to the high values.

    The rows of `band` `(3, N)` are the low, middle and high values at `x` `(N,)`.
    """
    low, middle, high = band
    axes.fill_between(x, low, high, color=style["color"], alpha=0.2, lw=0)
    axes.plot(x, middle, *filter(None, [mark]), label=label, **style)  # an empty format would set a line style


def draw_arrows(axes: Any, places: FloatArray, ways: FloatArray, **style: Any) -> None:
    """Draw arrows from `places` to `places + ways`, `(N, 2)` each, in the unit of the axes."""
    lengths: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver(*places.T, *ways.T, **{"width": 0.003, "zorder": 3, **lengths, **style})


def from_above(axes: Any, **settings: Any) -> None:
    """Set equal scales and the labels x and y for axes that show a room from above."""
    axes.set(**{"aspect": "equal", "xlabel": AXIS_LABELS[0], "ylabel": AXIS_LABELS[1], **settings})


class Group(NamedTuple):
    """Landmarks that are drawn in one style."""

    label: str
    """Legend entry."""
    colour: str
    """Colour of the landmarks."""
    chosen: BoolArray
    """Mask `(K,)` of the landmarks that belong to the group."""


def landmark_groups(count: int, fixed: int) -> list[Group]:
    """Divide `count` landmarks into groups for drawing; empty groups are omitted.

    The first `fixed` landmarks existed before the optimisation and form one group; all others form the other group.
    """
    hung = np.arange(count) < fixed
    if not fixed:
        return [Group("landmark and its normal", LANDMARK, ~hung)]
    groups = Group("new landmark", LANDMARK, ~hung), Group("landmark that hung already", FIXED, hung)
    return [group for group in groups if group.chosen.any()]


def qualified_labels(is_qualified: BoolArray, threshold: float) -> tuple[str, str]:
    """Legend entries, with shares, of the qualified positions (probability at least `threshold`) and of all others."""
    share = 100.0 * is_qualified.mean()
    return (f"qualified, probability ≥ {threshold:g} ({share:.1f} %)", f"unqualified ({100.0 - share:.1f} %)")


def draw_plan(axes: Any, room: Space, **style: Any) -> None:
    """Draw the outline of a room from above."""
    for part, edges in room.outline().items():
        colour, dashed = PARTS[part]
        for i, edge in enumerate(edges):
            label = "" if i else part  # of the legend
            axes.plot(*edge[:, :2].T, color=colour, linestyle="--" if dashed else "-", label=label, **style)


def draw_tags(axes: Any, deployment: Deployment, groups: Sequence[Group]) -> None:
    """Draw landmarks from above, with their ids.

    Each landmark is drawn as an arrow along its normal, in the colour of its group. The id is in front of the arrow.
    Landmarks that are above each other share one text with all their ids.
    """
    at, ways = deployment.positions[:, :2], deployment.normals[:, :2]
    ids: dict[tuple[float, ...], list[int]] = {}
    for group in groups:
        start, arrows = at[group.chosen], ARROW_LENGTH * ways[group.chosen]
        draw_arrows(axes, start, arrows, color=group.colour)
        axes.plot(*start.T, "o", color=group.colour, ms=2.5, zorder=3)
    for number, place, way in zip(deployment.ids, at.round(2), ways.round(1) + 0.0, strict=True):
        ids.setdefault((*place, *way), []).append(number)
    for (x, y, right, up), numbers in ids.items():
        across = "left" if right > 0.5 else "right" if right < -0.5 else "center"
        along = "bottom" if up > 0.5 else "top" if up < -0.5 else "center"
        tip = x + ARROW_LENGTH * right, y + ARROW_LENGTH * up
        axes.annotate(", ".join(map(str, sorted(numbers))), tip, (2.0 * right, 2.0 * up), textcoords="offset points",
                      ha=across, va=along, fontsize=7, zorder=4, bbox=BEHIND_ID)  # fmt: skip


def series(number: int) -> dict[str, str]:
    """Colour and line style of the curve with the index `number`, from 0, in figures of several optimisers.

    There are ten colours; the next ten curves repeat these colours with another dash pattern.
    """
    return {"color": f"C{number % HUES}", "linestyle": DASHES[number // HUES % len(DASHES)]}


def literal(text: object) -> str:
    """Escape a text for matplotlib, which would otherwise take `$` for the beginning of a formula."""
    return printable(str(text)).replace("$", r"\$")


def wrapped(title: str, inches: float) -> str:
    """Break a title into lines that fit into a figure `inches` wide."""
    return textwrap.fill(literal(title), int(LETTERS_PER_INCH * inches))


def new_panels(inches: tuple[float, float], title: str | None, rows: int, columns: int, **shared: Any) -> Any:
    """Make a figure with panels in rows and columns; return the figure and the panels, `(rows, columns)`.

    `inches` and `title` are as in `new_figure`. `shared` are further arguments of matplotlib's `subplots`.
    """
    figure = new_figure(inches, title)
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def new_figure(inches: tuple[float, float], title: str | None = None) -> Any:
    """Make a figure of the given width and height in inches, at 100 dots per inch, with automatic layout."""
    from matplotlib.figure import Figure  # slow to load

    figure = Figure(figsize=inches, dpi=100, layout="constrained", facecolor="white")
    if title is not None:
        figure.suptitle(wrapped(title, inches[0]))
    return figure


def shrink(path: str | Path) -> None:
    """Reduce a PNG in place to 256 colours, which saves two thirds of its size without visible differences."""
    from PIL import Image

    with Image.open(path) as picture:
        reduced = picture.convert("RGB").quantize(256)
    reduced.save(path, optimize=True)
