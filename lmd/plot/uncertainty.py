"""Picture of the uncertainty of the pose from one image, as a PNG: over the room, by heading, by distance."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.evaluation.uncertainty import ONE
from lmd.evaluation.uncertainty_law import UncertaintyLaw, per_axis
from lmd.plot import common
from lmd.plot.common import LANDMARK, draw_plan, new_figure, set_ticks, shrink
from lmd.plot.plans import NO_MEDIAN_COLOUR

if TYPE_CHECKING:
    from lmd.evaluation.uncertainty import Uncertainty
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

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
    """Write a PNG of three panels.

    From above: the share of views with one pose and the heading with the least share in each cell. The median standard
    deviation of the position, per axis, of the views with one pose. At the right: that deviation over the mean distance
    of the tags, with its law.

    Args:
        path: path of the PNG.
        problem: problem with the room.
        deployment: K tags.
        found: uncertainty in all views.
        law: laws of the uncertainty.
        title: title of the figure.
    """
    length, width, _ = common.size_of(problem.scene.room)
    figure = new_figure((17.0, 2.4 + 5.4 * float(np.clip(width / length, 0.5, 1.2))), title)
    shares, errors, by_distance = figure.subplots(1, 3)
    views = found.views.assign(sd=per_axis(found.views)["position"], one=found.views.pose == ONE)
    x, y, cell = _cells(views[["x", "y"]].to_numpy())
    _draw_shares(shares, views, x, y, cell)
    _draw_errors(errors, views, x, y, cell)
    for axes in (shares, errors):
        draw_plan(axes, problem.scene.room, lw=1.0)
        arrows = common.ARROW_LENGTH * deployment.normals[:, :2]
        axes.quiver(*deployment.places[:, :2].T, *arrows.T, color=LANDMARK, angles="xy", scale_units="xy", scale=1.0,
                    width=0.003, zorder=3)  # fmt: skip
        axes.set(xlabel=common.AXIS_LABELS[0], ylabel=common.AXIS_LABELS[1], aspect="equal")
    _draw_law(by_distance, views, law)
    figure.savefig(path)
    shrink(path)


def _cells(places: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Bounds of nearly square cells along x and y, and the cell of each place `(V, 2)`, counted along x first."""
    low, high = places.min(axis=0), np.maximum(places.max(axis=0), places.min(axis=0) + 1e-3)
    counts = np.maximum(np.rint(CELLS * (high - low) / (high - low).max()).astype(int), 1)
    bounds = [np.linspace(low[i], high[i], counts[i] + 1) for i in range(2)]
    column, row = (np.clip(np.searchsorted(bounds[i], places[:, i]) - 1, 0, counts[i] - 1) for i in range(2))
    return bounds[0], bounds[1], np.asarray(row * counts[0] + column)


def _draw_shares(axes: Any, views: Any, x: FloatArray, y: FloatArray, cell: IntArray) -> None:
    """Draw the share of views with one pose in each cell, and the heading with the least share as an arrow."""
    columns, rows = len(x) - 1, len(y) - 1
    number, hits = (np.bincount(cell, weights, columns * rows) for weights in (None, views.one.astype(float)))
    share = np.where(number >= LEAST_IN_CELL, hits / np.maximum(number, 1), np.nan)
    mesh = axes.pcolormesh(x, y, share.reshape(rows, columns), cmap=common.COLOUR_MAP)
    sector = np.floor((views.yaw.to_numpy() / (2.0 * np.pi) + 0.5 / SECTORS) * SECTORS).astype(int) % SECTORS
    both = cell * SECTORS + sector
    number, hits = (np.bincount(both, weights, share.size * SECTORS) for weights in (None, views.one.astype(float)))
    ratio = np.where(number >= LEAST_IN_CELL, hits / np.maximum(number, 1), np.nan).reshape(-1, SECTORS)
    known = np.flatnonzero(np.isfinite(ratio).any(axis=1))
    worst = np.nanargmin(ratio[known], axis=1) * 2.0 * np.pi / SECTORS
    middle = x[known % columns] + (x[1] - x[0]) / 2.0, y[known // columns] + (y[1] - y[0]) / 2.0
    reach = 0.8 * min(x[1] - x[0], y[1] - y[0])
    axes.quiver(*middle, reach * np.sin(worst), reach * np.cos(worst), angles="xy", scale_units="xy", scale=1.0,
                pivot="middle", color="white", edgecolor="black", linewidth=0.5, width=0.006, zorder=4)  # fmt: skip
    label = "share of views with one pose"
    axes.figure.colorbar(mesh, ax=axes, label=label, orientation="horizontal", aspect=40)
    axes.set_title("one pose; arrows: heading with the least share", fontsize=11)


def _draw_errors(axes: Any, views: Any, x: FloatArray, y: FloatArray, cell: IntArray) -> None:
    """Draw the median standard deviation of the position in each cell, over the views with one pose."""
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
    set_ticks(bar, common.logarithmic_ticks(low, high))
    axes.set_title("views with one pose", fontsize=11)


def _draw_law(axes: Any, views: Any, law: UncertaintyLaw) -> None:
    """Draw the standard deviation of the position over the mean distance of the tags, with its law."""
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
    axes.set(xlabel="mean distance of the tags [m]", ylabel="standard deviation of the position per axis [mm]")
    axes.set_title("dots: views; lines: law", fontsize=11)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        set_ticks(axis, common.logarithmic_ticks(low, high))
    axes.legend()
    axes.grid(alpha=0.3)
