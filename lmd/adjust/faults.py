"""Tags whose sightings disagree with the map: second poses, and wrong sizes.

*Second poses* are poses on which several outliers of a tag agree: the tag was moved, or two tags have its id.

*Sizes* follow from images that show two tags a and b, as the distance between the tags is constant. Let t_a and t_b be
the tags' centres in a camera's frame, computed with the stated edge lengths. Let s be the true edge length of b over
that of a, divided by the stated ratio. Then |s t_b - t_a| is constant over images from different places. The ratios of
all pairs give the size of each tag relative to most others.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from lmd.adjust.candidates import placed_tags, single_poses
from lmd.adjust.corners import Reprojection, agreeing, fitting, newton_step, squared_errors, student_weight, sums_by
from lmd.adjust.estimate import Estimate
from lmd.adjust.sightings import SQUARE, Observations, Sightings
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between, exp

# Minimum number of outliers, and minimum share of a tag's outliers, that agree on a second pose.
FEWEST_SIGHTINGS, LEAST_SHARE = 3, 0.5
APART_EDGES, TURNED_RAD = 0.2, 0.3  # least distance, in edges, and least rotation, rad, between two poses that differ
OUT_OF_ORDER_SHARE = 0.1  # maximum share of frames before and after a move that are out of order
RATIOS = np.geomspace(0.25, 4.0, 141)  # ratios of edges that are tested
FEWEST_TOGETHER = 4  # minimum number of images that show both tags of a pair
LEAST_SPREAD = 0.01  # scale of the robust loss of relative errors of distances
# A ratio is determined if its loss is smaller by `TOLD` than the losses `BESIDE` ratios away. The stated ratio is taken
# unless the loss of another ratio is smaller by `SURELY`.
BESIDE, TOLD, SURELY = 10, 2.0, 10.0
ODD = 0.1  # a tag is odd if the logarithm of its edge differs from that of most others by more than this
# A size is wrong if it differs from the estimated size by the share `DIFFERS` and by `SIGMAS` standard deviations, and
# if the share `FITS` of the sightings fits the estimated size.
DIFFERS, SIGMAS, FITS = 0.02, 5.0, 0.5
ROUNDS, STEPS = 3, 15  # estimates of sizes, each with the map of the previous estimate, and Gauss-Newton steps in each

Begun = TypeVar("Begun")


class SecondPlace(NamedTuple):
    """Second pose of a tag that was moved, or whose id another tag has as well."""

    tag: int
    """Index of the tag."""
    pose: FloatArray
    """`(4, 4)` pose, tag to world."""
    sightings: int
    """Number of sightings that agree with the second pose."""
    moved: int | None
    """Index of the first frame after the move; None if the frames alternate between the two poses, as two tags have the
    id.
    """
    later: bool
    """True if the second pose is the later pose."""


class Faults(NamedTuple):
    """Faults of tags in a map: moved tags, shared ids, wrong sizes, misread ids."""

    second_places: list[SecondPlace]
    """Second poses of tags that were moved or whose id two tags share."""
    sizes: dict[int, float]
    """Estimated edge lengths of the tags whose stated size is wrong, metres, keyed by id."""
    misread: IntArray
    """For each tag, number of sightings with its id that fit none of its poses, `(K,)`."""


def second_places(found: Estimate, gross: BoolArray) -> list[SecondPlace]:
    """Second poses of tags: poses on which several outliers of a tag agree. `gross` `(N,)` is the mask of the outliers
    to be considered.
    """
    every, counts, places = found.sightings, found.sightings.counts(gross), []
    some = every.of(np.flatnonzero(gross & (counts[every.tag] >= FEWEST_SIGHTINGS)))
    tags = placed_tags(some, found.poses, FEWEST_SIGHTINGS, LEAST_SHARE)
    agree = fitting(some, squared_errors(some, replace(found.poses, tags=tags)), found.floor)
    for tag in np.unique(some.tag).tolist():
        there = some.frame[agree & (some.tag == tag)]
        here, own = every.frame[found.used & (every.tag == tag)], found.poses.tags[tag]
        away = np.linalg.norm(own[:3, 3] - tags[tag, :3, 3]) / every.edges[tag]
        if not here.size or len(there) < max(FEWEST_SIGHTINGS, LEAST_SHARE * counts[tag]):
            continue
        if away < APART_EDGES and angle_between(own, tags[tag]) < TURNED_RAD:
            continue
        later = bool(np.median(there) > np.median(here))
        moved = _change(here, there) if later else _change(there, here)
        places.append(SecondPlace(tag, tags[tag], len(there), moved, later))
    return places


def _change(first: IntArray, second: IntArray) -> int | None:
    """Index of the first frame after a tag was moved; None if the frames alternate between its two poses. `first` has
    the indices of the frames that show the tag at the earlier pose, `second` of those that show it at the later pose.
    """
    begins = int(np.quantile(second, OUT_OF_ORDER_SHARE / 2.0))
    mixed = (first >= begins).mean() > OUT_OF_ORDER_SHARE
    mixed |= np.intersect1d(first, second).size > OUT_OF_ORDER_SHARE * len(first)
    return None if mixed else begins


def with_best_edges(
    seen: Observations, begun: Callable[[Observations], tuple[Begun, int]], plan: FloatArray | None = None
) -> tuple[Begun, BoolArray]:
    """Call `begun` with the stated edge lengths of tags and, if `odd_sizes` finds wrong ones, also with estimated
    lengths. Return the better of the two results.

    Args:
        seen: detections.
        begun: function that is called with detections and edge lengths (`Observations`). The function returns a result,
            such as rough poses, and the number of sightings that agree with it.
        plan: `(K, 3)` positions of the tags in a map, metres, NaN if unknown; None without a map.

    Returns:
        result with the estimated lengths if clearly more sightings agree with it, else with the stated lengths; mask of
        the tags whose size must be estimated from all frames, `(K,)`. With the stated lengths the mask is all False.
    """
    (found, agreed), (factors, odd) = begun(seen), odd_sizes(seen.through().with_separate_cameras(), plan)
    if odd.any():
        other, more = begun(replace(seen, edges=seen.edges * factors))
        if more > agreed + FEWEST_SIGHTINGS:
            return other, odd
    return found, np.zeros_like(odd)


def odd_sizes(sightings: Sightings, plan: FloatArray | None = None) -> tuple[FloatArray, BoolArray]:
    """Find tags whose stated edge length is grossly wrong.

    Args:
        sightings: sightings in which each camera is treated as a separate body, see `Sightings.with_separate_cameras`.
        plan: `(K, 3)` positions of the tags in a map, metres, NaN if unknown; None without a map.

    Returns:
        estimated factor on the stated edge length of each tag, `(K,)`; mask of the tags whose size must be estimated
        from all frames, `(K,)`. The mask has the tags with a factor other than 1. If there are any, it also has the
        tags whose size relative to other tags, or to the map, is unknown.
    """
    size, alone = _relative_sizes(sightings) if plan is None else _planned_sizes(sightings, plan)
    odd = np.abs(size) > ODD
    return np.where(odd, np.exp(size), 1.0), odd | (alone & odd.any())


def _together(sightings: Sightings) -> Iterator[tuple[int, int, FloatArray, FloatArray]]:
    """Iterate over the pairs of tags i < j that at least `FEWEST_TOGETHER` images show together. Yields i, j, and the
    centres of both tags in the camera frame of each of these n images, metres, `(n, 3)` each.
    """
    count, every = len(sightings.ids), np.arange(len(sightings))
    centres = single_poses(sightings).poses[:, 0, :3, 3]
    before = every - np.searchsorted(sightings.frame, sightings.frame)  # number of earlier sightings in the frame
    one = np.repeat(every, before)
    other = every[one] - 1 - (np.arange(len(one)) - np.searchsorted(one, one))
    swap = sightings.tag[one] > sightings.tag[other]
    a, b = np.where(swap, other, one), np.where(swap, one, other)
    key = sightings.tag[a] * count + sightings.tag[b]
    order = np.lexsort((other, one, key))
    keys, begins = np.unique(key[order], return_index=True)
    for pair, own in zip(keys.tolist(), np.split(order, begins)[1:], strict=True):
        if len(own) >= FEWEST_TOGETHER and pair // count != pair % count:
            yield *divmod(pair, count), centres[a[own]], centres[b[own]]


def _losses(one: FloatArray, two: FloatArray, expected: float | None) -> FloatArray:
    """Robust loss of n measured distances between two tags, `(...,)`. `one` and `two` `(..., n, 3)` are the measured
    centres of the tags. The distances are compared with the distance `expected`, or with their median if `expected` is
    None.
    """
    away = np.log(np.maximum(np.linalg.norm(two - one, axis=-1), 1e-9))
    off = away - (np.median(away, axis=-1, keepdims=True) if expected is None else np.log(expected))
    return np.asarray(np.log1p((off / LEAST_SPREAD) ** 2).sum(axis=-1))


def _planned_sizes(sightings: Sightings, plan: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Find the factors on edge lengths with which measured distances between tags fit the distances in a map best.

    For each pair of tags, a factor is tried on one tag alone and on both tags.

    Args:
        sightings: sightings of K tags.
        plan: positions of the tags in the map, metres, NaN if unknown, `(K, 3)`.

    Returns:
        logarithm of the factor on each tag's edge length, `(K,)`; mask of the tags that too few images show together
        with any other tag of the map, `(K,)`.
    """
    pairs = [pair for pair in _together(sightings) if np.isfinite(plan[[pair[0], pair[1]]]).all()]
    factors, alone = np.ones(len(plan)), np.ones(len(plan), dtype=bool)
    for _ in range(ROUNDS):
        losses = np.zeros((len(plan), len(RATIOS)))
        for i, j, one, two in pairs:
            one, two, away = factors[i] * one, factors[j] * two, float(np.linalg.norm(plan[j] - plan[i]))
            both = _losses(RATIOS[:, None, None] * one, RATIOS[:, None, None] * two, away)
            losses[i] += np.minimum(both, _losses(RATIOS[:, None, None] * one, two, away))
            losses[j] += np.minimum(both, _losses(one, RATIOS[:, None, None] * two, away))
            alone[[i, j]] = False
        surely = losses.min(axis=1) < losses[:, len(RATIOS) // 2] - SURELY
        factors = np.where(surely, factors * RATIOS[losses.argmin(axis=1)], factors)
    return np.log(factors), alone


def _relative_sizes(sightings: Sightings) -> tuple[FloatArray, BoolArray]:
    """Logarithm of the factor on each tag's edge length relative to most other tags, and mask of the tags for which
    this factor is unknown, `(K,)` each.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    count = len(sightings.ids)
    ratios, weights = np.zeros((2, count, count))
    for i, j, one, two in _together(sightings):
        cost = _losses(one, RATIOS[:, None, None] * two, None)
        stated, best = len(RATIOS) // 2, int(np.argmin(cost))
        best = best if cost[best] < cost[stated] - SURELY else stated
        beside = cost[[max(best - BESIDE, 0), min(best + BESIDE, len(RATIOS) - 1)]].min() - cost[best]
        ratios[i, j], ratios[j, i], weights[i, j] = np.log(RATIOS[best]), -np.log(RATIOS[best]), max(beside, 0.0)
    tree = minimum_spanning_tree(coo_array(np.where(weights > TOLD, 1.0 / np.maximum(weights, TOLD), 0.0)))
    size, (parts, labels) = np.zeros(count), connected_components(tree, directed=False)
    for part in range(parts):
        own = np.flatnonzero(labels == part)
        nodes, ahead = breadth_first_order(tree, own[0], directed=False)
        for node in nodes[1:]:
            size[node] = size[ahead[node]] + ratios[ahead[node], node]
        near = np.abs(size[own, None] - size[own]) < ODD
        size[own] -= np.median(size[own][near[np.argmax(near.sum(axis=1))]])
    return size, np.bincount(labels, minlength=count)[labels] == 1


def with_sizes(found: Estimate, odd: BoolArray, others: float, tried: bool) -> tuple[Estimate, BoolArray]:
    """Copy of the estimate in which the sizes of tags are unknowns of the refinement.

    Args:
        found: estimate with the stated sizes.
        odd: mask of the tags whose stated size is wrong or in doubt, `(K,)`.
        others: prior standard deviation of the growth (change of size) of the other tags, metres. If NaN, growth has
            the prior standard deviation of other deformations, see `Sightings.size_sigmas`.
        tried: True to search the other tags for wrong sizes first.

    Returns:
        the estimate; mask of the tags in `odd` and of the tags whose size proved to be wrong, `(K,)`.
    """
    for _ in range(ROUNDS if tried else 0):
        found, changed = resized(found, odd, np.ones_like(odd))
        if not changed.any():
            break
        odd = odd | changed
    some = found.sightings
    sigmas = np.where(odd, ODD / 2.0 * some.edges * np.linalg.norm(SQUARE), others)
    return replace(found, sightings=replace(some, size_sigmas=sigmas)), odd


def other_sizes(found: Estimate, odd: BoolArray) -> dict[int, float]:
    """Estimated edge lengths, metres, keyed by id, of those tags in the mask `odd` `(K,)` whose size differs by more
    than `DIFFERS` from the size that most tags agree on.
    """
    edges, ids = found.sightings.present_edges, found.sightings.ids
    differs = odd & (np.abs(edges / np.median(edges[~odd] if (~odd).any() else edges) - 1.0) > DIFFERS)
    return dict(zip(ids[differs].tolist(), edges[differs].tolist(), strict=True))


def resized(found: Estimate, odd: BoolArray, among: BoolArray) -> tuple[Estimate, BoolArray]:
    """Estimate with corrected edge lengths of wrongly sized tags, and mask of these tags, `(K,)`. The edge lengths are
    estimated from all frames.

    Args:
        found: estimate.
        odd: mask of the tags whose stated size is known to be wrong, `(K,)`; their edge lengths are corrected even if
            they differ little from the stated lengths.
        among: mask of the tags whose stated size may be wrong, `(K,)`.
    """
    every, tags, count = found.sightings, found.poses.tags.copy(), len(found.group)
    some = every.of(found.poses.known_frames[every.frame] & (found.group[every.tag] <= 0))
    astray = every.counts(found.used) == 0
    tags[astray] = placed_tags(some.of(astray[some.tag]), found.poses, fewest=0, share=0.0)[astray]
    growth, summed, variance = np.zeros(count), sums_by(some.tag, count), some.variance(found.floor)
    for _ in range(STEPS):
        grown = replace(some, edges=some.edges * np.exp(growth))
        at = Reprojection(grown, *replace(found.poses, tags=tags).of(some))
        weight = student_weight(at.squared / variance) / variance
        jacobian = np.concatenate([at.by_tag, at.by_size], axis=-1)
        step, matrix = newton_step(jacobian, at.error, weight, summed, np.diag([1e-6] * 6 + [1e-2]))
        tags, growth = tags @ exp(step[:, :6]), growth + np.clip(step[:, 6], -0.2, 0.2)
    grown = replace(some, edges=some.edges * np.exp(growth))
    fits = fitting(some, squared_errors(grown, replace(found.poses, tags=tags)), found.floor)
    sigma, counts = np.sqrt(np.linalg.inv(matrix)[:, 6, 6]), some.counts()
    differs = among & (odd | ((np.abs(growth) > DIFFERS) & (np.abs(growth) > SIGMAS * sigma)))
    differs &= (counts >= FEWEST_SIGHTINGS) & (some.counts(fits) >= FITS * counts)
    if not differs.any():
        return found, differs
    edges = np.where(differs, grown.edges, some.edges)
    other = replace(found, sightings=replace(every, edges=edges), group=np.where(differs, 0, found.group))
    return other.with_tags(differs, tags[differs]).adjusted(found.floor), differs


def without_faults(found: Estimate, odd: BoolArray) -> tuple[Estimate, Faults]:
    """Find the faults of all tags; return a corrected estimate and the faults. The estimate has corrected sizes, and
    the later poses of moved tags.

    Args:
        found: estimate.
        odd: mask of the tags whose size is an unknown of the estimate, `(K,)`.
    """
    found, changed = resized(found, np.zeros_like(odd), ~odd)
    edges = found.sightings.edges[changed].tolist()
    sizes = dict(zip(found.sightings.ids[changed].tolist(), edges, strict=True)) | other_sizes(found, odd)
    error = found.squares
    gross = found.misfits & np.isfinite(error) & ~agreeing(found.sightings, error)
    places, misread = second_places(found, gross), found.sightings.counts(gross)
    for place in places:
        misread[place.tag] = max(misread[place.tag] - place.sightings, 0)
    if last := [place for place in places if place.moved is not None and place.later]:
        moved = found.with_tags(np.array([place.tag for place in last]), np.stack([place.pose for place in last]))
        found = moved.adjusted(found.floor)
    return found, Faults(places, sizes, misread)
