"""Charts of metrics, as PNGs: convergence of a run, comparisons of optimisers, trade-offs, heat maps, sensitivity."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import FloatArray
from lmd.objectives.base import Headline
from lmd.plot.common import draw_band, dress, literal, new_panels, series, set_log_ticks

if TYPE_CHECKING:
    import pandas as pd

    from lmd.evaluation.comparison import OptimiserRun
    from lmd.evaluation.sensitivity import Sensitivity
    from lmd.optimisers.ledger import Record

LEGEND = 12  # most entries of a legend inside a panel
DARK_ABOVE = 0.6  # share of a heat map's colour scale above which the text of a cell is white
LANDMARKS = "number of landmarks K"


def save_convergence_figure(path: str | Path, history: Mapping[str, ArrayLike], title: str) -> None:
    """Write a PNG of 900 x 500 pixels: the best fitness as a step line against the number of evaluations.

    Args:
        path: path of the PNG.
        history: columns `evaluations`, `best_fitness` and `wall_time` (seconds since the start), with at least one
            record.
        title: title of the figure.
    """
    from matplotlib.ticker import MaxNLocator

    evaluations, fitness, seconds = (np.asarray(history[key]) for key in ("evaluations", "best_fitness", "wall_time"))
    best = 100.0 * fitness
    figure, ((axes,),) = new_panels((9.0, 5.0), title, 1, 1)
    axes.step(evaluations, best, where="post", linewidth=1.8)
    axes.plot(evaluations[-1], best[-1], "o", color="C0", clip_on=False)
    dress(axes, xlabel="evaluations", ylabel="best fitness [%]", xlim=(0.0, None))
    if best.min() >= 0.0 and best.max() <= 100.0:  # the fitness of a user's own objective need not be a share
        axes.set_ylim(0.0, 100.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.xaxis.set_major_formatter("{x:,.0f}")
    # The text is in the upper or lower half, away from the end of the line.
    y, align = (0.04, "bottom") if best[-1] > np.mean(axes.get_ylim()) else (0.96, "top")
    text = f"{best[-1]:.2f}% after {evaluations[-1]:,.0f} evaluations, {_duration(seconds[-1])}"
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": "0.7"}
    axes.text(0.97, y, text, transform=axes.transAxes, ha="right", va=align, bbox=box)
    figure.savefig(path)


def _duration(seconds: float) -> str:
    """Format a duration in seconds; 75.3 becomes `1 min 15 s`."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def save_comparison_figure(
    path: str | Path, runs: "Sequence[OptimiserRun]", axis: str, headline: Headline, title: str
) -> None:
    """Write a PNG of two panels that compare optimisers against evaluations or time, on a logarithmic axis.

    The left panel shows the median over seeds of each optimiser's best fitness, with a band from its worst to its best
    seed. The right panel shows the share of pairs (run, target fitness) in which the run has reached the target, as in
    COCO and IOHprofiler.

    Args:
        path: path of the PNG.
        runs: runs of all optimisers and seeds.
        axis: `evaluations` or `wall_time`.
        headline: main metric of a run; its medians order the legend, the highest median first.
        title: title of the figure.
    """
    from lmd.evaluation.comparison import attained, best_at, by_optimiser, curve_targets

    groups = by_optimiser(runs, headline.key)
    first = min(getattr(run.history[0], axis) for run in runs)
    last = max(getattr(run.history[-1], axis) for run in runs)
    at = np.geomspace(max(first, 1e-3 * last), last, 300)
    targets = curve_targets(runs)
    figure, ((convergence, distribution),) = new_panels((15, 6), title, 1, 2, sharex=True)
    for i, (name, group) in enumerate(groups.items()):
        _draw_median(convergence, at, best_at(group, axis, at), literal(name), i)
        distribution.step(at, 100.0 * attained(group, axis, at, targets), lw=1.8, where="post", **series(i))
    low, high = 100.0 * targets[[0, -1]]
    if high > low:
        convergence.set_ylim(low, high + 0.03 * (high - low))
    convergence.set(title="median over the seeds, band from worst to best", ylabel="best fitness [%]")
    distribution.set(title=f"{len(targets)} targets: best fitness of {low:.1f} to {high:.1f}%", ylim=(0.0, 100.0))
    distribution.set_ylabel("share of (run, target) pairs reached [%]")
    for axes in (convergence, distribution):
        dress(axes, xscale="log", xlabel="wall time [s]" if axis == "wall_time" else axis)
        set_log_ticks(axes.xaxis, at[0], at[-1])
    figure.legend(loc="outside right upper", frameon=False, title="best fitness at the end, median")
    figure.savefig(path)


def _draw_median(axes: Any, at: FloatArray, curves: FloatArray, name: str, number: int) -> None:
    """Draw the median of R curves of the fitness against `at` `(N,)`, and a band from the worst to the best curve.

    `curves` `(R, N)` has fractions, which are drawn in per cent. `number` is the index of the colour and line style.
    """
    known = np.isfinite(curves).all(axis=0)
    band = np.quantile(100.0 * curves[:, known], (0.0, 0.5, 1.0), axis=0)
    draw_band(axes, at[known], band, f"{name} {band[1, -1]:.1f}%", lw=1.8, **series(number))


class Searched(NamedTuple):
    """Results of one finished job of a sweep, for `save_groups_figure`."""

    history: "Sequence[Record]"
    """Records of the job's search."""
    fitness: float
    """Fitness of the deployment that the job found, on the grid of positions."""
    off_grid: float | None
    """Main metric (headline), off the grid, of the deployment that the job found; None if this metric was not
    computed.
    """


def save_groups_figure(
    path: str | Path, groups: Mapping[tuple[str, ...], Sequence[Searched]], keys: Sequence[str], title: str
) -> None:
    """Write a PNG of two panels about the groups of a sweep; the jobs of a group differ only in their seed.

    The left panel plots the median best fitness of each group against the number of evaluations, with a band from the
    worst to the best seed. The right panel plots the final median of each group against the value of the last key, with
    one line for each combination of the other values.

    Args:
        path: path of the PNG.
        groups: jobs of each group, at least one, keyed by the values of `keys`.
        keys: names of the settings that vary.
        title: title of the figure.
    """
    from lmd.evaluation.comparison import best_at

    figure, ((convergence, ends),) = new_panels((15, 6), title, 1, 2)
    spent = [job.history[-1].evaluations for jobs in groups.values() for job in jobs]
    at = np.geomspace(1.0, max(*spent, 2.0), 300)
    values = list(dict.fromkeys(group[-1] if group else "" for group in groups))
    if is_number := all(map(_is_number, values)):
        values.sort(key=float)
    places = {value: float(value) if is_number else float(i) for i, value in enumerate(values)}
    lines: dict[tuple[str, ...], list[tuple[str, Sequence[Searched]]]] = {}
    for i, (group, jobs) in enumerate(groups.items()):
        _draw_median(convergence, at, best_at(jobs, "evaluations", at), _labelled(keys, group), i)
        lines.setdefault(group[:-1], []).append((group[-1] if group else "", jobs))
    for i, (others, points) in enumerate(lines.items()):
        points.sort(key=lambda point: places[point[0]])
        x, style = [places[value] for value, _ in points], series(i)
        ranges = 100.0 * np.array([np.quantile([job.fitness for job in jobs], [0, 0.5, 1]) for _, jobs in points])
        draw_band(ends, x, ranges.T, _labelled(keys, others), "o", **style)
        off = [[job.off_grid for job in jobs if job.off_grid is not None] for _, jobs in points]
        if all(off):
            medians = [100.0 * np.median(each) for each in off]
            ends.plot(x, medians, "x", ls="none", color=style["color"], label="off the grid" if i == 0 else None)
    convergence.set(title="median over the seeds, band from worst to best", ylabel="best fitness [%]", xscale="log")
    convergence.set_xlabel("evaluations")
    set_log_ticks(convergence.xaxis, at[0], at[-1])
    ends.set(title="at the end: median over the seeds", ylabel="fitness [%]", xlabel=literal(keys[-1] if keys else ""))
    ends.set_xticks(list(places.values()), [literal(value) for value in places])
    for axes in (convergence, ends):
        dress(axes, legend=0 < len(axes.get_legend_handles_labels()[0]) <= LEGEND)
    figure.savefig(path)


def _labelled(keys: Sequence[str], group: Sequence[str]) -> str:
    """Label of a group of jobs: the values of the group for the settings `keys`.

    A number is preceded by the name of its setting, as in `annealing n=2`.
    """
    words = zip(keys, group, strict=False)
    return literal(" ".join(f"{key.split('.')[-1]}={value}" if _is_number(value) else value for key, value in words))


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d+(\.\d*)?(e[-+]?\d+)?", text) is not None


class Panel(NamedTuple):
    """Panel of a trade-off, which plots a metric against the number of landmarks."""

    label: str
    """Label of the vertical axis."""
    figure: str
    """Name of the column of the plotted metric in the table of points; the metric is a share (fraction) off the grid.
    """
    on_grid: str | None = None
    """Name of the column of this metric on the grid of positions, drawn as a dotted curve; None for no such curve."""
    wanted: float | None = None
    """Share that is marked by a line; None for no line."""


def curve_name(edge: float) -> str:
    """Label of the curve for tags with the edge length `edge`, metres; `points` for an edge length of 0."""
    return f"tags of {1e3 * edge:g} mm" if edge else "points"


def save_tradeoff_figure(path: str | Path, points: "pd.DataFrame", panels: Sequence[Panel], title: str) -> None:
    """Write a PNG of a trade-off, 550 pixels wide for each panel and 450 high.

    Curves show the medians over the seeds, and bands extend from the least to the greatest value.

    Args:
        path: path of the PNG.
        points: table with a row for each edge length `edge` (metres), number of landmarks `count` and `seed`; the
            metrics of the panels are further columns, fractions from 0 to 1.
        panels: panels from left to right.
        title: title of the figure.
    """
    figure, drawn = new_panels((5.5 * len(panels), 4.5), title, 1, len(panels))
    for axes, panel in zip(drawn[0], panels, strict=True):
        for i, (edge, same) in enumerate(points.groupby("edge")):
            by_count, name = same.groupby("count"), curve_name(float(str(edge)))
            shares = 100.0 * by_count[panel.figure].agg(["min", "median", "max"])
            style = {"color": f"C{i}", "ms": 4, "lw": 1.5}
            draw_band(axes, shares.index, shares.to_numpy().T, name, "o-", **style)
            if panel.on_grid is not None:
                on_grid = 100.0 * by_count[panel.on_grid].median()
                axes.plot(on_grid.index, on_grid, ":", color=f"C{i}", label=f"{name}, on the grid")
        if panel.wanted is not None:
            axes.axhline(100.0 * panel.wanted, color="0.5", ls="--", label="wanted")
        axes.set_ylabel(f"{panel.label} [%]")
        dress(axes, legend=True, xlabel=LANDMARKS, ylim=(0.0, None))
    figure.savefig(path)


def save_heat_map(path: str | Path, tables: "Mapping[str, pd.DataFrame]", title: str, label: str) -> None:
    """Write a PNG of heat maps side by side, one for each table; every cell shows its value in per cent.

    Args:
        path: path of the PNG.
        tables: tables of fractions, keyed by the heading of their panel; NaN for a cell without a run. Index and
            columns have names, and are equal in all tables.
        title: title of the figure.
        label: label of the colour bar.
    """
    rows, columns = next(iter(tables.values())).shape
    size = (1.6 + 1.0 * max(columns, 3) * len(tables), 1.8 + 0.8 * max(rows, 3))
    figure, (panels,) = new_panels(size, title, 1, len(tables), sharey=True)
    for axes, (name, table) in zip(panels, tables.items(), strict=True):
        image = axes.imshow(table, cmap="Greens", vmin=0.0, vmax=1.0, aspect="auto")
        for (row, column), value in np.ndenumerate(table.to_numpy()):
            text = "no run" if np.isnan(value) else f"{value:.2%}"
            colour = "white" if value > DARK_ABOVE else "black"
            axes.text(column, row, text, ha="center", va="center", color=colour)
        axes.set_title(literal(name), fontsize=11)
        axes.set_xticks(range(columns), [_written(value) for value in table.columns])
        axes.set_yticks(range(rows), [_written(value) for value in table.index])
        axes.set_xlabel(literal(table.columns.name))
    panels[0].set_ylabel(literal(table.index.name))
    figure.colorbar(image, ax=panels, format="{x:.0%}", label=label)
    figure.savefig(path)


def save_landmark_count_figure(
    path: str | Path, ratios: "pd.DataFrame", references: Mapping[str, tuple[int, float]], title: str
) -> None:
    """Write a PNG: the qualified ratio plotted against the number of landmarks K.

    Args:
        path: path of the PNG.
        ratios: one row per run with the columns `count` (K) and `qualified_ratio` (fraction); a line joins the medians
            of each K.
        references: points (K, qualified ratio) that are drawn for comparison, such as published results, keyed by the
            name of their source.
        title: title of the figure.
    """
    from matplotlib.ticker import PercentFormatter

    figure, ((axes,),) = new_panels((8.0, 4.8), None, 1, 1)
    medians = ratios.groupby("count")["qualified_ratio"].median()
    axes.plot(medians.index, medians, color="C2", label="median of the runs")
    axes.plot(ratios["count"], ratios["qualified_ratio"], "o", color="C2", markersize=5, alpha=0.6, label="run")
    for i, (name, (count, ratio)) in enumerate(references.items()):
        axes.plot(count, ratio, marker="D", color=f"C{3 + i}", linestyle="none", label=name)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    dress(axes, title=title, xlabel="landmarks K", ylabel="qualified ratio")
    axes.legend(loc="lower right")
    figure.savefig(path)


def _written(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else literal(value)


def save_sensitivity_figure(path: str | Path, found: "Sensitivity", title: str) -> None:
    """Write a PNG of 1500 x 500 pixels: sensitivity of a deployment to assumptions and to lost landmarks.

    The panels show two shares of random camera poses: poses that are localised, and poses with enough covered
    landmarks. The first panel plots both shares against the factors by which assumptions of the problem, such as the
    pixel noise, are multiplied. The second panel plots both shares against the fraction of covered landmarks that are
    missed at random. The third panel shows the decrease of both shares if one landmark is lost, for each landmark, and
    if the worst pair is lost.
    """
    from lmd.evaluation.sensitivity import SHARE_COLUMNS

    styles = dict(zip(SHARE_COLUMNS, (("localised", "-"), ("enough landmarks covered", "--")), strict=True))
    figure, (panels,) = new_panels((15.0, 5.0), title, 1, 3)
    varied, missed, lost = panels
    for i, (name, rows) in enumerate(found.assumptions.groupby("assumption", sort=False)):
        for share, (_, style) in styles.items():
            label = str(name).replace("_", " ") if share == SHARE_COLUMNS[0] else None
            varied.plot(rows.factor, 100.0 * rows[share], f"o{style}", color=f"C{i}", label=label)
    factors = np.unique(found.assumptions.factor)
    varied.set_xscale("log", base=2)
    varied.set_xticks(factors, [f"{factor:g}" for factor in factors])
    varied.set(xlabel="times what was assumed", ylabel="share of random views [%]")
    for share, (label, style) in styles.items():
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
        dress(axes, legend=True)
    figure.savefig(path)
