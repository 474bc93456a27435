"""Comparison of optimisers over several problems: mean ranks, the tests of Friedman and Nemenyi, and the critical
difference.

Source: Demsar, "Statistical Comparisons of Classifiers over Multiple Data Sets" (2006): each problem is one
observation, with the median over seeds as its value.

Runs are also written in the format of IOHprofiler, which IOHanalyzer and iohinspector read.

A folder for each optimiser holds `IOHprofiler_f<id>_<problem>.json` and the records of all seeds in
`data_f<id>_<problem>/IOHprofiler_f<id>_DIM<d>.dat`. There the numbers of evaluations are whole; a fraction of an
evaluation counts as one.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from lmd.core.checks import FloatArray
from lmd.evaluation.comparison import (
    SIGNIFICANCE,
    OptimiserRun,
    attainable,
    friedman,
    mann_whitney,
    mean_ranks,
)

HEADER = "evaluations raw_y"
NOTHING = -1.0
"""Value that is written for the fitness of a run before its first record."""
VERSION = "0.4.2"
"""Version of IOHexperimenter whose file format is written."""


def whole_evaluations(run: OptimiserRun) -> FloatArray:
    """Number of evaluations at each record of a run, rounded up, `(N,)`."""
    return np.array([math.ceil(record.evaluations) for record in run.history], dtype=np.float64)


def write_iohprofiler(folder: Path, runs: Sequence[OptimiserRun], problem: str, number: int, dim: int) -> Path:
    """Write the runs of one optimiser on one problem in IOHprofiler's format; return the path of the JSON file.

    Args:
        folder: folder of the optimiser; it is made if it does not exist.
        runs: runs of different seeds.
        problem: name of the problem.
        number: number of the problem, from 1 on.
        dim: number of genes of a candidate.
    """
    data = Path(f"data_f{number}_{problem}", f"IOHprofiler_f{number}_DIM{dim}.dat")
    (folder / data).parent.mkdir(parents=True, exist_ok=True)
    records, entries = list[str](), list[dict[str, object]]()
    for run in runs:
        reached = {1: NOTHING}  # a run begins where a record has one evaluation
        reached |= {
            int(at): record.best_fitness for at, record in zip(whole_evaluations(run), run.history, strict=True)
        }
        best, last = max(reached.values()), max(reached)
        records += [HEADER, *(f"{at} {value!r}" for at, value in reached.items())]
        found = {"evals": next(at for at, value in reached.items() if value == best), "y": best, "x": []}
        entries.append({"instance": 1, "evals": last, "best": found})
    (folder / data).write_text("\n".join(records) + "\n", encoding="utf-8")
    document = {
        "version": VERSION,
        "suite": "lmd",
        "function_id": number,
        "function_name": problem,
        "maximization": True,
        "algorithm": {"name": runs[0].optimiser, "info": "lmd"},
        "attributes": HEADER.split(),
        "scenarios": [{"dimension": dim, "path": data.as_posix(), "runs": entries}],
    }
    path = folder / f"IOHprofiler_f{number}_{problem}.json"
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path


@dataclass(frozen=True)
class Tournament:
    """Comparison of optimisers over several problems: the median of a metric over the seeds for each problem and
    optimiser, and the tests of these medians.
    """

    values: pd.DataFrame
    """Medians, with a row for each problem and a column for each optimiser; the optimiser with the best mean rank comes
    first. NaN if there is no run.
    """
    ranks: pd.Series
    """Mean rank of each optimiser over the problems on which all optimisers have run; 1 is best."""
    complete: int
    """Number of problems on which all optimisers have run; only these problems enter the tests."""
    friedman: float
    """P-value of Friedman's test of the hypothesis that all optimisers perform equally; NaN for fewer than three
    optimisers or two problems.
    """
    critical: float
    """Least difference of two mean ranks that is significant at the level `SIGNIFICANCE`; NaN if no problem has runs of
    all optimisers.
    """
    leads: Mapping[str, float]
    """P-value, keyed by problem, of the hypothesis that the two best optimisers perform equally (test of Mann and
    Whitney over the seeds); NaN for a single optimiser or seed.
    """
    limit: str
    """Sentence that states the least P-value of `leads` that the number of seeds allows."""

    @property
    def winners(self) -> Mapping[str, list[str]]:
        """For each problem, the optimiser with the greatest median; several optimisers if their medians are equal."""
        return {
            str(problem): [str(name) for name in row.index[row == row.max()]] for problem, row in self.values.iterrows()
        }


def tournament(runs: Sequence[OptimiserRun], key: str) -> Tournament:
    """Compare optimisers by the medians over seeds of the metric `key`; higher is better."""
    table = pd.DataFrame([(run.problem, run.optimiser, run.metrics[key]) for run in runs], columns=["row", "name", "y"])
    values = table.pivot_table(index="row", columns="name", values="y", aggfunc="median")
    complete = values.dropna()
    count, rows = values.shape[1], len(complete)
    names = list(values)
    ranks = pd.Series(mean_ranks(complete.to_numpy()) if rows else np.full(count, np.nan), names).sort_values()
    values, complete = values[ranks.index], complete[ranks.index]
    is_tested, seeds = count > 2 and rows > 1, int(table.groupby(["row", "name"]).size().max())
    return Tournament(
        values.rename_axis(index="problem", columns=None),
        ranks,
        rows,
        friedman(complete.to_numpy()) if is_tested else np.nan,
        critical_difference(count, rows),
        {str(problem): _lead(own) for problem, own in table.groupby("row")},
        attainable(lambda number: mann_whitney(np.linspace(0.0, 1.0, number), np.linspace(2.0, 3.0, number)), seeds),
    )


def _lead(own: pd.DataFrame) -> float:
    """P-value of the hypothesis that the two optimisers with the greatest medians on a problem perform equally.

    `own` is the table of the runs on this problem, with the optimiser `name` and the metric `y`.
    """
    medians = own.groupby("name").y.median().sort_values(ascending=False, kind="stable")
    best = [own.y[own.name == name] for name in medians.index[:2]]
    return mann_whitney(*best) if len(best) == 2 else np.nan


def critical_difference(optimisers: int, problems: int) -> float:
    """Critical difference of mean ranks by Nemenyi's test at `SIGNIFICANCE`; NaN for fewer than two optimisers or
    problems.
    """
    if optimisers < 2 or problems < 2:
        return np.nan
    quantile = float(stats.studentized_range.isf(SIGNIFICANCE, optimisers, np.inf)) / np.sqrt(2.0)
    return float(quantile * np.sqrt(optimisers * (optimisers + 1) / (6.0 * problems)))


def rank_correlation(one: pd.Series, other: pd.Series) -> float:
    """Kendall's tau-b of the mean ranks in two tournaments, over the optimisers that are in both; NaN for fewer than
    two.
    """
    both = one.index.intersection(other.index)
    return float(stats.kendalltau(one[both], other[both]).statistic) if len(both) > 1 else np.nan
