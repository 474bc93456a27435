"""A figure over two settings, as heat maps with the value in every cell."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.plot.common import literal, new_figure

DARK_BELOW = 0.6  # of the colour scale; text on darker cells is white


def save_heat_map(path: str | Path, tables: Mapping[str, pd.DataFrame], title: str, label: str) -> None:
    """Write a PNG of heat maps side by side.

    Args:
        tables: shares (fractions; NaN for a cell without a run), by the heading of their panel. The index and the
            columns are named, and the same in all tables.
        label: what the shares are.
    """
    rows, columns = next(iter(tables.values())).shape
    size = (1.6 + 1.0 * max(columns, 3) * len(tables), 1.8 + 0.8 * max(rows, 3))
    figure = new_figure(size, title)
    panels = figure.subplots(1, len(tables), sharey=True, squeeze=False)[0]
    for axes, (name, table) in zip(panels, tables.items(), strict=True):
        image = axes.imshow(table, cmap="Greens", vmin=0.0, vmax=1.0, aspect="auto")
        for (row, column), value in np.ndenumerate(table.to_numpy()):
            text = "no run" if np.isnan(value) else f"{value:.2%}"
            colour = "white" if value > DARK_BELOW else "black"
            axes.text(column, row, text, ha="center", va="center", color=colour)
        axes.set_title(literal(name), fontsize=11)
        axes.set_xticks(range(columns), [_written(value) for value in table.columns])
        axes.set_yticks(range(rows), [_written(value) for value in table.index])
        axes.set_xlabel(literal(table.columns.name))
    panels[0].set_ylabel(literal(table.index.name))
    figure.colorbar(image, ax=panels, format="{x:.0%}", label=label)
    figure.savefig(path)


def _written(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else literal(value)
