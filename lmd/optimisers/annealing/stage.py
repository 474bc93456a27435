"""Conditions of a stage of simulated annealing, as a user sets them, and the default stages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from lmd.core.checks import argument_of, check_fields, choice, real, vector
from lmd.optimisers.annealing.moves import Settings

PAIRS = ("temperature", "width", "step")
CONSTANTS = ("margin", "share", "jump", "join", "together", "exchange")


@dataclass(frozen=True)
class Stage:
    """Conditions of one stage; a pair has the values at the beginning and at the end of the stage, with geometric
    interpolation.

    Raises:
        InputError: a value is out of range.
    """

    temperature: Sequence[float]
    """Loss in the smoothed objective that is accepted with probability 1/e; the objective is a mean over positions."""
    width: Sequence[float]
    """Width of the smooth step around the threshold, in value."""
    step: Sequence[float]
    """Standard deviation of a local move, metres."""
    margin: float = 0.0
    """Height of the middle of the smooth step above the threshold, in value."""
    share: float = 0.02
    """Weight of the mean value beside the smooth step."""
    jump: float = 0.1
    """Probability of a move to a place drawn uniformly from all surfaces."""
    join: float = 0.1
    """Probability of a move next to another landmark."""
    together: float = 0.0
    """Probability that a landmark moves with its n - 1 nearest neighbours."""
    exchange: float = 0.05
    """Probability that a landmark exchanges its place with a landmark of another size, if there are several sizes."""

    def __post_init__(self) -> None:
        check_fields(self, vector, *PAIRS, size=2, above=0.0)
        real("margin", self.margin)
        real("share", self.share, low=0.0)
        real("join", self.join, low=0.0, high=1.0 - real("jump", self.jump, low=0.0, high=1.0))
        check_fields(self, real, "together", "exchange", low=0.0, high=1.0)

    def settings(self, progress: float, near: float) -> Settings:
        """Settings of the walk after a share `progress` in [0, 1] of the stage.

        Args:
            progress: completed share of the stage, clipped to [0, 1].
            near: standard deviation of the distance from the landmark that a move joins, metres.
        """
        progress = max(0.0, min(progress, 1.0))
        now = {name: getattr(self, name) for name in CONSTANTS}
        for name in PAIRS:
            first, last = getattr(self, name)
            now[name] = float(first * (last / first) ** progress)
        return Settings(near=near, **now)


STACKED_STAGE = Stage(temperature=(2e-3, 1e-5), width=(0.06, 0.003), step=(1.0, 0.1), jump=0.1, join=0.0)
SINGLE_STAGE = Stage(
    temperature=(2e-5, 2e-6), width=(0.006, 0.002), step=(0.1, 0.01), jump=0.03, join=0.05, together=0.3
)
SAMPLED_STAGE = replace(SINGLE_STAGE, width=(0.02, 0.004), share=0.2)
GIVEN_STAGE = replace(SINGLE_STAGE, temperature=(1e-4, 2e-6), width=(0.02, 0.002), step=(0.3, 0.01))


def changed(name: str, default: Stage, given: Stage | Mapping[str, Any]) -> Stage:
    """Return the stage `given`, or the default stage with the conditions that a mapping gives.

    Raises:
        InputError: a value is out of range, or no condition has such a name.
    """
    if isinstance(given, Stage):
        return given
    with argument_of(name):
        for key in given:
            choice("condition", key, [field.name for field in fields(Stage)])
        return replace(default, **given)
