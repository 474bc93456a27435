"""The stages of a survey, for whoever waits for it, and may stop it."""

from collections.abc import Callable
from enum import Enum


class Stage(Enum):
    """The stages, in their order."""

    PLACING = "placing tags"
    ADJUSTING = "adjusting"
    REFINING = "refining the cameras"
    COMPARING = "comparing blocks of time"
    CHECKING = "looking for what does not fit"
    HOLDING_OUT = "holding frames out"
    PROPOSING = "looking for the next photographs"
    AUDITING = "comparing with what was predicted"

    @property
    def has_map(self) -> bool:
        """True once there is a map."""
        return self not in (Stage.PLACING, Stage.ADJUSTING)

    @property
    def has_final_map(self) -> bool:
        """True once nothing that is left to do changes the map."""
        return self.has_map and self not in (Stage.REFINING, Stage.COMPARING)


# Told the stage, how many of its steps are done, and how many there are at most, 0 where that is not known; returns
# whether to stop with the map so far. It may raise where there is none.
Observer = Callable[[Stage, int, int], bool]


def unobserved(_stage: Stage, _done: int, _most: int) -> bool:
    """Let a survey go on to its end."""
    return False
