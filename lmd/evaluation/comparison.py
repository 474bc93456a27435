"""Comparison of optimisers over seeds: numbers for a table and for charts, and distribution-free tests.

All tests are two-sided. Sources: Demsar, "Statistical Comparisons of Classifiers over Multiple Data Sets" (2006), for
Friedman's test followed by Nemenyi's test. Vargha and Delaney, "A Critique and Improvement of the CL Common Language
Effect Size Statistics" (2000), for A12. Holm, "A Simple Sequentially Rejective Multiple Test Procedure" (1979).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Protocol

import numpy as np
import pandas as pd
from scipy import stats

from lmd.core.checks import FloatArray
from lmd.core.words import as_code, markdown_table
from lmd.objectives.base import Headline
from lmd.optimisers.ledger import Record
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig

TABLE_TARGETS = (0.25, 0.5, 0.75)  # quantiles of the final fitness of all runs
CURVE_TARGETS = 50  # number of targets of a curve
CONFIDENCE = 0.95  # confidence level of intervals
SIGNIFICANCE = 0.05  # significance level of tests
LEAST_PAIRS = 2  # least number of pairs for a test
MOST_EXACT = 8  # largest size of samples with ties for which all permutations are enumerated


@dataclass(frozen=True)
class OptimiserRun:
    """Result of one run of an optimiser with one seed: metrics, history, and best deployment."""

    optimiser: str
    seed: int
    metrics: Mapping[str, float]
    history: Sequence[Record]
    deployment: Deployment
    rig: Rig | None = None
    """Best cameras, if the run placed cameras; otherwise None."""
    problem: str = ""
    """Name of the problem in the suite; empty if the problem is not part of the suite."""

    def evaluations_to(self, fitness: float) -> float:
        """Number of evaluations after which the best fitness reached `fitness`; infinity if the run did not reach
        it.
        """
        return next((r.evaluations for r in self.history if r.best_fitness >= fitness), np.inf)


@dataclass(frozen=True)
class Comparison:
    """Comparison of several optimisers, computed from their runs."""

    table: pd.DataFrame
    """One row for each optimiser, the best optimiser first; see `compared` for the columns."""
    targets: tuple[float, ...]
    """Distinct quartiles of the final fitness of all runs, ascending; column `evaluations_to_<i>` of the table belongs
    to target i, from 1 on.
    """
    reference: str
    """Name of the optimiser with which the others are compared by the effect sizes and P-values of the table."""
    test: str
    """Two paragraphs in Markdown: the name of the test that gives the P-values, and the least P-value that the number
    of seeds allows; empty without a test.
    """
    pairs: pd.DataFrame | None
    """Table of the P-values, with a row and a column for each optimiser; None if the optimisers were tested only
    against the reference.
    """


def by_optimiser(runs: Sequence[OptimiserRun], key: str) -> dict[str, list[OptimiserRun]]:
    """Group runs by optimiser; optimisers are in descending order of their median of the metric `key`."""
    groups: dict[str, list[OptimiserRun]] = {}
    for run in runs:
        groups.setdefault(run.optimiser, []).append(run)

    def median(name: str) -> float:
        return float(np.median([run.metrics[key] for run in groups[name]]))

    return {name: groups[name] for name in sorted(groups, key=median, reverse=True)}


def compared(runs: Sequence[OptimiserRun], key: str, reference: str | None = None) -> Comparison:
    """Compare optimisers by the metric `key`; the tests pair runs that have equal seeds.

    The table of the result has these columns:

    - `optimiser`, `runs`: name of the optimiser, and number of runs.
    - `<key>`: median of the metric over the runs; `<key>_min` and `<key>_max`: the least and greatest value.
    - `<key>_low` and `<key>_high`: bounds of the median's bootstrap interval.
    - `rank`: mean rank over the seeds that all optimisers have run; 1 is best.
    - a column for each other metric, and `seconds` for the wall time: medians over the runs.
    - `evaluations_to_<i>`: expected running time to target i, see `Comparison.targets`.
    - `a12`, `p_value`: effect size (see `a12`), and P-value of the test, of this optimiser against the reference.

    Args:
        runs: runs of all optimisers.
        key: name of the metric; higher is better.
        reference: optimiser against which all others are tested. None tests every pair of optimisers; the table then
            compares with the optimiser of its first row.
    """
    groups = by_optimiser(runs, key)
    figures = pd.DataFrame({name: {run.seed: run.metrics[key] for run in group} for name, group in groups.items()})
    complete = figures.dropna()
    pairs = None
    if reference in groups or len(groups) <= 2:
        reference = reference if reference in groups else next(iter(groups))
        p_values, test = _against(figures, reference)
    else:
        reference = next(iter(groups))
        pairs, test = _all_against_all(complete, reference)
        p_values = pairs[reference]
    ranks = dict(zip(groups, mean_ranks(complete.to_numpy()), strict=True)) if len(complete) else {}
    ends = [run.history[-1].best_fitness for run in runs]
    targets = tuple(np.unique(np.quantile(ends, TABLE_TARGETS, method="higher")).tolist())
    others = [figure for figure in runs[0].metrics if figure != key]
    values = {name: figures[name].dropna().to_numpy() for name in groups}
    rows: list[dict[str, float | str]] = []
    for name, group in groups.items():
        reached = values[name]
        low, high = median_interval(reached, seed=0)
        row: dict[str, float | str] = {"optimiser": name, "runs": len(group), key: float(np.median(reached))}
        row |= {f"{key}_low": low, f"{key}_high": high, f"{key}_min": reached.min(), f"{key}_max": reached.max()}
        row["rank"] = ranks.get(name, np.nan)
        row |= {figure: float(np.median([run.metrics[figure] for run in group])) for figure in others}
        row |= {f"evaluations_to_{i}": expected_running_time(group, target) for i, target in enumerate(targets, 1)}
        row["seconds"] = float(np.median([run.history[-1].wall_time for run in group]))
        row |= {"a12": a12(reached, values[reference]), "p_value": np.nan if name == reference else p_values[name]}
        rows.append(row)
    return Comparison(pd.DataFrame(rows), targets, reference, test, pairs)


def _against(figures: pd.DataFrame, reference: str) -> tuple[pd.Series, str]:
    """Test each optimiser against the optimiser `reference`; return the P-values, and a text that names the test.

    `figures` has the metric, with a column for each optimiser and a row for each seed.
    """
    others = [name for name in figures if name != reference]
    pairs = [figures[[name, reference]].dropna().to_numpy() for name in others]
    p_values = holm(np.array([wilcoxon(pair[:, 0], pair[:, 1]) for pair in pairs]))

    def least(seeds: int) -> float:
        return float(holm(np.full(len(others), wilcoxon(np.linspace(1.0, 2.0, seeds), np.zeros(seeds))))[0])

    correction = f", with Holm's correction for {len(others)} comparisons" if len(others) > 1 else ""
    against = f"two-sided Wilcoxon signed-rank test against {as_code(reference)}"
    test = f"p: {against} on pairs of the same seed{correction}."
    return pd.Series(p_values, others), f"{test}\n\n{attainable(least, max(map(len, pairs)))}" if others else ""


def _all_against_all(complete: pd.DataFrame, reference: str) -> tuple[pd.DataFrame, str]:
    """Test each pair of optimisers; return the table of P-values, and a text that names the test.

    `complete` has the metric, with a column for each optimiser and a row for each seed that all have run.
    """
    names, values = list(complete), complete.to_numpy()
    test = (
        f"p: Nemenyi's test against {as_code(reference)} on the mean ranks over the {len(values)} seeds that all have "
        "run; "
        f"Friedman's test that all {len(names)} are alike: p = {friedman(values):.2g}.\n\n"
    )
    ladder = np.arange(len(names))
    limit = attainable(lambda seeds: nemenyi(np.tile(ladder, (seeds, 1)))[0, -1], len(values))
    return pd.DataFrame(nemenyi(values), names, names), test + limit


def attainable(least: Callable[[int], float], seeds: int) -> str:
    """Sentence that states the least P-value that a test can reach with the given number of seeds.

    Args:
        least: function of the number of seeds that returns the least corrected P-value of the test; NaN for too few
            seeds. The P-value is least if all seeds rank the optimisers alike.
        seeds: number of seeds.
    """
    lowest, runs = least(seeds), f"With {seeds} seed{'s' * (seeds != 1)}"
    if lowest < SIGNIFICANCE:
        return f"{runs} p can fall to {lowest:.2g}."
    why = "there is no test" if math.isnan(lowest) else f"p is at least {lowest:.2g}"
    enough = next(number for number in count(seeds + 1) if least(number) < SIGNIFICANCE)
    return f"{runs} {why}, so no difference can reach p < {SIGNIFICANCE:g}; {enough} seeds can."


def comparison_markdown(comparison: Comparison, headline: Headline) -> str:
    """Text of a comparison in Markdown: its table, and below it the name of the test. Values are in the unit of the
    objective's main metric (headline); unknown values are blank.
    """
    key, table = headline.key, comparison.table
    has_off_grid = "off_grid" in table
    head = ["optimiser", "runs", f"{headline.label}: median (95% interval)", *["off the grid"] * has_off_grid, "rank"]
    head += [f"evaluations to fitness {target:.2%}" for target in comparison.targets]
    head += ["seconds", f"A12 against {as_code(comparison.reference)}", "p"]
    rows: list[list[str]] = []
    for row in table.to_dict("records"):
        middle, low, high = (headline.text(row[name]) for name in (key, f"{key}_low", f"{key}_high"))
        cells = [as_code(row["optimiser"]), f"{row['runs']}", f"**{middle}** ({low} to {high})"]
        cells += [headline.text(row["off_grid"])] if has_off_grid else []
        cells.append(_known(row["rank"], ".1f"))
        running = [row[f"evaluations_to_{i}"] for i in range(1, len(comparison.targets) + 1)]
        cells += ["–" if np.isinf(evaluations) else f"{evaluations:.0f}" for evaluations in running]
        cells += [f"{row['seconds']:.0f}"]
        is_reference = row["optimiser"] == comparison.reference
        cells += ["", ""] if is_reference else [f"{row['a12']:.2f}", _known(row["p_value"], ".2g")]
        rows.append(cells)
    below = f"\n{comparison.test}\n" if comparison.test else ""
    return f"{markdown_table(head, rows)}\n{below}"


def _known(value: float, form: str) -> str:
    return "" if np.isnan(value) else f"{value:{form}}"


def expected_running_time(runs: Sequence[OptimiserRun], fitness: float) -> float:
    """Expected running time (ERT of COCO) to `fitness`, in evaluations; infinite if no run reaches this fitness.

    The evaluations of all runs, each counted until the run reaches `fitness` or ends, are summed. The sum is divided by
    the number of runs that reach `fitness`.
    """
    spent = [min(run.evaluations_to(fitness), run.history[-1].evaluations) for run in runs]
    reached = sum(np.isfinite(run.evaluations_to(fitness)) for run in runs)
    return sum(spent) / reached if reached else np.inf


class HasHistory(Protocol):
    """Interface of a search whose progress is recorded."""

    @property
    def history(self) -> Sequence[Record]:
        """Records of the search in the order of time."""


def best_at(runs: Sequence[HasHistory], axis: str, at: FloatArray) -> FloatArray:
    """Best fitness that each of R runs had reached at N moments of its search, `(R, N)`; NaN before the first record of
    a run. The moments are the values `at` `(N,)` of the field `axis` of `Record`, such as `evaluations`.
    """
    curves = []
    for run in runs:
        spent = np.array([getattr(record, axis) for record in run.history])
        best = np.array([np.nan] + [record.best_fitness for record in run.history])
        curves.append(best[np.searchsorted(spent, at, side="right")])
    return np.array(curves)


def curve_targets(runs: Sequence[OptimiserRun]) -> FloatArray:
    """T values of the fitness, `(T,)`, that serve as `targets` of `attained`.

    The values are evenly spaced. The first is above the lowest of the runs' first finite fitness values; the last is
    the best fitness of all runs.
    """
    low = min(next(r.best_fitness for r in run.history if np.isfinite(r.best_fitness)) for run in runs)
    high = max(run.history[-1].best_fitness for run in runs)
    return np.linspace(low, high, CURVE_TARGETS + 1)[1:]


def attained(runs: Sequence[OptimiserRun], axis: str, at: FloatArray, targets: FloatArray) -> FloatArray:
    """Share of targets that runs have reached at N moments of the search, `(N,)`.

    All pairs of a run and one of the `targets` `(T,)`, values of the fitness, are counted. The moments are the values
    `at` `(N,)` of the field `axis` of `Record`, such as `evaluations`. The result is an empirical cumulative
    distribution function.
    """
    share: FloatArray = (best_at(runs, axis, at)[:, :, None] >= targets).mean(axis=(0, 2))
    return share


def wilcoxon(first: FloatArray, second: FloatArray) -> float:
    """P-value of Wilcoxon's signed-rank test on pairs of values, `(N,)` each; 1 if no pair differs, NaN for fewer than
    two pairs.
    """
    differences = np.subtract(first, second)
    if len(differences) < LEAST_PAIRS:
        return np.nan
    return float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0


def holm(p_values: FloatArray) -> FloatArray:
    """Correct the P-values `(M,)` of several tests by Holm's procedure; NaN marks a missing test."""
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known])]
    corrected = np.full(len(p_values), np.nan)
    factors = np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(np.maximum.accumulate(factors * p_values[order]), 1.0)
    return corrected


def mann_whitney(first: FloatArray, second: FloatArray) -> float:
    """P-value of the test of Mann and Whitney, exact for at most `MOST_EXACT` values in each sample; NaN if a sample
    has a single value.
    """
    sizes, both = (len(first), len(second)), np.concatenate([first, second])
    if min(sizes) < LEAST_PAIRS:
        return np.nan
    every = stats.PermutationMethod(n_resamples=math.comb(2 * MOST_EXACT, MOST_EXACT))
    is_tied = len(np.unique(both)) < len(both)  # scipy would take the normal approximation, which is too low
    method = every if is_tied and max(sizes) <= MOST_EXACT else "auto"
    return float(stats.mannwhitneyu(first, second, method=method).pvalue)


def mean_ranks(values: FloatArray) -> FloatArray:
    """Mean rank of each of the K columns of `values` `(N, K)`, over the rows, `(K,)`. In a row, rank 1 is the highest
    value; equal values share the mean of their ranks.
    """
    ranks: FloatArray = stats.rankdata(-values, axis=1).mean(axis=0)
    return ranks


def friedman(values: FloatArray) -> float:
    """P-value of Friedman's test on the columns of `values` `(N, K)`, K >= 3; NaN for fewer than two rows.

    The tested hypothesis is that all columns have equal distributions.
    """
    if len(values) < LEAST_PAIRS:
        return np.nan
    if (values == values[:, :1]).all():
        return 1.0
    return float(stats.friedmanchisquare(*values.T).pvalue)


def nemenyi(values: FloatArray) -> FloatArray:
    """P-values `(K, K)` of Nemenyi's test for each pair of the K columns of `values` `(N, K)`; NaN for fewer than two
    rows.
    """
    rows, columns = values.shape
    if rows < LEAST_PAIRS:
        return np.full((columns, columns), np.nan)
    ranks = mean_ranks(values)
    apart = np.abs(ranks[:, None] - ranks) / np.sqrt(columns * (columns + 1) / (6 * rows))
    p_values: FloatArray = stats.studentized_range.sf(np.sqrt(2.0) * apart, columns, np.inf)
    return p_values


def a12(first: FloatArray, second: FloatArray) -> float:
    """Vargha and Delaney's A12: probability that a value of `first` exceeds a value of `second`; ties count half."""
    return float(stats.mannwhitneyu(first, second).statistic / (len(first) * len(second)))


def median_interval(values: FloatArray, seed: int) -> tuple[float, float]:
    """Percentile interval of the median by the bootstrap, with a confidence of 95 %; both bounds equal the value if
    there is only one.

    Args:
        values: the sample `(N,)`.
        seed: seed of the bootstrap.
    """
    if len(values) == 1:
        return float(values[0]), float(values[0])
    generator = np.random.default_rng(seed)
    found = stats.bootstrap((values,), np.median, confidence_level=CONFIDENCE, method="percentile", rng=generator)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
