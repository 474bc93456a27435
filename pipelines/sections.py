"""Sections of the reproduction report, in Markdown: they compare results of stored sweeps with results of the paper."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from lmd.core.words import as_code, escaped, markdown_table
from lmd.objectives.coverage import Coverage
from lmd.plot.charts import save_comparison_figure, save_heat_map, save_landmark_count_figure
from lmd.plot.scenes import save_deployments_figure

from .app import command_of
from .stored_runs import BUDGET, COUNT, GRID_FREE, INDICES, PAIR, PARENT, RATIO, TABLE_2, TABLE_3, Source

# Sweeps of a report: for each, the part of the command that follows `experiment=`, and the name.
COMMANDS = {
    **dict.fromkeys(("table2", "table3_reoptimised", "landmark_count"), ("optimise", "")),
    "table2_baselines": ("evaluate", ""),
    "table3": ("evaluate", " deployment.path=RUN/landmarks.csv"),
}
# Rows of Table II: for each, the sweep, and tag and value of the runs.
TABLE_2_RUNS = {
    "EGA": ("table2", "tags.choice.optimiser", "ega"),
    "SGA": ("table2", "tags.choice.optimiser", "sga"),
    "uniform": ("table2_baselines", "tags.choice.deployment", "uniform"),
    "initial": ("table2_baselines", "tags.choice.deployment", "random"),
}
PANELS = ("initial", "EGA", "SGA", "uniform")  # in the order of the paper's figure
COLUMNS = [f"{name}: {of}" for name in INDICES.values() for of in ("paper", "here")]
OFF_GRID = "qualified ratio off the grid: here"


def sections(source: Source) -> str:
    """Text of all sections in order; a section whose runs are not stored names the command that makes the runs."""
    built: dict[str, tuple[str, Callable[[Source, pd.DataFrame], list[str]]]] = {
        "Convergence": ("table2", _curves),
        "Table III: one deployment, nine pairs (n, thold_p)": ("table3", _table_3),
        "Every pair optimised for itself": ("table3_reoptimised", _each_for_itself),
        "How many landmarks?": ("landmark_count", _landmark_count),
    }
    blocks = ["## Table II: four deployments", *_table_2(source)]
    for title, (sweep, build) in built.items():
        jobs = source.jobs(sweep)
        blocks += [f"## {title}", *(([] if jobs.empty else build(source, jobs)) or [_origin(source, sweep, jobs[:0])])]
    return "\n\n".join(block.rstrip("\n") for block in blocks) + "\n"


def _table_2(source: Source) -> list[str]:
    jobs = {sweep: source.jobs(sweep) for sweep in ("table2", "table2_baselines")}
    found = {name: _of_row(jobs[TABLE_2_RUNS[name][0]], name) for name in TABLE_2}
    blocks = [_origin(source, sweep, its) for sweep, its in jobs.items()]
    shown = {name: source.load(_typical(found[name])) for name in PANELS if len(found[name])}
    if not shown:
        return blocks
    rows = [[name, *_beside(printed, found[name])] for name, printed in TABLE_2.items()]
    title = "For each row, the run with the median qualified ratio, or the lower of two"
    picture = source.picture("deployments", title, save_deployments_figure, shown, title)
    return [*blocks, markdown_table(["deployment", "runs", *COLUMNS, OFF_GRID], rows), picture]


def _table_3(source: Source, jobs: pd.DataFrame) -> list[str]:
    rows = [[f"{n}", f"{p:.2f}", *_beside(printed, _of_pair(jobs, n, p))] for (n, p), printed in TABLE_3.items()]
    return [_origin(source, "table3", jobs), markdown_table(["n", "thold_p", "runs", *COLUMNS, OFF_GRID], rows)]


def _each_for_itself(source: Source, own: pd.DataFrame) -> list[str]:
    columns = {"printed": {pair: pd.Series([row.qualified_ratio]) for pair, row in TABLE_3.items()}}
    for name, jobs in {"one deployment, re-scored": source.jobs("table3"), "each pair for itself": own}.items():
        columns[name] = {pair: _of_pair(jobs, *pair)[RATIO] for pair in TABLE_3}
    rows = [[f"{n}", f"{p:.2f}", *(_spread(column[n, p]) for column in columns.values())] for n, p in TABLE_3]
    tables = {}
    for name, column in columns.items():
        medians = pd.Series({pair: ratios.median() for pair, ratios in column.items()})
        tables[name] = medians.unstack().rename_axis(index="n", columns="thold_p")
    table, labels = markdown_table(["n", "thold_p", *columns], rows), ("Qualified ratio", "qualified ratio")
    picture = source.picture("pairs", "Qualified ratio over n and thold_p", save_heat_map, tables, *labels)
    return [_origin(source, "table3_reoptimised", own), table, picture]


def _landmark_count(source: Source, jobs: pd.DataFrame) -> list[str]:
    ratios = pd.DataFrame({"count": jobs[COUNT].astype(float).astype(int), "qualified_ratio": jobs[RATIO]})
    groups = ratios.groupby("count")["qualified_ratio"]
    rows = [[f"{count}", f"{len(values)}", _spread(values)] for count, values in groups]
    target, medians = TABLE_2["EGA"].qualified_ratio, groups.median()
    enough = medians.index[medians >= target]
    answer = f"With {enough[0]} landmarks, the fewest" if len(enough) else "With no number of landmarks"
    said = f"{answer} here, the median of the runs reaches {target:.2%}, which the paper's EGA reached with 90."
    references = {f"paper, {name}": (90, TABLE_2[name].qualified_ratio) for name in ("EGA", "uniform")}
    title = "Qualified ratio against the number of landmarks"
    picture = source.picture("landmark_count", title, save_landmark_count_figure, ratios, references, title)
    table = markdown_table(["K", "runs", "qualified ratio"], rows)
    return [_origin(source, "landmark_count", jobs), table, said, picture]


def _curves(source: Source, jobs: pd.DataFrame) -> list[str]:
    """Markdown lines with a picture of the convergence of optimisers; empty if the files of all runs are missing."""
    if not (runs := source.optimiser_runs(jobs)):
        return []
    caption = "Best fitness against evaluations, median and range of the seeds, and the share of targets reached"
    drawn = runs, "evaluations", Coverage.headline, "EGA and SGA"
    return [source.picture("convergence", caption, save_comparison_figure, *drawn)]


def _origin(source: Source, sweep: str, jobs: pd.DataFrame) -> str:
    """Text about the origin of a sweep's results: the number of runs, their command, budget and date.

    If `jobs` is empty, the text names the command that makes these runs.
    """
    if jobs.empty:
        command, more = COMMANDS[sweep]
        made_by = as_code(f"{command_of(command)} experiment={sweep}{more}")
        return f"There are no finished runs of the sweep {as_code(sweep)}; {made_by} makes them."
    began = f"the last began on {jobs['started'].max():%Y-%m-%d at %H:%M} UTC"
    parent = source.runs.loc[[each for each in source.runs.index if each == jobs[PARENT].iloc[-1]]]
    command = as_code(parent["tags.command"].iloc[0]) if len(parent) else f"the sweep {as_code(sweep)}"
    spent = jobs[BUDGET].dropna().unique()
    budget = f" with a budget of {escaped(' or '.join(map(str, spent)))} evaluations" if len(spent) else ""
    return f"{len(jobs)} runs of {command}{budget}; {began}."


def _of_row(jobs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Runs of `jobs` that belong to the row `name` of Table II of the paper."""
    _, column, value = TABLE_2_RUNS[name]
    return jobs[jobs[column] == value]


def _of_pair(jobs: pd.DataFrame, n: int, thold_p: float) -> pd.DataFrame:
    """Runs in `jobs` whose objective has the given settings `n` and `thold_p`."""
    return jobs[(jobs[PAIR].astype(float) == [n, thold_p]).all(axis=1)]


def _typical(jobs: pd.DataFrame) -> str:
    """Id of the run with the median `qualified_ratio`; of two middle runs, the run with the lower ratio."""
    return str(jobs[RATIO].sort_values(kind="stable").index[(len(jobs) - 1) // 2])


def _beside(printed: Any, jobs: pd.DataFrame) -> list[str]:
    """Cells of a table row that compares the paper with the runs `jobs`.

    The first cell is the number of runs. Two cells follow for each metric: the value `printed` in the paper, and the
    median of the runs, in per cent. The last cell is the median at random poses (`GRID_FREE`).
    """
    cells = [f"{len(jobs)}"]
    for index in INDICES:
        paper, values = getattr(printed, index), jobs[f"metrics.{index}"]
        cells += [f"{paper:.2%}", _spread(values) if index == "qualified_ratio" else _percent(values.median())]
    return [*cells, _percent(jobs[GRID_FREE].median())]


def _spread(ratios: "pd.Series[float]") -> str:
    """Text with the median of the ratios in per cent, followed by their range if the ratios differ."""
    median = _percent(ratios.median())
    return median if ratios.nunique() < 2 else f"{median} ({ratios.min():.2%} to {ratios.max():.2%})"


def _percent(ratio: float) -> str:
    return "–" if np.isnan(ratio) else f"{ratio:.2%}"
