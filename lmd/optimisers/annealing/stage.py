"""The conditions of a stage of simulated annealing, as a user sets them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from lmd.core.checks import argument_of, check_fields, choice, real, vector
from lmd.optimisers.annealing.walk import Settings


@dataclass(frozen=True)
class Stage:
    """The conditions of one stage; pairs run geometrically from the first to the second value.

    Args:
        temperature: loss in the smoothed objective (a mean over positions) accepted with probability 1/e.
        width: of the smooth step around the threshold, in probability.
        step: standard deviation of a local move, metres.
        margin: how far above thold_p the middle of the smooth step lies.
        share: weight of the average P_n beside the smooth step.
        jump: probability that a move goes anywhere on the walls.
        join: probability that a move goes next to another landmark.
        together: probability that a landmark takes its n - 1 nearest neighbours along.
        exchange: probability that a landmark exchanges its place with one of another size, if there is one.

    Raises:
        InputError: a value is out of range.
    """

    temperature: Sequence[float]
    width: Sequence[float]
    step: Sequence[float]
    margin: float = 0.0
    share: float = 0.02
    jump: float = 0.1
    join: float = 0.1
    together: float = 0.0
    exchange: float = 0.05

    def __post_init__(self) -> None:
        check_fields(self, vector, "temperature", "width", "step", size=2, above=0.0)
        real("margin", self.margin)
        real("share", self.share, low=0.0)
        real("jump", self.jump, low=0.0, high=1.0)
        real("join", self.join, low=0.0, high=1.0 - self.jump)
        real("together", self.together, low=0.0, high=1.0)
        real("exchange", self.exchange, low=0.0, high=1.0)

    def settings(self, progress: float, near: float) -> Settings:
        """The conditions after a share `progress` in [0, 1] of the stage."""

        def now(values: Sequence[float]) -> float:
            first, last = values
            return float(first * (last / first) ** max(0.0, min(progress, 1.0)))

        return Settings(
            temperature=now(self.temperature),
            width=now(self.width),
            margin=self.margin,
            share=self.share,
            step=now(self.step),
            jump=self.jump,
            join=self.join,
            near=near,
            together=self.together,
            exchange=self.exchange,
        )


def changed(name: str, default: Stage, given: Stage | Mapping[str, Any]) -> Stage:
    """The stage `given`, or the default one with what differs from it.

    Raises:
        InputError: a value is out of range, or there is no such condition.
    """
    if isinstance(given, Stage):
        return given
    with argument_of(name):
        for key in given:
            choice("condition", key, [field.name for field in fields(Stage)])
        return replace(default, **given)
