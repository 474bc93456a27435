"""How many, how big, as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from lmd.evaluation.tradeoff import COUNT_OF, COUNTS, MIXED, Axis
from lmd.plot.common import new_figure

LABELS = {"count": "number of landmarks K", "paper": "paper in all [square metres]", "budget": "cost of all tags"}


class Panel(NamedTuple):
    """A figure against the number of landmarks, or what limits it.

    Args:
        label: of the axis.
        figure: the column of points that is shown, off the grid.
        on_grid: the column of the same on the grid, drawn faintly; None for none.
        wanted: a value that is marked; None for none.
    """

    label: str
    figure: str
    on_grid: str | None = None
    wanted: float | None = None


def curve_name(curve: float | str) -> str:
    """A curve of `lmd.evaluation.tradeoff.Axis` for readers."""
    edges = [float(edge) for edge in str(curve).split(MIXED)]
    sizes = ", ".join(f"{1e3 * edge:g}" for edge in edges)
    return f"{'any mixture' if len(edges) > 1 else 'tags'} of {sizes} mm" if edges[0] else "points"


def save_tradeoff_figure(
    path: str | Path, points: pd.DataFrame, panels: Sequence[Panel], title: str, axis: Axis = COUNTS
) -> None:
    """Write a PNG, 550 pixels wide for each panel and 450 high: medians over the seeds, bands from least to greatest.

    Where sizes are mixed, one more panel shows how many tags have each.

    Args:
        points, axis: as for `lmd.evaluation.tradeoff.front`.
        panels: from left to right; their figures are shares.
    """
    curves = np.unique(points[axis.curve]).tolist()
    mixed = [curve for curve in curves if MIXED in str(curve)]  # at most one
    colours = {curve: f"C{i}" for i, curve in enumerate(curve for curve in curves if curve not in mixed)}
    number = len(panels) + len(mixed)
    figure = new_figure((5.5 * number, 4.5), title)
    drawn: Any = figure.subplots(1, number, squeeze=False)
    if mixed:
        _draw_counts(drawn[0, -1], points[points[axis.curve] == mixed[0]], axis, colours)
    for axes, panel in zip(drawn[0], panels, strict=False):
        for curve in [*mixed, *colours]:
            same, colour = points[points[axis.curve] == curve], colours.get(curve, "0.6")
            shares = 100.0 * same.groupby(axis.along)[panel.figure].agg(["median", "min", "max"])
            axes.fill_between(shares.index, shares["min"], shares["max"], color=colour, alpha=0.2, lw=0)
            name = curve_name(curve)
            axes.plot(
                shares.index, shares["median"], "o-", color=colour, ms=4, lw=5 if curve in mixed else 1.5, label=name
            )
            if panel.on_grid is not None:
                on_grid = 100.0 * same.groupby(axis.along)[panel.on_grid].median()
                label = None if mixed else f"{name}, on the grid"
                axes.plot(on_grid.index, on_grid, ":", color=colour, label=label)
        if panel.wanted is not None:
            axes.axhline(100.0 * panel.wanted, color="0.5", ls="--", label="wanted")
        axes.set(xlabel=LABELS[axis.along], ylabel=f"{panel.label} [%]")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(path)


def _draw_counts(axes: Any, points: pd.DataFrame, axis: Axis, colours: Mapping[str, str]) -> None:
    """Draw how many tags of each size a mixture has, medians over the seeds, in the colours of the sizes alone."""
    for edge, colour in colours.items():
        counts = points.groupby(axis.along)[f"{COUNT_OF}{edge}"].median()
        axes.plot(counts.index, counts, "o-", color=colour, ms=4, label=curve_name(edge))
    axes.set(xlabel=LABELS[axis.along], ylabel="tags of each size in the mixture")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
