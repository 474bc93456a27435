"""Words for people."""

from collections.abc import Iterable


def few(texts: Iterable[object], most: int) -> str:
    """The first of several texts, and how many more there are."""
    every = list(map(str, texts))
    return ", ".join(every[:most]) + f" and {len(every) - most} more" * (len(every) > most)
