"""How the best deployment found improves with the number of evaluations, as a PNG."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lmd.objectives.base import Headline
from lmd.plot.common import literal, new_figure


def save_convergence_figure(path: str | Path, history: Mapping[str, ArrayLike], headline: Headline, title: str) -> None:
    """Write a PNG with the best fitness so far as a step line over evaluations.

    Args:
        history: `evaluations`, `best_fitness` and `wall_time` (seconds since the start) at each recorded moment, of
            which there is at least one.
        headline: what the fitness is called and how it is shown.
    """
    from matplotlib.ticker import MaxNLocator

    evaluations, fitness, seconds = (np.asarray(history[key]) for key in ("evaluations", "best_fitness", "wall_time"))
    best = headline.scale * fitness
    figure = new_figure((9.0, 5.0))
    axes = figure.add_subplot()
    axes.step(evaluations, best, where="post", linewidth=1.8)
    axes.plot(evaluations[-1], best[-1], "o", color="C0", clip_on=False)
    axes.set(title=literal(title), xlabel="evaluations", ylabel=f"best fitness [{headline.unit}]", ylim=headline.limits)
    axes.set_xlim(left=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.grid(alpha=0.4)
    # In the half of the axes that the end of the line leaves free.
    y, align = (0.04, "bottom") if best[-1] > np.mean(axes.get_ylim()) else (0.96, "top")
    axes.text(
        0.97,
        y,
        f"{best[-1]:.2f} {headline.unit} after {evaluations[-1]:,.0f} evaluations, {_duration(seconds[-1])}",
        transform=axes.transAxes,
        horizontalalignment="right",
        verticalalignment=align,
        bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "0.7"},
    )
    figure.savefig(path)


def _duration(seconds: float) -> str:
    """`75.3` as `1 min 15 s`."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"
