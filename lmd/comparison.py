"""Comparing optimisers over seeds: the figures of a table and of a convergence plot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from lmd.checks import FloatArray
from lmd.deployment import Deployment
from lmd.optimisers.base import Record

MILESTONES = (0.50, 0.65, 0.80)


@dataclass(frozen=True)
class Outcome:
    """One run of one optimiser."""

    optimiser: str
    seed: int
    metrics: Mapping[str, float]
    history: Sequence[Record]
    deployment: Deployment

    def evaluations_to(self, fitness: float) -> float:
        """Evaluations after which the best fitness reached `fitness`; infinity if it never did."""
        return next((r.evaluations for r in self.history if r.best_fitness >= fitness), np.inf)


def by_optimiser(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Outcomes grouped by optimiser, the highest median qualified ratio first."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.optimiser, []).append(outcome)

    def median(name: str) -> float:
        return float(np.median([o.metrics["qualified_ratio"] for o in groups[name]]))

    return {name: groups[name] for name in sorted(groups, key=median, reverse=True)}


def comparison_table(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """One row per optimiser, the best first.

    Columns: runs; median, min and max of the qualified ratio; median average and maximum coverage probability;
    median evaluations to reach each milestone (infinite if most runs never do); median wall time in seconds; and the
    two-sided Mann-Whitney p-value of its qualified ratios against those of the first row.
    """
    groups = by_optimiser(outcomes)

    def values(name: str, metric: str) -> list[float]:
        return [o.metrics[metric] for o in groups[name]]

    best = values(next(iter(groups)), "qualified_ratio")
    rows: list[dict[str, float | str]] = []
    for name, runs in groups.items():
        ratio = values(name, "qualified_ratio")
        row: dict[str, float | str] = {
            "optimiser": name,
            "runs": len(runs),
            "qualified_ratio": float(np.median(ratio)),
            "qualified_ratio_min": min(ratio),
            "qualified_ratio_max": max(ratio),
            "average": float(np.median(values(name, "average_coverage_probability"))),
            "maximum": float(np.median(values(name, "maximum_coverage_probability"))),
        }
        for milestone in MILESTONES:
            row[f"evaluations_to_{milestone:.0%}"] = float(np.median([o.evaluations_to(milestone) for o in runs]))
        row["seconds"] = float(np.median([o.history[-1].wall_time for o in runs]))
        row["p_value"] = float(mannwhitneyu(ratio, best).pvalue) if rows else 1.0
        rows.append(row)
    return pd.DataFrame(rows)


def best_at(runs: Sequence[Outcome], axis: str, at: FloatArray) -> FloatArray:
    """Best fitness of each run at points `at` `(N,)` of an axis of `Record`, `(R, N)`; NaN before its first record."""
    curves = []
    for run in runs:
        spent = np.array([getattr(record, axis) for record in run.history])
        best = np.array([np.nan] + [record.best_fitness for record in run.history])
        curves.append(best[np.searchsorted(spent, at, side="right")])
    return np.array(curves)
