"""Objectives: the value of each position, the fitness of all values, and their names."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, check_fields, integer, real
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator

if TYPE_CHECKING:
    from lmd.incremental.field import Field, Target
    from lmd.objectives.sampling import Sampling


@dataclass(frozen=True)
class Headline:
    """The main figure of an objective, as displays show it.

    Args:
        key: its name among the figures.
        label: its name for readers.
        scale: from the figure to the unit shown.
        unit: shown behind the number.
        limits: least and greatest value on axes, in the unit shown; None to fit the data.
    """

    key: str
    label: str
    scale: float = 100.0
    unit: str = "%"
    limits: tuple[float, float] | None = (0.0, 100.0)

    def text(self, value: float) -> str:
        """A value for readers, such as `81.88%`."""
        return f"{self.scale * value:.2f}{self.unit}"

    @property
    def axis(self) -> str:
        """The label of an axis."""
        return f"{self.label} [{self.unit}]"


class Selection(Protocol):
    """A monotone submodular surrogate of an objective: gains of further landmarks, given those chosen."""

    @property
    def label(self) -> str:
        """The quantity in words, for readers."""

    def gains(self, poses: Deployment) -> FloatArray:
        """Gain of each pose, `(N,)`; never greater than before others were chosen."""

    def add(self, pose: Deployment) -> None:
        """Choose one landmark more."""


class Objective(Protocol):
    """The purpose of a deployment.

    Every black box can maximise an objective with these members; `annealing` needs one that is `Incremental` too,
    `greedy` one that is `Selectable`.
    """

    @property
    def n(self) -> int:
        """Landmarks that a useful view has at the least."""

    @property
    def sampling(self) -> "Sampling | None":
        """Positions and orientations of the fitness; None for the room's grid and the PDF itself."""

    @property
    def headline(self) -> Headline:
        """The figure that displays show."""

    @property
    def name(self) -> str:
        """Its settings for titles, such as `n=2 p=0.65`."""

    @property
    def value_name(self) -> str:
        """Name of the value of a position, such as `P_2`."""

    @property
    def value_label(self) -> str:
        """Meaning of the value, for the legend of a picture."""

    @property
    def threshold(self) -> float:
        """The value from which on a position is qualified."""

    def check(self, count: int) -> None:
        """Raise `InputError` if `count` landmarks are too few for it."""

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """The value of each position of `evaluator`, in [0, 1], `(B, P)`, for B deployments `(B, K, 3)`."""

    def qualified(self, values: FloatArray) -> BoolArray:
        """Flags of positions that are good enough, in the shape of `values`."""

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """The fitness that optimisers maximise, in [0, 1]: `(..., P)` values, weights `(P,)` -> `(...)`."""

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray | BoolArray]:
        """The figures that are means over positions: contribution of each position, in the shape of `values`."""

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """All figures of a deployment from the values of the grid's positions and their relevance, `(P,)` each."""

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """The figures of a number of positions and landmarks, as labelled sentences for the terminal."""

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """The figures off the grid (`lmd.evaluation.validation`) as labelled sentences for the terminal."""


@runtime_checkable
class Incremental(Protocol):
    """Members of an objective whose values can be updated as single landmarks move."""

    def field(self, evaluator: Evaluator) -> "Field":
        """The values at the positions of `evaluator`, ready to be updated."""

    def target(self, relevance: FloatArray) -> "Target":
        """Target for the values of a field, with weights `(Q,)` in the order of its positions."""


@runtime_checkable
class Selectable(Protocol):
    """Members of an objective for which landmarks can be selected one after the other."""

    def selection(self, evaluator: Evaluator, relevance: FloatArray) -> Selection:
        """A surrogate for greedy selection, with no landmark chosen."""


def incremental(objective: Objective) -> Incremental:
    """The objective, which must have a field.

    Raises:
        InputError: it has none.
    """
    if isinstance(objective, Incremental):
        return objective
    raise InputError(
        f"{type(objective).__name__} has no field that single moves could update; use a black box such as ega.",
        "objective",
    )


def selectable(objective: Objective) -> Selectable:
    """The objective, which must have a selection.

    Raises:
        InputError: it has none.
    """
    if isinstance(objective, Selectable):
        return objective
    raise InputError(f"{type(objective).__name__} has no selection that landmarks could be chosen by.", "objective")


@dataclass(frozen=True)
class AtLeast:
    """Shared part of objectives that need n landmarks at the same time with a probability.

    Args:
        n: landmarks that the camera must see at the same time.
        thold_p: the value from which on a position is qualified.

    Raises:
        InputError: n < 1 or thold_p outside [0, 1].
    """

    n: int
    thold_p: float

    def __post_init__(self) -> None:
        check_fields(self, integer, "n", low=1)
        check_fields(self, real, "thold_p", low=0.0, high=1.0)

    @property
    def threshold(self) -> float:
        """See `Objective.threshold`."""
        return self.thold_p

    def check(self, count: int) -> None:
        """See `Objective.check`."""
        if self.n > count:
            raise InputError(f"n = {self.n} exceeds the number of landmarks, {count}.", "n")

    def qualified(self, values: FloatArray) -> BoolArray:
        """See `Objective.qualified`: the value is at least `thold_p` (Eq. Qual)."""
        return np.asarray(values >= self.thold_p - TOLERANCE)
