"""The comparison of optimisers as a table for readers."""

import numpy as np
import pandas as pd

from lmd.comparison import MILESTONES

from .document import Table


def as_text(table: pd.DataFrame) -> Table:
    """`comparison_table` for readers, ratios in per cent."""
    milestones = [f"evaluations_to_{milestone:.0%}" for milestone in MILESTONES]
    head = ["optimiser", "runs", "qualified ratio: median (min to max)", "average", "maximum"]
    head += [f"evaluations to {milestone:.0%}" for milestone in MILESTONES] + ["seconds", "p against the first"]
    rows: list[list[str]] = []
    for row in table.to_dict("records"):
        low, high = row["qualified_ratio_min"], row["qualified_ratio_max"]
        cells = [
            f"`{row['optimiser']}`",
            f"{row['runs']}",
            f"**{row['qualified_ratio']:.2%}** ({low:.2%} to {high:.2%})",
        ]
        cells += [f"{row['average']:.2%}", f"{row['maximum']:.2%}"]
        cells += ["–" if np.isinf(row[m]) else f"{row[m]:.0f}" for m in milestones]
        cells += [f"{row['seconds']:.0f}", f"{row['p_value']:.2g}" if rows else ""]
        rows.append(cells)
    return Table(head, rows)


def to_markdown(table: pd.DataFrame) -> str:
    """`comparison_table` as a Markdown table, ratios in per cent."""
    return as_text(table).markdown() + "\n"
