"""Time limits for the search for a bound; an interrupted search still gives a valid bound."""

from collections.abc import Callable
from math import inf

from lmd.core.compiled import clock


class TimeLimit:
    """Time limit that starts now; time of compilation does not count.

    Args:
        seconds: limit, seconds; infinite for no limit, with reproducible results.
        report: called with texts on the progress.
    """

    def __init__(self, seconds: float = inf, report: Callable[[str], None] = lambda _: None) -> None:
        self.seconds, self.report, self._until = seconds, report, clock() + seconds
        self.cut: list[str] = []
        """Descriptions of the searches that were cut short."""

    @property
    def left(self) -> float:
        """Seconds left, not negative."""
        return max(self._until - clock(), 0.0)

    def part(self, share: float) -> "TimeLimit":
        """Make a limit that ends after a share of the remaining time."""
        return TimeLimit(share * self.left, self.report)

    def leaves(self, seconds: float, what: str) -> bool:
        """True if at least `seconds` are left; otherwise record that `what` was cut short."""
        if seconds <= self.left:
            return True
        self.cut.append(what)
        return False
