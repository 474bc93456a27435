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

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import angle_between, inverse, log, median_pose
from lmd.survey.initialisation import FLOOR_PIXELS, agreeing
from lmd.survey.linked_adjustment import LinkedAdjustment
from lmd.survey.links import MOST_SQUARE
from lmd.survey.motion import LONGEST_GAP, Motion, with_bridged_gaps
from lmd.survey.prior import EXACT_SIGMA, Prior
from lmd.survey.residuals import Poses, squared_errors
from lmd.survey.sightings import Sightings
from lmd.survey.single_poses import best_sequence, single_poses

TOGETHER = 3  # minimum number of agreeing images that put two tags into one part
# Errors of rough poses of frames: rotation, rad, and position, metres; and their growth by motion, per second.
ROUGH_TURN, ROUGH_PLACE, MOVING = 0.1, 0.15, 1.0
# Maximum number of following frames with which a frame gives relations, and of pairs of frames for each relation.
FOLLOWING, PAIRS = 12, 40
AGREE_TURN, AGREE_PLACE = 0.2, 0.3  # maximum deviation of a pair of frames from a relation, rad and metres
# A body leaps if, from a frame to one of the next `LEAP_FOLLOWING` frames, it moves farther than `LEAP`, metres, plus
# `LEAP_SPEEDS` times the distance at its highest speed. `FASTEST`, m/s, replaces an unknown highest speed.
LEAP, LEAP_SPEEDS, FASTEST, LEAP_FOLLOWING = 0.5, 2.0, 2.0, 3
# Odometry belongs to another camera or drive if the share of links that do not fit exceeds `MOST_OFF`, or if the bias
# exceeds `MOST_BIAS`, in units of `lmd.survey.motion.BIAS`.
MOST_OFF, MOST_BIAS = 0.5, 8.0
STEPS = 12  # steps of the bundle adjustment of parts


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


@dataclass(frozen=True)
class Nodes:
    """Nodes: pairs of a frame and a part that the frame shows, sorted by part, then by time."""

    sightings: Sightings
    """Sightings with nodes in place of frames."""
    frame: IntArray
    """`(n,)` frame of each node."""
    part: IntArray
    """`(n,)` part of each node."""
    motion: Motion
    """Motion between the nodes of each part."""

    @classmethod
    def of(cls, sightings: Sightings, part: IntArray, motion: Motion) -> "Nodes":
        """Nodes of all sightings of tags in parts `(K,)`."""
        key, node = np.unique(part[sightings.tag] * sightings.frames + sightings.frame, return_inverse=True)
        order = np.argsort(node, kind="stable")
        frame, own = key % sightings.frames, key // sightings.frames
        some = replace(sightings.of(order), frame=node[order], frames=len(key))
        return cls(some, frame, own, motion.of(frame, own))

    def following(self, count: int) -> tuple[IntArray, IntArray]:
        """Pairs of nodes, the second among the `count` nodes after the first in time."""
        order = np.lexsort((self.part, self.frame))
        ends = [(order[:-k], order[k:]) for k in range(1, min(count, len(order) - 1) + 1)]
        first, second = zip(*ends, strict=True) if ends else ((order[:0],), (order[:0],))
        return np.concatenate(first), np.concatenate(second)


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
    fits = _fitting(sightings, poses) & (group[sightings.tag] >= 0)
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


def _fitting(sightings: Sightings, poses: Poses) -> BoolArray:
    """True for sightings that agree with rough poses, `(N,)`."""
    error = squared_errors(sightings, poses)
    return np.asarray(agreeing(sightings, np.where(np.isfinite(error), error, np.inf)))


def smoothest(nodes: Nodes, poses: Poses) -> Poses:
    """Poses of the nodes in the worlds of their parts: the smoothest sequence of poses from their largest sightings and
    from the rough poses of frames.
    """
    some, count = nodes.sightings, len(nodes.frame)
    order = np.lexsort((-some.sizes, some.frame))
    best = order[np.searchsorted(some.frame[order], np.arange(count))]
    single = single_poses(some.of(best))
    views = poses.tags[some.tag[best]][:, None] @ inverse(poses.mounts[some.camera[best]][:, None] @ single.poses)
    costs = np.stack([np.zeros(count), single.odds], axis=1)
    placed = poses.frames[nodes.frame]
    several = np.bincount(some.frame[_fitting(some, replace(poses, frames=placed))], minlength=count) >= 2
    views[several] = placed[several, None]
    follows = np.flatnonzero(nodes.motion.follows(np.arange(count)))
    between = np.zeros((count, 2, 2))  # cost of each pose, given each pose of the previous node
    steps = nodes.motion.steps(follows, follows + 1)
    seconds = nodes.motion.times[follows + 1] - nodes.motion.times[follows]
    moving = 0.0 if nodes.motion.is_odometry else MOVING * seconds
    for here in range(2):
        for there in range(2):
            off = inverse(views[follows, here] @ steps) @ views[follows + 1, there]
            turn = angle_between(off, np.eye(4)) / np.hypot(ROUGH_TURN, moving)
            place = np.linalg.norm(off[:, :3, 3], axis=1) / np.hypot(ROUGH_PLACE, moving)
            between[follows + 1, there, here] = np.log1p(turn**2 + place**2)
    which = best_sequence(costs, between)
    return replace(poses, frames=views[np.arange(count), which])


def _adjusted(nodes: Nodes, poses: Poses) -> tuple[Poses, Motion]:
    """Poses of the parts, each adjusted by itself, and the motion with its estimated spread."""
    some, motion = nodes.sightings, nodes.motion
    of_tag = np.full(len(poses.tags), -1)
    of_tag[some.tag] = nodes.part[some.frame]
    _, first = np.unique(of_tag, return_index=True)
    information = np.zeros((len(of_tag), 6))
    information[first[of_tag[first] >= 0]] = EXACT_SIGMA**-2.0
    for _ in range(2):
        adjustment = LinkedAdjustment(some, Prior(poses.tags, information, None, poses.mounts, motion))
        poses, floor = adjustment.run(poses, FLOOR_PIXELS, STEPS)
        motion = adjustment.estimate_motion(poses, floor)
    check_odometry(adjustment, poses)
    return poses, motion if motion.is_odometry else with_bridged_gaps(motion, poses.frames)


def check_odometry(adjustment: LinkedAdjustment, poses: Poses) -> None:
    """Raise `InputError` if odometry contradicts the images."""
    if not adjustment.motion.is_odometry or not len(adjustment.links.first):
        return
    at = adjustment.links.at(poses.frames[adjustment.seen])
    off = float((adjustment.links.squares(at.error) > MOST_SQUARE).mean())
    if off > MOST_OFF or np.abs(at.bias).max() > MOST_BIAS:
        raise InputError(
            "odometry does not move as the images do: does it need a mount or frame=body, as it describes a body and "
            "not the (first) camera, or is it of another drive?",
            "odometry",
        )


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
