"""A detector against what was predicted of it: pure functions of arrays.

N frames and K tags throughout; `predicted` and `detected` are `(N, K)` bool.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.detectors import Detections

# Numbers of tags in a frame that are asked for, n = 1, 2, 3, 4.
TAG_NUMBERS = np.arange(1, 5)
# A detection with a corner farther than this from the projection is not of the tag it claims to be, pixels.
CORNER_TOLERANCE = 5.0


@dataclass(frozen=True)
class Matches:
    """Which of K tags a detector found in one frame.

    Args:
        detected: `(K,)`.
        corners: as found, pixels, `(K, 4, 2)`; NaN where not detected.
        false: detections of no tag of the room, or of one that is elsewhere or turned otherwise.
    """

    detected: BoolArray
    corners: FloatArray
    false: int


def match(
    detections: Detections, ids: NDArray[np.int64], expected: FloatArray, tolerance: float = CORNER_TOLERANCE
) -> Matches:
    """Assign detections to tags by id and place; of several of one tag the nearest counts, the others are false.

    Args:
        detections: of one frame.
        ids: numbers of the K tags, all different, `(K,)`.
        expected: exact corners, pixels in the detections' convention and order, `(K, 4, 2)`; NaN is never matched.
        tolerance: largest distance of a corner, pixels.
    """
    corners = np.full((len(ids), 4, 2), np.nan)
    distance = np.full(len(ids), np.inf)
    index = {int(number): k for k, number in enumerate(ids)}
    for number, found in zip(detections.ids, detections.corners, strict=True):
        k = index.get(int(number))
        if k is None:
            continue
        off = float(np.linalg.norm(found - expected[k], axis=-1).max())
        if off <= tolerance and off < distance[k]:
            corners[k], distance[k] = found, off
    detected = np.isfinite(distance)
    return Matches(detected, corners, len(detections) - int(detected.sum()))


def precision_recall(
    predicted: BoolArray, detected: BoolArray, axis: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Precision and recall: the share of predicted tags that is detected, and the reverse; NaN where there are none.

    Args:
        predicted, detected: `(N, K)`.
        axis: None over all frames and tags, 0 for each tag `(K,)`, 1 for each frame `(N,)`.
    """
    both = (predicted & detected).sum(axis=axis)
    with np.errstate(invalid="ignore"):
        return np.asarray(both / predicted.sum(axis=axis)), np.asarray(both / detected.sum(axis=axis))


class Shares(NamedTuple):
    """Shares of frames and their standard errors, `(4,)` each, for n = 1, 2, 3, 4."""

    share: FloatArray
    error: FloatArray


def at_least(seen: BoolArray) -> Shares:
    """P(>= n): share of the frames that have at least n of the tags, with sqrt(p (1 - p) / N) as its error.

    Args:
        seen: predicted or detected, `(N, K)`.
    """
    share = (seen.sum(axis=1)[:, None] >= TAG_NUMBERS).mean(axis=0)
    return Shares(share, np.sqrt(share * (1.0 - share) / len(seen)))


def agreement(predicted: BoolArray, detected: BoolArray, n: int = 2) -> float:
    """Share of the frames in which prediction and detector agree whether there are at least n tags."""
    return float(((predicted.sum(axis=1) >= n) == (detected.sum(axis=1) >= n)).mean())


def corner_error(found: FloatArray, expected: FloatArray) -> FloatArray:
    """Root mean square distance, pixels, `(...)`, of four corners `(..., 4, 2)` from the true ones; NaN for none."""
    return np.asarray(np.sqrt(((found - expected) ** 2).sum(axis=-1).mean(axis=-1)))


def quantiles_by(value: FloatArray, error: FloatArray, bounds: ArrayLike, quantiles: Sequence[float]) -> FloatArray:
    """Quantiles of an error in B classes of another value, `(B, Q)`, as of corner errors by pitch; NaN for empty ones.

    Args:
        value, error: the same shape; pairs with a NaN are left out.
        bounds: of the classes, ascending, `(B + 1,)`; a class contains its lower bound.
        quantiles: Q of them.
    """
    edges = np.asarray(bounds, dtype=np.float64)
    known = np.isfinite(value) & np.isfinite(error)
    place = np.searchsorted(edges, value[known], side="right") - 1
    classes = [error[known][place == b] for b in range(len(edges) - 1)]
    empty = np.full(len(quantiles), np.nan)
    return np.array([np.quantile(c, quantiles) if len(c) else empty for c in classes])
