"""Limits of a detector, fitted to views whose outcome is known."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.detection.evaluation import precision_recall
from lmd.detection.mosaic import Placed, Views
from lmd.sight.models.limits import Limits

RESAMPLES = 20  # for intervals
BLOCKS = 20  # of time, in a recording
# Values to choose from; units as in `Limits`.
PITCHES, BLURS = np.linspace(0.0, 3.0, 31), np.linspace(0.0, 4.0, 41)
EDGES, INCIDENCES = np.linspace(0.0, 40.0, 41), np.linspace(40.0, 89.0, 50)
MARGINS = np.linspace(0.0, 150.0, 31)
CIRCLES = np.linspace(1.0, 0.4, 61)  # of the largest one that a view needs
# An image circle ends where of so many views beyond it, at least, no larger share is found.
FEWEST_BEYOND, FOUND_BEYOND = 20, 0.05

Errors = Callable[[BoolArray, BoolArray], NDArray[np.intp]]
Choice = tuple[int, ...]


@dataclass(frozen=True)
class Fit:
    """Limits, and how well they predict the views that they were not fitted to.

    Args:
        limits: of the detector.
        accuracy: share of right verdicts.
        precision, recall: of views that are predicted, the share found; of those found, the share predicted.
        circles: diameter of the image circle of each camera, pixels; infinite where the views tell of none. Empty for
            views of which it is not known where in an image they are.
    """

    limits: Limits
    accuracy: float
    precision: float
    recall: float
    circles: tuple[float, ...] = ()

    @property
    def known_circles(self) -> dict[int, float]:
        """The finite `circles`, by the number of the camera, from 1."""
        return {number: diameter for number, diameter in enumerate(self.circles, 1) if math.isfinite(diameter)}


def fit(views: Views, rng: np.random.Generator, margin: float) -> Fit:
    """The limits with the fewest errors on one half of the views, measured on the other.

    What counts for single views is the larger of the two kinds of error: views that are found though not predicted, and
    the other way round. So neither outweighs the other, and shares of views, such as P(>= n), come out without bias.
    The halves are drawn.

    Of a recording the halves are the first and the second one in time, as images that follow each other are alike. All
    errors count: some tags are missed for reasons that no limit knows, such as glare or someone in the way, and limits
    that make up for them would be wrong. There the margin and the image circles are fitted, too.

    Args:
        views: at least two; those of a recording at two times.
        margin: of the limits, pixels, and the least one where it is fitted; single views lie wholly in the image, so
            they do not tell.

    Raises:
        InputError: there are too few views, or the margin is negative.
    """
    if len(views) < 2:
        raise InputError(f"views must be at least 2, got {len(views)}.")
    if views.placed is None:
        order = rng.permutation(len(views))
        train, held_out = views[order[::2]], views[order[1::2]]
    else:
        moments = np.unique(views.placed.moment)
        if len(moments) < 2:
            raise InputError("views must be of images at two times at least, got one.")
        early = views.placed.moment < moments[len(moments) // 2]
        train, held_out = views[early], views[~early]
    limits, circles = _best(train, margin)
    predicted = foretold(held_out, limits, circles)
    precision, recall = precision_recall(predicted, held_out.seen)
    return Fit(limits, float((predicted == held_out.seen).mean()), float(precision), float(recall), circles)


def foretold(views: Views, limits: Limits, circles: tuple[float, ...]) -> BoolArray:
    """True for views that are predicted to be found, `(M,)`."""
    found = limits.found(views.pitch, views.incidence, views.edge, views.sigma)
    if (placed := views.placed) is None:
        return found
    return found & (placed.border >= limits.margin) & ~(placed.circle > np.array(circles)[placed.camera])


def intervals(views: Views, rng: np.random.Generator, margin: float) -> dict[str, tuple[float, float]]:
    """In which nine of ten limits lie that are fitted to as many views, drawn from these with replacement, by name.

    Of a recording, blocks of time are drawn.
    """
    drawn = [_best(views[_drawn(views, rng)], margin)[0] for _ in range(RESAMPLES)]
    names = ["pitch", "blur", "edge", "incidence", *([] if views.placed is None else ["margin"])]
    rows = {name: [getattr(limits, name) for limits in drawn] for name in names}
    return {name: (float(np.quantile(row, 0.05)), float(np.quantile(row, 0.95))) for name, row in rows.items()}


def _drawn(views: Views, rng: np.random.Generator) -> NDArray[np.intp]:
    """Some of the views, by their index."""
    if views.placed is None:
        return rng.integers(0, len(views), len(views))
    _, rank = np.unique(views.placed.moment, return_inverse=True)
    block = rank * BLOCKS // (rank.max() + 1)
    kinds = np.unique(block)
    return np.concatenate([np.flatnonzero(block == kind) for kind in rng.choice(kinds, len(kinds))])


def _best(views: Views, margin: float) -> tuple[Limits, tuple[float, ...]]:
    """The limits and image circles with the fewest errors on `views`.

    Limits that are chosen together are a group, whose table says which views meet each choice.
    """
    placed, margins, circles = views.placed, np.array([margin]), []
    sharp = views.pitch >= np.hypot(PITCHES[:, None, None], BLURS[:, None] * views.sigma)  # (A, K, M)
    facing = views.incidence <= np.radians(INCIDENCES)[:, None]  # (B, M)
    groups = [sharp, (views.edge >= EDGES[:, None, None]) & facing]  # (E, B, M)
    start: list[Choice] = [(0, 0), (0, len(facing) - 1)]
    if placed is None:
        # The better one of two searches, one of which begins with the most accurate limits.
        first, second = ((_all_errors, _larger_errors), (_larger_errors,))
        _, chosen = min(_searched(groups, start, views.seen, kinds) for kinds in (first, second))
    else:
        margins, circles = np.append(margins, MARGINS[margin < MARGINS]), _circles(views, placed)
        groups.append(placed.border >= margins[:, None])
        groups += [(placed.camera != c) | ~(placed.circle > own[:, None]) for c, own in enumerate(circles)]
        _, chosen = _searched(groups, [*start, *[(0,)] * (1 + len(circles))], views.seen, (_all_errors,))
    (a, k), (e, b), *rest = chosen
    m, *ends = [index for (index,) in rest] or [0]
    limits = Limits(*map(float, (PITCHES[a], BLURS[k], EDGES[e], INCIDENCES[b], margins[m])))
    return limits, tuple(float(own[end]) for own, end in zip(circles, ends, strict=True))


def _circles(views: Views, placed: Placed) -> list[FloatArray]:
    """Diameters to choose from, of the image circle of each camera, from the largest on; infinite for none."""
    each = []
    for camera in range(placed.camera.max() + 1):
        own = (placed.camera == camera) & np.isfinite(placed.circle)
        needed, found = placed.circle[own], views.seen[own]
        sizes = CIRCLES * needed.max(initial=0.0)
        beyond = needed > sizes[:, None]
        ends = (beyond.sum(axis=1) >= FEWEST_BEYOND) & (
            (beyond & found).sum(axis=1) <= FOUND_BEYOND * beyond.sum(axis=1)
        )
        each.append(np.append(np.inf, sizes[ends]))
    return each


def _searched(
    groups: list[BoolArray], start: list[Choice], seen: BoolArray, kinds: tuple[Errors, ...]
) -> tuple[int, list[Choice]]:
    """The least errors of the last kind, after those before, and the choice in each group.

    Groups are improved in turn, each over all of its choices, until none moves.
    """
    chosen, least = list(start), 0
    for errors in kinds:
        least, moved = len(seen) + 1, True
        while moved:
            moved = False
            for g, table in enumerate(groups):
                others = [other[at] for o, (other, at) in enumerate(zip(groups, chosen, strict=True)) if o != g]
                wrong = errors(table & np.logical_and.reduce(others), seen)
                if wrong.min() < least:
                    least, moved = int(wrong.min()), True
                    chosen[g] = tuple(int(i) for i in np.unravel_index(wrong.argmin(), wrong.shape))
    return least, chosen


def _all_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """How many views are predicted wrongly, over the last axis."""
    return np.asarray((predicted != seen).sum(axis=-1))


def _larger_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """max(false positives, false negatives), over the last axis."""
    return np.asarray(np.maximum((predicted & ~seen).sum(axis=-1), (~predicted & seen).sum(axis=-1)))
