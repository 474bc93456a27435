"""The leaderboard of a tournament: tables, pictures, and the runs in IOHprofiler's format."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray
from lmd.core.words import as_code, markdown_table
from lmd.evaluation.comparison import SIGNIFICANCE, OptimiserRun
from lmd.evaluation.tournament import (
    TARGET_SHARE,
    Tournament,
    attained_curve,
    profile,
    rank_correlation,
    running_time_ratios,
    tournament,
    write_iohprofiler,
)
from lmd.plot.common import dress, literal, new_panels, series, set_log_ticks
from lmd.suite import document, names
from lmd.suite.families import HELD_OUT, SEPARATOR, instance_of

if TYPE_CHECKING:
    from lmd.suite import BlackBox, Document

LABEL = 45  # greatest number of characters of an optimiser's name


def _label(name: object) -> str:
    """Name of an optimiser, cut after whole words if it has many overrides."""
    return literal(shorten(str(name).replace("optimiser.", ""), LABEL, placeholder=" ..."))


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
    figure, ((left, right),) = new_panels((12.0, 5.0), title, 1, 2)
    left.set(title=f"target: {target}", xlabel="evaluations to the target, over the fewest")
    left.set_ylabel("share of problems whose target is reached [%]")
    right.set(title="targets: from 0 to the best value known", xlabel="evaluations done [% of the budget]")
    right.set_ylabel("share of (run, target) pairs reached [%]")
    for axes, (at, curves), scale in ((left, profiles, 1.0), (right, shares, 100.0)):
        for i, (name, curve) in enumerate(curves.items()):
            axes.step(scale * at, 100.0 * curve, where="post", label=_label(name), **series(i))
        dress(axes, ylim=(-2.0, 102.0), xscale="log")
        set_log_ticks(axes.xaxis, scale * at[0], scale * at[-1])
    right.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path)


RATIOS, LEAST_SHARE, POINTS = 1000.0, 1e-3, 400  # ends and points of the logarithmic axes of the profiles
FIGURES = {"fitness": "fitness", "off_grid": "off the grid"}  # figures of a run that are ranked
Runs = Mapping[int, Sequence[OptimiserRun]]  # keyed by the index, from 0, of one of a problem's three budgets


class Leaderboard(NamedTuple):
    """Leaderboard of a tournament."""

    text: str
    """Tables and tests in Markdown."""
    table: pd.DataFrame
    """Medians of each problem, figure and budget, a column for each optimiser."""
    pictures: Mapping[str, Callable[[Path], None]]
    """Functions that draw the pictures, keyed by file name."""
    figures: Mapping[str, float]
    """Mean ranks, such as `rank_3/fitness/annealing`."""


def leaderboard(results: Runs, problems: Iterable[str]) -> Leaderboard:
    """Leaderboard of the runs of some problems of the suite."""
    frozen = {name: document(name) for name in problems}
    blocks, pictures, figures, every = list[str](), dict[str, Any](), dict[str, float](), []
    for place in sorted(results, reverse=True):  # the largest budget first
        runs, budget = results[place], f"budget {place + 1} of 3"
        if not runs:
            continue
        blocks.append(f"## {budget.capitalize()}")
        for key, label in FIGURES.items():
            if not all(key in run.metrics for run in runs):
                continue
            ranks = []
            for of, some in _held_out_apart(runs).items():
                held, suffix = tournament(some, key), f"_{of.replace('-', '_')}" if of else ""
                blocks += [f"### {label.capitalize()}, {of} instances"] * bool(of)
                blocks += _section(held, label, frozen)
                ranks.append(held.ranks)
                named = {name: rank for name, rank in held.ranks.items() if rank == rank}
                figures |= {f"rank_{place + 1}{suffix}/{key}/{name}": rank for name, rank in named.items()}
                every.append(held.values.assign(figure=key, budget=place + 1).reset_index())
            if len(ranks) == 2:
                figures[f"tau_{place + 1}/{key}"] = tau = rank_correlation(*ranks)
                blocks.append(f"Kendall's tau between the two rankings by {label}: {tau:.2f}.")
        pictures[f"profiles_{place + 1}.png"] = partial(_profiles, runs=runs, frozen=frozen, title=budget)
    return Leaderboard("\n\n".join(blocks) + "\n", pd.concat(every), pictures, figures)


def _held_out_apart(runs: Sequence[OptimiserRun]) -> Mapping[str, Sequence[OptimiserRun]]:
    """Runs on the development instances and on the held-out instances, keyed by group; all runs if one is empty."""
    is_held_out = [instance_of(run.problem) >= HELD_OUT for run in runs]
    if len(set(is_held_out)) == 1:
        return {"": runs}
    kept = [run for run, out in zip(runs, is_held_out, strict=True) if not out]
    return {"development": kept, "held-out": [run for run, out in zip(runs, is_held_out, strict=True) if out]}


def _section(held: Tournament, label: str, frozen: "Mapping[str, Document]") -> list[str]:
    """Table of a figure, and the tests below it. Only the fitness has a proven bound."""
    names, is_fitness = list(held.values), label == FIGURES["fitness"]
    columns = ["best known", "bound"] if is_fitness else ["best known"]
    ranks = [f"**{rank:.2f}**" if rank == rank else "" for rank in held.ranks]
    rows = [["**mean rank**", *ranks, *("" for _ in columns)]]
    for problem, values in zip(held.values.index, held.values.to_numpy(), strict=True):
        known, greatest = frozen[problem], float(np.nanmax(values))
        cells = [_cell(value, greatest) for value in values.tolist()]
        best = None if known.best is None else known.best["value" if is_fitness else "off_grid"]
        ends = [best, known.bound] if is_fitness else [best]
        rows.append([as_code(problem), *cells, *("" if end is None else f"{end:.2%}" for end in ends)])
    head = [label, *map(as_code, names), *columns]
    wins = {name: sum(name in winners for winners in held.winners.values()) for name in names}
    first = ", ".join(f"{as_code(name)} on {count}" for name, count in wins.items() if count)
    unsure = ", ".join(f"{as_code(name)} (p = {p:.2g})" for name, p in held.leads.items() if p > SIGNIFICANCE)
    leads = (
        f"Over the seeds the first is not significantly better than the second on {unsure or 'none'} (Mann-Whitney, "
        f"p < {SIGNIFICANCE:g}). "
    )
    tests = (
        f"Friedman's test over {held.complete} problems that all optimisers have run: "
        f"p = {held.friedman:.2g}. Critical difference of mean ranks at p = {SIGNIFICANCE:g}: {held.critical:.2f} of "
        f"at most {len(names) - 1} (Nemenyi)."
    )
    if not np.isnan(list(held.leads.values())).all():
        tests = leads + tests
    return [
        markdown_table(head, rows),
        held.limit,
        f"First, ties included: {first}, of {len(held.values)} problems. {tests}",
    ]


def _cell(value: float, greatest: float) -> str:
    if value != value:
        return "–"
    return f"**{value:.2%}**" if value == greatest else f"{value:.2%}"


def _profiles(path: Path, runs: Sequence[OptimiserRun], frozen: "Mapping[str, Document]", title: str) -> None:
    """Draw performance profiles and ECDFs of the runs with one budget."""
    known = {name: _best_known(name, runs, document) for name, document in frozen.items()}
    ratios = running_time_ratios(runs, known)
    at, shares = np.geomspace(1.0, RATIOS, POINTS), np.geomspace(LEAST_SHARE, 1.0, POINTS)
    names = tournament(runs, "fitness").ranks.index
    profiles = {str(name): profile(ratios[name].to_numpy(), at) for name in names}
    curves = {name: attained_curve([run for run in runs if run.optimiser == name], known, shares) for name in profiles}
    target = f"{TARGET_SHARE:.0%} of the best value known"
    save_profile_figure(path, (at, profiles), (shares, curves), target, title)


def _best_known(name: str, runs: Iterable[OptimiserRun], document: "Document") -> float:
    """Best known value of a problem, from its document and from the runs."""
    recorded = 0.0 if document.best is None else document.best["value"]
    return max([recorded, *(run.metrics["fitness"] for run in runs if run.problem == name)])


def write_runs(folder: Path, results: Runs, boxes: "Mapping[str, BlackBox]") -> None:
    """Write all runs in IOHprofiler's format: a folder for each budget, which has a folder for each optimiser."""
    numbers = {name: number for number, name in enumerate(names(), 1)}
    shutil.rmtree(folder, ignore_errors=True)
    for place, every in results.items():
        groups: dict[tuple[str, str], list[OptimiserRun]] = {}
        for run in every:
            groups.setdefault((run.optimiser, run.problem), []).append(run)
        for (optimiser, name), runs in groups.items():
            own = folder / f"budget_{place + 1}" / optimiser.replace("/", "_")
            write_iohprofiler(own, runs, name, numbers[name.partition(SEPARATOR)[0]], boxes[name].dim)
