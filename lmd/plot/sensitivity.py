"""How much the figures of a deployment hang on what was assumed, as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.evaluation.sensitivity import SHARE_COLUMNS, Sensitivity
from lmd.plot.common import new_figure

STYLES = dict(zip(SHARE_COLUMNS, (("localised", "-"), ("enough landmarks covered", "--")), strict=True))


def save_sensitivity_figure(path: str | Path, found: Sensitivity, title: str) -> None:
    """Write a PNG of 1500 x 500 pixels: other assumptions, landmarks missed, landmarks lost."""
    figure = new_figure((15.0, 5.0), title)
    panels: Any = figure.subplots(1, 3)
    varied, missed, lost = panels
    for i, (name, rows) in enumerate(found.assumptions.groupby("assumption", sort=False)):
        for share, (_, style) in STYLES.items():
            label = str(name).replace("_", " ") if share == SHARE_COLUMNS[0] else None
            varied.plot(rows.factor, 100.0 * rows[share], f"o{style}", color=f"C{i}", label=label)
    factors = np.unique(found.assumptions.factor)
    varied.set_xscale("log", base=2)
    varied.set_xticks(factors, [f"{factor:g}" for factor in factors])
    varied.set(xlabel="times what was assumed", ylabel="share of random views [%]")
    for share, (label, style) in STYLES.items():
        missed.plot(100.0 * found.misses.missed, 100.0 * found.misses[share], f"ko{style}", label=label)
        losses = 100.0 * np.sort(found.tags[f"{share.removesuffix('_share')}_loss"].to_numpy())[::-1]
        pair = found.lost[(found.lost.lost == 2) & (found.lost.share == share)]
        for worst in 100.0 * pair.worst:
            lost.axhline(worst, color="C3", linestyle=style, label=f"{label}, worst pair")
        lost.step(np.arange(len(losses)), losses, f"k{style}", where="mid", label=label)
    missed.set(xlabel="landmarks missed [%]", ylabel="share of random views [%]")
    lost.set(xlabel="landmark lost, the dearest first", ylabel="loss [points]")
    for axes in (varied, missed):
        axes.set_ylim(0.0, 100.0)
    lost.set_ylim(bottom=min(0.0, lost.get_ylim()[0]))
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(path)
