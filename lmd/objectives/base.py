"""Objectives: the value of each position, the fitness computed from all values, and the names of objectives."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from lmd.core.checks import BoolArray, Checked, Count, FloatArray, InputError, Share
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator

if TYPE_CHECKING:
    from lmd.incremental.field import Field, Target
    from lmd.objectives.sampling import Sampling


@dataclass(frozen=True)
class Headline:
    """Label, unit and format with which displays show a figure (a metric).

    Args:
        key: name of the figure in mappings of figures.
        label: name in displays.
        scale: factor from the figure to the displayed unit.
        unit: unit, displayed after the number.
        form: format of the number, as in Python's format strings.
    """

    key: str
    label: str
    scale: float = 100.0
    unit: str = "%"
    form: str = ".2f"

    def text(self, value: float) -> str:
        """Formatted value, such as `81.88%`."""
        return f"{self.scale * value:{self.form}}{self.unit}"


# Labels that do not follow from the names of the figures.
LABELS = {
    "average_coverage_probability": "average probability", "maximum_coverage_probability": "maximum probability",
    "covered_share": "views of n tags or more", "pose_fixed_share": "pose determined",
    "position_bound_mm_per_pixel": "position bound, median", "attitude_bound_mrad_per_pixel": "attitude bound, median",
    "predicted_error_median": "predicted error, median", "predicted_error_90": "predicted error, 90% quantile",
    "lattice_bound": "bound on the lattice", "lattice_gap": "fitness below that bound",
    "lattice_found": "choice on the lattice, nothing hidden", "worst_drives": "filtered share of the worst drives",
    **{f"fitness_without_{n}_{of}": f"fitness without {n}, {of}" for n in ("one", "two") for of in ("worst", "mean")},
    "held_out_share": "share of the held-out time", "recorded_share": "share of the recorded time",
}  # fmt: skip
PREFIXES = {"grid_free_": "off the grid", "finer_grid_": "on a finer grid", "worst_crowd_": "worst crowds"}
# Scale, unit and format of figures whose names contain one of the keys; other figures are plain numbers.
UNITS = {
    "evaluations": (1.0, "", ",.0f"), "wall_time": (1.0, " s", ",.1f"), "predicted_error": (1e3, " mm", ".1f"),
    "mm_per_pixel": (1.0, " mm per pixel of noise", ".1f"), "mrad_per_pixel": (1.0, " mrad per pixel of noise", ".1f"),
    **dict.fromkeys(("share", "ratio", "probability", "fitness", "worst", "loss", "lattice"), (100.0, "%", ".2f")),
}  # fmt: skip


def figure_of(key: str) -> Headline:
    """Return the label, unit and format of the figure (metric) with the name `key`.

    For a figure without a label of its own, the label is the name with spaces instead of underscores.
    """
    prefixes = [prefix for prefix in PREFIXES if prefix in key]
    name = key.removeprefix("".join(prefixes))
    spelt = re.sub(r"localised share (\d+)mm", r"views localised to \1 mm", name.replace("_", " "))
    label = ", ".join([LABELS.get(name, spelt), *(PREFIXES[prefix] for prefix in reversed(prefixes))])
    return Headline(key, label, *next((unit for part, unit in UNITS.items() if part in key), (1.0, "", "g")))


def labelled_figures(figures: Mapping[str, float]) -> dict[str, str]:
    """Format figures (values of metrics) as texts with units, keyed by label."""
    return {figure.label: figure.text(figures[figure.key]) for figure in map(figure_of, figures)}


def with_error(figures: Mapping[str, float], key: str) -> str:
    """Format the figure `key`, a fraction, with its standard error, such as `85.32% +- 0.06%`.

    The error is left out if it is not in `figures`.
    """
    error = figures.get(f"{key}_standard_error")
    return f"{figures[key]:.2%}{'' if error is None else f' +- {error:.2%}'}"


class Selection(Protocol):
    """Interface of surrogates for greedy selection. A surrogate is a monotone submodular function that replaces an
    objective: it holds the landmarks chosen already, and returns the gain of a further landmark.
    """

    @property
    def label(self) -> str:
        """Name, in displays, of the quantity that the gains add up to."""

    def gains(self, poses: Deployment) -> FloatArray:
        """Gain of each pose, `(N,)`; the gain of a pose does not increase when further landmarks are chosen."""

    def add(self, pose: Deployment) -> None:
        """Add the landmark at `pose` to the chosen landmarks, on which later gains depend."""


class Objective(Protocol):
    """Interface of objectives, which value each position of the camera, and compute the fitness from all values.

    Black-box optimisers use only the members of this interface. The optimiser `annealing` also needs those of
    `Incremental`, and `greedy` those of `Selectable`.
    """

    @property
    def n(self) -> int:
        """Least number of landmarks that a useful view must show."""

    @property
    def sampling(self) -> "Sampling | None":
        """Sample of positions and orientations on which the fitness is computed; None for the room's grid and the
        orientations of the scene's PDF.
        """

    @property
    def headline(self) -> Headline:
        """Label, unit and format of the objective's main figure."""

    @property
    def name(self) -> str:
        """Settings as a short text for titles, such as `n=2 p=0.65`."""

    @property
    def value_label(self) -> str:
        """Meaning of a position's value in a few words, for the legend of a plot."""

    @property
    def threshold(self) -> float:
        """Least value of a qualified position."""

    def check(self, count: int) -> None:
        """Raise `InputError` if `count` landmarks are too few for the objective."""

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """Value in [0, 1] of each position of `evaluator`, `(B, P)`, for B deployments. The deployments' landmarks have
        `positions`, metres, and unit `normals`, `(B, K, 3)` each.
        """

    def qualified(self, values: FloatArray) -> BoolArray:
        """Mask, in the shape of `values`, of the qualified positions: those whose value reaches the threshold."""

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """Fitness in [0, 1], which optimisers maximise.

        `values` `(..., P)` are the values of P positions, and `relevance` `(P,)` are their weights. The result has the
        shape `(...)`.
        """

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray | BoolArray]:
        """Contributions of the positions to the figures (metrics) that are means over positions.

        The keys are the names of the figures. Each array has the shape of `values`, and its mean over the positions is
        the figure.
        """

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """Figures (metrics) of a deployment, computed from the values of the grid's positions and from their weights
        `relevance`, `(P,)` each.
        """

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """Sentences about the `figures` for the terminal, keyed by label. `positions` and `count` are the numbers of
        positions and of landmarks.
        """

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """Sentences for the terminal about the figures of `lmd.evaluation.validation`, keyed by label."""


@runtime_checkable
class Incremental(Protocol):
    """Interface of objectives whose values can be updated when a single landmark moves."""

    def field(self, evaluator: Evaluator) -> "Field":
        """Incremental evaluator (field) for the positions of `evaluator`.

        When a single landmark moves, the field updates the values of these positions.
        """

    def target(self, relevance: FloatArray) -> "Target":
        """Return the `Target`, a function that computes the fitness from the values of the field.

        `relevance` `(Q,)` has the weights of the field's Q positions, see `lmd.incremental.field.in_order`.
        """


@runtime_checkable
class Selectable(Protocol):
    """Interface of objectives with a surrogate for greedy selection."""

    def selection(self, evaluator: Evaluator, relevance: FloatArray) -> Selection:
        """Surrogate for greedy selection; no landmark is chosen yet."""


@runtime_checkable
class SelfValidating(Protocol):
    """Interface of objectives with their own validation away from the grid of positions.

    Other objectives are validated at random poses in the room.
    """

    def off_grid(self, evaluator: Evaluator, deployment: Deployment) -> dict[str, float]:
        """Figures (metrics) of a deployment at positions away from the room's grid.

        The names of the figures begin with `grid_free_`. The result is empty if the objective has no data for
        validation.
        """


def incremental(objective: Objective) -> Incremental:
    """Return the objective, after a check that it has a `field`, an incremental evaluator.

    Raises:
        InputError: the objective has no field.
    """
    if isinstance(objective, Incremental):
        return objective
    raise InputError(
        f"{type(objective).__name__} cannot evaluate moves of single landmarks; use a black-box optimiser such as ega.",
        "objective",
    )


def selectable(objective: Objective) -> Selectable:
    """Return the objective, after a check that it has a `selection`, a surrogate for greedy selection.

    Raises:
        InputError: the objective has no selection.
    """
    if isinstance(objective, Selectable):
        return objective
    raise InputError(f"{type(objective).__name__} has no `selection`, which greedy choices need.", "objective")


@dataclass(frozen=True)
class AtLeast(Checked):
    """Base of objectives that count landmarks seen at the same time.

    Args:
        n: least number of landmarks that the camera must see at the same time.
        thold_p: least value of a qualified position.

    Raises:
        InputError: n < 1 or thold_p outside [0, 1].
    """

    n: Count
    thold_p: Share

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
