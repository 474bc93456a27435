"""Times as they are written: nanoseconds since 1970 have more digits than a float."""

import math
from collections.abc import Iterable
from decimal import Decimal, InvalidOperation


def time_of(text: str) -> Decimal | str:
    """The key that tells a time from others: the number written, or else, as for names of photographs, the text."""
    try:
        number = Decimal(text)
    except InvalidOperation:
        return text
    return number if number.is_finite() else text


def in_order(texts: Iterable[str]) -> list[str]:
    """Different texts for times, in ascending order: numbers first, then, as for names of photographs, texts."""
    return sorted(set(texts), key=_key)


def _key(text: str) -> tuple[float, str]:
    try:
        number = float(text)
    except ValueError:
        number = math.inf
    return number if math.isfinite(number) else math.inf, text
