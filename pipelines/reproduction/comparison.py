"""The comparison of optimisers as a table for readers."""

import numpy as np
import pandas as pd

from lmd.evaluation.comparison import MILESTONES
from lmd.objectives.base import Headline

from .document import Table

# Figures beside the headline that readers want to see, if the objective has them.
FURTHER = {"average_coverage_probability": "average", "maximum_coverage_probability": "maximum"}


def as_text(table: pd.DataFrame, headline: Headline) -> Table:
    """`comparison_table` for readers, figures in the unit of the objective's headline."""
    key, further = headline.key, {figure: label for figure, label in FURTHER.items() if figure in table}
    milestones = [f"evaluations_to_{milestone:.0%}" for milestone in MILESTONES]
    head = ["optimiser", "runs", f"{headline.label}: median (min to max)", *further.values()]
    head += [f"evaluations to {milestone:.0%}" for milestone in MILESTONES] + ["seconds", "p against the first"]
    rows: list[list[str]] = []
    for row in table.to_dict("records"):
        middle, low, high = (headline.text(row[name]) for name in (key, f"{key}_min", f"{key}_max"))
        cells = [f"`{row['optimiser']}`", f"{row['runs']}", f"**{middle}** ({low} to {high})"]
        cells += [f"{row[figure]:.2%}" for figure in further]
        cells += ["–" if np.isinf(row[m]) else f"{row[m]:.0f}" for m in milestones]
        cells += [f"{row['seconds']:.0f}", f"{row['p_value']:.2g}" if rows else ""]
        rows.append(cells)
    return Table(head, rows)


def to_markdown(table: pd.DataFrame, headline: Headline) -> str:
    """`comparison_table` as a Markdown table."""
    return as_text(table, headline).markdown() + "\n"
