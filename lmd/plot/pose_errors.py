"""Figures of pose errors, as PNGs: over time, over the positions of a room, and with several maps of some tags."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray, IntArray
from lmd.estimation.cramer_rao import CramerRaoMap
from lmd.evaluation.accuracy import TOLERANCES
from lmd.plot import common
from lmd.plot.common import literal, new_figure, series
from lmd.space.space import Space

QUANTITIES = {
    "error": r"$Er = \|X - \hat X\|_F^2$",
    "position": "position error [m]",
    "attitude": "attitude error [rad]",
}
DECADES = 12  # number of decades shown below the largest error


def save_error_figure(
    path: str | Path, curves: pd.DataFrame, time: FloatArray, counts: dict[str, IntArray], n: int, title: str
) -> None:
    """Write a PNG: for each estimator the errors over time, below them the landmarks in view.

    Args:
        path: path of the PNG.
        curves: result of `FlightStudy.curves`.
        time: time of the frames, `(T,)`, seconds.
        counts: number of landmarks in each frame of one flight, `(T,)`, by deployment.
        n: number of landmarks that is marked by a dotted line.
        title: title of the figure.
    """
    estimators, names = list(curves.estimator.unique()), list(counts)
    columns = len(estimators)
    figure = new_figure((3.0 + 5.0 * columns, 12.0), title)
    parts: Any = figure.subfigures(2, 1, height_ratios=[len(QUANTITIES), 1])
    upper, lower = parts
    panels = upper.subplots(len(QUANTITIES), columns, sharex=True, sharey="row", squeeze=False)
    for row, (quantity, label) in zip(panels, QUANTITIES.items(), strict=True):
        row[0].set_ylabel(label)
        for axes, estimator in zip(row, estimators, strict=True):
            for i, name in enumerate(names):
                curve = curves[(curves.estimator == estimator) & (curves.deployment == name)]
                low, median, high = (curve[f"{quantity}_{part}"].to_numpy() for part in ("low", "median", "high"))
                axes.fill_between(curve.time, low, high, color=series(i)["color"], alpha=0.2, lw=0)
                axes.plot(curve.time, median, lw=1.6, label=literal(name), **series(i))
            axes.set_yscale("log")
            axes.grid(alpha=0.3)
        low, top = curves[f"{quantity}_low"], float(curves[f"{quantity}_high"].max())
        if top > 0.0:  # without noise a bound is 0 and has no logarithm
            row[0].set_ylim(bottom=max(top * 10.0**-DECADES, 0.3 * float(low[low > 0.0].min())))
    for axes, estimator in zip(panels[0], estimators, strict=True):
        axes.set_title(literal(estimator))
    panels[0][-1].legend(frameon=False)
    axes = lower.subplots()
    for i, name in enumerate(names):
        axes.step(time, counts[name], where="post", lw=0.8, alpha=0.8, **series(i))
    axes.axhline(n, color="green", linestyle=":", lw=2.0)
    axes.set(xlabel="time [s]", ylabel="landmarks in view, first flight")
    axes.grid(alpha=0.3)
    figure.savefig(path)


def save_cramer_rao_map(path: str | Path, room: Space, bounds: CramerRaoMap, title: str) -> None:
    """Write a PNG: at each position the share of single frames that determine the pose, and their median position
    bound.

    Args:
        path: path of the PNG.
        room: room, drawn as a box.
        bounds: bounds for one deployment.
        title: title of the figure.
    """
    from matplotlib.colors import LogNorm

    figure = new_figure((15.0, 7.0), title)
    finite = np.isfinite(bounds.position)
    size = 49.0 * common.ball_scale(room, bounds.positions) ** 2
    shown: tuple[tuple[FloatArray, str, dict[str, Any]], ...] = (
        (bounds.share, "share of orientations in which one frame fixes the pose", {"vmin": 0.0, "vmax": 1.0}),
        (1e3 * np.where(finite, bounds.position, np.nan), "median position bound there [mm per pixel of noise]",
         {"norm": LogNorm()}),
    )  # fmt: skip
    for i, (values, label, scale) in enumerate(shown, start=1):
        axes = figure.add_subplot(1, 2, i, projection="3d")
        axes.set_box_aspect(common.size_of(room))
        for edges in room.outline().values():
            for edge in edges:
                axes.plot(*edge.T, color=common.REACHABLE, lw=0.8)
        axes.set(**dict(zip(("xlabel", "ylabel", "zlabel"), common.AXIS_LABELS, strict=True)))
        drawn = np.isfinite(values)
        colours = common.COLOUR_MAP if i == 1 else f"{common.COLOUR_MAP}_r"  # bright is good in both panels
        balls = axes.scatter(
            *bounds.positions[drawn].T, c=values[drawn], s=size, cmap=colours, linewidths=0, depthshade=False, **scale
        )
        if drawn.any():
            bar = figure.colorbar(balls, ax=axes, orientation="horizontal", shrink=0.6, pad=0.02, label=label)
            if "norm" in scale:
                common.set_ticks(bar, common.logarithmic_ticks(np.nanmin(values), np.nanmax(values)))
    figure.savefig(path)


def save_map_figure(path: str | Path, views: pd.DataFrame, title: str) -> None:
    """Write a PNG of 800 x 500 pixels: for each map, the share of views with a position error below the value on the
    axis.

    Args:
        path: path of the PNG.
        views: rows of `lmd.evaluation.maps.map_errors`; views without an estimate count as infinitely far off.
        title: title of the figure.
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
