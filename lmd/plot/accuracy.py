"""How accurate single images are over the plan of a room, for several deployments beside each other."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lmd.evaluation.accuracy import plan_of_errors
from lmd.plot import common
from lmd.plot.common import new_figure
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

NO_MEDIAN_COLOUR = "#c8c8c8"  # where there is no median


def save_accuracy_figure(path: str | Path, deployments: Mapping[str, tuple[Problem, Deployment]], title: str) -> None:
    """Write a PNG: top views with the landmarks and the median predicted error as colour, on one scale.

    The median is that of all views of the grid's positions above a place of the plan.

    Args:
        deployments: a deployment and the problem that it is judged for, by what heads its panel.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    # The medians as tables, y by x, in millimetres; NaN where the grid has no position.
    each = (plan_of_errors(problem, deployment) for problem, deployment in deployments.values())
    plans = [1e3 * one.pivot(index="y", columns="x", values="predicted_error_median") for one in each]
    known = np.concatenate([plan.to_numpy().ravel() for plan in plans])
    known = known[np.isfinite(known)]
    low, high = (known.min(), known.max()) if len(known) else (1.0, 10.0)
    colours = colormaps[f"{common.COLOUR_MAP}_r"].with_extremes(over=NO_MEDIAN_COLOUR)  # bright is good
    length, width, _ = np.max([common.size_of(problem.scene.room) for problem, _ in deployments.values()], axis=0)
    size = (1.0 + 5.0 * len(plans), 2.2 + 5.0 * width / length)
    figure = new_figure(size, title)
    panels: Any = figure.subplots(1, len(plans), squeeze=False, sharex=True, sharey=True)[0]
    for axes, plan, (heading, (problem, deployment)) in zip(panels, plans, deployments.items(), strict=True):
        shown = np.where(np.isinf(plan), 2.0 * high, plan)  # infinite has no logarithm
        mesh = axes.pcolormesh(
            plan.columns, plan.index, shown, cmap=colours, norm=LogNorm(low, high), shading="nearest"
        )
        for part, edges in problem.scene.room.outline().items():
            colour, dashed = common.PARTS[part]
            for edge in edges:
                axes.plot(*edge[:, :2].T, color=colour, linestyle="--" if dashed else "-", lw=1.0)
        arrows = common.ARROW_LENGTH * deployment.normals[:, :2]
        axes.quiver(*deployment.positions[:, :2].T, *arrows.T, color=common.LANDMARK, angles="xy",
                    scale_units="xy", scale=1.0, width=0.003, zorder=3)  # fmt: skip
        axes.plot(*deployment.positions[:, :2].T, "o", color=common.LANDMARK, ms=2.5, zorder=3)
        axes.set(xlabel=common.AXIS_LABELS[0], title=common.literal(heading), aspect="equal")
    panels[0].set_ylabel(common.AXIS_LABELS[1])
    label = "median predicted error of the position [mm];\ngrey where most views see too few landmarks"
    bar = figure.colorbar(mesh, ax=list(panels), label=label, extend="max", orientation="horizontal", aspect=60)
    ticks = common.logarithmic_ticks(low, high)
    bar.set_ticks(ticks.tolist(), labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    figure.savefig(path)
