"""How long a bound may be looked for: it holds whenever that ends, and who asked for it is told what was cut short."""

from collections.abc import Callable
from math import inf

from lmd.core.compiled import clock


class TimeLimit:
    """So many seconds from now on, those not counted in which kernels are compiled.

    Args:
        seconds: infinite for no limit, where results do not depend on the time.
        tell: is told now and then how far it is.
    """

    def __init__(self, seconds: float = inf, tell: Callable[[str], None] = lambda _: None) -> None:
        self.seconds, self.tell, self._until = seconds, tell, clock() + seconds
        self.cut: list[str] = []
        """What was cut short, and where."""

    @property
    def left(self) -> float:
        """Seconds that are left, not negative."""
        return max(self._until - clock(), 0.0)

    def part(self, share: float) -> "TimeLimit":
        """A limit that ends after this share of what is left."""
        return TimeLimit(share * self.left, self.tell)

    def leaves(self, seconds: float, what: str) -> bool:
        """Whether there are so many seconds more; if not, `what` is cut short."""
        if seconds <= self.left:
            return True
        self.cut.append(what)
        return False
