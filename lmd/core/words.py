"""Text for messages and Markdown: shortened lists, tables, escapes."""

import re
from collections.abc import Iterable, Mapping, Sequence

from lmd.core.checks import printable

# Characters with a meaning in Markdown or HTML; an underscore within a word has none.
MARKS = re.compile(r"[\\`*{}\[\]<>#|&\"$^~!+]|(?<![^\W_])_|_(?![^\W_])")

# Characters that some Markdown renderers interpret in inline code within a table cell.
CODE_MARKS = re.compile(r"[\\`*<>|&]")


def labelled(rows: Mapping[str, str]) -> str:
    """Text for a terminal with one line for each row: the label, followed by the row's text."""
    width = max(map(len, rows))
    return "\n".join(f"{label:<{width}} {text}" for label, text in rows.items())


def few(texts: Iterable[object], most: int) -> str:
    """First `most` of the texts, separated by commas, and the number of omitted texts, as in `a, b and 3 more`."""
    every = list(map(str, texts))
    return ", ".join(every[:most]) + f" and {len(every) - most} more" * (len(every) > most)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table; all rows have the length of `head`."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))


def escaped(text: object) -> str:
    """Escape a text for Markdown (also in table cells) and HTML.

    Special characters of Markdown and HTML become numeric entities; non-printable characters become escapes.
    """
    return MARKS.sub(lambda found: f"&#{ord(found[0])};", printable(str(text)))


def as_code(text: object) -> str:
    """Text as inline code in Markdown: in backticks; a text with special characters is `escaped` and put in HTML tags
    instead.
    """
    plain = str(text)
    is_plain = plain.isprintable() and plain == plain.strip() != "" and not CODE_MARKS.search(plain)
    return f"`{plain}`" if is_plain else f"<code>{escaped(plain)}</code>"
