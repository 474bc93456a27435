"""Second places: poses on which several outliers of a tag agree, as the tag was moved or two tags have its id."""

from dataclasses import dataclass, replace

import numpy as np

from lmd.adjust.candidates import placed_tags
from lmd.adjust.corners import squared_errors
from lmd.adjust.estimate import Estimate
from lmd.adjust.noise import fitting
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between

# Minimum number of outliers, and minimum share of a tag's outliers, that agree on a second pose.
FEWEST_SIGHTINGS, LEAST_SHARE = 3, 0.5
APART_EDGES, TURNED_RAD = 0.2, 0.3  # least distance, in edges, and least rotation, rad, between two poses that differ
OUT_OF_ORDER_SHARE = 0.1  # maximum share of frames before and after a move that are out of order


@dataclass(frozen=True)
class SecondPlace:
    """Second pose of a tag."""

    tag: int
    """Index of the tag."""
    pose: FloatArray
    """`(4, 4)` pose, tag to world."""
    sightings: int
    """Number of sightings that agree with the second pose."""
    moved: int | None
    """Index of the frame from which the tag hangs at the later pose; None if frames show the tag at both poses in
    turns, which means that two tags have its id.
    """
    later: bool
    """True if the second pose is the later pose."""


def second_places(found: Estimate, gross: BoolArray) -> list[SecondPlace]:
    """Second poses of tags: poses on which several of the `gross` outliers, mask `(N,)`, agree."""
    counts = found.sightings.counts(gross)
    often = counts[found.sightings.tag] >= FEWEST_SIGHTINGS
    some = found.sightings.of(np.flatnonzero(gross & often))
    tags = placed_tags(some, found.poses, FEWEST_SIGHTINGS, LEAST_SHARE)
    agree = fitting(some, squared_errors(some, replace(found.poses, tags=tags)), found.floor)
    places = []
    for tag in np.unique(some.tag).tolist():
        there = some.frame[agree & (some.tag == tag)]
        if len(there) < max(FEWEST_SIGHTINGS, LEAST_SHARE * counts[tag]):
            continue
        here = found.sightings.frame[found.used & (found.sightings.tag == tag)]
        own = found.poses.tags[tag]
        away = np.linalg.norm(own[:3, 3] - tags[tag, :3, 3]) / found.sightings.edges[tag]
        if not here.size or (away < APART_EDGES and angle_between(own, tags[tag]) < TURNED_RAD):
            continue
        later = bool(np.median(there) > np.median(here))
        moved = _change(here, there) if later else _change(there, here)
        places.append(SecondPlace(tag, tags[tag], len(there), moved, later))
    return places


def _change(first: IntArray, second: IntArray) -> int | None:
    """Frame at which a tag was moved: the `first` frames come before this frame, the `second` frames after; None if
    first and second frames are mixed.
    """
    begins = int(np.quantile(second, OUT_OF_ORDER_SHARE / 2.0))
    mixed = (first >= begins).mean() > OUT_OF_ORDER_SHARE
    mixed |= np.intersect1d(first, second).size > OUT_OF_ORDER_SHARE * len(first)
    return None if mixed else begins
