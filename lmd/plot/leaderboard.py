"""The leaderboard of a tournament: tables, pictures, and the runs in IOHprofiler's format."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from lmd.core.words import as_code, markdown_table
from lmd.evaluation.comparison import SIGNIFICANCE, OptimiserRun
from lmd.evaluation.iohprofiler import write_iohprofiler
from lmd.evaluation.tournament import (
    TARGET_SHARE,
    Tournament,
    attained_curve,
    profile,
    running_time_ratios,
    tournament,
)
from lmd.plot.ranks import save_critical_difference_diagram, save_profile_figure
from lmd.suite import document, names

if TYPE_CHECKING:
    from lmd.suite import BlackBox, Document

RATIOS, LEAST_SHARE, POINTS = 1000.0, 1e-3, 400  # ends and points of the logarithmic axes of the profiles
FIGURES = {"fitness": "fitness", "off_grid": "off the grid"}  # figures of a run that are ranked
Runs = Mapping[int, Sequence[OptimiserRun]]  # by the place of the budget among the three of a problem, from 0


class Leaderboard(NamedTuple):
    """Leaderboard of a tournament."""

    text: str
    """Tables and tests in Markdown."""
    table: pd.DataFrame
    """Medians of each problem, figure and budget, a column for each optimiser."""
    pictures: Mapping[str, Callable[[Path], None]]
    """Functions that draw the pictures, by the names of the files."""
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
            held = tournament(runs, key)
            blocks += _section(held, label, frozen)
            figures |= {f"rank_{place + 1}/{key}/{name}": rank for name, rank in held.ranks.items() if rank == rank}
            every.append(held.values.assign(figure=key, budget=place + 1).reset_index())
            title = f"mean ranks over {held.complete} problems: {label}, {budget}"
            draw = partial(save_critical_difference_diagram, ranks=held.ranks, critical=held.critical, title=title)
            pictures[f"ranks_{place + 1}_{key}.png"] = draw
        pictures[f"profiles_{place + 1}.png"] = partial(_profiles, runs=runs, frozen=frozen, title=budget)
    return Leaderboard("\n\n".join(blocks) + "\n", pd.concat(every), pictures, figures)


def _section(held: Tournament, label: str, frozen: "Mapping[str, Document]") -> list[str]:
    """Table of a figure, and the tests below it. Only the fitness has a proven bound."""
    names, is_fitness = list(held.values), label == FIGURES["fitness"]
    columns = ["best known", "bound"] if is_fitness else ["best known"]
    ranks = [f"**{rank:.2f}**" if rank == rank else "" for rank in held.ranks]
    rows = [["**mean rank**", *ranks, *("" for _ in columns)]]
    for problem, values in zip(held.values.index, held.values.to_numpy(), strict=True):
        known, greatest = frozen[problem], float(np.nanmax(values))
        cells = [_cell(value, greatest) for value in values.tolist()]
        best = None if known.best is None else known.best.value if is_fitness else known.best.off_grid
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
    """Best value of a problem, of its document and of the runs."""
    recorded = 0.0 if document.best is None else document.best.value
    return max([recorded, *(run.metrics["fitness"] for run in runs if run.problem == name)])


def write_runs(folder: Path, results: Runs, boxes: "Mapping[str, BlackBox]") -> None:
    """Write all runs in IOHprofiler's format: a folder for each budget, in it one for each optimiser."""
    numbers = {name: number for number, name in enumerate(names(), 1)}
    shutil.rmtree(folder, ignore_errors=True)
    for place, every in results.items():
        groups: dict[tuple[str, str], list[OptimiserRun]] = {}
        for run in every:
            groups.setdefault((run.optimiser, run.problem), []).append(run)
        for (optimiser, name), runs in groups.items():
            own = folder / f"budget_{place + 1}" / optimiser.replace("/", "_")
            write_iohprofiler(own, runs, name, numbers[name], boxes[name].dim)
