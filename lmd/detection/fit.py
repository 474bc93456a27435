"""A criterion that predicts a detector, and its fit to views whose outcome is known."""

import math
from dataclasses import dataclass, field

import numpy as np

from lmd.checks import BoolArray, FloatArray, InputError, real
from lmd.detection.evaluation import precision_recall
from lmd.detection.mosaic import Views


@dataclass(frozen=True)
class Limits:
    """What a tag must be like for a detector to find it.

    It is found if its incidence is at most b, its pitch at least sqrt(a^2 + (k sigma)^2) and its area-equivalent
    edge at least m; see `lmd.detection.quality`.

    Args:
        pitch: a, pixels a module in a sharp image.
        blur: k, pixels a module for each pixel of sigma.
        edge: m, pixels.
        incidence: b, rad.

    Raises:
        InputError: a value is out of range.
    """

    pitch: float
    blur: float
    edge: float
    incidence: float

    def __post_init__(self) -> None:
        for name in ("pitch", "blur", "edge"):
            object.__setattr__(self, name, real(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "incidence", real("incidence", self.incidence, low=0.0, high=math.pi / 2.0))

    def found(self, pitch: FloatArray, incidence: FloatArray, edge: FloatArray, sigma: FloatArray) -> BoolArray:
        """Whether views are found, arrays of one shape; NaN (behind the camera) is not."""
        least = np.hypot(self.pitch, self.blur * sigma)
        return np.asarray((pitch >= least) & (edge >= self.edge) & (incidence <= self.incidence))


@dataclass(frozen=True)
class Grid:
    """Values among which `fit` chooses; units as in `Limits`."""

    pitch: FloatArray = field(default_factory=lambda: np.linspace(0.0, 3.0, 31))
    blur: FloatArray = field(default_factory=lambda: np.linspace(0.0, 4.0, 41))
    edge: FloatArray = field(default_factory=lambda: np.linspace(0.0, 40.0, 41))
    incidence: FloatArray = field(default_factory=lambda: np.radians(np.linspace(60.0, 90.0, 31)))


@dataclass(frozen=True)
class Fit:
    """Limits, and how well they predict the views that they were not fitted to."""

    limits: Limits
    accuracy: float
    precision: float
    recall: float


def fit(views: Views, rng: np.random.Generator, grid: Grid | None = None) -> Fit:
    """The limits with the highest accuracy on one half of the views, measured on the other.

    Pairs of limits are improved in turn, (a, k) and (m, b), each over its whole grid, until neither moves.

    Args:
        views: at least two.
        rng: splits them.
        grid: values to choose from; None for the defaults.

    Raises:
        InputError: there are fewer than two views.
    """
    if len(views) < 2:
        raise InputError(f"views must be at least 2, got {len(views)}.")
    order = rng.permutation(len(views))
    train, held_out = views[order[::2]], views[order[1::2]]
    limits = _best(train, grid or Grid())
    predicted = limits.found(held_out.pitch, held_out.incidence, held_out.edge, held_out.sigma)
    precision, recall = precision_recall(predicted, held_out.seen)
    return Fit(limits, float((predicted == held_out.seen).mean()), float(precision), float(recall))


def _best(views: Views, grid: Grid) -> Limits:
    """The most accurate limits on `views` that alternating searches reach."""
    sharp = views.pitch >= np.hypot(grid.pitch[:, None, None], grid.blur[:, None] * views.sigma)  # (A, K, M)
    large = views.edge >= grid.edge[:, None]  # (E, M)
    facing = views.incidence <= grid.incidence[:, None]  # (B, M)
    e, b, best = 0, len(facing) - 1, -1
    while True:
        right = (sharp & (large[e] & facing[b]) == views.seen).sum(axis=-1)
        a, k = np.unravel_index(right.argmax(), right.shape)
        right = (large[:, None] & (facing & sharp[a, k]) == views.seen).sum(axis=-1)
        if right.max() <= best:
            return Limits(*(float(v) for v in (grid.pitch[a], grid.blur[k], grid.edge[e], grid.incidence[b])))
        best = int(right.max())
        e, b = (int(i) for i in np.unravel_index(right.argmax(), right.shape))
