"""Time limits of the search for a bound, which is valid whenever the search ends."""

from collections.abc import Callable
from math import inf

from lmd.core.compiled import clock


class TimeLimit:
    """Seconds from now on, without those in which kernels are compiled.

    Args:
        seconds: infinite for no limit, where results do not depend on the time.
        report: called now and then with the progress in words.
    """

    def __init__(self, seconds: float = inf, report: Callable[[str], None] = lambda _: None) -> None:
        self.seconds, self.report, self._until = seconds, report, clock() + seconds
        self.cut: list[str] = []
        """Searches that were cut short, in words."""

    @property
    def left(self) -> float:
        """Seconds left, not negative."""
        return max(self._until - clock(), 0.0)

    def part(self, share: float) -> "TimeLimit":
        """Make a limit that ends after a share of the time left."""
        return TimeLimit(share * self.left, self.report)

    def leaves(self, seconds: float, what: str) -> bool:
        """Return True if at least `seconds` are left; if not, note that `what` was cut short."""
        if seconds <= self.left:
            return True
        self.cut.append(what)
        return False
