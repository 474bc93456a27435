"""The error of the pose with several maps of the same tags, as a picture."""

from pathlib import Path

import numpy as np
import pandas as pd

from lmd.evaluation.accuracy import TOLERANCES
from lmd.plot.common import literal, new_figure


def save_map_figure(path: str | Path, views: pd.DataFrame, title: str) -> None:
    """Write a PNG of 800 x 500 pixels: the share of views with a position error below that of the axis.

    Args:
        views: rows of `lmd.evaluation.maps.map_errors`; views without an estimate never come in.
    """
    figure = new_figure((8.0, 5.0))
    axes = figure.subplots()
    for column in views.columns[views.columns.str.startswith("position_")]:
        errors = 1e3 * np.sort(views[column].dropna())
        below = 100.0 * np.arange(1, len(errors) + 1) / max(len(views), 1)
        axes.step(errors, below, where="post", label=literal(f"map as {column.removeprefix('position_')}"))
    for limit in TOLERANCES:
        axes.axvline(1e3 * limit, color="0.7", linestyle=":", zorder=0)
    axes.set_xscale("log")
    axes.set(
        xlabel="position error of one image by PnP, less than [mm]", ylabel="share of views [%]", ylim=(0.0, 100.0)
    )
    axes.set_title(literal(title), fontsize=11)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path)
