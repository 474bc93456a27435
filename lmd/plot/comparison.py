"""Convergence of several optimisers with bands over their seeds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmd.comparison import Outcome, best_at, by_optimiser


def save_comparison_figure(path: str | Path, outcomes: Sequence[Outcome], axis: str, title: str) -> None:
    """Write a PNG: median best fitness of each optimiser, with a band from its worst to its best seed.

    Args:
        path: the file.
        outcomes: all runs.
        axis: what runs are compared at, `evaluations` or `wall_time`.
        title: heads the picture.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.ticker import PercentFormatter

    groups = by_optimiser(outcomes)
    first = min(getattr(o.history[0], axis) for o in outcomes)
    last = max(getattr(o.history[-1], axis) for o in outcomes)
    at = np.geomspace(max(first, 1e-3 * last), last, 300)
    figure = Figure(figsize=(10, 6), dpi=100, layout="constrained")
    axes = figure.subplots()
    colours = mpl.colormaps["tab20"]
    for i, (name, runs) in enumerate(groups.items()):
        colour = colours(i % colours.N)
        curves = best_at(runs, axis, at)
        known = ~np.isnan(curves).any(axis=0)
        median = np.median(curves[:, known], axis=0)
        axes.fill_between(
            at[known], curves[:, known].min(axis=0), curves[:, known].max(axis=0), color=colour, alpha=0.2, lw=0
        )
        axes.plot(at[known], median, color=colour, lw=1.8, label=f"{name} {median[-1]:.1%}")
    axes.set_xscale("log")
    axes.set_xlabel("wall time [s]" if axis == "wall_time" else axis)
    axes.set_ylabel("best fitness: median, band from worst to best seed")
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(alpha=0.3)
    axes.set_title(title)
    figure.legend(loc="outside right upper", frameon=False)
    figure.savefig(path)
