"""Matching of detections to expected corners, and scores of predictions.

Arrays have N frames and K tags; `predicted` and `detected` are `(N, K)` bool.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.detectors import Detections

# Numbers of tags n in P(>= n).
TAG_NUMBERS = np.arange(1, 5)
# Largest distance of a detected corner from its projection, pixels; a detection farther away is false.
CORNER_TOLERANCE = 5.0


@dataclass(frozen=True)
class Matches:
    """Tags that a detector found in one frame `()`, or in N frames `(N,)`."""

    detected: BoolArray
    """True for tags detected with their id within the corner tolerance, `(..., K)`."""
    corners: FloatArray
    """Detected corners, pixels from the border, `(..., K, 4, 2)`; NaN for tags not detected."""
    false: IntArray
    """Number of detections that match no tag of the room by id and corners, `(...)`."""

    @classmethod
    def stacked(cls, frames: Sequence["Matches"]) -> Self:
        """Stack the matches of N single frames."""
        return cls(*(np.stack([getattr(one, field.name) for one in frames]) for field in fields(cls)))

    @classmethod
    def concatenated(cls, parts: Sequence["Matches"]) -> Self:
        """Concatenate matches along the frames."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @classmethod
    def beside(cls, parts: Sequence["Matches"]) -> Self:
        """Concatenate the matches of C cameras along the tags, `(N, C K)`."""
        detected = np.concatenate([part.detected for part in parts], axis=1)
        corners = np.concatenate([part.corners for part in parts], axis=1)
        return cls(detected, corners, np.sum([part.false for part in parts], axis=0))


def match(
    detections: Detections, ids: NDArray[np.int64], expected: FloatArray, tolerance: float = CORNER_TOLERANCE
) -> Matches:
    """Assign the detections of one frame to tags by id and corners.

    Of several detections of one tag, the detection nearest to the tag is assigned; the others are false.

    Args:
        detections: detections of the frame.
        ids: ids of the K tags, all different, `(K,)`.
        expected: exact corners, convention and order as in `Detections`, pixels, `(K, 4, 2)`; NaN is never matched.
        tolerance: largest distance between detected and exact corner, pixels.
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
    return Matches(detected, corners, np.asarray(len(detections) - int(detected.sum())))


def precision_recall(
    predicted: BoolArray, detected: BoolArray, axis: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Precision and recall: share of predicted tags that are detected, and share of detected tags that are predicted;
    NaN without such tags.

    Args:
        predicted, detected: `(N, K)`.
        axis: None over all frames and tags, 0 for each tag `(K,)`, 1 for each frame `(N,)`.
    """
    both = (predicted & detected).sum(axis=axis)
    with np.errstate(invalid="ignore"):
        return np.asarray(both / predicted.sum(axis=axis)), np.asarray(both / detected.sum(axis=axis))


class Shares(NamedTuple):
    """Shares of frames with at least n = 1, 2, 3, 4 tags."""

    share: FloatArray
    """Share p = P(>= n) of frames with at least n tags, `(4,)`."""
    error: FloatArray
    """Standard errors sqrt(p (1 - p) / N), `(4,)`."""


def shares_of_frames(seen: BoolArray) -> Shares:
    """Shares of the frames with at least n tags.

    Args:
        seen: predicted or detected, `(N, K)`.
    """
    share = (seen.sum(axis=1)[:, None] >= TAG_NUMBERS).mean(axis=0)
    return Shares(share, np.sqrt(share * (1.0 - share) / len(seen)))


def agreement(predicted: BoolArray, detected: BoolArray, n: int = 2) -> float:
    """Share of the frames in which prediction and detection agree on whether there are at least n tags."""
    return float(((predicted.sum(axis=1) >= n) == (detected.sum(axis=1) >= n)).mean())


def corner_error(found: FloatArray, expected: FloatArray) -> FloatArray:
    """Root mean square distance of four corners from the exact corners, `(..., 4, 2)` each, pixels, `(...)`."""
    return np.asarray(np.sqrt(((found - expected) ** 2).sum(axis=-1).mean(axis=-1)))


def quantiles_by(value: FloatArray, error: FloatArray, bounds: ArrayLike, quantiles: Sequence[float]) -> FloatArray:
    """Quantiles of an error in B classes of another value, `(B, Q)`; NaN for empty classes.

    Args:
        value, error: arrays of one shape; pairs with a NaN are left out.
        bounds: bounds of the classes, ascending, `(B + 1,)`; a class contains its lower bound.
        quantiles: Q probabilities.
    """
    edges = np.asarray(bounds, dtype=np.float64)
    known = np.isfinite(value) & np.isfinite(error)
    place = np.searchsorted(edges, value[known], side="right") - 1
    classes = [error[known][place == b] for b in range(len(edges) - 1)]
    empty = np.full(len(quantiles), np.nan)
    return np.array([np.quantile(c, quantiles) if len(c) else empty for c in classes])
