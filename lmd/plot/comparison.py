"""Several optimisers side by side: convergence with bands over their seeds, and how many targets they reached."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmd.evaluation.comparison import OptimiserRun, attained, best_at, by_optimiser, curve_targets
from lmd.objectives.base import Headline
from lmd.plot.common import literal, logarithmic_ticks, new_figure


def save_comparison_figure(
    path: str | Path, runs: Sequence[OptimiserRun], axis: str, headline: Headline, title: str
) -> None:
    """Write a PNG of two panels over what was spent, on a logarithmic axis.

    The left one has the median best fitness of each optimiser, with a band from its worst to its best seed. The right
    one has the share of all seeds and targets that were reached (`attained`), as COCO and IOHprofiler draw it.

    Args:
        axis: what runs are compared at, `evaluations` or `wall_time`.
        headline: what the fitness is called and how it is shown.
    """
    import matplotlib as mpl

    groups = by_optimiser(runs, headline.key)
    first = min(getattr(run.history[0], axis) for run in runs)
    last = max(getattr(run.history[-1], axis) for run in runs)
    at = np.geomspace(max(first, 1e-3 * last), last, 300)
    targets = curve_targets(runs)
    figure = new_figure((15, 6), title)
    convergence, distribution = figure.subplots(1, 2, sharex=True)
    colours = mpl.colormaps["tab20"]
    for i, (name, group) in enumerate(groups.items()):
        colour = colours(i % colours.N)
        curves = headline.scale * best_at(group, axis, at)
        known = ~np.isnan(curves).any(axis=0)
        median = np.median(curves[:, known], axis=0)
        convergence.fill_between(
            at[known], curves[:, known].min(axis=0), curves[:, known].max(axis=0), color=colour, alpha=0.2, lw=0
        )
        convergence.plot(
            at[known], median, color=colour, lw=1.8, label=f"{literal(name)} {median[-1]:.1f}{headline.unit}"
        )
        distribution.step(at, attained(group, axis, at, targets), color=colour, lw=1.8, where="post")
    ticks = logarithmic_ticks(at[0], at[-1])
    low, high = headline.scale * targets[[0, -1]]
    if high > low:
        convergence.set_ylim(low, high + 0.03 * (high - low))
    convergence.set_ylabel(f"best fitness [{headline.unit}]: median, band from worst to best seed")
    distribution.set_ylim(0.0, 1.0)
    distribution.set_ylabel(f"share of seeds and of {len(targets)} targets, {low:.1f} to {high:.1f}{headline.unit}")
    for axes in (convergence, distribution):
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
        axes.set_xticks([], minor=True)
        axes.set_xlabel("wall time [s]" if axis == "wall_time" else axis)
        axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False)
    figure.savefig(path)
