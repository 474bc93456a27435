"""Leaderboard of a tournament between optimisers: tables, and files with the runs in IOHprofiler's format."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from lmd.core.words import as_code, markdown_table
from lmd.evaluation.comparison import SIGNIFICANCE, OptimiserRun
from lmd.evaluation.tournament import (
    Tournament,
    rank_correlation,
    tournament,
    write_iohprofiler,
)
from lmd.suite import document, names
from lmd.suite.families import HELD_OUT, SEPARATOR, instance_of

if TYPE_CHECKING:
    from lmd.suite import BlackBox, Document

FIGURES = {"fitness": "fitness", "off_grid": "off the grid"}  # figures of a run that are ranked
Runs = Mapping[int, Sequence[OptimiserRun]]  # keyed by the index, from 0, of one of a problem's three budgets


class Leaderboard(NamedTuple):
    """Leaderboard of a tournament between optimisers."""

    text: str
    """Tables and tests in Markdown."""
    table: pd.DataFrame
    """Table of medians over the seeds: a row for each problem, metric and budget, and a column for each optimiser."""
    figures: Mapping[str, float]
    """Mean ranks, keyed by names such as `rank_3/fitness/annealing`: the mean rank of the optimiser `annealing` by
    fitness, for runs with the third budget.
    """


def leaderboard(results: Runs, problems: Iterable[str]) -> Leaderboard:
    """Make the leaderboard of the suite's `problems` from `results`, the runs of optimisers on these problems."""
    frozen = {name: document(name) for name in problems}
    blocks, figures, every = list[str](), dict[str, float](), []
    for place in sorted(results, reverse=True):  # the largest budget first
        if not (runs := results[place]):
            continue
        blocks.append(f"## Budget {place + 1} of 3")
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
    return Leaderboard("\n\n".join(blocks) + "\n", pd.concat(every), figures)


def _held_out_apart(runs: Sequence[OptimiserRun]) -> Mapping[str, Sequence[OptimiserRun]]:
    """Divide runs into two groups, and return them keyed by the group's name: `development` and `held-out`.

    A run is in the group `held-out` if its problem is an instance on which no optimiser is tuned. If all runs belong to
    one group, the key of this group is an empty string.
    """
    is_held_out = [instance_of(run.problem) >= HELD_OUT for run in runs]
    if len(set(is_held_out)) == 1:
        return {"": runs}
    kept = [run for run, out in zip(runs, is_held_out, strict=True) if not out]
    return {"development": kept, "held-out": [run for run, out in zip(runs, is_held_out, strict=True) if out]}


def _section(held: Tournament, label: str, frozen: "Mapping[str, Document]") -> list[str]:
    """Markdown paragraphs about the results of optimisers by one metric: a table, and statistical tests below.

    If the metric is the fitness, the table also has a column with proven upper bounds.

    Args:
        held: tournament with the results.
        label: label of the metric.
        frozen: documents of the problems, keyed by name.
    """
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


def write_runs(folder: Path, results: Runs, boxes: "Mapping[str, BlackBox]") -> None:
    """Write all runs in IOHprofiler's format to `folder`.

    The previous content of the folder is deleted. There is a subfolder for each budget, with a subfolder for each
    optimiser. `boxes` are the problems, keyed by name.
    """
    numbers = {name: number for number, name in enumerate(names(), 1)}
    shutil.rmtree(folder, ignore_errors=True)
    for place, every in results.items():
        groups: dict[tuple[str, str], list[OptimiserRun]] = {}
        for run in every:
            groups.setdefault((run.optimiser, run.problem), []).append(run)
        for (optimiser, name), runs in groups.items():
            own = folder / f"budget_{place + 1}" / optimiser.replace("/", "_")
            write_iohprofiler(own, runs, name, numbers[name.partition(SEPARATOR)[0]], boxes[name].dim)
