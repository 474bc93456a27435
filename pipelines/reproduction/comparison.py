"""The comparison of optimisers as a table for readers."""

import numpy as np

from lmd.core.words import as_code
from lmd.evaluation.comparison import Comparison
from lmd.objectives.base import Headline

from .document import Table

OFF_GRID = "off_grid"


def as_text(comparison: Comparison, headline: Headline) -> Table:
    """A comparison for readers, figures in the unit of the objective's headline; what is unknown is left blank."""
    key, table = headline.key, comparison.table
    has_off_grid = OFF_GRID in table
    head = ["optimiser", "runs", f"{headline.label}: median (95% interval)", *["off the grid"] * has_off_grid, "rank"]
    head += [f"evaluations to {target:.2%}" for target in comparison.targets]
    head += ["seconds", f"A12 against {as_code(comparison.reference)}", "p"]
    rows: list[list[str]] = []
    for row in table.to_dict("records"):
        middle, low, high = (headline.text(row[name]) for name in (key, f"{key}_low", f"{key}_high"))
        cells = [as_code(row["optimiser"]), f"{row['runs']}", f"**{middle}** ({low} to {high})"]
        cells += [headline.text(row[OFF_GRID])] if has_off_grid else []
        cells.append(_known(row["rank"], ".1f"))
        running = [row[f"evaluations_to_{i}"] for i in range(1, len(comparison.targets) + 1)]
        cells += ["–" if np.isinf(evaluations) else f"{evaluations:.0f}" for evaluations in running]
        cells += [f"{row['seconds']:.0f}"]
        is_reference = row["optimiser"] == comparison.reference
        cells += ["", ""] if is_reference else [f"{row['a12']:.2f}", _known(row["p_value"], ".2g")]
        rows.append(cells)
    return Table(head, rows)


def _known(value: float, form: str) -> str:
    return "" if np.isnan(value) else f"{value:{form}}"


def to_markdown(comparison: Comparison, headline: Headline) -> str:
    """A comparison as a Markdown table, with what was tested below it."""
    below = f"\n{comparison.test}\n" if comparison.test else ""
    return f"{as_text(comparison, headline).markdown()}\n{below}"
