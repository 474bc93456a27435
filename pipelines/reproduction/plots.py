"""What the sweeps found: the qualified ratio over (n, thold_p) and over the number of landmarks, as PNGs."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

DARK = 0.6  # of the colour scale; text on darker cells is white


def save_heat_map(path: str | Path, tables: Mapping[str, pd.DataFrame], title: str) -> None:
    """Write a PNG of heat maps side by side, with the value in every cell.

    Args:
        path: the PNG.
        tables: qualified ratios (fractions; NaN for a cell without a run), by the heading of their panel; indexed by n,
            one column per thold_p, the same in all tables.
        title: one line above the panels.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(0.6 + 3.6 * len(tables), 4.2), dpi=100, facecolor="white", layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(1, len(tables), sharey=True, squeeze=False)[0]
    for axes, (name, table) in zip(panels, tables.items(), strict=True):
        image = axes.imshow(table, cmap="Greens", vmin=0.0, vmax=1.0, aspect="auto")
        for (row, column), value in np.ndenumerate(table.to_numpy()):
            text = "no run" if np.isnan(value) else f"{value:.2%}"
            colour = "white" if value > DARK else "black"
            axes.text(column, row, text, ha="center", va="center", color=colour)
        axes.set_title(name, fontsize=11)
        axes.set_xticks(range(table.shape[1]), [f"{p:.2f}" for p in table.columns])
        axes.set_yticks(range(table.shape[0]), [str(n) for n in table.index])
        axes.set_xlabel("thold_p")
    panels[0].set_ylabel("n")
    figure.colorbar(image, ax=panels, format="{x:.0%}", label="qualified ratio")
    figure.savefig(path)


def save_landmark_count_figure(
    path: str | Path, ratios: pd.DataFrame, references: Mapping[str, tuple[int, float]], title: str
) -> None:
    """Write a PNG: the qualified ratio against the number of landmarks K.

    Args:
        path: the PNG.
        ratios: one row per run with the columns `count` (K) and `qualified_ratio` (fraction); a line joins the medians
            of each K.
        references: points (K, qualified ratio) to compare with, by name.
        title: one line above the axes.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import PercentFormatter

    figure = Figure(figsize=(8.0, 4.8), dpi=100, facecolor="white", layout="constrained")
    axes = figure.add_subplot(title=title, xlabel="landmarks K", ylabel="qualified ratio")
    medians = ratios.groupby("count")["qualified_ratio"].median()
    axes.plot(medians.index, medians, color="C2", label="median of the runs")
    axes.plot(ratios["count"], ratios["qualified_ratio"], "o", color="C2", markersize=5, alpha=0.6, label="run")
    for i, (name, (count, ratio)) in enumerate(references.items()):
        axes.plot(count, ratio, marker="D", color=f"C{3 + i}", linestyle="none", label=name)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(path)
