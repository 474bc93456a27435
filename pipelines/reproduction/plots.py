"""What the sweeps found: the qualified ratio over the number of landmarks, as a PNG."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from lmd.plot.common import new_figure


def save_landmark_count_figure(
    path: str | Path, ratios: pd.DataFrame, references: Mapping[str, tuple[int, float]], title: str
) -> None:
    """Write a PNG: the qualified ratio against the number of landmarks K.

    Args:
        ratios: one row per run with the columns `count` (K) and `qualified_ratio` (fraction); a line joins the medians
            of each K.
        references: points (K, qualified ratio) to compare with, by name.
    """
    from matplotlib.ticker import PercentFormatter

    figure = new_figure((8.0, 4.8))
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
