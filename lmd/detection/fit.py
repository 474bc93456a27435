"""Limits of a detector, fitted to views whose outcome is known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, InputError
from lmd.detection.evaluation import precision_recall
from lmd.detection.mosaic import Views
from lmd.sight.models.limits import Limits

RESAMPLES = 20  # for intervals
# Values to choose from; units as in `Limits`.
PITCHES, BLURS = np.linspace(0.0, 3.0, 31), np.linspace(0.0, 4.0, 41)
EDGES, INCIDENCES = np.linspace(0.0, 40.0, 41), np.linspace(60.0, 89.0, 30)


@dataclass(frozen=True)
class Fit:
    """Limits, and how well they predict the views that they were not fitted to."""

    limits: Limits
    accuracy: float
    precision: float
    recall: float


def fit(views: Views, rng: np.random.Generator, margin: float) -> Fit:
    """The limits with the fewest errors on one half of the views, measured on the other.

    What counts is the larger of the two kinds of error: views that are found though not predicted, and the other way
    round. So neither outweighs the other, and shares of views, such as P(>= n), come out without bias. Pairs of limits
    are improved in turn, (a, k) and (m, b), each over all of its values, until neither moves.

    Args:
        views: at least two.
        margin: of the limits, pixels; views lie wholly in the image, so they do not tell.

    Raises:
        InputError: there are fewer than two views, or the margin is negative.
    """
    if len(views) < 2:
        raise InputError(f"views must be at least 2, got {len(views)}.")
    order = rng.permutation(len(views))
    train, held_out = views[order[::2]], views[order[1::2]]
    limits = _best(train, margin)
    predicted = limits.found(held_out.pitch, held_out.incidence, held_out.edge, held_out.sigma)
    precision, recall = precision_recall(predicted, held_out.seen)
    return Fit(limits, float((predicted == held_out.seen).mean()), float(precision), float(recall))


def intervals(views: Views, rng: np.random.Generator, margin: float) -> dict[str, tuple[float, float]]:
    """In which nine of ten limits lie that are fitted to as many views, drawn from these with replacement, by name."""
    drawn = [_best(views[rng.integers(0, len(views), len(views))], margin) for _ in range(RESAMPLES)]
    rows = {name: [getattr(limits, name) for limits in drawn] for name in ("pitch", "blur", "edge", "incidence")}
    return {name: (float(np.quantile(row, 0.05)), float(np.quantile(row, 0.95))) for name, row in rows.items()}


def _best(views: Views, margin: float) -> Limits:
    """The better limits on `views` of two searches, one of which begins with the most accurate ones."""
    sharp = views.pitch >= np.hypot(PITCHES[:, None, None], BLURS[:, None] * views.sigma)  # (A, K, M)
    large = views.edge >= EDGES[:, None]  # (E, M)
    facing = views.incidence <= np.radians(INCIDENCES)[:, None]  # (B, M)

    def searched(*kinds: Callable[[BoolArray, BoolArray], NDArray[np.intp]]) -> tuple[int, tuple[int, int, int, int]]:
        """The least errors of the last kind, after those before, and where they are."""
        a, k, e, b, least = 0, 0, 0, len(facing) - 1, 0
        for errors in kinds:
            least = len(views) + 1
            while True:
                wrong = errors(sharp & (large[e] & facing[b]), views.seen)
                a, k = (int(i) for i in np.unravel_index(wrong.argmin(), wrong.shape))
                wrong = errors(large[:, None] & (facing & sharp[a, k]), views.seen)
                if wrong.min() >= least:
                    break
                least = int(wrong.min())
                e, b = (int(i) for i in np.unravel_index(wrong.argmin(), wrong.shape))
        return least, (a, k, e, b)

    _, (a, k, e, b) = min(searched(_all_errors, _larger_errors), searched(_larger_errors))
    chosen = PITCHES[a], BLURS[k], EDGES[e], INCIDENCES[b], margin
    return Limits(*map(float, chosen))


def _all_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """How many views are predicted wrongly, over the last axis."""
    return np.asarray((predicted != seen).sum(axis=-1))


def _larger_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """How many errors there are of the kind that there are more of."""
    return np.asarray(np.maximum((predicted & ~seen).sum(axis=-1), (~predicted & seen).sum(axis=-1)))
