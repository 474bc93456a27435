"""What does not fit: tags that were moved, hang twice, have another size than was told, or were misread.

The sightings of a tag that do not show it where it hangs (`Estimate.misfits`) either agree on another place, and then
the tag was moved or there are two with its number, or they do not, and then they were misread. A tag has another size
than was told if its sightings, with all frames fixed, agree on that.
"""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between, exp
from lmd.survey.estimate import ONE_THREAD, Estimate, adjusted, fitting
from lmd.survey.proposals import proposals
from lmd.survey.residuals import Poses, errors_at, linearise, summing
from lmd.survey.start import Placing, agreeing
from lmd.survey.student import RESIDUALS, solved, weight_of

# So many sightings, and so much of all that do not fit, make a second place.
FEWEST_SIGHTINGS, LEAST_SHARE = 3, 0.5
# The two places of a tag are so many of its edges apart, or turned so far from each other, rad.
APART_EDGES, TURNED_RAD = 0.2, 0.3
# Of the frames before and after a tag was moved, so much may be out of order.
OUT_OF_ORDER_SHARE = 0.1
# A size is another one if it differs by so much, is known so many times better, and if so many sightings then fit.
SIZE_DIFFERS, SIZE_SIGMAS, SIZE_SHARE = 0.02, 5.0, 0.5
SIZE_STEPS = 15


@dataclass(frozen=True)
class SecondPlace:
    """Where else a tag was seen.

    Args:
        tag: its index.
        pose: to the world, `(4, 4)`.
        sightings: how many show it there.
        moved: the frame from which on it hangs at the later of the two places; None if it is seen at both in turns, so
            that there are two such tags.
        later: whether the second place is the later one.
    """

    tag: int
    pose: FloatArray
    sightings: int
    moved: int | None
    later: bool


@dataclass(frozen=True)
class Faults:
    """What did not fit in a survey, tags by their index.

    Args:
        second_places: of tags that were moved or hang twice.
        sizes: the edges that tags have in place of those that were told, metres.
        misread: how many sightings show each tag at no place that it has, `(K,)`.
    """

    second_places: tuple[SecondPlace, ...]
    sizes: dict[int, float]
    misread: IntArray


def settled(found: Estimate) -> tuple[Estimate, Faults]:
    """An estimate without the faults that can be cured, and all of them.

    A tag with another size gets that size, and one that was moved hangs where it was seen last.
    """
    with threadpool_limits(limits=ONE_THREAD):
        return _settled(found)


def _settled(found: Estimate) -> tuple[Estimate, Faults]:
    sizes, poses = _sizes(found)
    if sizes:
        edges, group = found.sightings.edges.copy(), found.group.copy()
        edges[list(sizes)], group[list(sizes)] = list(sizes.values()), 0
        found = adjusted(replace(found.sightings, edges=edges), found.prior, poses, group, found.floor, found.inflation)
    error = errors_at(found.sightings, found.poses)
    gross = found.misfits & np.isfinite(error) & ~agreeing(found.sightings, error)
    places = _second_places(found, gross)
    last = [place for place in places if place.moved is not None and place.later]
    misread = np.bincount(found.sightings.tag[gross], minlength=len(found.group))
    for place in places:
        misread[place.tag] = max(misread[place.tag] - place.sightings, 0)
    if last:
        tags = found.poses.tags.copy()
        tags[[place.tag for place in last]] = [place.pose for place in last]
        found = adjusted(
            found.sightings, found.prior, replace(found.poses, tags=tags), found.group, found.floor, found.inflation
        )
    return found, Faults(tuple(places), sizes, misread)


def _views(poses: Poses) -> FloatArray:
    """The poses of the cameras in all frames, in the order of `Sightings.apart`, `(C F, 4, 4)`."""
    return np.asarray((poses.frames[None] @ poses.mounts[:, None]).reshape(-1, 4, 4))


def _second_places(found: Estimate, gross: BoolArray) -> list[SecondPlace]:
    """The tags that agreeing sightings, of those that are far off, `(N,)`, show at a second place."""
    counts = np.bincount(found.sightings.tag[gross], minlength=len(found.group))
    often = counts[found.sightings.tag] >= FEWEST_SIGHTINGS
    some = found.sightings.of(np.flatnonzero(gross & often)).apart()
    if not len(some):
        return []
    placing = Placing(some, proposals(some))
    placing.frames = _views(found.poses)
    placing.settle(np.arange(len(some)), by_frame=False, fewest=FEWEST_SIGHTINGS)
    agree = fitting(some, errors_at(some, placing.poses), found.floor)
    places = []
    for tag in np.unique(some.tag).tolist():
        there = some.frame[agree & (some.tag == tag)] % found.sightings.frames
        if len(there) < max(FEWEST_SIGHTINGS, LEAST_SHARE * counts[tag]):
            continue
        here = found.sightings.frame[found.used & (found.sightings.tag == tag)]
        own = found.poses.tags[tag]
        away = np.linalg.norm(own[:3, 3] - placing.tags[tag, :3, 3]) / found.sightings.edges[tag]
        if not here.size or (away < APART_EDGES and angle_between(own, placing.tags[tag]) < TURNED_RAD):
            continue
        later = bool(np.median(there) > np.median(here))
        moved = _change(here, there) if later else _change(there, here)
        places.append(SecondPlace(tag, placing.tags[tag], len(there), moved, later))
    return places


def _change(first: IntArray, second: IntArray) -> int | None:
    """The frame from which on the `second` frames follow the `first` ones; None if they are mixed."""
    begins = int(np.quantile(second, OUT_OF_ORDER_SHARE / 2.0))
    mixed = (first >= begins).mean() > OUT_OF_ORDER_SHARE or np.intersect1d(
        first, second
    ).size > OUT_OF_ORDER_SHARE * len(first)
    return None if mixed else begins


def _sizes(found: Estimate) -> tuple[dict[int, float], Poses]:
    """The edges of tags that have another one than was told, metres, and the poses with which they fit."""
    sightings = found.sightings
    known = np.isfinite(found.poses.frames[sightings.frame, 0, 0]) & (found.group[sightings.tag] <= 0)
    some = sightings.of(np.flatnonzero(known))
    tags, count = found.poses.tags.copy(), len(found.group)
    astray = np.bincount(sightings.tag[found.used], minlength=count) == 0
    lost = np.flatnonzero(astray[some.tag])
    if lost.size:
        unplaced = some.of(lost).apart()
        placing = Placing(unplaced, proposals(unplaced))
        placing.frames = _views(found.poses)
        placing.settle(np.arange(lost.size), by_frame=False, fewest=0, share=0.0)
        tags[astray] = placing.tags[astray]
    told, growth, summed = some.edges, np.zeros(count), summing(some.tag, count)
    for _ in range(SIZE_STEPS):
        scaled = replace(some, edges=told * np.exp(growth))
        at = linearise(scaled, tags[some.tag], found.poses.frames[some.frame], found.poses.mounts[some.camera])
        # A corner at s moves by s where the tag grows, and the way along the tag's axes is the second half of a twist.
        by_size = (at.by_tag[..., 3:].reshape(len(some), 4, 2, 3) @ scaled.corners[..., None]).reshape(-1, RESIDUALS, 1)
        slope = np.concatenate([at.by_tag, by_size], axis=-1)
        variance = some.noise**2 + found.floor**2
        weight = weight_of((at.error**2).sum(axis=1) / variance) / variance
        turned = np.swapaxes(slope, 1, 2) * weight[:, None, None]
        matrix = summed(turned @ slope) + np.diag([1e-6] * 6 + [1e-2])
        step = -solved(matrix, summed((turned @ at.error[..., None])[..., 0]))
        tags, growth = tags @ exp(step[:, :6]), growth + np.clip(step[:, 6], -0.2, 0.2)
    sigma = np.sqrt(np.linalg.inv(matrix)[:, 6, 6])
    other = (np.abs(growth) > SIZE_DIFFERS) & (np.abs(growth) > SIZE_SIGMAS * sigma)
    counts = np.bincount(some.tag, minlength=count)
    poses = replace(found.poses, tags=tags)
    fits = fitting(some, errors_at(replace(some, edges=told * np.exp(growth)), poses), found.floor)
    other &= (counts >= FEWEST_SIGHTINGS) & (np.bincount(some.tag, fits, minlength=count) >= SIZE_SHARE * counts)
    changed = np.flatnonzero(other)
    kept = found.poses.tags.copy()
    kept[changed] = tags[changed]
    sizes = {int(tag): float(told[tag] * np.exp(growth[tag])) for tag in changed}
    return sizes, replace(found.poses, tags=kept)
