"""Keyframes: the frames of a video from which a map is made.

Corner errors are correlated in consecutive images. In tests on recordings, a map from five frames per second was as
good as a map from all frames. Keyframes are evenly spaced in time. The selection must not depend on the motion or on
the number of tags in view. Otherwise blurred or oblique images would have more weight than other images, and maps would
differ by more than their stated errors.

Two further kinds of frames are kept:

- a frame that is the only one to show a tag, or to show two tags together, as it connects the map.
- frames close to a moment at which all tags in view change, as only motion connects the tags before and after.

Frames without times are all kept.
"""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from lmd.adjust.motion import SHORTEST_GAP, seconds_of
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.formats.detections import DetectedTags

LONGEST = 0.21  # maximum seconds between keyframes that have frames between them: five keyframes a second, with jitter


def select_keyframes(detected: DetectedTags, every: int | None = None) -> DetectedTags:
    """Select the detections in the keyframes; `left_out` of the result lists the other frames.

    Args:
        detected: detections in all frames.
        every: n to keep every n-th frame with tags, from the first frame. None to keep about five frames per second,
            and the frames that connect the map.
    """
    order = np.argsort(detected.frame, kind="stable")
    frames, begins = np.unique(detected.frame[order], return_index=True)
    if every is None:
        shown = [np.unique(detected.ids[own]) for own in np.split(order, begins[1:])]
        chosen = _informative(seconds_of(detected.times)[frames], shown)
    else:
        chosen = np.arange(len(frames)) % every == 0
    out = np.isin(np.arange(len(detected.times)), frames[~chosen])
    names = tuple(detected.times[frame] for frame in np.flatnonzero(out).tolist())
    some = detected.of(np.flatnonzero(~out[detected.frame]))
    return replace(some, taken=detected.images & ~out[:, None], left_out=names) if names else detected


def _informative(seconds: FloatArray, shown: list[IntArray]) -> BoolArray:
    """Mask of the keyframes (frames from which a map is made) among n frames, `(n,)`. `seconds` `(n,)` has the times of
    the frames; `shown` has an array for each frame, with the ids of the tags that it shows.
    """
    kept = _evenly(seconds, _at_changes(seconds, shown))
    together = [set(combinations_with_replacement(tags.tolist(), 2)) for tags in shown]
    connected = set().union(*(together[k] for k in np.flatnonzero(kept)))
    for k in np.flatnonzero(~kept):
        if not together[k] <= connected:
            kept[k] = True
            connected |= together[k]
    return kept


def _evenly(seconds: FloatArray, needed: BoolArray) -> BoolArray:
    """Mask of the keyframes among n frames, `(n,)`: the `needed` frames, and few others. Frames are added such that
    neighbouring keyframes are at most `LONGEST` seconds apart, where the video has frames in between.
    """
    kept, since = np.ones(len(seconds), dtype=bool), np.nan
    for k, following in enumerate(np.append(seconds[1:], np.inf)):
        if not needed[k] and following - since <= LONGEST:
            kept[k] = False
        else:
            since = seconds[k]
    return kept


def _at_changes(seconds: FloatArray, shown: list[IntArray]) -> BoolArray:
    """Mask of the frames that are close in time to a change of all tags in view, `(n,)`. At such a change, two
    successive frames show no common tag.
    """
    at = np.array([k for k in range(len(shown) - 1) if not np.intersect1d(shown[k], shown[k + 1]).size], dtype=int)
    moments = np.sort(np.concatenate([seconds[at], seconds[at + 1]]))
    first = np.searchsorted(moments, seconds - SHORTEST_GAP)
    return np.asarray(first < np.searchsorted(moments, seconds + SHORTEST_GAP, side="right"))
