"""Words for people."""

import re
from collections.abc import Iterable, Sequence

from lmd.core.checks import printable

# What means something in Markdown or HTML; an underscore does not within a word.
MARKS = re.compile(r"[\\`*{}\[\]<>#|&\"$^~!+]|(?<![^\W_])_|_(?![^\W_])")

# What means something in code between backticks, in a cell of a table, to one of the readers of Markdown.
CODE_MARKS = re.compile(r"[\\`*<>|&]")


def few(texts: Iterable[object], most: int) -> str:
    """The first of several texts, and how many more there are."""
    every = list(map(str, texts))
    return ", ".join(every[:most]) + f" and {len(every) - most} more" * (len(every) > most)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown; all rows are as long as `head`."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))


def escaped(text: object) -> str:
    """A text from a store, a file or a name that stands for itself in Markdown, in a cell of a table and in HTML.

    What would mean something there becomes a numeric entity, what cannot be printed an escape.
    """
    return MARKS.sub(lambda found: f"&#{ord(found[0])};", printable(str(text)))


def as_code(text: object) -> str:
    """A text from a store, a file or a name as code in Markdown: between backticks, or `escaped` between tags."""
    plain = str(text)
    is_plain = plain.isprintable() and plain == plain.strip() != "" and not CODE_MARKS.search(plain)
    return f"`{plain}`" if is_plain else f"<code>{escaped(plain)}</code>"
