"""Page of text, tables and pictures, written as Markdown and as self-contained HTML.

Texts and cells may use two marks of Markdown, `code` between backticks and **bold**. Texts of other origin must be
escaped by `lmd.core.words.escaped` or `as_code`.
"""

import base64
import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from lmd.core.words import as_code, markdown_table
from lmd.evaluation.comparison import Comparison
from lmd.objectives.base import Headline

STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; display: block; overflow-x: auto; font-size: 0.9rem; }
th, td { border-bottom: 1px solid #ccc; padding: 0.3rem 0.7rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
figure { margin: 1rem 0; }
figcaption { color: #555; font-size: 0.9rem; }
img { max-width: 100%; }
code { background: #f2f2f2; padding: 0 0.2rem; }
"""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of text cells, every row as long as `head`."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """Table as lines of Markdown."""
        return markdown_table(self.head, self.rows)


@dataclass(frozen=True)
class Picture:
    """A PNG and its caption."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading and its blocks."""

    title: str
    blocks: Sequence[Text | Table | Picture]


def to_markdown(sections: Sequence[Section], pictures: str) -> str:
    """Sections as Markdown, with headings of the second level.

    Args:
        pictures: prefix of the file names of pictures.
    """
    blocks: list[str] = []
    for section in sections:
        blocks.append(f"## {section.title}")
        for block in section.blocks:
            if isinstance(block, Text):
                blocks.append(block.text)
            elif isinstance(block, Table):
                blocks.append(block.markdown())
            else:
                blocks.append(f"![{block.caption}]({quote(pictures + block.path.name)})")
    return "\n\n".join(blocks) + "\n"


def to_html(title: str, sections: Sequence[Section]) -> str:
    """Page as one HTML file that contains its pictures and its style."""
    blocks = [f"<h1>{html.escape(title)}</h1>"]
    for section in sections:
        blocks.append(f"<h2>{html.escape(section.title)}</h2>")
        for block in section.blocks:
            if isinstance(block, Text):
                blocks.append(f"<p>{_inline(block.text)}</p>")
            elif isinstance(block, Table):
                rows = [_row("th", block.head), *(_row("td", row) for row in block.rows)]
                blocks.append("<table>\n" + "\n".join(rows) + "\n</table>")
            else:
                data = base64.b64encode(block.path.read_bytes()).decode("ascii")
                caption = html.escape(block.caption)
                image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
                blocks.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    body = "\n".join(blocks)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{STYLE}</style></head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in cells) + "</tr>"


def _inline(text: str) -> str:
    """Text as HTML, with marks as tags; escaped characters stay."""
    text = re.sub(r"&amp;(#\d+;)", r"&\1", html.escape(text))
    text = re.sub(r"&lt;(/?code)&gt;", r"<\1>", text)
    text = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", text)
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", text)


OFF_GRID = "off_grid"


def comparison_table(comparison: Comparison, headline: Headline) -> Table:
    """Table of a comparison of optimisers, in the unit of the objective's headline; unknown figures are blank."""
    key, table = headline.key, comparison.table
    has_off_grid = OFF_GRID in table
    head = ["optimiser", "runs", f"{headline.label}: median (95% interval)", *["off the grid"] * has_off_grid, "rank"]
    head += [f"evaluations to fitness {target:.2%}" for target in comparison.targets]
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


def comparison_markdown(comparison: Comparison, headline: Headline) -> str:
    """Table of a comparison as Markdown, followed by the name of the test."""
    below = f"\n{comparison.test}\n" if comparison.test else ""
    return f"{comparison_table(comparison, headline).markdown()}\n{below}"
