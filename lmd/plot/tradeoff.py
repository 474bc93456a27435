"""How many, how big, as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from lmd.plot.common import new_figure


class Panel(NamedTuple):
    """A figure against the number of landmarks.

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


def save_tradeoff_figure(path: str | Path, points: pd.DataFrame, panels: Sequence[Panel], title: str) -> None:
    """Write a PNG, 550 pixels wide for each panel and 450 high: medians over the seeds, bands from least to greatest.

    Args:
        points: as for `lmd.evaluation.tradeoff.front`.
        panels: from left to right; their figures are shares.
    """
    figure = new_figure((5.5 * len(panels), 4.5), title)
    drawn: Any = figure.subplots(1, len(panels), squeeze=False)
    for axes, panel in zip(drawn[0], panels, strict=True):
        for i, edge in enumerate(np.unique(points.edge).tolist()):
            same, colour = points[points.edge == edge], f"C{i}"
            shares = 100.0 * same.groupby("count")[panel.figure].agg(["median", "min", "max"])
            axes.fill_between(shares.index, shares["min"], shares["max"], color=colour, alpha=0.2, lw=0)
            name = f"tags of {1e3 * edge:g} mm" if edge else "points"
            axes.plot(shares.index, shares["median"], "o-", color=colour, ms=4, label=name)
            if panel.on_grid is not None:
                on_grid = 100.0 * same.groupby("count")[panel.on_grid].median()
                axes.plot(on_grid.index, on_grid, ":", color=colour, label=f"{name}, on the grid")
        if panel.wanted is not None:
            axes.axhline(100.0 * panel.wanted, color="0.5", ls="--", label="wanted")
        axes.set(xlabel="number of landmarks K", ylabel=f"{panel.label} [%]")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(path)
