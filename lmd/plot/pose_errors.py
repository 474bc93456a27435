"""Figures of pose errors, as PNGs.

The figures show errors of estimators against time, errors with several maps of the tags, and the uncertainty of the
pose from single images in a room.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray, IntArray
from lmd.evaluation.accuracy import TOLERANCES
from lmd.evaluation.uncertainty import ONE
from lmd.evaluation.uncertainty_law import UncertaintyLaw, per_axis
from lmd.plot import common
from lmd.plot.common import LANDMARK, draw_band, draw_plan, dress, literal, new_figure, new_panels, series, shrink
from lmd.plot.plans import NO_MEDIAN_COLOUR

if TYPE_CHECKING:
    from lmd.evaluation.uncertainty import Uncertainty
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment


QUANTITIES = {
    "error": r"$Er = \|X - \hat X\|_F^2$",
    "position": "position error [m]",
    "attitude": "attitude error [rad]",
}
DECADES = 12  # number of decades shown below the largest error


def save_error_figure(
    path: str | Path, curves: pd.DataFrame, time: FloatArray, counts: dict[str, IntArray], n: int, title: str
) -> None:
    """Write a PNG of the errors of estimated poses against time; a lower panel shows the numbers of landmarks in view.

    Args:
        path: path of the PNG.
        curves: table of the errors that `FlightStudy.curves` returns.
        time: time of the frames, `(T,)`, seconds.
        counts: number of landmarks in each frame of one flight, `(T,)`, keyed by deployment.
        n: required number of landmarks, marked by a dotted line.
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
                bands = [curve[f"{quantity}_{part}"].to_numpy() for part in ("low", "median", "high")]
                draw_band(axes, curve.time, bands, literal(name), lw=1.6, **series(i))
            dress(axes, yscale="log")
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
    dress(axes, xlabel="time [s]", ylabel="landmarks in view, first flight")
    figure.savefig(path)


def save_map_figure(path: str | Path, views: pd.DataFrame, title: str) -> None:
    """Write a PNG of 800 x 500 pixels with a curve for each map of the tags.

    The curve shows the share of views whose position error is below the value on the horizontal axis.

    Args:
        path: path of the PNG.
        views: rows of `lmd.evaluation.maps.map_errors`; views without an estimate count as views with an infinite
            error.
        title: title of the figure.
    """
    figure, ((axes,),) = new_panels((8.0, 5.0), title, 1, 1)
    for column in views.columns[views.columns.str.startswith("position_")]:
        errors = 1e3 * np.sort(views[column].dropna())
        below = 100.0 * np.arange(1, len(errors) + 1) / max(len(views), 1)
        axes.step(errors, below, where="post", label=literal(f"map as {column.removeprefix('position_')}"))
    for limit in TOLERANCES:
        axes.axvline(1e3 * limit, color="0.7", linestyle=":", zorder=0)
    label = "position error of one image by PnP, less than [mm]"
    dress(axes, legend=True, xscale="log", xlabel=label, ylabel="share of views [%]", ylim=(0.0, 100.0))
    figure.savefig(path)


CELLS = 16  # number of cells along the longer side of the views
SECTORS = 8  # number of sectors of the heading
LEAST_IN_CELL = 5  # least number of views of a coloured cell or a sector
MOST_DOTS = 1500  # greatest number of dots of a number of tags
NUMBERS = (1, 2, 3, 4)  # numbers of tags in the right panel


def save_uncertainty_figure(
    path: str | Path,
    problem: "Problem",
    deployment: "Deployment",
    found: "Uncertainty",
    law: UncertaintyLaw,
    title: str,
) -> None:
    """Write a PNG of three panels about the uncertainty of the pose from single images.

    The first panel shows the room from above, divided into cells. The colour of a cell is the share of views with an
    unambiguous pose, and an arrow shows the heading of the camera for which this share is least. The second panel shows
    the median standard deviation of the position per axis in each cell, over the views with an unambiguous pose. The
    third panel plots this standard deviation against the mean distance of the tags, and the law (fitted formula).

    Args:
        path: path of the PNG.
        problem: problem with the room.
        deployment: K tags.
        found: uncertainty in all views.
        law: laws, i.e. a formula fitted to each standard deviation of the pose.
        title: title of the figure.
    """
    length, width, _ = common.size_of(problem.scene.room)
    inches = 17.0, 2.4 + 5.4 * float(np.clip(width / length, 0.5, 1.2))
    figure, ((shares, errors, by_distance),) = new_panels(inches, title, 1, 3)
    views = found.views.assign(sd=per_axis(found.views)["position"], one=found.views.pose == ONE)
    x, y, cell = _cells(views[["x", "y"]].to_numpy())
    _draw_shares(shares, views, x, y, cell)
    _draw_errors(errors, views, x, y, cell)
    for axes in (shares, errors):
        draw_plan(axes, problem.scene.room, lw=1.0)
        arrows = common.ARROW_LENGTH * deployment.normals[:, :2]
        common.draw_arrows(axes, deployment.places[:, :2], arrows, color=LANDMARK)
        common.from_above(axes)
    _draw_law(by_distance, views, law)
    figure.savefig(path)
    shrink(path)


def _cells(places: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Divide the floor into nearly square cells, and find the cell of each of V places `(V, 2)`, metres.

    Returns:
        coordinates x of the lines between columns of cells, coordinates y of the lines between rows, and the index of
        the cell of each place, `(V,)`. Cells are numbered row by row, along x first.
    """
    low, high = places.min(axis=0), np.maximum(places.max(axis=0), places.min(axis=0) + 1e-3)
    counts = np.maximum(np.rint(CELLS * (high - low) / (high - low).max()).astype(int), 1)
    bounds = [np.linspace(low[i], high[i], counts[i] + 1) for i in range(2)]
    column, row = (np.clip(np.searchsorted(bounds[i], places[:, i]) - 1, 0, counts[i] - 1) for i in range(2))
    return bounds[0], bounds[1], np.asarray(row * counts[0] + column)


def _draw_shares(axes: Any, views: Any, x: FloatArray, y: FloatArray, cell: IntArray) -> None:
    """Draw the share of views with an unambiguous pose in each cell of the floor.

    An arrow in the cell shows the heading of the camera for which this share is least. `x`, `y` and `cell` are the
    results of `_cells`.
    """
    columns, rows = len(x) - 1, len(y) - 1
    share = _shares(cell, views.one, columns * rows)
    mesh = axes.pcolormesh(x, y, share.reshape(rows, columns), cmap=common.COLOUR_MAP)
    sector = np.floor((views.yaw.to_numpy() / (2.0 * np.pi) + 0.5 / SECTORS) * SECTORS).astype(int) % SECTORS
    ratio = _shares(cell * SECTORS + sector, views.one, share.size * SECTORS).reshape(-1, SECTORS)
    known = np.flatnonzero(np.isfinite(ratio).any(axis=1))
    worst = np.nanargmin(ratio[known], axis=1) * 2.0 * np.pi / SECTORS
    middle = x[known % columns] + (x[1] - x[0]) / 2.0, y[known // columns] + (y[1] - y[0]) / 2.0
    ways = 0.8 * min(x[1] - x[0], y[1] - y[0]) * np.stack([np.sin(worst), np.cos(worst)], axis=1)
    style = {"color": "white", "edgecolor": "black", "linewidth": 0.5, "width": 0.006, "zorder": 4}
    common.draw_arrows(axes, np.stack(middle, axis=1), ways, pivot="middle", **style)
    label = "share of views with one pose"
    axes.figure.colorbar(mesh, ax=axes, label=label, orientation="horizontal", aspect=40)
    axes.set_title("one pose; arrows: heading with the least share", fontsize=11)


def _shares(cell: IntArray, hit: Any, count: int) -> FloatArray:
    """Share of the views in each of `count` cells for which `hit` is True, `(count,)`; NaN for cells with few views.

    `cell` `(V,)` has the index of each view's cell, and `hit` is a mask `(V,)`.
    """
    number, hits = np.bincount(cell, minlength=count), np.bincount(cell, hit.astype(float), count)
    return np.where(number >= LEAST_IN_CELL, hits / np.maximum(number, 1), np.nan)


def _draw_errors(axes: Any, views: Any, x: FloatArray, y: FloatArray, cell: IntArray) -> None:
    """Draw the median standard deviation of the position in each cell of the floor, for unambiguous poses.

    `x`, `y` and `cell` are the results of `_cells`.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    columns, rows = len(x) - 1, len(y) - 1
    one = views.one.to_numpy()
    groups = views.sd[one].groupby(cell[one])
    medians = groups.median()[groups.size() >= LEAST_IN_CELL]
    table = np.full(columns * rows, np.nan)
    table[medians.index.to_numpy(dtype=int)] = 1e3 * medians.to_numpy()
    known = table[np.isfinite(table)]
    low, high = (known.min(), known.max() * (1.0 + 1e-9)) if len(known) else (1.0, 10.0)
    colours = colormaps[f"{common.COLOUR_MAP}_r"].with_extremes(bad=NO_MEDIAN_COLOUR)
    mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(table.reshape(rows, columns)), cmap=colours,
                           norm=LogNorm(low, high))  # fmt: skip
    label = "median standard deviation of the position per axis [mm]"
    bar = axes.figure.colorbar(mesh, ax=axes, label=label, orientation="horizontal", aspect=40)
    common.set_log_ticks(bar, low, high)
    axes.set_title("views with one pose", fontsize=11)


def _draw_law(axes: Any, views: Any, law: UncertaintyLaw) -> None:
    """Plot the position's standard deviation in each view, and the formula fitted to it, against mean tag distance."""
    one = views[views.one]
    for number in NUMBERS:
        some = one[one.tags == number]
        if not len(some):
            continue
        name = "1 tag" if number == 1 else f"{number} tags"
        dots = some.iloc[:: max(1, len(some) // MOST_DOTS)]
        (drawn,) = axes.loglog(dots.distance, 1e3 * dots.sd, ".", ms=3.0, alpha=0.35)
        along = np.linspace(some.distance.min(), some.distance.max(), 50)
        expected = law.laws["position"].at(along, np.full(len(along), number))
        axes.loglog(along, 1e3 * expected, color=drawn.get_color(), lw=2.0, label=name)
    label = "standard deviation of the position per axis [mm]"
    dress(axes, legend=True, xlabel="mean distance of the tags [m]", ylabel=label)
    axes.set_title("dots: views; lines: law", fontsize=11)
    common.set_log_ticks(axes.xaxis, *axes.get_xlim())
    common.set_log_ticks(axes.yaxis, *axes.get_ylim())
