"""Sections of the reproduction report: results of the stored sweeps and of the paper."""

import shlex
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.core.words import as_code, escaped
from lmd.evaluation.comparison import OptimiserRun, compared
from lmd.objectives.coverage import Coverage
from lmd.plot.charts import save_comparison_figure, save_heat_map
from lmd.plot.common import new_figure
from lmd.plot.orientations import save_cap_figure
from lmd.plot.scenes import save_deployments_figure

from ..app import command_of
from .document import Picture, Section, Table, Text, comparison_table
from .paper import TABLE_2, TABLE_3, Printed
from .source import BUDGET, COUNT, GRID_FREE, INDICES, PAIR, PARENT, RATIO, Source

# Sweeps of a report, and their commands.
COMMANDS = {
    "table2": f"{command_of('optimise')} experiment=table2",
    "table2_baselines": f"{command_of('evaluate')} experiment=table2_baselines",
    "table3": f"{command_of('evaluate')} experiment=table3 deployment.path=RUN/landmarks.csv",
    "table3_reoptimised": f"{command_of('optimise')} experiment=table3_reoptimised",
    "landmark_count": f"{command_of('optimise')} experiment=landmark_count",
    "optimisers": f"{command_of('optimise')} experiment=optimisers",
}
# Rows of Table II: sweep, tag and value of their runs.
TABLE_2_RUNS = {
    "EGA": ("table2", "tags.choice.optimiser", "ega"),
    "SGA": ("table2", "tags.choice.optimiser", "sga"),
    "uniform": ("table2_baselines", "tags.choice.deployment", "uniform"),
    "initial": ("table2_baselines", "tags.choice.deployment", "random"),
}
PANELS = ("initial", "EGA", "SGA", "uniform")  # the order of the paper's figure
OVERRIDE = "tags.override."
NO_VALUE = "–"  # cell without runs

Blocks = list[Text | Table | Picture]


def sections(source: Source) -> list[Section]:
    """All sections in order; a section without runs names the command that makes the runs."""
    built = {
        "Convergence": ("table2", _convergence),
        "An n-ple coverage spherical cap": ("table2", _cap),
        "Table III: one deployment, nine pairs (n, thold_p)": ("table3", _table_3),
        "Every pair optimised for itself": ("table3_reoptimised", _each_for_itself),
        "How many landmarks?": ("landmark_count", _landmark_count),
        "Optimisers": ("optimisers", _optimisers),
    }
    found = [Section("Table II: four deployments", _table_2(source))]
    for title, (sweep, build) in built.items():
        jobs = source.jobs(sweep)
        found.append(Section(title, [_missing(sweep)] if jobs.empty else build(source, jobs)))
    return found


def _table_2(source: Source) -> Blocks:
    found = {name: _of_row(source.jobs(TABLE_2_RUNS[name][0]), name) for name in TABLE_2}
    rows = [[name, *_beside(printed, found[name])] for name, printed in TABLE_2.items()]
    table = Table(["deployment", *_beside_head()], rows)
    blocks: Blocks = [*_origins(source, "table2", "table2_baselines"), table]
    shown = {name: source.load(_typical(found[name])) for name in PANELS if len(found[name])}
    if not shown:
        return blocks[:-1]
    title = "Of each row the run in the middle by qualified ratio, the lower one of two"
    picture = source.picture("deployments", title, lambda path: save_deployments_figure(path, shown, title))
    return [*blocks, picture]


def _convergence(source: Source, jobs: pd.DataFrame) -> Blocks:
    runs = source.optimiser_runs(jobs)
    return [_curves(source, "convergence", runs, "EGA and SGA") if runs else _missing("table2")]


def _cap(source: Source, jobs: pd.DataFrame) -> Blocks:
    jobs = _of_row(jobs, "EGA")
    if jobs.empty:
        return [_missing("table2")]
    problem, deployment = source.load(_typical(jobs))
    room, n = problem.scene.room, problem.objective.n
    positions = problem.evaluator.positions
    middle = positions[np.argmin(np.linalg.norm(positions - np.mean(room.bounds(), axis=0), axis=1))]
    title = "The reachable unit sphere near the middle of the room, EGA's deployment"
    return [
        source.picture(
            "cap",
            f"Optical axes by the number of landmarks they cover, the {n}-ple cap outlined",
            lambda path: save_cap_figure(path, problem.scene, deployment, middle, n, title),
        )
    ]


def _table_3(source: Source, jobs: pd.DataFrame) -> Blocks:
    rows = [[f"{n}", f"{p:.2f}", *_beside(printed, _of_pair(jobs, n, p))] for (n, p), printed in TABLE_3.items()]
    return [*_origins(source, "table3"), Table(["n", "thold_p", *_beside_head()], rows)]


def _each_for_itself(source: Source, own: pd.DataFrame) -> Blocks:
    rescored = source.jobs("table3")
    columns = {
        "printed": pd.Series({pair: row.qualified_ratio for pair, row in TABLE_3.items()}),
        "one deployment, re-scored": _by_pair(rescored),
        "each pair for itself": _by_pair(own),
    }
    rows = [
        [
            f"{n}",
            f"{p:.2f}",
            f"{row.qualified_ratio:.2%}",
            *(_spread(_of_pair(jobs, n, p)[RATIO]) for jobs in (rescored, own)),
        ]
        for (n, p), row in TABLE_3.items()
    ]
    tables = {name: column.unstack().rename_axis(index="n", columns="thold_p") for name, column in columns.items()}
    picture = source.picture(
        "pairs",
        "Qualified ratio over n and thold_p",
        lambda path: save_heat_map(path, tables, "Qualified ratio", "qualified ratio"),
    )
    return [*_origins(source, "table3_reoptimised"), Table(["n", "thold_p", *columns], rows), picture]


def _landmark_count(source: Source, jobs: pd.DataFrame) -> Blocks:
    ratios = pd.DataFrame({"count": jobs[COUNT].astype(float).astype(int), "qualified_ratio": jobs[RATIO]})
    groups = ratios.groupby("count")["qualified_ratio"]
    rows = [[f"{count}", f"{len(values)}", _spread(values)] for count, values in groups]
    target = TABLE_2["EGA"].qualified_ratio
    medians = groups.median()
    enough = medians.index[medians >= target]
    answer = f"With {enough[0]} landmarks, the fewest" if len(enough) else "With no number of landmarks"
    picture = source.picture(
        "landmark_count",
        "Qualified ratio against the number of landmarks",
        lambda path: save_landmark_count_figure(
            path,
            ratios,
            {f"paper, {name}": (90, TABLE_2[name].qualified_ratio) for name in ("EGA", "uniform")},
            "Qualified ratio against the number of landmarks",
        ),
    )
    return [
        *_origins(source, "landmark_count"),
        Table(["K", "runs", "qualified ratio"], rows),
        Text(f"{answer} here, the median of the runs reaches {target:.2%}, which the paper's EGA reached with 90."),
        picture,
    ]


def _optimisers(source: Source, jobs: pd.DataFrame) -> Blocks:
    runs = source.optimiser_runs(jobs)
    if not runs:
        return [_missing("optimisers")]
    picture = _curves(source, "optimisers", runs, "Optimisers")
    found = compared(runs, Coverage.headline.key)
    return [*_origins(source, "optimisers"), comparison_table(found, Coverage.headline), Text(found.test), picture]


def _curves(source: Source, name: str, runs: list[OptimiserRun], title: str) -> Picture:
    return source.picture(
        name,
        "Best fitness against evaluations, the median of the seeds with a band from the worst to the best, and the "
        "share of seeds and targets that were reached",
        lambda path: save_comparison_figure(path, runs, "evaluations", Coverage.headline, title),
    )


def _origins(source: Source, *sweeps: str) -> list[Text]:
    """Origin of the runs of a section: one paragraph for each sweep."""
    return [_origin(source, sweep) for sweep in sweeps]


def _origin(source: Source, sweep: str) -> Text:
    jobs = source.jobs(sweep)
    if jobs.empty:
        return _missing(sweep)
    began = f"the last began on {jobs['started'].max():%Y-%m-%d at %H:%M} UTC"
    if (sweep_id := jobs[PARENT].iloc[-1]) not in source.runs.index:
        gone = f"whose own run, {as_code(sweep_id)}, is gone from the store"
        return Text(f"{len(jobs)} runs of a sweep {as_code(sweep)}, {gone}; {began}.")
    parent = source.runs.loc[sweep_id]
    given = {str(key).removeprefix(OVERRIDE): value for key, value in parent.filter(like=OVERRIDE).dropna().items()}
    overrides = shlex.join(
        f"{key}={value}" for key, value in sorted(given.items(), key=lambda item: item[0] != "experiment")
    )
    command = f"{command_of(str(parent.get('tags.pipeline', 'optimise')))} {overrides}"
    planned = parent.get("metrics.jobs", np.nan)  # known after the end of the sweep
    share = f"{len(jobs)}" if pd.isna(planned) else f"{len(jobs)} of {planned:.0f}"
    spent = jobs[BUDGET].dropna().unique()
    budget = f" with a budget of {escaped(' or '.join(map(str, spent)))} evaluations" if len(spent) else ""
    return Text(f"{share} runs of {as_code(command)}{budget}; {began}.")


def _missing(sweep: str) -> Text:
    return Text(f"There are no finished runs of the sweep {as_code(sweep)}; {as_code(COMMANDS[sweep])} makes them.")


def _of_row(jobs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Runs of a sweep for a row of Table II."""
    _, column, value = TABLE_2_RUNS[name]
    return jobs[jobs[column] == value]


def _of_pair(jobs: pd.DataFrame, n: int, thold_p: float) -> pd.DataFrame:
    """Runs for (n, thold_p)."""
    return jobs[(jobs[PAIR].astype(float) == [n, thold_p]).all(axis=1)]


def _by_pair(jobs: pd.DataFrame) -> pd.Series:
    """Median qualified ratio for each (n, thold_p) of Table III; NaN without a run."""
    return pd.Series({pair: _of_pair(jobs, *pair)[RATIO].median() for pair in TABLE_3})


def _typical(jobs: pd.DataFrame) -> str:
    """Id of the run with the median qualified ratio; of two middle runs, the run with the lower ratio."""
    return str(jobs[RATIO].sort_values(kind="stable").index[(len(jobs) - 1) // 2])


def _beside_head() -> list[str]:
    columns = [f"{name}: {what}" for name in INDICES.values() for what in ("paper", "here", "difference")]
    return ["runs", *columns, "qualified ratio off the grid: here"]


def _beside(printed: Printed, jobs: pd.DataFrame) -> list[str]:
    """Cells of a row: printed figures and medians of runs, per cent, and the differences in percentage points."""
    cells = [f"{len(jobs)}"]
    for index in INDICES:
        paper, values = getattr(printed, index), jobs[f"metrics.{index}"]
        here = _spread(values) if index == "qualified_ratio" else _percent(values.median())
        cells += [f"{paper:.2%}", here, f"{100.0 * (values.median() - paper):+.2f}" if len(jobs) else NO_VALUE]
    return [*cells, _percent(jobs[GRID_FREE].median())]


def _spread(ratios: "pd.Series[float]") -> str:
    """Median in per cent, with the range if the ratios differ."""
    median = _percent(ratios.median())
    return median if ratios.nunique() < 2 else f"{median} ({ratios.min():.2%} to {ratios.max():.2%})"


def _percent(ratio: float) -> str:
    return NO_VALUE if np.isnan(ratio) else f"{ratio:.2%}"


def save_landmark_count_figure(
    path: str | Path, ratios: pd.DataFrame, references: Mapping[str, tuple[int, float]], title: str
) -> None:
    """Write a PNG: the qualified ratio against the number of landmarks K.

    Args:
        ratios: one row per run with the columns `count` (K) and `qualified_ratio` (fraction); a line joins the medians
            of each K.
        references: points (K, qualified ratio) for comparison, by name.
    """
    from matplotlib.ticker import PercentFormatter

    figure = new_figure((8.0, 4.8))
    axes = figure.add_subplot(title=title, xlabel="landmarks K", ylabel="qualified ratio")
    medians = ratios.groupby("count")["qualified_ratio"].median()
    axes.plot(medians.index, medians, color="C2", label="median of the runs")
    axes.plot(ratios["count"], ratios["qualified_ratio"], "o", color="C2", markersize=5, alpha=0.6, label="run")
    for i, (name, (count, ratio)) in enumerate(references.items()):
        axes.plot(count, ratio, marker="D", color=f"C{3 + i}", linestyle="none", label=name)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(path)
