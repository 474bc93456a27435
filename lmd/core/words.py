"""Words for people."""

from collections.abc import Iterable, Sequence


def few(texts: Iterable[object], most: int) -> str:
    """The first of several texts, and how many more there are."""
    every = list(map(str, texts))
    return ", ".join(every[:most]) + f" and {len(every) - most} more" * (len(every) > most)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown; all rows are as long as `head`."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))
