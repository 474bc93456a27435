"""Pictures of optimisers over several problems: critical difference diagram, performance profiles, ECDF."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.checks import FloatArray
from lmd.plot.common import literal, logarithmic_ticks, new_figure, series, set_ticks

if TYPE_CHECKING:
    import pandas as pd

ROW, HEAD = 0.28, 1.0  # inches: height of a name, and of axis and bar above the names
LEFT, RIGHT = 0.30, 0.70  # ends of the axis of ranks, as fractions of the width
LABEL = 45  # characters of the name of an optimiser


def save_critical_difference_diagram(path: Path, ranks: "pd.Series", critical: float, title: str) -> None:
    """Write a PNG with the mean ranks on an axis; bars join optimisers that do not differ significantly.

    Args:
        path: path of the PNG.
        ranks: mean rank of each optimiser, ascending.
        critical: critical difference; NaN to draw no bars.
        title: title of the figure.
    """
    count, half = len(ranks), (len(ranks) + 1) // 2
    bars = _cliques(ranks.to_numpy(), critical)
    height = HEAD + ROW * half + 0.12 * len(bars) + 0.5
    figure = new_figure((9.0, height))
    axes = figure.add_subplot()
    axes.set(xlim=(0.0, 1.0), ylim=(height - 0.4, 0.0))
    axes.axis("off")
    axes.set_title(literal(title))

    def place(rank: float) -> float:
        return LEFT + (rank - 1.0) / max(count - 1, 1) * (RIGHT - LEFT)

    line = 0.65
    axes.plot([place(1), place(count)], [line, line], color="black")
    for tick in range(1, count + 1):
        axes.plot([place(tick)] * 2, [line - 0.06, line], color="black")
        axes.text(place(tick), line - 0.1, str(tick), ha="center", va="bottom", fontsize=8)
    if np.isfinite(critical):
        axes.plot([place(1), place(1 + critical)], [0.25, 0.25], color="black", linewidth=2)
        axes.text(place(1 + critical) + 0.01, 0.25, f"critical difference {critical:.2f}", va="center", fontsize=8)
    for i, (first, last) in enumerate(bars):
        at = line + 0.12 * (i + 1)
        ends = [place(ranks.iloc[first]) - 0.004, place(ranks.iloc[last]) + 0.004]
        axes.plot(ends, [at, at], color="C0", linewidth=3.5, solid_capstyle="butt")
    top = line + 0.12 * (len(bars) + 1) + 0.2
    for i, (name, rank) in enumerate(ranks.items()):
        is_left = i < half
        y = top + ROW * (i if is_left else count - 1 - i)
        x, align = (LEFT - 0.02, "right") if is_left else (RIGHT + 0.02, "left")
        axes.plot([place(rank), place(rank), x], [line, y, y], color="0.4", linewidth=0.8)
        text = f"{_label(name)}  {rank:.2f}" if is_left else f"{rank:.2f}  {_label(name)}"
        axes.text(x, y, text, ha=align, va="center", fontsize=9)
    figure.savefig(path)


def _label(name: object) -> str:
    """Name of an optimiser, cut after whole words if it has many overrides."""
    return literal(shorten(str(name).replace("optimiser.", ""), LABEL, placeholder=" ..."))


def _cliques(ranks: FloatArray, critical: float) -> list[tuple[int, int]]:
    """Longest runs of ascending ranks `(K,)` whose ends differ by less than the critical difference."""
    ends = [int(np.searchsorted(ranks, rank + critical, side="left")) - 1 for rank in ranks]
    firsts = [0, *(i for i, (before, after) in enumerate(pairwise(ends), 1) if after > before)]
    return [(first, ends[first]) for first in firsts if ends[first] > first]


def save_profile_figure(
    path: Path,
    profiles: "tuple[FloatArray, Mapping[str, FloatArray]]",
    shares: "tuple[FloatArray, Mapping[str, FloatArray]]",
    target: str,
    title: str,
) -> None:
    """Write a PNG of two panels: performance profiles, and the ECDF over the budget.

    Args:
        path: path of the PNG.
        profiles: ratios `(N,)`, and the profile of each optimiser, `(N,)`.
        shares: fractions of the budget `(M,)`, and the ECDF of each optimiser, `(M,)`.
        target: name of the target of the profiles.
        title: title of the figure.
    """
    figure = new_figure((12.0, 5.0))
    left, right = figure.subplots(1, 2)
    left.set(title=f"target: {target}", xlabel="evaluations to the target, over the fewest")
    left.set_ylabel("share of problems whose target is reached [%]")
    right.set(title="targets: from 0 to the best value known", xlabel="evaluations done [% of the budget]")
    right.set_ylabel("share of (run, target) pairs reached [%]")
    for axes, (at, curves), scale in ((left, profiles, 1.0), (right, shares, 100.0)):
        for i, (name, curve) in enumerate(curves.items()):
            axes.step(scale * at, 100.0 * curve, where="post", label=_label(name), **series(i))
        axes.set(ylim=(-2.0, 102.0), xscale="log")
        set_ticks(axes.xaxis, logarithmic_ticks(scale * at[0], scale * at[-1]))
        axes.grid(alpha=0.4)
    right.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.suptitle(literal(title))
    figure.savefig(path)
