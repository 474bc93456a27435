"""Convergence of several optimisers with bands over their seeds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmd.evaluation.comparison import OptimiserRun, best_at, by_optimiser
from lmd.objectives.base import Headline


def save_comparison_figure(
    path: str | Path, runs: Sequence[OptimiserRun], axis: str, headline: Headline, title: str
) -> None:
    """Write a PNG: median best fitness of each optimiser, with a band from its worst to its best seed.

    Args:
        path: the file.
        runs: all of them.
        axis: what runs are compared at, `evaluations` or `wall_time`.
        headline: what the fitness is called and how it is shown.
        title: heads the picture.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    groups = by_optimiser(runs, headline.key)
    first = min(getattr(run.history[0], axis) for run in runs)
    last = max(getattr(run.history[-1], axis) for run in runs)
    at = np.geomspace(max(first, 1e-3 * last), last, 300)
    figure = Figure(figsize=(10, 6), dpi=100, layout="constrained")
    axes = figure.subplots()
    colours = mpl.colormaps["tab20"]
    for i, (name, group) in enumerate(groups.items()):
        colour = colours(i % colours.N)
        curves = headline.scale * best_at(group, axis, at)
        known = ~np.isnan(curves).any(axis=0)
        median = np.median(curves[:, known], axis=0)
        axes.fill_between(
            at[known], curves[:, known].min(axis=0), curves[:, known].max(axis=0), color=colour, alpha=0.2, lw=0
        )
        axes.plot(at[known], median, color=colour, lw=1.8, label=f"{name} {median[-1]:.1f}{headline.unit}")
    axes.set_xscale("log")
    axes.set_xlabel("wall time [s]" if axis == "wall_time" else axis)
    axes.set_ylabel(f"best fitness [{headline.unit}]: median, band from worst to best seed")
    axes.set_ylim(headline.limits)
    axes.grid(alpha=0.3)
    axes.set_title(title)
    figure.legend(loc="outside right upper", frameon=False)
    figure.savefig(path)
