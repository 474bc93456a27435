"""The frames of a video that a map is made from.

What corners are off by is alike in frames that follow each other closely: on recordings, five frames a second make as
good a map as all. Those that are kept are even in time, and must not depend on how tags move or how many are in view:
blurred and oblique images would then count more than others, and maps differ by more than is stated.

- *Connections*: a frame is kept, too, if it alone shows a tag, or two tags together.
- *Motion* links frames as before: those that are kept are near enough in time, and close to a moment at which all tags
  in view change, which motion alone connects, all frames are kept.

Frames without times are all kept.
"""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.formats.detections import DetectedTags
from lmd.survey.motion import SHORTEST_GAP, seconds_of

LONGEST = 0.21  # seconds between frames that are kept, where others lie between: five a second, whose times jitter


def thinned(detected: DetectedTags, every: int | None = None) -> DetectedTags:
    """The detections in some of the frames; the others are `left_out`.

    Args:
        every: of the frames with tags, the first and each `every`-th after it is kept; None for those that add to the
            others.
    """
    order = np.argsort(detected.frame, kind="stable")
    frames, begins = np.unique(detected.frame[order], return_index=True)
    if every is None:
        shown = [np.unique(detected.ids[own]) for own in np.split(order, begins[1:])]
        chosen = _adding(seconds_of(detected.times)[frames], shown)
    else:
        chosen = np.arange(len(frames)) % every == 0
    out = np.isin(np.arange(len(detected.times)), frames[~chosen])
    names = tuple(detected.times[frame] for frame in np.flatnonzero(out).tolist())
    some = detected.of(np.flatnonzero(~out[detected.frame]))
    return replace(some, taken=detected.images & ~out[:, None], left_out=names) if names else detected


def _adding(seconds: FloatArray, shown: list[IntArray]) -> BoolArray:
    """True for frames that add to the others, `(n,)`, by their times and the tags that each shows."""
    kept = _evenly(seconds, _changing(seconds, shown))
    together = [set(combinations_with_replacement(tags.tolist(), 2)) for tags in shown]
    connected = set().union(*(together[k] for k in np.flatnonzero(kept)))
    for k in np.flatnonzero(~kept):
        if not together[k] <= connected:
            kept[k] = True
            connected |= together[k]
    return kept


def _evenly(seconds: FloatArray, needed: BoolArray) -> BoolArray:
    """Few of the frames, the `needed` ones among them, no two further apart than `LONGEST` that others lie between."""
    kept, since = np.ones(len(seconds), dtype=bool), np.nan
    for k, following in enumerate(np.append(seconds[1:], np.inf)):
        if not needed[k] and following - since <= LONGEST:
            kept[k] = False
        else:
            since = seconds[k]
    return kept


def _changing(seconds: FloatArray, shown: list[IntArray]) -> BoolArray:
    """True for frames close to a moment at which all tags in view change, `(n,)`."""
    at = np.array([k for k in range(len(shown) - 1) if not np.intersect1d(shown[k], shown[k + 1]).size], dtype=int)
    moments = np.sort(np.concatenate([seconds[at], seconds[at + 1]]))
    first = np.searchsorted(moments, seconds - SHORTEST_GAP)
    return np.asarray(first < np.searchsorted(moments, seconds + SHORTEST_GAP, side="right"))
