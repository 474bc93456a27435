"""Paired comparison of deployments: equal flights are localised with each deployment, and the errors are compared
flight by flight.
"""

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from lmd.core.checks import FloatArray
from lmd.core.words import escaped, markdown_table

PAIRED_FIGURE = "within_20mm"


def paired(figures: pd.DataFrame) -> pd.DataFrame:
    """Compare each deployment with the first deployment in `figures`.

    Args:
        figures: `FlightStudy.figures`, one row for each deployment, estimator and seed.

    Returns:
        A row for each estimator and each deployment but the first, with the columns `estimator`, `deployment`, and
        `against` (the name of the first deployment). `flights` is the number of flights with estimates for both
        deployments. `position_ratio` is the median, over these flights, of the position error divided by the error with
        the first deployment. `position_better` is the number of flights in which the deployment of the row has the
        smaller error. `within_20mm_gain` is the mean increase, from the first deployment to that of the row, of the
        fraction of frames with a position error of at most 20 mm. `position_p` and `within_20mm_p` are P-values of
        two-sided Wilcoxon signed-rank tests of the ratios and of the increases. `position_ratio` and `position_p` are
        NaN if no flight has estimates for both.
    """
    rows = []
    for estimator, runs in figures.groupby("estimator", sort=False):
        position, share = (
            runs.pivot(index="seed", columns="deployment", values=key) for key in ("position_error", PAIRED_FIGURE)
        )
        first, *others = runs.deployment.unique()
        for name in others:
            ratio = (position[name] / position[first]).dropna().to_numpy()
            gain = (share[name] - share[first]).to_numpy()
            rows.append({
                "estimator": estimator,
                "deployment": name,
                "against": first,
                "flights": len(ratio),
                "position_ratio": float(np.median(ratio)) if ratio.size else np.nan,
                "position_better": int((ratio < 1.0).sum()),
                "position_p": _p_value(np.log(ratio)),
                f"{PAIRED_FIGURE}_gain": float(gain.mean()),
                f"{PAIRED_FIGURE}_p": _p_value(gain),
            })  # fmt: skip
    return pd.DataFrame(rows)


def _p_value(differences: FloatArray) -> float:
    """P-value of the Wilcoxon signed-rank test for paired `differences`; 1 if all are 0, NaN without differences."""
    if not differences.size:
        return np.nan
    return float(wilcoxon(differences).pvalue) if differences.any() else 1.0


def to_markdown(pairs: pd.DataFrame) -> str:
    """Format the result of `paired` as a Markdown table."""
    head = ["deployment", "against", "estimator", "position error", "smaller in", "p", "more frames within 20 mm", "p"]
    rows = [
        [
            escaped(row["deployment"]),
            escaped(row["against"]),
            escaped(row["estimator"]),
            f"x {row['position_ratio']:.2f}",
            f"{row['position_better']} of {row['flights']} flights",
            f"{row['position_p']:.2g}",
            f"{100.0 * row[f'{PAIRED_FIGURE}_gain']:+.1f} points",
            f"{row[f'{PAIRED_FIGURE}_p']:.2g}",
        ]
        for row in pairs.to_dict("records")
    ]
    return markdown_table(head, rows) + "\n"
