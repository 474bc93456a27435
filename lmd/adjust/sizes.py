"""Sizes: tags whose edge is another one than stated, by tags that images show together.

The distance of two tags is constant. If s is the ratio of the edges of tag b and tag a over the stated ratio, and t_a
and t_b are their centres in a camera by their stated edges, |s t_b - t_a| is constant over images from different
places. The ratios of all pairs give the size of each tag relative to most others.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lmd.adjust.candidates import placed_tags
from lmd.adjust.corners import Poses, Reprojection, normal_equations, squared_errors, student_weight, sums_by
from lmd.adjust.estimate import Estimate
from lmd.adjust.frames import solved
from lmd.adjust.noise import fitting
from lmd.adjust.second_places import FEWEST_SIGHTINGS
from lmd.adjust.sightings import SQUARE, Sightings
from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.se3 import exp

RATIOS = np.geomspace(0.25, 4.0, 141)  # ratios of edges that are tried
FEWEST_TOGETHER = 4  # minimum number of images that show two tags
LEAST_SPREAD = 0.01  # scale of the robust loss of relative errors of distances
# A ratio is told if its loss is smaller by `TOLD` than `BESIDE` ratios beside it. It is the stated one unless the loss
# of another is smaller by `SURELY`.
BESIDE, TOLD, SURELY = 10, 2.0, 10.0
ODD = 0.1  # difference of logarithms of edges from most others beyond which a tag is odd
# A size is wrong if it differs from the estimated size by the share `DIFFERS` and by `SIGMAS` standard deviations, and
# if the share `FITS` of the sightings fits the estimated size.
DIFFERS, SIGMAS, FITS = 0.02, 5.0, 0.5
ROUNDS, STEPS = 3, 15  # estimates of sizes, each with the map of the estimate before, and Gauss-Newton steps in each


def odd_sizes(sightings: Sightings, single: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Factor on the stated edge of each tag, `(K,)`, and mask of the tags whose size must be estimated, `(K,)`: those
    with a factor other than 1 and, if there are any, those that no image tells.

    Args:
        sightings: sightings in which each camera is a body of its own.
        single: better pose of the tag of each sighting in its camera, `(N, 4, 4)`.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    count, some = len(sightings.ids), sightings
    first = np.searchsorted(some.frame, some.frame)
    one = np.repeat(np.arange(len(some)), np.arange(len(some)) - first)
    other = np.arange(len(one)) - np.repeat(np.cumsum(np.arange(len(some)) - first), np.arange(len(some)) - first)
    other += np.repeat(np.arange(len(some)), np.arange(len(some)) - first)
    swap = some.tag[one] > some.tag[other]
    a, b = np.where(swap, other, one), np.where(swap, one, other)
    key = some.tag[a] * count + some.tag[b]
    order = np.argsort(key, kind="stable")
    keys, begins, together = np.unique(key[order], return_index=True, return_counts=True)
    ratios, weights = np.zeros((2, count, count))
    for pair, begin, number in zip(keys, begins, together, strict=True):
        i, j = divmod(int(pair), count)
        if number < FEWEST_TOGETHER or i == j:
            continue
        own = order[begin : begin + number]
        ways = RATIOS[:, None, None] * single[b[own], :3, 3] - single[a[own], :3, 3]
        away = np.log(np.maximum(np.linalg.norm(ways, axis=2), 1e-9))
        off = away - np.median(away, axis=1, keepdims=True)
        cost = np.log1p((off / LEAST_SPREAD) ** 2).sum(axis=1)
        stated, best = len(RATIOS) // 2, int(np.argmin(cost))
        best = best if cost[best] < cost[stated] - SURELY else stated
        beside = cost[[max(best - BESIDE, 0), min(best + BESIDE, len(RATIOS) - 1)]].min() - cost[best]
        ratios[i, j], ratios[j, i], weights[i, j] = np.log(RATIOS[best]), -np.log(RATIOS[best]), max(beside, 0.0)
    strong = weights > TOLD
    tree = minimum_spanning_tree(coo_array(np.where(strong, 1.0 / np.maximum(weights, TOLD), 0.0)))
    size = np.zeros(count)
    for part in range((labels := connected_components(tree, directed=False)[1]).max() + 1):
        own = np.flatnonzero(labels == part)
        nodes, before = breadth_first_order(tree, own[0], directed=False)
        for node in nodes[1:]:
            size[node] = size[before[node]] + ratios[before[node], node]
        near = np.abs(size[own, None] - size[own]) < ODD
        size[own] -= np.median(size[own][near[np.argmax(near.sum(axis=1))]])
    odd = np.abs(size) > ODD
    alone = np.bincount(labels, minlength=count)[labels] == 1
    return np.where(odd, np.exp(size), 1.0), odd | (alone & odd.any())


def with_sizes(found: Estimate, odd: BoolArray, others: float, tried: bool) -> tuple[Estimate, BoolArray]:
    """Estimate with the sizes of some tags, which are unknowns of a refinement from there on, and the mask of the tags
    with another size, `(K,)`.

    Args:
        found: estimate with the stated sizes.
        odd: mask of the tags that are known to have another size, `(K,)`.
        others: standard deviation of the other tags, see `Sightings.size_sigmas`.
        tried: True if further tags may have another size.
    """
    for _ in range(ROUNDS if tried else 0):
        sizes, poses = estimated_sizes(found, odd)
        if not sizes:
            break
        found, odd = resized(found, sizes, poses), odd | np.isin(np.arange(len(odd)), list(sizes))
    some = found.sightings
    sigmas = np.where(odd, ODD / 2.0 * some.edges * np.linalg.norm(SQUARE), others)
    return replace(found, sightings=replace(some, size_sigmas=sigmas)), odd


def other_sizes(found: Estimate, odd: BoolArray) -> dict[int, float]:
    """Edges of the tags `odd` `(K,)` that differ from those of most others by `DIFFERS`, metres, by index."""
    edges = found.sightings.present_edges
    differs = odd & (np.abs(edges / np.median(edges[~odd] if (~odd).any() else edges) - 1.0) > DIFFERS)
    return {int(tag): float(edges[tag]) for tag in np.flatnonzero(differs)}


def resized(found: Estimate, sizes: Mapping[int, float], poses: Poses) -> Estimate:
    """Estimate with other edges of some tags by index, metres, adjusted from `poses`."""
    edges, group = found.sightings.edges.copy(), found.group.copy()
    edges[list(sizes)], group[list(sizes)] = list(sizes.values()), 0
    return replace(found, sightings=replace(found.sightings, edges=edges), group=group).adjusted(poses)


def estimated_sizes(found: Estimate, odd: BoolArray) -> tuple[dict[int, float], Poses]:
    """Edges of tags with a wrong size, metres, by index, and poses that fit these edges, with all frames fixed.

    Args:
        found: estimate.
        odd: mask of the tags that are known to have another size, which are always estimated, `(K,)`.
    """
    sightings = found.sightings
    known = np.isfinite(found.poses.frames[sightings.frame, 0, 0]) & (found.group[sightings.tag] <= 0)
    some = sightings.of(np.flatnonzero(known))
    tags, count = found.poses.tags.copy(), len(found.group)
    astray = sightings.counts(found.used) == 0
    lost = np.flatnonzero(astray[some.tag])
    tags[astray] = placed_tags(some.of(lost), found.poses, fewest=0, share=0.0)[astray]
    edges, growth, summed = some.edges, np.zeros(count), sums_by(some.tag, count)
    for _ in range(STEPS):
        at = Reprojection(some.grown(growth), *found.poses.with_tags(tags).of(some))
        variance = some.variance(found.floor)
        weight = student_weight(at.squared / variance) / variance
        jacobian = np.concatenate([at.by_tag, at.by_size], axis=-1)
        matrix, right = normal_equations(jacobian, at.error, weight, summed)
        matrix += np.diag([1e-6] * 6 + [1e-2])
        step = -solved(matrix, right)
        tags, growth = tags @ exp(step[:, :6]), growth + np.clip(step[:, 6], -0.2, 0.2)
    sigma = np.sqrt(np.linalg.inv(matrix)[:, 6, 6])
    differs = odd | ((np.abs(growth) > DIFFERS) & (np.abs(growth) > SIGMAS * sigma))
    error = squared_errors(some.grown(growth), found.poses.with_tags(tags))
    counts = some.counts()
    differs &= (counts >= FEWEST_SIGHTINGS) & (some.counts(fitting(some, error, found.floor)) >= FITS * counts)
    changed = np.flatnonzero(differs)
    kept = found.poses.tags.copy()
    kept[changed] = tags[changed]
    return {int(tag): float(edges[tag] * np.exp(growth[tag])) for tag in changed}, found.poses.with_tags(kept)
