"""Groups of tags that no image connects, joined by the motion of the body between the frames of the groups.

1. Tags that several images show together form a part. Each other tag is a part by itself, as an id that was misread in
   one image would connect distant tags.
2. A frame that shows one tag of a part has two possible poses relative to the part, which look alike (IPPE). The
   smoothest sequence of such poses is found for each part (Viterbi).
3. Each part is adjusted by itself, with links between its own frames, which also estimates the spread of the motion.
4. Two frames of different parts that are near in time give a relation, the relative pose of the parts. Relations on
   which most frames agree join parts first (maximum spanning tree).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.candidates import agreeing
from lmd.adjust.corners import Poses, squared_errors
from lmd.adjust.estimate import FLOOR_PIXELS, Estimate
from lmd.adjust.motion import LONGEST_GAP, Motion, with_bridged_gaps
from lmd.adjust.mounts import Mounts
from lmd.adjust.prior import EXACT_SIGMA, Prior
from lmd.adjust.sequence import Nodes, smoothest
from lmd.adjust.sightings import Sightings
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse, log, median_pose, skew

TOGETHER = 3  # minimum number of agreeing images that put two tags into one part
# Maximum number of following frames with which a frame gives relations, and of pairs of frames for each relation.
FOLLOWING, PAIRS = 12, 40
AGREE_TURN, AGREE_PLACE = 0.2, 0.3  # maximum deviation of a pair of frames from a relation, rad and metres
# A body leaps if, from a frame to one of the next `LEAP_FOLLOWING` frames, it moves farther than `LEAP`, metres, plus
# `LEAP_SPEEDS` times the distance at its highest speed. `FASTEST`, m/s, replaces an unknown highest speed.
LEAP, LEAP_SPEEDS, FASTEST, LEAP_FOLLOWING = 0.5, 2.0, 2.0, 3
STEPS = 12  # steps of the bundle adjustment of parts
NEAREST = 6  # number of tags of other groups relative to which the covariance of a tag is computed


class Relation(NamedTuple):
    """Relative pose of two parts."""

    one: int
    """Index of a part."""
    other: int
    """Index of another part."""
    way: FloatArray
    """`(4, 4)` motion from the world of `other` to the world of `one`."""
    agreed: int
    """Number of frames of each part that agree on `way`."""
    seconds: float
    """Median time between the frames of the two parts, seconds."""


def join_groups(sightings: Sightings, poses: Poses, group: IntArray, prior: Prior) -> tuple[Poses, IntArray, Prior]:
    """Join groups by motion.

    Args:
        sightings: sightings of the tags.
        poses: rough poses; each group that images connect has a world of its own.
        group: group of each tag, `(K,)`, -1 for none.
        prior: prior with a motion.

    Returns:
        rough poses, the remaining groups, and the prior with the estimated spread of the motion.
    """
    assert prior.motion is not None
    parts = _parts(sightings, poses, group, prior)
    nodes = Nodes.of(sightings, parts, prior.motion)
    tags = np.where((group < 0)[:, None, None], np.eye(4), poses.tags)
    there, motion = _adjusted(nodes, smoothest(nodes, replace(poses, tags=tags)))
    joint = replace(prior.motion, spread=motion.spread, gaps=motion.gaps, bridged=motion.bridged)
    worlds, joined = _worlds(replace(nodes, motion=motion), there.frames, joint)
    tags = np.where((parts < 0)[:, None, None], np.nan, worlds[parts] @ there.tags)
    frames = np.full_like(poses.frames, np.nan)
    views = worlds[nodes.part] @ there.frames
    # Of several nodes of a frame the last node counts: the node with most tags or, in a tie, nearest to its neighbours.
    counts = np.bincount(nodes.sightings.frame, minlength=len(nodes.frame))
    before, after = nodes.following(LEAP_FOLLOWING)
    apart = np.linalg.norm(views[after, :3, 3] - views[before, :3, 3], axis=1)
    away = sum(np.bincount(end, apart, minlength=len(counts)) for end in (before, after))
    order = np.lexsort((-np.asarray(away), counts))
    frames[nodes.frame[order]] = views[order]
    whole = np.where(parts < 0, -1, joined[parts])
    alone = (np.bincount(whole[parts >= 0], minlength=len(joined))[whole] == 1) & (group < 0)
    tags[alone], whole[alone] = np.nan, -1
    result = np.where(whole < 0, -1, np.unique(np.append(whole, -1), return_inverse=True)[1][:-1] - 1)
    return Poses(tags, frames, poses.mounts), result, replace(prior, motion=joint)


def _parts(sightings: Sightings, poses: Poses, group: IntArray, prior: Prior) -> IntArray:
    """Part of each tag, `(K,)`; -1 for tags without sightings.

    A group with a tag of known pose stays one part.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(group)
    fits = agreeing(sightings, squared_errors(sightings, poses)) & (group[sightings.tag] >= 0)
    shown = coo_array(
        (np.ones(fits.sum()), (sightings.frame[fits], sightings.tag[fits])), shape=(sightings.frames, count)
    ).tocsr()
    together = (shown.T @ shown).tocoo()
    often = together.data >= TOGETHER
    known = np.flatnonzero(np.isin(group, np.unique(group[(group >= 0) & prior.information.any(axis=1)])))
    first = np.unique(group[known], return_index=True)[1]  # one tag of each group with a tag of known pose
    one = np.concatenate([together.row[often], known])
    other = np.concatenate([together.col[often], known[first][np.searchsorted(group[known][first], group[known])]])
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    seen = sightings.counts() > 0
    parts = np.full(count, -1)
    parts[seen] = np.unique(connected_components(graph, directed=False)[1][seen], return_inverse=True)[1]
    return parts


def _adjusted(nodes: Nodes, poses: Poses) -> tuple[Poses, Motion]:
    """Poses of the parts, each adjusted by itself, and the motion with its estimated spread."""
    some, motion = nodes.sightings, nodes.motion
    of_tag = np.full(len(poses.tags), -1)
    of_tag[some.tag] = nodes.part[some.frame]
    _, first = np.unique(of_tag, return_index=True)
    information = np.zeros((len(of_tag), 6))
    information[first[of_tag[first] >= 0]] = EXACT_SIGMA**-2.0
    for _ in range(2):
        adjustment = Adjustment(some, Prior(poses.tags, information, None, Mounts(poses.mounts), motion))
        poses, floor = adjustment.run(poses, FLOOR_PIXELS, STEPS)
        motion = adjustment.estimate_motion(poses, floor)
    assert adjustment.links is not None
    adjustment.links.check(poses.frames[adjustment.seen])
    return poses, motion if motion.is_odometry else with_bridged_gaps(motion, poses.frames)


def _worlds(nodes: Nodes, poses: FloatArray, motion: Motion) -> tuple[FloatArray, IntArray]:
    """Join parts by relations with which the body does not leap.

    A leap between two joined parts has one of two causes. If fewer frames of a part leap than support the weakest
    relation between the parts, those frames were misread; otherwise the relation is wrong.

    Args:
        nodes: nodes, with the motion between them.
        poses: poses of the nodes in the worlds of their parts, `(n, 4, 4)`.
        motion: motion between the frames.

    Returns:
        motions of the parts to common worlds, `(P, 4, 4)`; index of the world of each part, `(P,)`.
    """
    velocities = nodes.motion.links(np.arange(len(nodes.frame))).velocities(poses)
    relations = _relations(nodes, poses, motion, velocities)
    before, after = nodes.following(LEAP_FOLLOWING)
    seconds = nodes.motion.times[after] - nodes.motion.times[before]
    near = (seconds > 0.0) & (seconds < LONGEST_GAP) & (nodes.part[before] != nodes.part[after])
    before, after, seconds = before[near], after[near], seconds[near]
    speeds = np.linalg.norm(velocities[:, 3:], axis=1)
    fastest = np.nanquantile(speeds, 0.95) if np.isfinite(speeds).any() else FASTEST
    most = LEAP + LEAP_SPEEDS * fastest * seconds
    misread = np.zeros(len(nodes.frame), dtype=bool)
    while True:
        worlds, joined, joined_by = _spanned(int(nodes.part.max()) + 1, relations)
        places = (worlds[nodes.part] @ poses)[:, :3, 3]
        leaps = np.linalg.norm(places[after] - places[before], axis=1) > most
        leaps &= (joined[nodes.part[before]] == joined[nodes.part[after]]) & ~misread[before] & ~misread[after]
        if not leaps.any():
            return worlds, joined
        ends = np.stack([before[leaps], after[leaps]], axis=1)
        ends = np.take_along_axis(ends, np.argsort(nodes.part[ends], axis=1), axis=1)
        between, which, counts = np.unique(nodes.part[ends], axis=0, return_inverse=True, return_counts=True)
        own = ends[which.ravel() == np.argmax(counts)]
        fewest = min((np.unique(side) for side in own.T), key=len)
        weakest = joined_by[tuple(between[np.argmax(counts)])]
        if relations[weakest].agreed > len(fewest):
            misread[fewest] = True
        else:
            del relations[weakest]


def _spanned(count: int, relations: Sequence[Relation]) -> tuple[FloatArray, IntArray, IntArray]:
    """Worlds of parts, see `_worlds`, by the spanning tree that takes relations in their order.

    Returns:
        motions and worlds as in `_worlds`; index of the relation that first joined each pair of parts, which is the
        weakest relation between them, `(P, P)`.
    """
    worlds, joined = np.tile(np.eye(4), (count, 1, 1)), np.arange(count)
    joined_by = np.full((count, count), -1)
    for number, relation in enumerate(relations):
        if joined[relation.one] == joined[relation.other]:
            continue
        moved, still = joined == joined[relation.other], joined == joined[relation.one]
        joined_by[np.ix_(moved, still)] = joined_by[np.ix_(still, moved)] = number
        worlds[moved] = worlds[relation.one] @ relation.way @ inverse(worlds[relation.other]) @ worlds[moved]
        joined[moved] = joined[relation.one]
    return worlds, joined, joined_by


def _relations(nodes: Nodes, poses: FloatArray, motion: Motion, velocities: FloatArray) -> list[Relation]:
    """Relations of all pairs of parts with frames near in time, in the order of decreasing agreement."""
    i, j = nodes.following(FOLLOWING)
    swap = nodes.part[i] > nodes.part[j]
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    there = (nodes.part[i] < nodes.part[j]) & motion.relates(nodes.frame[i], nodes.frame[j])
    i, j = i[there], j[there]
    steps = nodes.motion.steps(i, j, velocities)
    known = np.isfinite(steps[:, 0, 0])
    i, j, steps = i[known], j[known], steps[known]
    between = poses[i] @ steps @ inverse(poses[j])
    away = np.abs(nodes.motion.times[j] - nodes.motion.times[i])
    key = nodes.part[i] * len(nodes.frame) + nodes.part[j]
    order = np.lexsort((away, key))
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    found = []
    for own in np.split(order, starts[1:]) if len(order) else []:
        own = own[:PAIRS]
        centre = median_pose(between[own])
        off = log(inverse(centre) @ between[own])
        near = (np.linalg.norm(off[:, :3], axis=1) < AGREE_TURN) & (np.linalg.norm(off[:, 3:], axis=1) < AGREE_PLACE)
        # A frame with a misread id is in many pairs, so each frame counts once.
        agreed = min(len(np.unique(i[own[near]])), len(np.unique(j[own[near]])))
        one, other = int(nodes.part[i[own[0]]]), int(nodes.part[j[own[0]]])
        found.append(Relation(one, other, centre, agreed, float(np.median(away[own]))))
    return sorted(found, key=lambda relation: (-relation.agreed, relation.seconds))


@dataclass(frozen=True)
class JoinedGroups:
    """Groups of a map that only motion joins."""

    group: IntArray
    """`(K,)` group of each tag, as images alone connect them; -1 for tags that are not in the map."""
    sigma: FloatArray
    """`(G,)` standard deviation of each group's place relative to the nearest other tags, in the worst direction, m."""


def joined_groups(found: Estimate, group: IntArray) -> JoinedGroups:
    """Groups that motion has joined, and the standard deviations of their places relative to each other.

    Args:
        found: estimate with a motion.
        group: group of each tag, `(K,)`, as images alone connect them; -1 for tags that no image connects with others.
    """
    alone = group < 0
    own = np.where(alone, group.max(initial=-1) + 1 + np.cumsum(alone), group)
    own = np.where(found.known, own, -1)
    own[found.known] = np.unique(own[found.known], return_inverse=True)[1]
    best = np.full(int(own.max(initial=-1)) + 1, np.inf)
    tags, covariance = found.poses.tags, found.covariance
    for k in np.flatnonzero(found.known).tolist():
        others = np.flatnonzero(found.known & (own != own[k]))
        near = others[np.argsort(np.linalg.norm(tags[others, :3, 3] - tags[k, :3, 3], axis=1))[:NEAREST]]
        for other in near.tolist():
            between = inverse(tags[k]) @ tags[other]
            slope = np.hstack([skew(between[:3, 3]), -np.eye(3), np.zeros((3, 3)), between[:3, :3]])
            rows = np.r_[6 * k : 6 * k + 6, 6 * other : 6 * other + 6]
            square = slope @ covariance[np.ix_(rows, rows)] @ slope.T
            best[own[k]] = min(best[own[k]], float(np.sqrt(np.linalg.eigvalsh(square)[-1])))
    return JoinedGroups(own, best)
