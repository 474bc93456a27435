"""Comparing optimisers over seeds: the figures of a table and of a convergence plot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from lmd.core.checks import FloatArray
from lmd.optimisers.base import Record
from lmd.scene.deployment import Deployment

MILESTONES = (0.50, 0.65, 0.80)


@dataclass(frozen=True)
class OptimiserRun:
    """One run of one optimiser."""

    optimiser: str
    seed: int
    metrics: Mapping[str, float]
    history: Sequence[Record]
    deployment: Deployment

    def evaluations_to(self, fitness: float) -> float:
        """Evaluations after which the best fitness reached `fitness`; infinity if it never did."""
        return next((r.evaluations for r in self.history if r.best_fitness >= fitness), np.inf)


def by_optimiser(runs: Sequence[OptimiserRun], key: str) -> dict[str, list[OptimiserRun]]:
    """Runs grouped by optimiser, the highest median of the figure `key` first."""
    groups: dict[str, list[OptimiserRun]] = {}
    for run in runs:
        groups.setdefault(run.optimiser, []).append(run)

    def median(name: str) -> float:
        return float(np.median([run.metrics[key] for run in groups[name]]))

    return {name: groups[name] for name in sorted(groups, key=median, reverse=True)}


def comparison_table(runs: Sequence[OptimiserRun], key: str) -> pd.DataFrame:
    """One row per optimiser, the best first.

    Columns: optimiser, runs; the median, `<key>_min` and `<key>_max` of the objective's headline `key`; the medians of
    all other figures; median evaluations to reach each milestone (infinite if most runs never do); median wall time in
    seconds; and the two-sided Mann-Whitney p-value of the headline against that of the first row.
    """
    groups = by_optimiser(runs, key)

    def values(name: str, figure: str) -> list[float]:
        return [run.metrics[figure] for run in groups[name]]

    best = values(next(iter(groups)), key)
    others = [figure for figure in runs[0].metrics if figure != key]
    rows: list[dict[str, float | str]] = []
    for name, group in groups.items():
        reached = values(name, key)
        row: dict[str, float | str] = {"optimiser": name, "runs": len(group)}
        row |= {key: float(np.median(reached)), f"{key}_min": min(reached), f"{key}_max": max(reached)}
        row |= {figure: float(np.median(values(name, figure))) for figure in others}
        for milestone in MILESTONES:
            row[f"evaluations_to_{milestone:.0%}"] = float(np.median([run.evaluations_to(milestone) for run in group]))
        row["seconds"] = float(np.median([run.history[-1].wall_time for run in group]))
        row["p_value"] = float(mannwhitneyu(reached, best).pvalue) if rows else 1.0
        rows.append(row)
    return pd.DataFrame(rows)


def best_at(runs: Sequence[OptimiserRun], axis: str, at: FloatArray) -> FloatArray:
    """Best fitness of each run at points `at` `(N,)` of an axis of `Record`, `(R, N)`; NaN before its first record."""
    curves = []
    for run in runs:
        spent = np.array([getattr(record, axis) for record in run.history])
        best = np.array([np.nan] + [record.best_fitness for record in run.history])
        curves.append(best[np.searchsorted(spent, at, side="right")])
    return np.array(curves)
